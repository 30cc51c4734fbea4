"""The funnel algorithm: the shortest polyline from start to end that crosses gates in order.

       gates' left ends   *      *     *
        start ────────────┼──────┼─────┼──────── end
       gates' right ends  *      *     *

(Lee and Preparata 1984.) What can be seen from the last corner narrows gate by gate, and where nothing is left to see,
the side's end that is in the way is the next corner. The way from a gate to the next must be convex, so neighbouring
gates must not cross: where they do, both are cut off there. A polyline that does not turn round such a cut is the
shortest without it too, because its length is convex in where it crosses the gates.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from planner.arrays import Array

Point = tuple[float, float]


def shortest_crossings(start: Array, left: Array, right: Array, end: Array) -> Array | None:
    """Where the shortest polyline from ``start`` ``(2,)`` to ``end`` crosses each gate: ``(E, 2)``.

    ``left``, ``right`` ``(E, 2)`` are the gates' ends as seen on the way. None where gates that cross, or come in the
    wrong order, are in the way.
    """
    cut = _cut_off(start, left, right, end)
    if cut is None:
        return None
    low, high = cut
    left, right = right + high[:, None] * (left - right), right + low[:, None] * (left - right)
    lefts, rights = ([(float(x), float(y)) for x, y in (*side, end)] for side in (left, right))
    corners = _corners((float(start[0]), float(start[1])), lefts, rights)
    for gate, corner in corners[1:-1]:
        if (high[gate] < 1.0 and corner == lefts[gate]) or (low[gate] > 0.0 and corner == rights[gate]):
            return None
    crossings = np.empty_like(left)
    for (gate, a), (until, b) in pairwise(corners):
        between = slice(gate + 1, until)
        crossings[between] = _meet(np.array(a), np.array(b), left[between], right[between])
        if until < len(left):
            crossings[until] = b
    return crossings


def _cut_off(start: Array, left: Array, right: Array, end: Array) -> tuple[Array, Array] | None:
    """From where to where each gate, counted from 0 right to 1 left, lies beyond the one before and short of the next.

    None where nothing does, or the start is not short of the first gate, the end not beyond the last.
    """
    across = left - right
    low, high = np.zeros(len(left)), np.ones(len(left))
    for here, other, sign in ((slice(1, None), slice(-1), 1.0), (slice(-1), slice(1, None), -1.0)):
        # How far short of the other gate's line each end is, or beyond.
        at_right = sign * _cross(across[other], right[here] - right[other])
        at_left = sign * _cross(across[other], left[here] - right[other])
        cut = at_right / np.where(at_right == at_left, 1.0, at_right - at_left)
        low[here] = np.where((at_right > 0.0) & (at_left <= 0.0), np.maximum(low[here], cut), low[here])
        high[here] = np.where((at_right <= 0.0) & (at_left > 0.0), np.minimum(high[here], cut), high[here])
        high[here] = np.where((at_right > 0.0) & (at_left > 0.0), -1.0, high[here])
    passed = _cross(across[0], start - right[0]) < 0.0 or _cross(across[-1], end - right[-1]) > 0.0
    if passed or (low > high).any():
        return None
    return low, high


def _cross(a: Array, b: Array) -> Array:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def _corners(start: Point, left: list[Point], right: list[Point]) -> list[tuple[int, Point]]:
    """The corners with the gates they belong to: the start (gate -1), gates' ends, and the last gate, a point."""

    def turn(a: Point, b: Point, c: Point) -> float:
        """Positive when c is to the left of the line from a to b."""
        return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])

    # What is seen from the apex lies between the lines to the tips, right and left.
    ends, turned = (right, left), (1.0, -1.0)
    corners = [(-1, start)]
    apex, tips, tip_gates = start, [start, start], [-1, -1]
    gate = 0
    while gate < len(left):
        for side, other in ((0, 1), (1, 0)):
            point = ends[side][gate]
            if turned[side] * turn(apex, tips[side], point) < 0.0:
                continue  # it would see more, not less
            if apex == tips[side] or turned[side] * turn(apex, tips[other], point) < 0.0:
                tips[side], tip_gates[side] = point, gate
            else:
                apex, gate = tips[other], tip_gates[other]
                corners.append((gate, apex))
                tips, tip_gates = [apex, apex], [gate, gate]
                break
        gate += 1
    if corners[-1][0] < len(left) - 1:
        corners.append((len(left) - 1, left[-1]))
    return corners


def _meet(a: Array, b: Array, left: Array, right: Array) -> Array:
    """Where the line from ``a`` to ``b`` crosses each gate, ``(g, 2)``; a gate's end where it only grazes it."""
    way = left - right
    over = _cross(b - a, way)
    share = _cross(a - right, b - a) / np.where(over == 0.0, 1.0, -over)
    return np.asarray(right + np.clip(share, 0.0, 1.0)[:, None] * way)
