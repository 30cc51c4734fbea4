"""The contingency in force, as it can be flown by the station in control alone.

A plan's contingencies cover their straight ways by any stations of the mission; a flight has links to the plan's own,
and on a straight way there is no handover. So a diversion is flown only where it lies wholly in the range of the
station in control; otherwise the flight goes back along the path, which is always covered by stations it has.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gcs.plan import Plan

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class WayOut:
    """``divert_to`` a safe point at once, or back along the path, leaving it at a time of the plan for a safe point."""

    divert_to: str | None = None
    leave_for: tuple[float, str] | None = None


def way_out(plan: Plan, time_s: float) -> WayOut:
    """What the plan says for a time of it; back to the start where it says nothing."""
    for way in plan.contingencies:
        if way.from_s <= time_s <= way.to_s and way.safe_point is not None:
            if way.action == "divert":
                return WayOut(divert_to=way.safe_point)
            if way.leave_path_s is not None:
                return WayOut(leave_for=(way.leave_path_s, way.safe_point))
    return WayOut()


def over_safe_point(plan: Plan, station_index: int, stop_enu_m: Vector, safe_point: str) -> Vector | None:
    """The place over a safe point at the height of ``stop_enu_m``; None where the way leaves the station's range."""
    point = next(p for p in plan.mission.safe_points if p.id == safe_point)
    ground = plan.geometry.enu_m([point.position])[0]
    over = (float(ground[0]), float(ground[1]), stop_enu_m[2])
    # A ball is convex: with its corners inside, the way there and down is.
    corners = np.array([stop_enu_m, over, ground])
    outside = plan.geometry.outside_m(np.array([station_index] * 3), corners)
    return over if bool((outside <= 0.0).all()) else None
