"""A mission laid out as a planning problem: margin and projection error off its ranges, its limits made the plane's."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gcs.errors import PlanningFailed
from gcs.geodesy.plane import Plane
from gcs.geodesy.range_bounds import bound_speed_factor, height_factor
from gcs.layout.findings import NoAirspeed, NoRangeLeft
from gcs.layout.mission_geometry import MissionGeometry, choose_plane
from gcs.mission.model import Mission, overlap_after_target_s
from planner import Limits, Problem, ProblemError
from planner.arrays import Array, Indices


@dataclass(frozen=True)
class PlanningProblem:
    """A mission as a planning problem. ``stations`` ``(M',)`` are the mission's indices of the problem's stations."""

    geometry: MissionGeometry
    problem: Problem
    stations: Indices


def lay_out(mission: Mission, plane: Plane | None = None) -> PlanningProblem:
    """The planning problem of a mission, in ``plane`` or one of its own.

    Raises `NoRangeLeft` and `NoAirspeed` (`gcs.layout.findings`).
    """
    geometry = MissionGeometry(mission, choose_plane(mission) if plane is None else plane)
    options, limits = mission.options, mission.limits
    less_margin = geometry.full_ranges_m - options.range_margin_m
    planned = geometry.inner_ranges_m(less_margin)
    excluded = frozenset(options.excluded_stations)
    stations = np.flatnonzero(np.array([s.id not in excluded for s in mission.stations]) & (planned > 0.0))
    if not len(stations):
        raise NoRangeLeft(mission)
    at, bound = geometry.stations_enu_m[stations], geometry.outer_ranges_m(np.maximum(less_margin, 0.0))[stations]
    # On the earth a way at altitude is longer than on the plane: the plane's speed limit is that much lower.
    k = 1.0 if geometry.is_local else float(height_factor(limits.max_alt_amsl_m))
    farthest = float((np.hypot(at[:, 0], at[:, 1]) + bound).max())
    mask = geometry.planning_mask(stations)
    start, destination = geometry.enu_m([mission.start, mission.destination])
    velocity, acceleration = _start_state(geometry, start)
    airspeed_m_s = _airspeed_m_s(geometry, np.stack([start, destination]), k)
    try:
        problem = Problem(
            start_m=start,
            destination_m=destination,
            station_positions_m=at,
            ranges_m=planned[stations],
            limits=_plane_limits(geometry, k, airspeed_m_s),
            min_overlap_s=options.min_overlap_s,
            min_tenure_s=options.min_tenure_s,
            max_handovers=options.max_handovers,
            handover_tolerance=options.handover_tolerance,
            overlap_after_target_s=_after_target_s(mission),
            bound_ranges_m=None if geometry.is_local else bound,
            bound_speed_factor=1.0 if geometry.is_local else k * bound_speed_factor(farthest, limits.min_alt_amsl_m),
            min_elevation_deg=mask.lowest_deg if mask.limited.any() else None,
            wind=wind_of(geometry),
            start_velocity_m_s=velocity,
            start_acceleration_m_s2=acceleration,
        )
    except ProblemError as error:
        raise PlanningFailed(f"the mission passed the door but makes no problem: {error}") from error
    return PlanningProblem(geometry, problem, stations)


def _after_target_s(mission: Mission) -> float:
    """The target of `overlap_after_target_s` in the ranges planned with: the margin taken off them comes on top."""
    target_s = overlap_after_target_s(mission.options, mission.limits)
    if any(station.min_elevation_deg is not None for station in mission.stations):
        return target_s
    return max(0.0, target_s - mission.options.range_margin_m / mission.limits.max_speed_m_s)


def in_a_hurry(problem: Problem) -> Problem:
    """As `without_endurance`, and the fastest plan whatever its handovers."""
    return replace(without_endurance(problem), handover_tolerance=0.0, overlap_after_target_s=0.0)


def without_endurance(problem: Problem) -> Problem:
    """The problem with all the time in the world: how long a flight takes is only known when there is one."""
    return replace(problem, limits=replace(problem.limits, max_duration_s=None))


def _plane_limits(geometry: MissionGeometry, k: float, airspeed_m_s: float | None) -> Limits:
    """The mission's limits in the plane, where a way at altitude shows ``k`` times too short."""
    limits, floor_amsl_m = geometry.mission.limits, geometry.plane.alt_amsl_m
    return Limits(
        min_alt_m=limits.min_alt_amsl_m - floor_amsl_m,
        max_alt_m=limits.max_alt_amsl_m - floor_amsl_m,
        max_speed_m_s=limits.max_speed_m_s / k,
        max_accel_m_s2=limits.max_accel_m_s2,
        max_jerk_m_s3=limits.max_jerk_m_s3,
        max_climb_m_s=limits.max_climb_m_s,
        max_descent_m_s=limits.max_descent_m_s,
        max_airspeed_m_s=airspeed_m_s,
        wind_m_s=limits.wind_m_s or (0.0, 0.0),
        max_duration_s=limits.allowed_s,
    )


def _start_state(geometry: MissionGeometry, start_m: Array) -> tuple[Array, Array]:
    """Velocity and acceleration at T+0, ``(3,)`` each, along the plane's axes; at rest where none is given."""
    state = geometry.mission.options.start_state
    if state is None:
        return np.zeros(3), np.zeros(3)
    velocity, acceleration = np.array(state.velocity_m_s), np.array(state.acceleration_m_s2)
    if not geometry.is_local:
        plane = geometry.plane
        back = np.linalg.inv(plane.true_axes(start_m[0], start_m[1], plane.altitude_amsl_m(start_m[2])))
        velocity[:2], acceleration[:2] = back @ velocity[:2], back @ acceleration[:2]
    return velocity, acceleration


@dataclass(frozen=True)
class TurnedWind:
    """A wind that is the same everywhere along true axes, along those of a plane, which turn from place to place."""

    plane: Plane
    wind_m_s: tuple[float, float]

    def at(self, points_m: Array) -> Array:
        """``(..., 2)``: the wind at plane points ``(..., 3)``."""
        axes = self.plane.true_axes(points_m[..., 0], points_m[..., 1])
        wind = np.broadcast_to(np.array(self.wind_m_s)[:, None], (*axes.shape[:-1], 1))
        return np.asarray(np.linalg.solve(axes, wind)[..., 0])


def wind_of(geometry: MissionGeometry) -> TurnedWind | None:
    """The wind as a field of the plane; None where there is none, or the plane is the world."""
    limits = geometry.mission.limits
    if geometry.is_local or limits.max_airspeed_m_s is None or not any(limits.wind_m_s or ()):
        return None
    assert limits.wind_m_s is not None
    return TurnedWind(geometry.plane, limits.wind_m_s)


def _airspeed_m_s(geometry: MissionGeometry, ends_m: Array, k: float) -> float | None:
    """The airspeed limit in the plane; None where there is none. Raises `NoAirspeed`.

    At altitude the plane shows ways up to ``k`` times too short, and a wind that much too strong. That the wind turns
    is dealt with piece by piece (`planner.airspeed`).
    """
    limits = geometry.mission.limits
    if limits.max_airspeed_m_s is None:
        return None
    field, blown = wind_of(geometry), float(np.hypot(*(limits.wind_m_s or (0.0, 0.0))))
    wind = blown if field is None else float(np.linalg.norm(field.at(ends_m), axis=-1).max())
    airspeed = (limits.max_airspeed_m_s - 2.0 * (k - 1.0) * blown) / k
    if airspeed <= wind:
        raise NoAirspeed(geometry.mission, wind * k + 2.0 * (k - 1.0) * blown)
    return airspeed


def wind_turn_m_s(laid: PlanningProblem) -> float:
    """How far the wind along true axes can differ from the same wind along the plane's, within all ranges.

    The axes turn with the distance from the origin; the largest difference on rings around the stations, a twentieth
    more for what lies between the samples.
    """
    field = wind_of(laid.geometry)
    if field is None:
        return 0.0
    reach = laid.problem.ranges_m if laid.problem.bound_ranges_m is None else laid.problem.bound_ranges_m
    angle = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1)
    at = laid.problem.station_positions_m[:, None, :] + reach[:, None, None] * ring
    return float(1.05 * np.linalg.norm(field.at(at) - np.array(field.wind_m_s), axis=-1).max())
