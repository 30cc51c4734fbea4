"""The least value of convex functions of one variable, many at once, by zooming in on a grid."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from planner.arrays import Array

# Points of a grid, and grids laid: each an eighth as wide as the one before.
POINTS, ROUNDS = 17, 12
_GRID = np.linspace(0.0, 1.0, POINTS)


def least_by_zooming(value: Callable[[Array], Array], low: Array, high: Array) -> tuple[Array, Array]:
    """Where between ``low`` and ``high`` ``(...)`` each function is least, and how small it is there: ``(...)`` each.

    ``value`` takes points ``(..., 17)`` to values of the same shape, infinite where the function is not defined. Convex
    where it is finite. The least is known to 8^-12 of the interval, the ends included.
    """
    low, high = np.asarray(low)[..., None], np.asarray(high)[..., None]
    where, least = low[..., 0].astype(float), np.full(low.shape[:-1], np.inf)
    for _ in range(ROUNDS):
        points = low + _GRID * (high - low)
        values = value(points)
        at = np.argmin(values, axis=-1)[..., None]
        best = np.take_along_axis(values, at, axis=-1)[..., 0]
        where = np.where(best < least, np.take_along_axis(points, at, axis=-1)[..., 0], where)
        least = np.minimum(least, best)
        low, high = (
            np.take_along_axis(points, np.maximum(at - 1, 0), axis=-1),
            np.take_along_axis(points, np.minimum(at + 1, POINTS - 1), axis=-1),
        )
    return where, least
