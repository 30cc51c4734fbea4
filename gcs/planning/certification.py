"""Certificates on the true earth: a plan's curve held against slant ranges, not the plane's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gcs.errors import Finding, PlanningFailed
from gcs.layout.planning_problem import PlanningProblem, lay_out, wind_turn_m_s
from gcs.plan.model import Plan
from planner import Certificate, Solution, Trajectory, certify
from planner.coverage import ElevationMask
from planner.routing import lower_bound


def certify_true(laid: PlanningProblem, trajectory: Trajectory) -> Certificate:
    """The certificate of a trajectory (station indices of ``laid.problem``), with true ranges and speeds.

    ``range_m`` is the excess over the full range, of the larger of true range and its bound
    (`gcs.geodesy.range_bounds`) at every control point: the bound is convex, so what holds at the control points holds
    on the curve. ``range_margin_m`` is the same over the range less the margin asked for. In a WGS84 mission
    ``speed_m_s`` is that at the top of the altitude band.
    """
    problem, geometry = laid.problem, laid.geometry
    # Minus infinity: a limit none of the stations flown has.
    worst = {name: value for name, value in certify(problem, trajectory).worst.items() if value > -np.inf}
    worst["plane_range_m"] = worst.pop("range_m")
    stations = laid.stations[trajectory.station_index][:, None]
    points = trajectory.control_points_m
    reach = np.maximum(geometry.true_range_m(stations, points), geometry.range_bound_m(stations, points))
    excess = float((reach - geometry.full_ranges_m[stations]).max())
    margin = geometry.mission.options.range_margin_m
    limits = geometry.mission.limits
    if not geometry.is_local:
        k = limits.max_speed_m_s / problem.limits.max_speed_m_s
        worst["speed_m_s"] = (worst["speed_m_s"] + problem.limits.max_speed_m_s) * k - limits.max_speed_m_s
        # Undo one rounding of the product above, never more.
        if 0.0 < worst["speed_m_s"] <= 4e-16 * limits.max_speed_m_s:
            worst["speed_m_s"] = 0.0
    first = {"range_m": excess}
    if margin > 0:
        first["range_margin_m"] = float((reach - (geometry.full_ranges_m[stations] - margin)).max())
    return Certificate({**first, **worst})


def recertify(plan: Plan) -> Certificate:
    """The certificate of a plan measured anew from its mission and its curve, whatever its document says.

    Raises `PlanningFailed` for a plan that cannot be one of its mission.
    """
    try:
        laid = lay_out(plan.mission, plan.plane)
    except Finding as error:
        raise PlanningFailed(f"no plan of this mission can be flown: {error}") from error
    back = {int(station): k for k, station in enumerate(laid.stations)}
    try:
        stations = np.array([back[int(i)] for i in plan.trajectory.station_index])
    except KeyError as error:
        raise PlanningFailed(f"the plan uses station {error}, which its mission excludes") from None
    return certify_true(laid, Trajectory(plan.trajectory.control_points_m, plan.trajectory.durations_s, stations))


def true_lower_bound_s(laid: PlanningProblem, solution: Solution) -> float:
    """The solution's bound, or one of its own where elevation or wind are corrected for the projection."""
    limits = laid.geometry.mission.limits
    problem = laid.problem
    if laid.geometry.is_local or (problem.min_elevation_deg is None and problem.limits.max_airspeed_m_s is None):
        return solution.lower_bound_s
    wider = problem.limits
    if limits.max_airspeed_m_s is not None and wider.max_airspeed_m_s is not None:
        widest = limits.max_airspeed_m_s + wind_turn_m_s(laid)
        wider = replace(wider, max_airspeed_m_s=widest * problem.bound_speed_factor)
    # What truly is above e shows in the plane above e less 0.1 degree (deflection of the vertical, stretch).
    lowest_deg = laid.geometry.elevation_mask.lowest_deg[laid.stations].tolist()
    mask = ElevationMask.of_each(angle - 0.1 if angle > 0.1 else None for angle in lowest_deg)
    return lower_bound(replace(problem, limits=wider, min_elevation_deg=mask.lowest_deg)).time_s
