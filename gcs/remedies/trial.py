"""Missions on trial: whether a changed mission can be flown, as far as that can be told without ado."""

from __future__ import annotations

import math
from collections.abc import Sequence

from gcs.errors import Finding
from gcs.layout.planning_problem import in_a_hurry, lay_out, without_endurance
from gcs.layout.problem_planner import ProblemPlanner
from gcs.mission.model import Mission
from gcs.remedies.application import applied
from gcs.remedies.remedy import Remedy
from planner import InfeasibleError, SolverError
from planner.infeasibility import diagnose, infeasibility_of
from planner.joint import Effort, plan_joint
from planner.routing import candidate_routes, lower_bound

# A start state that can be taken up takes the solver twenty or thirty steps.
START_EFFORT = Effort(1, 4, max_iterations=60)
# Remedies whose flight is planned to say what they cost, and on how large maps.
MAX_PRICED = 4
MAX_PRICED_STATIONS = 300


def is_linked(mission: Mission) -> bool:
    """Whether ranges, band, elevations and handovers allowed leave a way from start to destination."""
    try:
        return diagnose(lay_out(mission).problem) is None
    except Finding:
        return False


def planned_s(mission: Mission, planner: ProblemPlanner) -> float:
    """How long the fastest plan of a mission takes, whatever its endurance; infinite when it has none.

    Raises `Finding` for a mission that makes no problem.
    """
    try:
        return planner.plan(in_a_hurry(lay_out(mission).problem)).trajectory.duration_s
    except (InfeasibleError, SolverError):
        return math.inf


def prices_s(mission: Mission, remedies: Sequence[Remedy], planner: ProblemPlanner) -> dict[Remedy, float]:
    """How long the flight takes after each of the first few remedies, of those that make one: what they cost."""
    if len(mission.stations) > MAX_PRICED_STATIONS:
        return {}
    prices: dict[Remedy, float] = {}
    for remedy in remedies[:MAX_PRICED]:
        try:
            prices[remedy] = planned_s(applied(mission, remedy), planner)
        except Finding:
            continue
    return {remedy: time_s for remedy, time_s in prices.items() if math.isfinite(time_s)}


def can_start(mission: Mission) -> bool:
    """Whether a quick look finds a way to take up the start state, along the sequence that looks best.

    Finding none takes a solver far longer than finding one: it is given few steps, and one try. Raises `Finding` for a
    mission that makes no problem.
    """
    problem = without_endurance(lay_out(mission).problem)
    bound = lower_bound(problem)
    if infeasibility_of(problem, bound.time_s) is not None:
        return False
    (route,) = candidate_routes(problem, 1, bound=bound)
    return plan_joint(problem, route.sequence, START_EFFORT, starts=1) is not None
