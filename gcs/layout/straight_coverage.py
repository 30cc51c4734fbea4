"""Whether straight ways stay in somebody's range: exact, for many ways at once.

Each station covers one interval of a straight way (a ball cuts a line in one piece), and the intervals must join from
end to end.
"""

from __future__ import annotations

import numpy as np

from gcs.layout.mission_geometry import MissionGeometry
from planner.arrays import Array, Flags

# Ways whose coverage is worked out together.
_AT_ONCE = 256


class Cover:
    """Whether straight ways lie in the union of the ranges, each less ``off_m``; excluded stations do not count."""

    def __init__(self, geometry: MissionGeometry, off_m: float) -> None:
        excluded = set(geometry.mission.options.excluded_stations)
        keep = [i for i, s in enumerate(geometry.mission.stations) if s.id not in excluded]
        self.radius = (geometry.inner_ranges_m(geometry.full_ranges_m) - off_m)[keep]
        self.centre = geometry.stations_enu_m[keep]
        self.mask = geometry.planning_mask(np.array(keep, dtype=np.int64))
        self.off_m = off_m

    def holds(self, begin: Array, end: Array) -> Flags:
        """``(...)``: whether each straight way from ``begin`` to ``end`` ``(..., 3)`` is covered all along."""
        flat_begin, flat_end = begin.reshape(-1, 3), end.reshape(-1, 3)
        result = np.zeros(len(flat_begin), dtype=bool)
        for k in range(0, len(result), _AT_ONCE):
            result[k : k + _AT_ONCE] = self._holds(flat_begin[k : k + _AT_ONCE], flat_end[k : k + _AT_ONCE])
        return result.reshape(begin.shape[:-1])

    def _holds(self, begin: Array, end: Array) -> Flags:
        # Only stations that reach the box around these ways: on a large map that is a few of many.
        box = np.concatenate([begin, end])
        beyond = np.maximum(np.maximum(box.min(axis=0) - self.centre, self.centre - box.max(axis=0)), 0.0)
        near = np.flatnonzero((np.linalg.norm(beyond, axis=1) <= self.radius) & (self.radius > 0))
        if not len(near):
            return np.zeros(len(begin), dtype=bool)
        radius, centre, mask = self.radius[near], self.centre[near], self.mask.at(near)
        way = end - begin
        offset = begin[:, None, :] - centre
        # |offset + u way|^2 <= radius^2: one interval of u for each station
        a = np.maximum(np.einsum("ni,ni->n", way, way), 1e-12)[:, None]
        b = np.einsum("nmi,ni->nm", offset, way)
        c = np.einsum("nmi,nmi->nm", offset, offset) - radius**2
        square = b * b - a * c
        cuts = square >= 0
        root = np.sqrt(np.maximum(square, 0.0))
        low, high = np.where(cuts, (-b - root) / a, np.inf), np.where(cuts, (-b + root) / a, -np.inf)
        for k in np.flatnonzero(mask.limited).tolist():
            first, last = self._above_cone(float(mask.slope[k]), offset[:, k], way)
            low[:, k], high[:, k] = np.maximum(low[:, k], first), np.minimum(high[:, k], last)
        # Sorted by their beginnings, the intervals join when none begins beyond what is reached so far.
        met = (high >= low).any(axis=0)
        order = np.argsort(low[:, met], axis=1)
        low, high = np.take_along_axis(low[:, met], order, 1), np.take_along_axis(high[:, met], order, 1)
        reached = np.maximum.accumulate(np.concatenate([np.zeros((len(begin), 1)), high], axis=1), axis=1)
        apart = np.concatenate([low > reached[:, :-1], np.ones((len(begin), 1), dtype=bool)], axis=1)
        return np.asarray(reached[np.arange(len(begin)), apart.argmax(axis=1)] >= 1.0)

    def _above_cone(self, slope: float, offset: Array, way: Array) -> tuple[Array, Array]:
        """The part of each way above a cone: height over it is concave, so all between two good samples is good."""
        u = np.linspace(0.0, 1.0, 65)
        at = offset[:, None, :] + u[None, :, None] * way[:, None, :]
        good = at[..., 2] - self.off_m - slope * (np.linalg.norm(at[..., :2], axis=-1) + self.off_m) >= 0
        some = good.any(axis=1)
        first = np.where(some, u[good.argmax(axis=1)], np.inf)
        last = np.where(some, u[len(u) - 1 - good[:, ::-1].argmax(axis=1)], -np.inf)
        return first, last
