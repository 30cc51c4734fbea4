"""Chords: where two neighbours' discs cross, and what a leg between two chords costs.

         p ......................... q          p on the chord with the station before, q with the one after.
        (│)    station's own disc   (│)         The leg is inside the overlap with the one before for the length
         └─► out of the      into ──┘           "out", inside the overlap with the one after for the length "into".
             overlaps

With a minimum overlap time a vehicle must spend half of it inside the two ranges' overlap on either side of a handover.
Where that is too short at full speed it slows down beforehand, and both losses are added to the leg's time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.arrays import Array, Indices
from planner.coverage.disc import disc_radius_m
from planner.coverage.overlap import overlap_altitude_m
from planner.problem import Problem


@dataclass(frozen=True)
class Chords:
    """E chords seen from above: points are ``base + t half normal``, |t| <= 1.

    ``base``, ``normal`` ``(E, 2)``. ``half``, ``alt_m`` and at that altitude the two radii, the distance ``apart`` of
    the centres and that of the chord from the first one, ``foot``: ``(E,)``.
    """

    base: Array
    normal: Array
    half: Array
    alt_m: Array
    radius_first: Array
    radius_second: Array
    apart: Array
    foot: Array

    def points(self, t: Array) -> Array:
        """``(E, ..., 2)`` for ``t`` ``(E, ...)``."""
        extra = (1,) * (np.ndim(t) - 1)
        reach = (t * self.half.reshape(-1, *extra))[..., None]
        points: Array = self.base.reshape(-1, *extra, 2) + reach * self.normal.reshape(-1, *extra, 2)
        return points

    def overlap_points(self, t: Array, s: Array) -> Array:
        """``(E, len(t) len(s), 2)``: at each ``t`` along every chord, the parts ``s`` of the way across the overlap."""
        y = t * self.half[:, None]
        wide_first = np.sqrt(np.maximum(self.radius_first[:, None] ** 2 - y**2, 0.0))
        wide_second = np.sqrt(np.maximum(self.radius_second[:, None] ** 2 - y**2, 0.0))
        near = np.maximum(-wide_first, self.apart[:, None] - wide_second) - self.foot[:, None]
        far = np.minimum(wide_first, self.apart[:, None] + wide_second) - self.foot[:, None]
        across = near[..., None] + np.maximum(far - near, 0.0)[..., None] * s
        unit = np.stack([self.normal[:, 1], -self.normal[:, 0]], axis=1)
        points = self.points(np.broadcast_to(t, y.shape))[:, :, None] + across[..., None] * unit[:, None, None]
        return points.reshape(len(y), -1, 2)


def chords(problem: Problem, first: Indices, second: Indices) -> Chords:
    """Chords of pairs of stations at the altitude where their ranges overlap most, seen from above.

    One disc inside the other has no chord: the smaller one's diameter serves.
    """
    altitude = overlap_altitude_m(problem, first, second)
    radius_a, radius_b = disc_radius_m(problem, first, altitude), disc_radius_m(problem, second, altitude)
    along = problem.station_positions_m[second, :2] - problem.station_positions_m[first, :2]
    apart = np.linalg.norm(along, axis=1)
    unit = np.where((apart > 1e-9)[:, None], along / np.maximum(apart, 1e-9)[:, None], [1.0, 0.0])
    foot = (apart**2 + radius_a**2 - radius_b**2) / (2.0 * np.maximum(apart, 1e-9))
    half = np.sqrt(np.maximum(radius_a**2 - foot**2, 0.0))
    b_inside, a_inside = apart + radius_b <= radius_a, apart + radius_a <= radius_b
    foot = np.where(b_inside, apart, np.where(a_inside, 0.0, foot))
    half = np.where(b_inside, radius_b, np.where(a_inside, radius_a, half))
    # Ranges that barely meet: the middle of the overlap, not a foot outside it.
    low, high = np.maximum(-radius_a, apart - radius_b), np.minimum(radius_a, apart + radius_b)
    foot = np.where(high > low, np.clip(foot, low, high), 0.5 * (low + high))
    base = problem.station_positions_m[first, :2] + foot[:, None] * unit
    return Chords(base, np.stack([-unit[:, 1], unit[:, 0]], axis=1), half, altitude, radius_a, radius_b, apart, foot)


def leaves_after(at: Array, towards: Array, length: Array, centre: Array, radius: Array) -> Array:
    """How far a straight leg of ``length`` from ``at`` stays inside the disc or ball, up to its length; 0 outside."""
    offset, along = at - centre, towards - at
    # Coordinates one by one: sums over so short an axis cost more than the rest together.
    middle = sum(offset[..., k] * along[..., k] for k in range(at.shape[-1]))
    square = sum(offset[..., k] ** 2 for k in range(at.shape[-1]))
    middle = middle / np.where(length > 0.0, length, 1.0)
    reach = np.sqrt(np.maximum(middle * middle - square + np.asarray(radius) ** 2, 0.0)) - middle
    return np.asarray(np.minimum(np.maximum(reach, 0.0), length))


def leg_times_s(problem: Problem, length: Array, out: Array, into: Array, *, slowdown: float = 1.0) -> Array:
    """Expected time of legs, given how far each stays in the overlap it leaves and the one it enters (infinite: none).

    With half the minimum overlap time to spend on a length s inside, speed drops to s / half; slowing down to it and
    speeding up again loses (v - s / half)^2 / (2 v a) more. ``slowdown`` scales these losses.
    """
    speed, accel = problem.limits.max_speed_m_s, problem.limits.max_accel_m_s2
    time = length / speed
    if problem.min_overlap_s > 0.0:
        half = 0.5 * problem.min_overlap_s
        for inside in (out, into):
            slow = np.minimum(inside / half, speed)
            time = time + slowdown * (half * (1.0 - slow / speed) + (speed - slow) ** 2 / (2.0 * speed * accel))
    if problem.min_tenure_s > 0.0:
        time = np.maximum(time, problem.min_tenure_s)
    return np.asarray(time)
