"""When stations cover the vehicle: roots of polynomials, not samples.

On one segment the squared distance to a station less the squared range is a polynomial of degree 2 n in Bernstein
form. The vehicle leaves the range where that changes sign upwards; where it only touches zero the range is not left.

Many windows are worked out at once, each by a walk over the segments away from its own moment, forwards and back. A few
segments of every walk are looked at together; walks that have found their end drop out.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from planner import bezier
from planner.arrays import Array, Flags, Indices
from planner.coverage.elevation_mask import ElevationMask
from planner.trajectory import Trajectory

# An excursion of less than this is rounding: a vehicle that rides along the very edge of a range stays inside it.
SLACK_M = 1e-6
# Segments of a walk looked at together, and walks at most, which bounds the memory.
_STRIDE, _WALKS = 4, 4096


@dataclass(frozen=True, eq=False)
class Stations:
    """Whose coverage is asked for, one entry a window: ``at_m`` ``(W, 3)``, ``range_m`` ``(W,)``.

    ``mask`` of ``(W,)``, or None, narrows ranges to what lies above elevation cones.
    """

    at_m: Array
    range_m: Array
    mask: ElevationMask | None = None

    def __len__(self) -> int:
        return len(self.range_m)

    def part(self, which: Indices | slice) -> Stations:
        """Only some of them."""
        return Stations(self.at_m[which], self.range_m[which], None if self.mask is None else self.mask.at(which))


def range_excess(trajectory: Trajectory, segment: int, station_m: Array, range_m: float) -> Array:
    """Bernstein coefficients ``(2 n + 1,)`` of |u(t) - O|^2 - R^2 on one segment, in m^2; negative inside."""
    return np.asarray(_squared(trajectory.control_points_m[segment] - station_m) - range_m**2)


def coverage_window(
    trajectory: Trajectory,
    station_m: Array,
    range_m: float,
    around_s: float,
    *,
    min_elevation_deg: float | None = None,
    slack_m: float = SLACK_M,
) -> tuple[float, float]:
    """`coverage_windows` of a single station: the span ``(start_s, end_s)``."""
    mask = None if min_elevation_deg is None else ElevationMask.of_each([min_elevation_deg])
    station = Stations(np.asarray(station_m, dtype=float)[None], np.array([range_m]), mask)
    early, late = coverage_windows(trajectory, station, np.array([around_s]), slack_m=slack_m)
    return float(early[0]), float(late[0])


def coverage_windows(
    trajectory: Trajectory, stations: Stations, around_s: Array, *, slack_m: float = SLACK_M
) -> tuple[Array, Array]:
    """The longest spans holding ``around_s`` ``(W,)`` in which the vehicle stays inside each range; ends ``(W,)`` each.

    Ranges are taken ``slack_m`` larger and cones as much lower. Ends are 0 and the mission time where a range is never
    left; a vehicle outside at ``around_s`` gives the empty span there.
    """
    early = leaves_s(trajectory, stations, around_s, ahead=False, slack_m=slack_m)
    late = leaves_s(trajectory, stations, around_s, ahead=True, slack_m=slack_m)
    around = np.clip(around_s, 0.0, trajectory.duration_s)
    outside = np.isnan(early) | np.isnan(late)
    return np.where(outside, around, np.minimum(early, around)), np.where(outside, around, np.maximum(late, around))


def leaves_s(
    trajectory: Trajectory, stations: Stations, around_s: Array, *, ahead: bool, slack_m: float = SLACK_M
) -> Array:
    """When each range is first left, going forwards or back from ``around_s`` ``(W,)``; NaN: outside already.

    0 or the mission time where it never is. Ranges are taken ``slack_m`` larger and cones as much lower.
    """
    around = np.clip(around_s, 0.0, trajectory.duration_s)
    at = trajectory.segment_at(around)
    within = np.clip((around - trajectory.knots_s[at]) / trajectory.durations_s[at], 0.0, 1.0)
    left = np.empty(len(around))
    for begin in range(0, len(around), _WALKS):
        part = slice(begin, begin + _WALKS)
        left[part] = _Walk(trajectory, stations.part(part), slack_m).exits(at[part], within[part], ahead=ahead)
    return left


def held_s(trajectory: Trajectory, stations: Stations, first: Indices, *, ahead: bool) -> Array:
    """``(W,)``: time over the segments from ``first`` ``(W,)`` on, forwards or back, that lie in the range as a whole.

    A segment does when all its control points do, at zero tolerance. The first that does not ends the time.
    """
    held = np.zeros(len(first))
    for begin in range(0, len(first), _WALKS):
        walks = np.arange(begin, min(begin + _WALKS, len(first)))
        for step in range(0, len(trajectory), _STRIDE):
            segment, there = _segments(first[walks], step, len(trajectory), ahead=ahead)
            offset = trajectory.control_points_m[segment] - stations.at_m[walks][:, None, None]
            inside = np.linalg.norm(offset, axis=-1) <= stations.range_m[walks][:, None, None]
            if stations.mask is not None:
                inside &= ~(stations.mask.at(walks[:, None, None]).below_m(offset) > 0.0)
            whole = np.logical_and.accumulate(inside.all(axis=-1) & there, axis=1)
            held[walks] += (trajectory.durations_s[segment] * whole).sum(axis=1)
            walks = walks[whole[:, -1]]
            if not len(walks):
                break
    return held


def _segments(at: Indices, step: int, count: int, *, ahead: bool) -> tuple[Indices, Flags]:
    """The next segments ``(W, _STRIDE)`` of walks that began at ``at`` ``(W,)``, and which of them there are."""
    steps = np.arange(step, step + _STRIDE)
    segment = at[:, None] + (steps if ahead else -steps)
    return np.clip(segment, 0, count - 1), (segment >= 0) & (segment < count)


class _Walk:
    """Walks of ``stations`` over a trajectory."""

    def __init__(self, trajectory: Trajectory, stations: Stations, slack_m: float) -> None:
        self._trajectory, self._at, self._slack_m = trajectory, stations.at_m, slack_m
        self._range = stations.range_m + slack_m
        mask = ElevationMask.none(len(stations)) if stations.mask is None else stations.mask
        self._masked, self._slope = mask.limited, mask.slope

    def exits(self, at: Indices, within: Array, *, ahead: bool) -> Array:
        """When each range is first left, going forwards or back from the part ``within`` of segment ``at``.

        NaN for a vehicle that is outside there.
        """
        flight = self._trajectory
        result = np.full(len(at), flight.duration_s if ahead else 0.0)
        walks = np.arange(len(at))
        for step in range(0, len(flight), _STRIDE):
            segment, there = _segments(at[walks], step, len(flight), ahead=ahead)
            # The part of each segment that is left to walk: all but of the first one.
            passed = np.zeros(segment.shape)
            if step == 0:
                passed[:, 0] = within if ahead else 1.0 - within
            share = np.full(segment.shape, np.inf)
            which = np.nonzero(there & self._may_leave(walks, segment))
            share[which] = self._first_exits(walks[which[0]], segment[which], passed[which], ahead=ahead)
            if step == 0:
                outside = share[:, 0] < 0.0
            left = np.isfinite(share)
            found = np.flatnonzero(left.any(axis=1))
            where = left[found].argmax(axis=1)
            k, gone = segment[found, where], passed[found, where]
            u = gone + (1.0 - gone) * np.maximum(share[found, where], 0.0)
            result[walks[found]] = flight.knots_s[k] + (u if ahead else 1.0 - u) * flight.durations_s[k]
            walks = walks[~left.any(axis=1) & there[:, -1]]
            if not len(walks):
                break
        return np.where(outside, np.nan, result)

    def _may_leave(self, walks: Indices, segment: Indices) -> Flags:
        """False where a segment's control points prove that it stays inside."""
        offset = self._trajectory.control_points_m[segment] - self._at[walks][:, None, None]
        beyond = (offset * offset).sum(axis=-1).max(axis=-1) > (self._range[walks] ** 2)[:, None]
        return np.asarray(beyond | self._masked[walks][:, None])

    def _first_exits(self, walks: Indices, segment: Indices, passed: Array, *, ahead: bool) -> Array:
        """Part of what is left of each segment at which its range is left; -1: outside already; infinite: never."""
        offset = self._trajectory.control_points_m[segment] - self._at[walks][:, None]
        share = _first_positive(_rest(_squared(offset) - (self._range[walks] ** 2)[:, None], passed, ahead=ahead))
        masked = np.flatnonzero(self._masked[walks])
        if len(masked):
            # Above the cone: the height is positive, and slope^2 (x^2 + y^2) <= height^2.
            slope, offset = self._slope[walks[masked]][:, None], offset[masked]
            height = offset[..., 2] + self._slack_m
            flat = slope**2 * _squared(offset[..., :2]) - _squared(height[..., None])
            for excess in (-height, flat):
                share[masked] = np.minimum(share[masked], _first_positive(_rest(excess, passed[masked], ahead=ahead)))
        return share


@lru_cache(maxsize=16)
def _products(degree: int) -> Array:
    """``((n + 1)^2, 2 n + 1)``: takes products of two coefficients to those of the product of the polynomials."""
    weights = np.zeros((degree + 1, degree + 1, 2 * degree + 1))
    unit = np.eye(degree + 1)
    for i in range(degree + 1):
        for j in range(degree + 1):
            weights[i, j] = bezier.product(unit[i], unit[j])
    return weights.reshape(-1, 2 * degree + 1)


def _squared(offset: Array) -> Array:
    """Bernstein coefficients ``(..., 2 n + 1)`` of the squared length of curves ``(..., n + 1, d)``."""
    inner = offset @ np.swapaxes(offset, -1, -2)
    count = offset.shape[-2]
    return np.asarray(inner.reshape(*offset.shape[:-2], count * count) @ _products(count - 1))


def _rest(coefficients: Array, passed: Array, *, ahead: bool) -> Array:
    """The polynomials ``(C, m + 1)`` on what is left of their segments, beginning where the walk is."""
    rest = coefficients if ahead else coefficients[:, ::-1]
    begun = np.flatnonzero(passed)
    rest = rest.copy() if len(begun) else rest
    for k in begun.tolist():
        rest[k] = rest[k, -1] if passed[k] == 1.0 else bezier.split(rest[k][:, None], float(passed[k]))[1][:, 0]
    return rest


def _first_positive(coefficients: Array) -> Array:
    """``(C,)``: the first ``u`` of [0, 1] at which each polynomial turns positive, -1 where it is from the beginning.

    Infinite where it never does.
    """
    result = np.full(len(coefficients), np.inf)
    nonzero = coefficients != 0.0
    first = coefficients[np.arange(len(coefficients)), nonzero.argmax(axis=1)]
    result[first > 0.0] = 0.0
    result[coefficients[:, 0] > 0.0] = -1.0
    rising = np.flatnonzero((first < 0.0) & (coefficients.max(axis=1) > 0.0))
    if not len(rising):
        return result
    changes = np.count_nonzero(np.diff(coefficients[rising] > 0.0, axis=1), axis=1)
    once = (changes == 1) & nonzero[rising].all(axis=1)
    result[rising[once]] = bezier.only_roots(coefficients[rising[once]])
    for k in rising[~once].tolist():
        found = bezier.roots(coefficients[k])
        result[k] = found[0] if found else np.inf
    return result
