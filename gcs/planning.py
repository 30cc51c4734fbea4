"""From a mission to a certified plan.

The mission is laid on its plane (`gcs.layout`); the planner finds the curve (`gcs.solving`); schedule and
contingencies are worked out; and everything is measured again, the ranges as true slant ranges.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version

import numpy as np
from numpy.typing import NDArray

from gcs.contingency import contingencies
from gcs.errors import PlanningFailed
from gcs.geodesy import Plane
from gcs.layout import LaidOut, lay_out
from gcs.mission import Mission
from gcs.plan import Plan
from gcs.schedule import schedule
from gcs.solving import PlannerLike, laid_out, solve
from planner import Planner
from planner.bound import lower_bound
from planner.certificate import Certificate, certify
from planner.planner import Method
from planner.solution import Solution
from planner.trajectory import Trajectory

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]


def product_version() -> str:
    """Version of this product, as installed."""
    try:
        return version("skyrelay")
    except PackageNotFoundError:
        return "0+unknown"


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
    and a fraction from 0 to 1. ``plane`` is where to plan, where it is not left to `gcs.ground.choose_plane`.

    Raises `MissionInfeasible` and `PlanningFailed`; `MissionError` when the stations flown cannot get system ids.
    """
    begin = time.perf_counter()
    tell = progress or (lambda phase, fraction: None)
    tell("preparing", 0.0)
    laid = laid_out(mission, plane)
    worker = planner if planner is not None else default_planner()
    tell("planning", 0.05)
    solution = solve(laid, worker, method or ("fast" if fast else "joint"), time_limit_s)
    tell("scheduling", 0.9)
    trajectory = solution.trajectory
    certificate = certify_true(laid, trajectory)
    if not certificate.feasible:
        raise PlanningFailed(f"the plan made by {solution.method} fails its own certificate: {certificate.broken}")
    curve = Trajectory(trajectory.control_points_m, trajectory.durations_s, laid.stations[trajectory.station_index])
    named = mission.with_system_ids(curve.sequence)
    ground = laid.ground.renamed(named)
    remarks = [*notes, *solution.notes]
    if time_limit_s is not None:
        remarks.append(f"planned within a time limit of {time_limit_s:g} s: another machine may plan otherwise")
    plan = Plan(
        mission=named,
        trajectory=curve,
        plane=ground.plane,
        handovers=schedule(ground, curve),
        contingencies=contingencies(ground, curve),
        certificate=certificate,
        lower_bound_s=_lower_bound_s(laid, solution),
        path_length_m=curve.path_length_m(),
        solve_time_s=time.perf_counter() - begin,
        created_utc=utc_text(created_utc or datetime.now(UTC)),
        method=solution.method,
        planner_version=product_version(),
        iterations=solution.iterations,
        notes=tuple(remarks),
    )
    tell("done", 1.0)
    return plan


_shared_planner: PlannerLike | None = None


def default_planner() -> PlannerLike:
    """The planner of this process, made once: it keeps what it compiled."""
    global _shared_planner
    if _shared_planner is None:
        _shared_planner = Planner()
    return _shared_planner


def utc_text(moment: datetime) -> str:
    """RFC 3339 in UTC, whole seconds."""
    return moment.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def certify_true(laid: LaidOut, trajectory: Trajectory) -> Certificate:
    """The certificate of a trajectory (station indices of ``laid.problem``), with true ranges and speeds.

    ``range_m`` is the excess over the full range, of the larger of true range and its bound (`gcs.ranges`) at every
    control point: the bound is convex, so what holds at the control points holds on the curve. ``range_margin_m`` is
    the same over the range less the margin asked for. In a WGS84 mission ``speed_m_s`` is that at the top of the
    altitude band.
    """
    problem, ground = laid.problem, laid.ground
    # Minus infinity: a limit none of the stations flown has.
    worst = {name: value for name, value in certify(problem, trajectory).worst.items() if value > -np.inf}
    worst["plane_range_m"] = worst.pop("range_m")
    stations = laid.stations[trajectory.station_index][:, None]
    points = trajectory.control_points_m
    reach = np.maximum(ground.true_range_m(stations, points), ground.range_bound_m(stations, points))
    excess = float((reach - ground.full_ranges_m[stations]).max())
    margin = ground.mission.options.range_margin_m
    limits = ground.mission.limits
    if not ground.is_local:
        k = limits.max_speed_m_s / problem.limits.max_speed_m_s
        worst["speed_m_s"] = (worst["speed_m_s"] + problem.limits.max_speed_m_s) * k - limits.max_speed_m_s
        # Undo one rounding of the product above, never more.
        if 0.0 < worst["speed_m_s"] <= 4e-16 * limits.max_speed_m_s:
            worst["speed_m_s"] = 0.0
    first = {"range_m": excess}
    if margin > 0:
        first["range_margin_m"] = float((reach - (ground.full_ranges_m[stations] - margin)).max())
    return Certificate({**first, **worst})


def recertify(plan: Plan) -> Certificate:
    """The certificate of a plan measured anew from its mission and its curve, whatever its document says."""
    laid = lay_out(plan.mission, plan.plane)
    back = {int(station): k for k, station in enumerate(laid.stations)}
    try:
        stations = np.array([back[int(i)] for i in plan.trajectory.station_index])
    except KeyError as error:
        raise PlanningFailed(f"the plan uses station {error}, which its mission excludes") from None
    return certify_true(laid, Trajectory(plan.trajectory.control_points_m, plan.trajectory.durations_s, stations))


def _lower_bound_s(laid: LaidOut, solution: Solution) -> float:
    """The solution's bound, or one of its own where elevation or wind are corrected for the projection."""
    limits = laid.ground.mission.limits
    problem = laid.problem
    if laid.ground.is_local or (problem.min_elevation_deg is None and problem.limits.max_airspeed_m_s is None):
        return solution.lower_bound_s
    wider = problem.limits
    if limits.max_airspeed_m_s is not None and wider.max_airspeed_m_s is not None:
        taken_off = limits.max_airspeed_m_s - wider.max_airspeed_m_s
        wider = replace(wider, max_airspeed_m_s=(limits.max_airspeed_m_s + taken_off) * problem.bound_speed_factor)
    lowest = laid.ground.min_elevations_deg[laid.stations]
    # What truly is above e shows in the plane above e less 0.1 degree (deflection of the vertical, stretch).
    lowest = np.where(lowest > 0.1, lowest - 0.1, -90.0)
    return lower_bound(replace(problem, limits=wider, min_elevation_deg=lowest)).time_s


__all__ = [
    "LaidOut",
    "PlannerLike",
    "certify_true",
    "default_planner",
    "lay_out",
    "plan_mission",
    "product_version",
    "recertify",
    "utc_text",
]
