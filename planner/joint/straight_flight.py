"""One station and a straight way: the fastest flight in closed form.

From rest, as hard as the limits allow up to the top speed, on at it, and down again the same way:

    acceleration   0 /‾‾‾‾\\ 0        0 \\____/ 0
    pieces          a  b  a    cruise     a  b  a

A range is convex, so that a straight way between two places in it stays in it, and no flight is faster but for the
time the acceleration takes to come and go.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, sqrt

import numpy as np

from planner.arrays import Array
from planner.joint.program import LEAST_PIECE, SHRINK, least_piece_s
from planner.problem import Limits, Problem
from planner.trajectory import Trajectory

# Acceleration control points of the piece in which it comes, as parts of its value: as fast as can be, or evenly.
AT_ONCE, EVENLY = np.array([0.0, 1.0, 1.0, 1.0]), np.array([0.0, 1.0, 2.0, 3.0]) / 3.0
BISECTIONS = 80


@dataclass(frozen=True)
class _Ramp:
    """From rest to ``speed``: acceleration ``accel`` comes in ``change_s``, stays for ``steady_s``, goes again."""

    speed: float
    accel: float
    change_s: float
    steady_s: float

    @property
    def length(self) -> float:
        """What it takes of the way: it is symmetric, so half its speed in the mean."""
        return 0.5 * self.speed * (2.0 * self.change_s + self.steady_s)


def straight_flight(problem: Problem, station: int) -> Trajectory | None:
    """From rest to rest along the line from start to destination, under ``station``; certified by the caller.

    None where the flight does not start at rest, or does not move, or the wind leaves no way to, or differs by place;
    and where the climb or descent limit bounds the speed: then climbing evenly wastes the ramps, and others are faster.
    """
    way = problem.destination_m - problem.start_m
    length = float(np.linalg.norm(way))
    if not problem.starts_at_rest or length <= 0.0 or problem.wind is not None:
        return None
    heading = way / length
    top = _top_speed_m_s(problem.limits, heading)
    vertical = problem.limits.max_climb_m_s if heading[2] > 0.0 else problem.limits.max_descent_m_s
    if top <= 0.0 or (vertical is not None and top * abs(float(heading[2])) > vertical):
        return None
    accel = problem.limits.max_accel_m_s2
    finest_s = least_piece_s(problem.limits, np.stack([problem.start_m, problem.destination_m]))
    least_s = max(finest_s, LEAST_PIECE * min(top / accel, sqrt(length / accel)))
    ramp = _ramp(problem.limits, top, least_s)
    if 2.0 * ramp.length + top * least_s > length:
        slow, fast = 0.0, top
        for _ in range(BISECTIONS):
            middle = 0.5 * (slow + fast)
            tried = _ramp(problem.limits, middle, least_s)
            slow, fast = (middle, fast) if 2.0 * tried.length + middle * least_s <= length else (slow, middle)
        if slow <= 0.0:
            return None
        ramp = _ramp(problem.limits, slow, least_s)
    return _flown(problem, station, ramp, length, heading)


def _top_speed_m_s(limits: Limits, heading: Array) -> float:
    """Largest speed along ``heading`` that the limits of speed and airspeed allow."""
    top = limits.max_speed_m_s
    if limits.max_airspeed_m_s is not None:
        # |s heading - wind| = airspeed for the larger s.
        wind = np.array([*limits.wind_m_s, 0.0])
        along = float(heading @ wind)
        inside = along**2 - float(wind @ wind) + limits.max_airspeed_m_s**2
        top = min(top, along + sqrt(inside)) if inside > 0.0 else 0.0
    return top * (1.0 - SHRINK)


def _ramp(limits: Limits, speed: float, least_s: float) -> _Ramp:
    accel = limits.max_accel_m_s2 * (1.0 - SHRINK)
    jerk = inf if limits.max_jerk_m_s3 is None else limits.max_jerk_m_s3 * (1.0 - SHRINK)
    # How much of its time a change of acceleration counts: see `AT_ONCE` and `EVENLY`.
    full = 0.75 if jerk == inf else 0.5
    change_s = max(least_s, accel / jerk)
    steady_s = speed / accel - 2.0 * full * change_s
    if steady_s >= least_s:
        return _Ramp(speed, accel, change_s, steady_s)
    # No time for the full acceleration.
    change_s = max(least_s, sqrt(speed / jerk), speed / (2.0 * full * accel))
    return _Ramp(speed, speed / (2.0 * full * change_s), change_s, 0.0)


def _flown(problem: Problem, station: int, ramp: _Ramp, length: float, heading: Array) -> Trajectory:
    come = EVENLY if problem.limits.max_jerk_m_s3 is not None else AT_ONCE
    up = [(ramp.change_s, ramp.accel * come), (ramp.steady_s, np.full(4, ramp.accel))]
    up.append((ramp.change_s, ramp.accel * come[::-1]))
    cruise = ((length - 2.0 * ramp.length) / ramp.speed, np.zeros(4))
    pieces = [*up, cruise, *((duration, -accel) for duration, accel in up)]
    pieces = [piece for piece in pieces if piece[0] > 0.0]
    at, speed = 0.0, 0.0
    along = np.empty((len(pieces), 6))
    for k, (duration, accel) in enumerate(pieces):
        speeds = speed + np.concatenate([[0.0], np.cumsum(accel)]) * duration / 4.0
        along[k] = at + np.concatenate([[0.0], np.cumsum(speeds)]) * duration / 5.0
        at, speed = float(along[k, -1]), float(speeds[-1])
    points = problem.start_m + along[..., None] * heading
    points[0, :3], points[-1, -3:] = problem.start_m, problem.destination_m
    durations = np.array([duration for duration, _ in pieces])
    return Trajectory(points, durations, np.full(len(pieces), station))
