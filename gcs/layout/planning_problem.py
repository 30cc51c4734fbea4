"""A mission laid out as a planning problem: margin and projection error off its ranges, its limits made the plane's."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gcs.errors import PlanningFailed
from gcs.geodesy.plane import Plane
from gcs.geodesy.range_bounds import bound_speed_factor, height_factor
from gcs.layout.findings import NoAirspeed, NoRangeLeft
from gcs.layout.mission_geometry import MissionGeometry, choose_plane
from gcs.mission.model import Mission
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
    airspeed_m_s = _airspeed_m_s(geometry, stations, bound, k)
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
            bound_ranges_m=None if geometry.is_local else bound,
            bound_speed_factor=1.0 if geometry.is_local else k * bound_speed_factor(farthest, limits.min_alt_amsl_m),
            min_elevation_deg=mask.lowest_deg if mask.limited.any() else None,
            start_velocity_m_s=velocity,
            start_acceleration_m_s2=acceleration,
        )
    except ProblemError as error:
        raise PlanningFailed(f"the mission passed the door but makes no problem: {error}") from error
    return PlanningProblem(geometry, problem, stations)


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


def _airspeed_m_s(geometry: MissionGeometry, stations: Indices, reach_m: Array, k: float) -> float | None:
    """The airspeed limit in the plane; None where there is none. Raises `NoAirspeed`."""
    limits = geometry.mission.limits
    airspeed, turn = limits.max_airspeed_m_s, 0.0
    if airspeed is None:
        return None
    if not geometry.is_local:
        turn = _wind_turn_m_s(geometry, stations, reach_m)
        airspeed = (airspeed - turn) / k
    wind = float(np.hypot(*(limits.wind_m_s or (0.0, 0.0))))
    if airspeed <= wind:
        raise NoAirspeed(geometry.mission, wind * k + turn)
    return airspeed


def _wind_turn_m_s(geometry: MissionGeometry, stations: Indices, reach_m: Array) -> float:
    """How far the wind, constant along true axes, can differ from the same wind along the plane's, within all ranges.

    The axes turn with the distance from the origin; the largest difference on rings of ``reach_m`` ``(M',)`` around the
    stations, a twentieth more for what lies between the samples.
    """
    wind = np.array(geometry.mission.limits.wind_m_s or (0.0, 0.0))
    angle = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    at = geometry.stations_enu_m[stations, None, :2] + reach_m[:, None, None] * ring
    axes = geometry.plane.true_axes(at[..., 0], at[..., 1])
    return float(1.05 * np.linalg.norm(axes @ wind - wind, axis=-1).max())
