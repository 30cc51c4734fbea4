"""The seed paper's method, Algorithms 1 to 3, a module a step.

Qi, Dou, Xin: 3D Smooth Trajectory Planning for UAVs under Navigation Relayed by Multiple Stations Using Bézier
Curves. Electronics 2023, 12, 2358. Equation, algorithm and table numbers in these modules are the paper's.

==================  ===================================================================================
station_graph       upper level: adjacency (Proposition 1), edge weights (26) to (28), Dijkstra
boundary            boundary conditions D (29), and the control points they fix
initial             Algorithm 2: the initial trajectory (31) to (36)
control_points      P5, control points with durations fixed (37)
cone_rows           how P5 becomes rows of a cone program whose numbers follow the durations
time_search         Algorithm 3: durations with boundary conditions fixed
alternating         Algorithm 1: alternating minimisation, `alternating.plan_paper`
==================  ===================================================================================

P4, the shortest polyline through the overlaps (30), and the constraints (17), (19), (21) are `planner.corridor`'s; what
the paper compares its method with is in `planner.experiments`. All of it works on a `planner.Corridor`, of which the
paper's one ball a piece is the simplest: overlap and tenure add pieces in two balls and least durations. Errata met:
Proposition 1 must read "<=", (30b) and (30c) bind W_i to the ranges of stations i and i + 1, and Algorithm 1 goes on
while there is time *and* gain.
"""

from planner.paper.alternating import Iteration, plan_paper
from planner.paper.station_graph import shortest_sequence

__all__ = ["Iteration", "plan_paper", "shortest_sequence"]
