"""The mathematics of relayed flights: ranges, routing, Bézier curves, programs, bounds, certificates.

Plain numpy in and out, metres and seconds in a local plane; no I/O and no clock.
"""

from planner.certificate import Certificate, certify
from planner.corridor.corridor import Corridor, Piece, build_corridor
from planner.errors import Infeasibility, InfeasibleError, PlannerError, ProblemError, SolverError
from planner.planner import Method, Planner
from planner.problem import Limits, Problem
from planner.routing.bound import LowerBound, lower_bound
from planner.solution import Solution
from planner.trajectory import Trajectory

__all__ = [
    "Certificate",
    "Corridor",
    "Infeasibility",
    "InfeasibleError",
    "Limits",
    "LowerBound",
    "Method",
    "Piece",
    "Planner",
    "PlannerError",
    "Problem",
    "ProblemError",
    "Solution",
    "SolverError",
    "Trajectory",
    "build_corridor",
    "certify",
    "lower_bound",
]
