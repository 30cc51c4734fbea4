"""How fast a line can be flown: the least time from rest to rest, and a profile of speeds along a polyline.

The limits of speed and acceleration, and of jerk and airspeed where given, along a path whose shape does not matter:
what a lower bound, a first guess and a price per leg have in common.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from planner.arrays import Array
from planner.problem import Limits


def fastest_time_s(
    limits: Limits, length_m: float, start_speed_m_s: float = 0.0, start_accel_m_s2: float = 0.0
) -> float:
    """Least time for a path of at least ``length_m`` that ends at rest, from a speed and size of acceleration.

    The speed at time t after the start is at most what the largest acceleration gives, itself at most what the
    jerk limit lets it grow to; likewise backwards from the end. Nothing is assumed about the path's shape.
    """
    top = _top_speed_m_s(limits)
    start = min(start_speed_m_s, top)

    def ends(peak: float) -> tuple[float, float]:
        up = _ramp(limits, start, min(start_accel_m_s2, limits.max_accel_m_s2), peak)
        down = _ramp(limits, 0.0, 0.0, peak)
        return up[0] + down[0], up[1] + down[1]

    time, distance = ends(top)
    if distance <= length_m:
        return time + (length_m - distance) / top
    low, high = start, top
    if ends(low)[1] >= length_m:
        return ends(low)[0]
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if ends(middle)[1] < length_m else (low, middle)
    return ends(low)[0]


def speed_profile(speed: Array, length: Array, accel: float) -> Array:
    """The largest speeds ``(n + 1,)`` at the ends of the parts of a path that ``accel`` can follow; in any unit.

    ``length`` ``(n,)`` of the parts; ``speed`` ``(n + 1,)`` is what each end allows by itself. The first one is given
    and stays, even where it is too fast to brake from.
    """
    lowered = np.array(speed, dtype=float)
    for joint in range(1, len(lowered)):
        lowered[joint] = min(lowered[joint], np.sqrt(lowered[joint - 1] ** 2 + 2.0 * accel * length[joint - 1]))
    for joint in range(len(length) - 1, 0, -1):
        lowered[joint] = min(lowered[joint], np.sqrt(lowered[joint + 1] ** 2 + 2.0 * accel * length[joint]))
    return lowered


def _ramp(limits: Limits, speed: float, accel: float, peak: float) -> tuple[float, float]:
    """Time and distance from ``speed`` to ``peak`` as fast as acceleration and jerk allow (``peak`` >= ``speed``)."""
    time = distance = 0.0
    top = limits.max_accel_m_s2
    if limits.max_jerk_m_s3 is not None and accel < top:
        jerk = limits.max_jerk_m_s3
        full = (top - accel) / jerk
        reached = (-accel + sqrt(accel**2 + 2.0 * jerk * (peak - speed))) / jerk
        time = min(full, reached)
        distance = speed * time + accel * time**2 / 2.0 + jerk * time**3 / 6.0
        speed = speed + accel * time + jerk * time**2 / 2.0
        if reached <= full:
            return time, distance
    rest = max(peak - speed, 0.0) / top
    return time + rest, distance + 0.5 * (speed + peak) * rest


def _top_speed_m_s(limits: Limits) -> float:
    """Largest speed over ground in any direction."""
    if limits.max_airspeed_m_s is None:
        return limits.max_speed_m_s
    return min(limits.max_speed_m_s, limits.max_airspeed_m_s + float(np.hypot(*limits.wind_m_s)))
