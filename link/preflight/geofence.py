"""The vehicle's own fence against the plan: one that would act inside it, and one laid around it on request.

A fence acts by itself: a plan that leaves it ends in the fence's action, in mid-flight. So what is in force is judged
before the flight; the profile says which kinds are.

The fence laid on request is one convex polygon around everything the vehicle may do by itself: the path, and every
straight line from it to home and to the rally points, with a margin. Anything narrower would stop the failsafe return
at the fence.

Source: MAVLink fence items (MAV_CMD_NAV_FENCE_*, 5001-5004); parameter definitions of both autopilots.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from gcs.plan import Place, Plan
from link.autopilot.parameter_catalogue import Values
from link.autopilot.profile import FENCE_CIRCLE, FENCE_HEIGHT, FENCE_POLYGONS, AutopilotProfile
from link.dialect import mavlink
from link.microservices.mission_item import MissionItem, inclusion_fence
from link.preflight.check import Check, Level
from planner.arrays import Array, Flags

SIDES = 16
"""Of the polygon laid: a vehicle stores few corners (PX4 16 at least), and this many cost 2 % of area."""
MARGIN_S = 5.0
LEAST_MARGIN_M = 50.0
PATH_STEP_S = 0.5
INSIDE_POLYGON = mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION
OUTSIDE_POLYGON = mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION
INSIDE_CIRCLE = mavlink.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION
OUTSIDE_CIRCLE = mavlink.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION


def path_m(plan: Plan) -> Array:
    """``(N, 3)``: the plan's path in its plane, closely."""
    count = max(2, math.ceil(plan.mission_time_s / PATH_STEP_S) + 1)
    return np.asarray(plan.trajectory.evaluate(np.linspace(0.0, plan.mission_time_s, count)))


def around(plan: Plan, home_enu_m: Place, points: Sequence[Place]) -> list[MissionItem]:
    """The fence to lay: `SIDES` corners around the path, home and the rally points, convex."""
    margin_m = max(LEAST_MARGIN_M, MARGIN_S * plan.mission.limits.max_speed_m_s)
    places = np.concatenate([path_m(plan)[:, :2], np.array([p[:2] for p in (home_enu_m, *points)])])
    angles = 2.0 * np.pi * np.arange(SIDES) / SIDES
    normals = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    reach = (places @ normals.T).max(axis=0) + margin_m
    corners = []
    for k in range(SIDES):
        pair = [k, (k + 1) % SIDES]
        corner = np.linalg.solve(normals[pair], reach[pair])
        lat, lon = plan.plane.to_geodetic(float(corner[0]), float(corner[1]))
        corners.append((float(lat), float(lon)))
    return inclusion_fence(corners)


def in_force(profile: AutopilotProfile, values: Values) -> bool:
    """Whether polygons stored in the vehicle act, or may."""
    kinds = profile.fence_kinds(values)
    return kinds is None or bool(kinds & FENCE_POLYGONS)


def judge_limits(profile: AutopilotProfile, values: Values, plan: Plan, home_enu_m: Place) -> list[Check]:
    """The fence's distance and height about home, where they are in force."""
    kinds = profile.fence_kinds(values)
    if not kinds:
        return []
    path = path_m(plan)
    asked = {
        "fence_radius": (FENCE_CIRCLE, float(np.hypot(*(path[:, :2] - home_enu_m[:2]).T).max()), "from home"),
        "fence_height": (FENCE_HEIGHT, float(path[:, 2].max() - home_enu_m[2]), "above home"),
    }
    _, harmless = profile.fence_action(values)
    checks = []
    for key, (bit, far_m, where) in asked.items():
        parameter = values.get(key)
        if parameter is None or not kinds & bit or parameter.value <= 0.0:
            continue
        fits = far_m < float(parameter.value)
        level = Level.PASS if fits else Level.WARNING if harmless else Level.FAILURE
        message = f"the plan goes up to {far_m:.0f} m {where}" + ("" if fits else "; the vehicle's own fence would act")
        fix = f"raise {parameter.name} above {far_m:.0f} m, or switch that fence off"
        checks.append(Check(parameter.name, level, message, parameter.value, f"more than {far_m:.0f} m", fix=fix))
    return checks


def judge_stored(profile: AutopilotProfile, values: Values, plan: Plan, items: Sequence[MissionItem]) -> Check:
    """The polygons and circles the vehicle holds, which are in force."""
    if not items:
        return Check("fence", Level.PASS, "the vehicle holds no fence", 0)
    path = path_m(plan)[:, :2]
    outside = _outside(plan, items, path)
    does, harmless = profile.fence_action(values)
    if not outside:
        message = f"the plan stays inside the vehicle's own fence of {len(items)} items (its action: {does})"
        return Check("fence", Level.PASS, message, len(items), "the plan inside it")
    level = Level.WARNING if harmless else Level.FAILURE
    message = f"the plan leaves the vehicle's own fence of {len(items)} items, which answers with: {does}"
    fix = "clear or redraw the vehicle's fence, or give --fence to lay one around this plan for the flight"
    return Check("fence", level, message, len(items), "the plan inside it", fix=fix)


def _outside(plan: Plan, items: Sequence[MissionItem], path: Array) -> bool:
    """Whether any place of the path is where the items do not let it be."""
    index = 0
    while index < len(items):
        item = items[index]
        if item.command in (INSIDE_POLYGON, OUTSIDE_POLYGON):
            count = max(1, int(item.parameters[0]))
            inside = _in_polygon(path, _plane_m(plan, items[index : index + count]))
            if not inside.all() if item.command == INSIDE_POLYGON else inside.any():
                return True
            index += count
            continue
        if item.command in (INSIDE_CIRCLE, OUTSIDE_CIRCLE):
            away_m = np.hypot(*(path - _plane_m(plan, [item])[0]).T)
            inside = away_m < item.parameters[0]
            if not inside.all() if item.command == INSIDE_CIRCLE else inside.any():
                return True
        index += 1
    return False


def _plane_m(plan: Plan, items: Sequence[MissionItem]) -> Array:
    east, north = plan.plane.to_plane([i.lat_deg for i in items], [i.lon_deg for i in items])
    return np.stack([np.asarray(east), np.asarray(north)], axis=-1)


def _in_polygon(places: Array, corners: Array) -> Flags:
    """Whether each place is inside, by the number of sides a ray to the east crosses."""
    inside = np.zeros(len(places), dtype=bool)
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        spans = (a[1] > places[:, 1]) != (b[1] > places[:, 1])
        if not spans.any():
            continue
        east = a[0] + (places[spans, 1] - a[1]) / (b[1] - a[1]) * (b[0] - a[0])
        inside[spans] ^= places[spans, 0] < east
    return inside
