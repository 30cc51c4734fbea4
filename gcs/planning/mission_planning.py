"""From a mission to a certified plan.

The mission is laid on its plane (`gcs.layout.planning_problem`); the planner finds the curve (`gcs.planning.solve`);
schedule and contingencies are worked out; and everything is measured again, the ranges as true slant ranges. What shows
on the way that nobody can fly it is raised as a finding, and explained once, at the end (`gcs.remedies.explanation`).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version

from gcs.errors import Finding, PlanningFailed
from gcs.geodesy.plane import Plane
from gcs.layout.planning_problem import lay_out
from gcs.layout.problem_planner import PlannerLike, ProblemPlanner
from gcs.mission.model import Mission, overlap_after_target_s
from gcs.mission.plausibility import doubts
from gcs.mission.system_ids import MOST_STATIONS
from gcs.plan.contingency import contingencies
from gcs.plan.handover_schedule import Handover, schedule
from gcs.plan.model import Fastest, Plan
from gcs.planning.certification import certify_true, true_lower_bound_s
from gcs.planning.solve import solve
from gcs.remedies.explanation import explain
from gcs.remedies.findings import TooManyStations
from gcs.timestamps import utc_text
from planner import Method, Planner, Problem, Solution, Trajectory

Progress = Callable[[str, float], None]


def product_version() -> str:
    """Version of this product, as installed."""
    try:
        return version("skyrelay")
    except PackageNotFoundError:
        return "0+unknown"


@dataclass(frozen=True)
class PlanningMethod:
    """How to plan, as `plan_mission` is told."""

    planner: ProblemPlanner
    created_utc: datetime | None = None
    notes: Sequence[str] = ()
    progress: Progress | None = None
    plane: Plane | None = None


def plan_mission(
    mission: Mission,
    *,
    fast: bool = False,
    method: Method | None = None,
    planner: PlannerLike | None = None,
    time_limit_s: float | None = None,
    created_utc: datetime | None = None,
    notes: Sequence[str] = (),
    progress: Progress | None = None,
    plane: Plane | None = None,
) -> Plan:
    """Plan a mission.

    ``method`` is one of `planner.Planner.plan`'s (default ``"joint"``; ``fast``: ``"fast"``). ``time_limit_s`` makes
    the result depend on the machine and is recorded. ``notes`` go into the plan. ``progress`` is called with a phase
    and a fraction from 0 to 1. ``plane`` is where to plan, where it is not left to
    `gcs.layout.mission_geometry.choose_plane`.

    Raises `MissionInfeasible` and `PlanningFailed`; `MissionError` when the stations flown cannot get system ids.
    """
    how = PlanningMethod(
        problem_planner(planner, method or ("fast" if fast else "joint"), time_limit_s),
        created_utc=created_utc,
        notes=notes,
        progress=progress,
        plane=plane,
    )
    try:
        try:
            return find_plan(mission, how)
        except TooManyStations as crowd:
            return _with_fewer_stations(crowd, how)
    except Finding as finding:
        # The one place where it is asked what would help; nothing below looks for it.
        raise explain(finding, how.planner) from finding


def _with_fewer_stations(crowd: TooManyStations, how: PlanningMethod) -> Plan:
    """A slower plan with as many stations as there are system ids. Raises ``crowd`` where there is none."""
    options = replace(crowd.mission.options, max_handovers=crowd.most - 1)
    note = f"max_handovers {crowd.most - 1}: system ids tell no more than {crowd.most} stations apart"
    try:
        return find_plan(replace(crowd.mission, options=options), replace(how, notes=(*how.notes, note)))
    except Finding:
        raise crowd from None


def find_plan(mission: Mission, how: PlanningMethod) -> Plan:
    """As `plan_mission`, for those who may do without an explanation: raises `Finding`, not `MissionInfeasible`."""
    begin = time.perf_counter()
    tell = how.progress or (lambda phase, fraction: None)
    tell("preparing", 0.0)
    laid = lay_out(mission, how.plane)
    tell("planning", 0.05)
    solution = solve(laid, how.planner)
    tell("scheduling", 0.9)
    trajectory = solution.trajectory
    certificate = certify_true(laid, trajectory)
    if not certificate.feasible:
        raise PlanningFailed(f"the plan made by {solution.method} fails its own certificate: {certificate.broken}")
    curve = Trajectory(trajectory.control_points_m, trajectory.durations_s, laid.stations[trajectory.station_index])
    count = len(set(curve.sequence))
    if count > MOST_STATIONS:
        raise TooManyStations(mission, count=count, most=MOST_STATIONS)
    named = mission.with_system_ids(curve.sequence)
    geometry = laid.geometry.renamed(named)
    remarks = [*how.notes, *solution.notes, *doubts(mission)]
    if how.planner.time_limit_s is not None:
        remarks.append(
            f"planned within a time limit of {how.planner.time_limit_s:g} s: another machine may plan otherwise"
        )
    fastest = None
    if solution.fastest_s is not None and solution.fastest_handovers is not None:
        fastest = Fastest(solution.fastest_s, solution.fastest_handovers, solution.fewer_cost_s)
    handovers = schedule(geometry, curve)
    remarks += _overlap_remarks(mission, solution, handovers)
    plan = Plan(
        mission=named,
        trajectory=curve,
        plane=geometry.plane,
        handovers=handovers,
        contingencies=contingencies(geometry, curve),
        certificate=certificate,
        lower_bound_s=true_lower_bound_s(laid, solution),
        path_length_m=curve.path_length_m(),
        solve_time_s=time.perf_counter() - begin,
        created_utc=utc_text(how.created_utc or datetime.now(UTC)),
        method=solution.method,
        planner_version=product_version(),
        iterations=solution.iterations,
        notes=tuple(remarks),
        fastest=fastest,
    )
    tell("done", 1.0)
    return plan


def _overlap_remarks(mission: Mission, solution: Solution, handovers: Sequence[Handover]) -> list[str]:
    """What the overlaps aimed at cost, and which handovers fall short of them."""
    target_s = overlap_after_target_s(mission.options, mission.limits)
    remarks = []
    if solution.overlap_cost_s >= 0.05:
        remarks.append(
            f"overlaps as long as aimed at ({target_s:.1f} s after a handover) cost {solution.overlap_cost_s:.1f} s"
        )
    short = [h for h in handovers if h.overlap_end_s - h.time_s < target_s - 1e-6]
    if short:
        which = ", ".join(f"{h.index} ({h.overlap_end_s - h.time_s:.1f} s)" for h in short)
        price_s = Problem.price_s(solution.trajectory.duration_s)
        remarks.append(
            f"handovers that fall short of {target_s:.1f} s of overlap after them, which would cost more than "
            f"{price_s:.1f} s each: {which}"
        )
    return remarks


def problem_planner(planner: PlannerLike | None, method: Method, time_limit_s: float | None = None) -> ProblemPlanner:
    """``planner``, or this process's where there is none, asked for ``method``."""
    return ProblemPlanner(planner if planner is not None else default_planner(), method, time_limit_s)


_shared_planner: PlannerLike | None = None


def default_planner() -> PlannerLike:
    """The planner of this process, made once: it keeps what it compiled."""
    global _shared_planner
    if _shared_planner is None:
        _shared_planner = Planner()
    return _shared_planner
