"""The seed paper's method, its experiments and its rivals, a module a step.

Qi, Dou, Xin: 3D Smooth Trajectory Planning for UAVs under Navigation Relayed by Multiple Stations Using Bézier
Curves. Electronics 2023, 12, 2358. Equation, algorithm and table numbers in these modules are the paper's.

==================  ===================================================================================
station_graph       upper level: adjacency (Proposition 1), edge weights (26) to (28), Dijkstra
waypoints           P4, the shortest polyline through the overlaps (30)
refuge              points every joint can fall back to: feasibility at zero tolerance
boundary            boundary conditions D (29), and the control points they fix
initial             Algorithm 2: the initial trajectory (31) to (36)
control_points      P5, control points with durations fixed (37)
cone_rows           how P5 becomes rows of a cone program whose numbers follow the durations
feasibility         constraints (17), (19), (21) of given control points
time_search         Algorithm 3: durations with boundary conditions fixed
am                  Algorithm 1: alternating minimisation, `am.plan_paper`
reference           P4 and P5 in cvxpy, as the paper writes them; the whole method through it
enumeration         EM of Table 3: every station sequence
rivals              the seven optimisers of Table 4
==================  ===================================================================================

All of it works on a `planner.Corridor`, of which the paper's one ball a piece is the simplest: overlap and tenure
add pieces in two balls and least durations. Errata met: Proposition 1 must read "<=", (30b) and (30c) bind W_i to
the ranges of stations i and i + 1, and Algorithm 1 goes on while there is time *and* gain.
"""

from planner.paper.alternating import Iteration, plan_paper
from planner.paper.station_graph import shortest_sequence

__all__ = ["Iteration", "plan_paper", "shortest_sequence"]
