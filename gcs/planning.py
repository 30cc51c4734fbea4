"""From a mission to a certified plan.

The mission is laid on its plane; margin and projection error come off the ranges (`gcs.ranges`); the planner finds
the curve; schedule and contingencies are worked out; and everything is measured again, the ranges as true slant ranges.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gcs.contingency import contingencies
from gcs.errors import MissionInfeasible, PlanningFailed
from gcs.geodesy import Plane
from gcs.ground import Ground, choose_plane
from gcs.infeasible import explain
from gcs.mission import Mission
from gcs.plan import Plan
from gcs.ranges import (
    bound_speed_factor,
    height_factor,
    planning_elevation_deg,
)
from gcs.schedule import schedule
from planner import Planner
from planner.bound import lower_bound
from planner.certificate import Certificate, certify
from planner.errors import InfeasibleError, ProblemError, SolverError
from planner.infeasibility import too_long
from planner.planner import Method
from planner.problem import Limits, Problem
from planner.solution import Solution
from planner.trajectory import Trajectory

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]


class PlannerLike(Protocol):
    """What planning needs of a planner: `planner.Planner`."""

    def plan(self, problem: Problem, *, method: Method = "joint", time_limit_s: float | None = None) -> Solution:
        """A certified solution; raises `planner.InfeasibleError` or `planner.SolverError`."""
        ...


@dataclass(frozen=True)
class LaidOut:
    """A mission as a planning problem. ``stations`` ``(M',)`` are the mission's indices of the problem's stations."""

    ground: Ground
    problem: Problem
    stations: NDArray[np.int64]


def product_version() -> str:
    """Version of this product, as installed."""
    try:
        return version("skyrelay")
    except PackageNotFoundError:
        return "0+unknown"


def lay_out(mission: Mission, plane: Plane | None = None) -> LaidOut:
    """The planning problem of a mission, in ``plane`` or one of its own.

    Raises `MissionInfeasible` when the margin leaves no station any range.
    """
    ground = Ground(mission, plane if plane is not None else choose_plane(mission))
    options, limits, plane = mission.options, mission.limits, ground.plane
    less_margin = ground.full_ranges_m - options.range_margin_m
    planned = ground.inner_ranges_m(less_margin)
    kept = np.array([s.id not in options.excluded_stations for s in mission.stations]) & (planned > 0.0)
    stations = np.flatnonzero(kept)
    start, destination = ground.enu_m([mission.start, mission.destination])
    if not len(stations):
        raise _no_range_left(ground, start, destination)
    at, bound = ground.stations_enu_m, ground.outer_ranges_m(np.maximum(less_margin, 0.0))
    # On the earth a way at altitude is longer than on the plane: the plane's speed limit is that much lower.
    k = 1.0 if ground.is_local else float(height_factor(limits.max_alt_amsl_m))
    farthest = float((np.hypot(at[stations, 0], at[stations, 1]) + bound[stations]).max())
    elevation = ground.min_elevations_deg[stations]
    airspeed, turn = limits.max_airspeed_m_s, 0.0
    if not ground.is_local:
        raised = np.minimum(planning_elevation_deg(elevation, ground.full_ranges_m[stations]), 89.9)
        elevation = np.where(elevation > -90.0, raised, elevation)
        if airspeed is not None:
            turn = _wind_turn_m_s(ground, stations, bound)
            airspeed = (airspeed - turn) / k
    state = options.start_state
    velocity, acceleration = np.zeros(3), np.zeros(3)
    if state is not None:
        velocity, acceleration = np.array(state.velocity_m_s), np.array(state.acceleration_m_s2)
        if not ground.is_local:
            back = np.linalg.inv(plane.true_axes(start[0], start[1], plane.altitude_amsl_m(start[2])))
            velocity[:2], acceleration[:2] = back @ velocity[:2], back @ acceleration[:2]
    endurance = None if limits.endurance_s is None else limits.endurance_s - (limits.reserve_s or 0.0)
    wind = float(np.hypot(*(limits.wind_m_s or (0.0, 0.0))))
    if airspeed is not None and airspeed <= wind:
        needed = 1.1 * (wind * k + turn)  # a tenth more than it takes to stand still
        raise MissionInfeasible(
            "limits",
            "The wind is as fast as the airspeed limit: the vehicle cannot hold its place, nor start or end at rest.",
            fix={"action": "raise_limit", "limit": "max_airspeed_m_s", "to": needed},
            fix_text=f"Wait for less wind, or raise max_airspeed_m_s to {needed:.1f} m/s.",
        )
    try:
        problem = Problem(
            start_m=start,
            destination_m=destination,
            station_positions_m=at[stations],
            ranges_m=planned[stations],
            limits=Limits(
                min_alt_m=limits.min_alt_amsl_m - plane.alt_amsl_m,
                max_alt_m=limits.max_alt_amsl_m - plane.alt_amsl_m,
                max_speed_m_s=limits.max_speed_m_s / k,
                max_accel_m_s2=limits.max_accel_m_s2,
                max_jerk_m_s3=limits.max_jerk_m_s3,
                max_climb_m_s=limits.max_climb_m_s,
                max_descent_m_s=limits.max_descent_m_s,
                max_airspeed_m_s=airspeed,
                wind_m_s=limits.wind_m_s or (0.0, 0.0),
                max_duration_s=endurance,
            ),
            min_overlap_s=options.min_overlap_s,
            min_tenure_s=options.min_tenure_s,
            max_handovers=options.max_handovers,
            bound_ranges_m=None if ground.is_local else bound[stations],
            bound_speed_factor=1.0 if ground.is_local else k * bound_speed_factor(farthest, limits.min_alt_amsl_m),
            min_elevation_deg=elevation if (elevation > -90.0).any() else None,
            start_velocity_m_s=velocity,
            start_acceleration_m_s2=acceleration,
        )
    except ProblemError as error:
        raise PlanningFailed(f"the mission passed the door but makes no problem: {error}") from error
    return LaidOut(ground, problem, stations)


def _no_range_left(ground: Ground, start: Array, destination: Array) -> MissionInfeasible:
    """The margin eats every range: says the largest one with which both ends are covered."""
    mission = ground.mission
    reach = [np.linalg.norm(ground.stations_enu_m - end, axis=1) for end in (start, destination)]
    spare = [float((ground.full_ranges_m - ground.needed_ranges_m(r)).max()) for r in reach]
    margin = max(0.0, min(spare))
    widest = int(ground.full_ranges_m.argmax())
    return MissionInfeasible(
        "start_uncovered",
        f"The range margin of {mission.options.range_margin_m:g} m leaves no station any range.",
        stations=[mission.stations[widest].id],
        gap_m=float(mission.options.range_margin_m - ground.full_ranges_m[widest]),
        fix={"action": "lower_margin", "by_m": mission.options.range_margin_m - margin, "range_margin_m": margin},
        fix_text=f"Lower range_margin_m to {np.floor(margin * 10.0) / 10.0:g} m.",
    )


def _wind_turn_m_s(ground: Ground, stations: NDArray[np.int64], reach_m: Array) -> float:
    """How far the wind, constant along true axes, can differ from the same wind along the plane's, within all ranges.

    The axes turn with the distance from the origin; the largest difference on rings around the stations, a twentieth
    more for what lies between the samples.
    """
    wind = np.array(ground.mission.limits.wind_m_s or (0.0, 0.0))
    angle = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    at = ground.stations_enu_m[stations, None, :2] + reach_m[stations, None, None] * ring
    axes = ground.plane.true_axes(at[..., 0], at[..., 1])
    return float(1.05 * np.linalg.norm(axes @ wind - wind, axis=-1).max())


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
    laid = lay_out(mission, plane)
    worker = planner if planner is not None else default_planner()
    tell("planning", 0.05)
    solution = _solve(laid, worker, method or ("fast" if fast else "joint"), time_limit_s)
    tell("scheduling", 0.9)
    trajectory = _arrive(mission, solution.trajectory)
    certificate = certify_true(laid, trajectory)
    if not certificate.feasible:
        broken = {name: value for name, value in certificate.worst.items() if value > 0}
        raise PlanningFailed(f"the plan made by {solution.method} fails its own certificate: {broken}")
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


def _solve(laid: LaidOut, planner: PlannerLike, method: Method, time_limit_s: float | None) -> Solution:
    """The planner's solution, its refusals in the mission's words."""
    problem = laid.problem
    try:
        try:
            return planner.plan(problem, method=method, time_limit_s=time_limit_s)
        except SolverError:
            if problem.limits.max_duration_s is None:
                raise
        # An endurance hardly above the bound can be more than the solver manages: how long does it take without?
        free = replace(problem, limits=replace(problem.limits, max_duration_s=None))
        solution = planner.plan(free, method=method, time_limit_s=time_limit_s)
        finding = too_long(problem, solution.trajectory.duration_s)
        if finding is not None:
            raise InfeasibleError(finding)
        return solution
    except InfeasibleError as error:
        raise explain(laid.ground, laid.stations, error.infeasibility, problem.ranges_m) from error
    except SolverError as error:
        raise PlanningFailed(f"every planning method gave up: {error}") from error


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


def _arrive(mission: Mission, trajectory: Trajectory) -> Trajectory:
    """Slowed to arrive when asked: the same path, all limits kept with more to spare."""
    wished = mission.options.arrival_s
    if wished is None:
        return trajectory
    if wished < trajectory.duration_s:
        raise MissionInfeasible(
            "arrival",
            f"The fastest plan found takes {trajectory.duration_s:.1f} s, but arrival is asked for at {wished:g} s.",
            fix={"action": "later_arrival", "by_s": trajectory.duration_s - wished},
            fix_text=f"Ask for arrival_s of {np.ceil(trajectory.duration_s):.0f} or later.",
        )
    slowed = trajectory.scale_time(wished / trajectory.duration_s)
    limit = mission.limits.endurance_s
    if limit is not None and slowed.duration_s > limit - (mission.limits.reserve_s or 0.0):
        raise MissionInfeasible(
            "endurance",
            f"Arrival at {wished:g} s is later than endurance less reserve allow.",
            fix_text="Ask for an earlier arrival_s.",
        )
    return slowed


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
