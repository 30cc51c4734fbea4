"""A mission laid out as a planning problem: margin and projection error off its ranges, its limits made the plane's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gcs.errors import MissionInfeasible, PlanningFailed
from gcs.geodesy.plane import Plane
from gcs.geodesy.range_bounds import bound_speed_factor, height_factor, planning_elevation_deg
from gcs.layout.mission_geometry import MissionGeometry, choose_plane
from gcs.mission.model import Mission, overlap_after_target_s
from planner import Limits, Problem, ProblemError

Array = NDArray[np.float64]

# Airspeed over the wind's that a fix asks for, as a part of it: with none to spare the vehicle hardly moves.
WIND_SPARE = 0.005


@dataclass(frozen=True)
class PlanningProblem:
    """A mission as a planning problem. ``stations`` ``(M',)`` are the mission's indices of the problem's stations."""

    geometry: MissionGeometry
    problem: Problem
    stations: NDArray[np.int64]


def lay_out(mission: Mission, plane: Plane | None = None) -> PlanningProblem:
    """The planning problem of a mission, in ``plane`` or one of its own.

    Raises `MissionInfeasible` when the margin leaves no station any range (without a fix) or the wind no airspeed.
    """
    geometry = MissionGeometry(mission, choose_plane(mission) if plane is None else plane)
    options, limits, plane = mission.options, mission.limits, geometry.plane
    less_margin = geometry.full_ranges_m - options.range_margin_m
    planned = geometry.inner_ranges_m(less_margin)
    excluded = frozenset(options.excluded_stations)
    kept = np.array([s.id not in excluded for s in mission.stations]) & (planned > 0.0)
    stations = np.flatnonzero(kept)
    start, destination = geometry.enu_m([mission.start, mission.destination])
    if not len(stations):
        widest = int(geometry.full_ranges_m.argmax())
        raise MissionInfeasible(
            "start_uncovered",
            f"The range margin of {options.range_margin_m:g} m leaves no station any range.",
            stations=[mission.stations[widest].id],
            gap_m=float(options.range_margin_m - geometry.full_ranges_m[widest]),
        )
    at, bound = geometry.stations_enu_m, geometry.outer_ranges_m(np.maximum(less_margin, 0.0))
    # On the earth a way at altitude is longer than on the plane: the plane's speed limit is that much lower.
    k = 1.0 if geometry.is_local else float(height_factor(limits.max_alt_amsl_m))
    farthest = float((np.hypot(at[stations, 0], at[stations, 1]) + bound[stations]).max())
    elevation = geometry.min_elevations_deg[stations]
    airspeed, turn = limits.max_airspeed_m_s, 0.0
    if not geometry.is_local:
        raised = np.minimum(planning_elevation_deg(elevation, geometry.full_ranges_m[stations]), 89.9)
        elevation = np.where(elevation > -90.0, raised, elevation)
        if airspeed is not None:
            turn = _wind_turn_m_s(geometry, stations, bound)
            airspeed = (airspeed - turn) / k
    state = options.start_state
    velocity, acceleration = np.zeros(3), np.zeros(3)
    if state is not None:
        velocity, acceleration = np.array(state.velocity_m_s), np.array(state.acceleration_m_s2)
        if not geometry.is_local:
            back = np.linalg.inv(plane.true_axes(start[0], start[1], plane.altitude_amsl_m(start[2])))
            velocity[:2], acceleration[:2] = back @ velocity[:2], back @ acceleration[:2]
    endurance = None if limits.endurance_s is None else limits.endurance_s - (limits.reserve_s or 0.0)
    wind = float(np.hypot(*(limits.wind_m_s or (0.0, 0.0))))
    if airspeed is not None and airspeed <= wind:
        raise _no_airspeed(mission, wind * k + turn)
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
            handover_tolerance=options.handover_tolerance,
            overlap_after_target_s=_after_target_s(mission),
            bound_ranges_m=None if geometry.is_local else bound[stations],
            bound_speed_factor=1.0 if geometry.is_local else k * bound_speed_factor(farthest, limits.min_alt_amsl_m),
            min_elevation_deg=elevation if (elevation > -90.0).any() else None,
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


def _no_airspeed(mission: Mission, standing_m_s: float) -> MissionInfeasible:
    """The wind carries the vehicle away: ``standing_m_s`` is the airspeed it takes to hold a place."""
    limits = mission.limits
    assert limits.max_airspeed_m_s is not None
    assert limits.wind_m_s is not None
    needed = (1.0 + WIND_SPARE) * standing_m_s
    part = limits.max_airspeed_m_s / needed
    east, north = (part * x for x in limits.wind_m_s)
    wind = float(np.hypot(*limits.wind_m_s))
    return MissionInfeasible(
        "limits",
        f"The wind of {wind:.1f} m/s leaves nothing of the airspeed limit of {limits.max_airspeed_m_s:g} m/s: "
        "the vehicle cannot hold its place, nor start or end at rest.",
        fix={
            "action": "raise_limit",
            "limit": "max_airspeed_m_s",
            "by": needed - limits.max_airspeed_m_s,
            "to": needed,
            "alternatives": [{"action": "lower_wind", "below_m_s": part * wind, "east_m_s": east, "north_m_s": north}],
        },
        fix_text=f"Raise max_airspeed_m_s to {np.ceil(needed * 10.0) / 10.0:.1f} m/s, or wait until the wind is below "
        f"{np.floor(part * wind * 10.0) / 10.0:.1f} m/s.",
    )


def _wind_turn_m_s(geometry: MissionGeometry, stations: NDArray[np.int64], reach_m: Array) -> float:
    """How far the wind, constant along true axes, can differ from the same wind along the plane's, within all ranges.

    The axes turn with the distance from the origin; the largest difference on rings around the stations, a twentieth
    more for what lies between the samples.
    """
    wind = np.array(geometry.mission.limits.wind_m_s or (0.0, 0.0))
    angle = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    at = geometry.stations_enu_m[stations, None, :2] + reach_m[stations, None, None] * ring
    axes = geometry.plane.true_axes(at[..., 0], at[..., 1])
    return float(1.05 * np.linalg.norm(axes @ wind - wind, axis=-1).max())
