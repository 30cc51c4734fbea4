"""Curves joined: a plan's own up to a place of it, then another that takes its state over, or brakes before it.

Control points are ``(segments, degree + 1, 3)``, times are those of the plan's curve. A curve goes on where another one
is left with position, velocity and acceleration taken over exactly; one that is to stand first brakes on the path
behind the place.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from planner import Trajectory, bezier
from planner.arrays import Array, Indices

QUINTIC = 5
BRAKING_SHARES = (0.6, 0.45, 0.3, 0.8)
"""Peak braking, of the acceleration limit, tried in turn for a flight that stands."""
LEAST_PIECE_S = 2.0
"""Shortest piece a join leaves: coordinates of 100 km round to 1e-11 m, and an acceleration is their second difference
over the piece's time squared, so that shorter pieces would not be continuous to the certificate's tolerance."""
_BRAKING_PIECE_S = 1.5
_SAME_S = 1e-6


def as_flown(curve: Trajectory, present_s: float | None, handovers_done: int | None) -> Trajectory:
    """A plan's curve with the stations that truly were in control until now, where that is told."""
    if present_s is None or handovers_done is None or not 0 <= handovers_done < len(curve.sequence):
        return curve
    stations = np.array(curve.station_index)
    due = int(np.count_nonzero(curve.handover_times_s <= present_s))
    late = (curve.leg_index > handovers_done) & (curve.leg_index <= due)
    stations[late] = curve.sequence[handovers_done]
    return Trajectory(curve.control_points_m, curve.durations_s, stations)


def clear_of_joints(curve: Trajectory, time_s: float) -> tuple[float, float]:
    """The nearest times before and after, or the time itself, at which to split the curve leaves no short piece."""
    before = int(np.searchsorted(curve.knots_s, time_s + _SAME_S, side="right")) - 1
    knot_s = float(curve.knots_s[before])
    if time_s <= knot_s + _SAME_S:
        return knot_s, knot_s
    if time_s >= knot_s + LEAST_PIECE_S:
        return time_s, time_s
    return knot_s, min(knot_s + LEAST_PIECE_S, float(curve.knots_s[before + 1]))


def moving_on(curve: Trajectory, join_s: float, rest: Trajectory) -> Trajectory:
    """``curve`` up to ``join_s``, and from there on ``rest``, which begins with the state there."""
    degree = max(curve.degree, rest.degree)
    points, durations, stations = _until(curve, join_s)
    state = [np.asarray(curve.evaluate(join_s, order)) for order in (0, 1, 2)]
    return Trajectory(
        np.concatenate([bezier.elevate(points, degree), bezier.elevate(_snapped(rest, *state), degree)]),
        np.concatenate([durations, rest.durations_s]),
        np.concatenate([stations, rest.station_index]),
    )


def standing_first(
    curve: Trajectory, stand_s: float, rest: Trajectory, *, max_accel_m_s2: float, from_rest: bool
) -> Iterator[tuple[Trajectory, float]]:
    """Ways to brake on the path of ``curve`` behind ``stand_s``, to rest there, and to go on by ``rest``.

    Gives each curve with the time of it at which it rests. ``from_rest``: ``curve`` begins at rest.
    """
    place, still = np.asarray(curve.evaluate(stand_s)), np.zeros(3)
    degree = max(curve.degree, rest.degree, QUINTIC)
    rest_points = bezier.elevate(_snapped(rest, place, still, still), degree)
    speed = float(np.linalg.norm(curve.evaluate(np.linspace(0.0, stand_s, 200), 1), axis=-1).max())
    for share in BRAKING_SHARES:
        lasts_s = 1.5 * speed / (share * max_accel_m_s2)
        begin_s = clear_of_joints(curve, max(0.0, stand_s - 0.5 * lasts_s))[0]
        # From rest to rest, as slowly as need be.
        lasts_s = max(lasts_s, LEAST_PIECE_S) if begin_s == 0.0 and from_rest else 2.0 * (stand_s - begin_s)
        points, durations, stations = _nothing(degree)
        if begin_s > _SAME_S:
            points, durations, stations = _until(curve, begin_s)
        brake, pieces_s = _braking(curve, begin_s, stand_s, lasts_s, degree)
        ends = curve.station_index[curve.segment_at(np.array([begin_s, stand_s]))]
        # Around a handover the station before it may be the one that covers all of the braking.
        for station in dict.fromkeys(ends[::-1].tolist()):
            joined = Trajectory(
                np.concatenate([bezier.elevate(points, degree), brake, rest_points]),
                np.concatenate([durations, pieces_s, rest.durations_s]),
                np.concatenate([stations, np.full(len(pieces_s), station), rest.station_index]),
            )
            yield joined, begin_s + lasts_s


def _until(curve: Trajectory, time_s: float) -> tuple[Array, Array, Indices]:
    """Control points, durations and stations of a curve up to a time of it."""
    parts = curve.split([time_s])
    count = int(np.searchsorted(parts.knots_s, time_s + _SAME_S, side="right")) - 1
    return parts.control_points_m[:count], parts.durations_s[:count], parts.station_index[:count]


def _snapped(rest: Trajectory, place: Array, velocity: Array, acceleration: Array) -> Array:
    """Control points of ``rest``, which begins exactly with that state: what a solver leaves of a residual is gone."""
    points = np.array(rest.control_points_m)
    degree, duration = rest.degree, float(rest.durations_s[0])
    one = velocity * duration / degree
    points[0, 0] = place
    points[0, 1] = place + one
    points[0, 2] = place + 2.0 * one + acceleration * duration**2 / (degree * (degree - 1))
    return points


def _braking(curve: Trajectory, begin_s: float, stand_s: float, lasts_s: float, degree: int) -> tuple[Array, Array]:
    """The way from ``begin_s`` to rest at ``stand_s`` of the same path: control points and durations of its pieces.

    The rate along the plan falls from its first value to 0 as 1 - 3 u^2 + 2 u^3 with u the share of the time taken,
    ``lasts_s``. That is twice the plan's time, and the first value 1, or more from rest. Each piece is the quintic with
    the right position, velocity and acceleration at both ends.
    """
    if stand_s - begin_s < _SAME_S:
        return np.empty((0, degree + 1, 3)), np.empty(0)
    count = max(1, math.floor(lasts_s / _BRAKING_PIECE_S))
    u = np.linspace(0.0, 1.0, count + 1)
    span_s = 2.0 * (stand_s - begin_s)
    on_plan = begin_s + span_s * (u - u**3 + 0.5 * u**4)
    on_plan[-1] = stand_s
    rate = span_s / lasts_s * (1.0 - 3.0 * u**2 + 2.0 * u**3)
    change = span_s / lasts_s**2 * (-6.0 * u + 6.0 * u**2)
    rate[-1] = change[-1] = 0.0
    place, first, second = (np.asarray(curve.evaluate(on_plan, order)) for order in (0, 1, 2))
    velocity = rate[:, None] * first
    acceleration = (rate**2)[:, None] * second + change[:, None] * first
    each_s = lasts_s / count
    one, two = each_s / QUINTIC, each_s**2 / (QUINTIC * (QUINTIC - 1))
    begin, end = slice(0, -1), slice(1, None)
    points = np.stack(
        [
            place[begin],
            place[begin] + one * velocity[begin],
            place[begin] + 2.0 * one * velocity[begin] + two * acceleration[begin],
            place[end] - 2.0 * one * velocity[end] + two * acceleration[end],
            place[end] - one * velocity[end],
            place[end],
        ],
        axis=1,
    )
    return bezier.elevate(points, degree), np.full(count, each_s)


def _nothing(degree: int) -> tuple[Array, Array, Indices]:
    return np.empty((0, degree + 1, 3)), np.empty(0), np.empty(0, dtype=np.int64)
