r"""The union of discs as a mesh of convex cells, and exact shortest paths through it.

The power diagram gives every point of the union to the disc it lies deepest in (least |p - c|^2 - r^2). Inside
the union its cells are convex, and two neighbouring cells share a piece of the chord through both circles' crossings:

        ____       ____
       /    \  ___/    \         cells: the three discs, cut at the bars
      |  A   ||_B_|  C  |        bars: portals; their ends are corners where two circles cross uncovered
       \____/     \____/

A shortest path is a chain of straight lines that turns at such corners alone, so it is found exactly by the
Polyanya search (Cui, Harabor and Grastien 2017): A* whose nodes are a root and an interval of a portal seen from it.
One thing more is left out than there: intervals that an earlier root, expanded before, reaches no later throughout.
At any moment the smallest f-value in the queue is a lower bound of the answer, so a search cut short still bounds.

Points of the plane are complex numbers here: east + 1j north, metres.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from itertools import count
from math import inf, sqrt

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from planner.arrays import Array, Indices

# How a portal looks from inside its cell, facing out: right end, left end, id of the corner at either end (-1: the
# end is inside the union and nothing turns there), the cell behind it, the portal's own number.
Portal = tuple[complex, complex, int, int, int, int]

# Relative size by which discs are grown: what touches within rounding is connected, and a bound stays a bound.
GROWTH = 1e-10


@dataclass(frozen=True)
class ShortestPath:
    """``length_m`` of the path; ``points_m`` ``(k, 2)`` its ends and turns; ``exact`` False: a lower bound only."""

    length_m: float
    points_m: Array
    exact: bool


class NavigationMesh:
    """Cells and portals of a union of discs: ``centres_m`` ``(M, 2)``, ``radii_m`` ``(M,)``, radii not negative."""

    def __init__(self, centres_m: Array, radii_m: Array) -> None:
        centres = np.asarray(centres_m, dtype=float)
        origin = 0.5 * (centres.min(axis=0) + centres.max(axis=0))
        scale = float((np.linalg.norm(centres - origin, axis=1) + radii_m).max()) or 1.0
        radii = np.asarray(radii_m, dtype=float) + GROWTH * scale
        self._centres = centres[:, 0] + 1j * centres[:, 1]
        self._radii = radii
        self._slack = GROWTH * scale
        facets, power_centres, neighbours = _power_triangulation((centres - origin) / scale, radii / scale)
        power_centres = power_centres * scale + complex(*origin)
        self._cells = self._build_cells(facets, power_centres, neighbours)

    def _build_cells(
        self, facets: Indices, power_centres: NDArray[np.complex128], neighbours: Indices
    ) -> dict[int, list[Portal]]:
        left, right, first, second = _edges(facets, neighbours)
        stations = len(self._radii)
        real = (first < stations) & (second < stations)
        left, right, first, second = left[real], right[real], first[real], second[real]
        along = self._centres[second] - self._centres[first]
        apart = np.abs(along)
        real = apart > 0
        left, right, first, second = left[real], right[real], first[real], second[real]
        along, apart = along[real], apart[real]
        unit = along / apart
        foot = (apart**2 + self._radii[first] ** 2 - self._radii[second] ** 2) / (2.0 * apart)
        half_square = self._radii[first] ** 2 - foot**2
        base = self._centres[first] + unit * foot
        ends = np.stack([((power_centres[side] - base) * (1j * unit).conj()).real for side in (left, right)])
        low, high = ends.min(axis=0), ends.max(axis=0)
        half = np.sqrt(np.maximum(half_square, 0.0))
        is_low_corner, is_high_corner = low <= -half + self._slack, high >= half - self._slack
        low, high = np.maximum(low, -half), np.minimum(high, half)
        opened = (half_square >= 0) & (low <= high)
        cells: dict[int, list[Portal]] = {int(i): [] for i in np.unique(facets) if i < stations}
        ones, others = first[opened].tolist(), second[opened].tolist()
        feet = base[opened]
        lows = (feet + 1j * unit[opened] * low[opened]).tolist()
        highs = (feet + 1j * unit[opened] * high[opened]).tolist()
        flags = zip(is_low_corner[opened].tolist(), is_high_corner[opened].tolist(), strict=True)
        for k, (i, j, a, b, (a_corner, b_corner)) in enumerate(zip(ones, others, lows, highs, flags, strict=True)):
            corner_a, corner_b = (2 * k if a_corner else -1), (2 * k + 1 if b_corner else -1)
            cells[i].append((a, b, corner_a, corner_b, j, k))
            cells[j].append((b, a, corner_b, corner_a, i, k))
        return cells

    def locate(self, point: complex) -> int | None:
        """The cell that holds ``point``, None when no disc does."""
        indices = np.fromiter(self._cells, dtype=np.int64)
        distance = np.abs(self._centres[indices] - point)
        cell = int(indices[np.argmin(distance**2 - self._radii[indices] ** 2)])
        inside = abs(self._centres[cell] - point) <= self._radii[cell] + self._slack
        return cell if inside else None

    def shortest_path(
        self,
        start_m: tuple[float, float],
        target_m: tuple[float, float],
        *,
        max_expansions: int = 1_000_000,
        max_length_m: float = inf,
    ) -> ShortestPath | None:
        """The shortest path between two points inside the union, None when there is none within ``max_length_m``.

        After ``max_expansions`` steps of the search the best lower bound so far is returned, with ``exact`` False.
        """
        start, target = complex(*start_m), complex(*target_m)
        first, last = self.locate(start), self.locate(target)
        if first is None or last is None:
            return None
        if first == last:
            return ShortestPath(abs(target - start), np.array([start_m, target_m], dtype=float), True)
        return _Search(self._cells, start, target, last).run(first, max_expansions, max_length_m)


def _power_triangulation(centres: Array, radii: Array) -> tuple[Indices, NDArray[np.complex128], Indices]:
    """Dual of the power diagram: triangles ``(F, 3)``, their power centres ``(F,)``, their neighbours ``(F, 3)``.

    It is the lower hull of the points lifted to x^2 + y^2 - r^2. Everything fits in the unit circle; four
    far points frame it, so that one station, or stations in line, make no degenerate hull. Inside a disc its own
    power is negative and the frame's positive, so the frame never owns a point of the union.
    """
    frame = 4.0 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    points = np.concatenate([centres, frame])
    weight = np.concatenate([radii**2, np.zeros(4)])
    hull = ConvexHull(np.column_stack([points, (points**2).sum(axis=1) - weight]))
    normals = hull.equations[:, :3]
    lower = normals[:, 2] < -1e-12
    number = np.full(len(lower) + 1, -1)
    number[:-1][lower] = np.arange(int(lower.sum()))
    normals = normals[lower]
    power_centres = -(normals[:, 0] + 1j * normals[:, 1]) / (2.0 * normals[:, 2])
    return hull.simplices[lower].astype(np.int64), power_centres, number[hull.neighbors[lower]]


def _edges(facets: Indices, neighbours: Indices) -> tuple[Indices, ...]:
    """Every inner edge once: the two triangles beside it and the two vertices on it."""
    triangles = np.repeat(np.arange(len(facets)), 3)
    other = neighbours.ravel()
    first = facets[:, [1, 2, 0]].ravel()
    second = facets[:, [2, 0, 1]].ravel()
    keep = other > triangles
    return triangles[keep], other[keep], first[keep], second[keep]


def _cross(a: complex, b: complex) -> float:
    return a.real * b.imag - a.imag * b.real


@dataclass(frozen=True)
class _Root:
    """A turn of the path: where, how long the path is so far, and the turn before."""

    point: complex
    length: float
    corner: int
    previous: _Root | None


class _Search:
    def __init__(self, cells: dict[int, list[Portal]], start: complex, target: complex, last: int) -> None:
        self._cells = cells
        self._target = target
        self._last = last
        self._best: dict[int, float] = {}
        # Roots and intervals expanded through each portal into each cell.
        self._seen: dict[tuple[int, int], list[tuple[_Root, complex, int, complex, int]]] = {}
        self._queue: list[tuple[float, int, _Root, complex, int, complex, int, int, int]] = []
        self._ties = count()
        self._start = _Root(start, 0.0, -1, None)

    def run(self, first: int, max_expansions: int, max_length_m: float) -> ShortestPath | None:
        for right, left, right_corner, left_corner, cell, portal in self._cells[first]:
            self._push(self._start, right, right_corner, left, left_corner, cell, portal)
        for step in count():
            if not self._queue:
                return None
            f, _, root, right, right_corner, left, left_corner, cell, portal = heapq.heappop(self._queue)
            if f > max_length_m:
                return None
            if cell == self._last:
                return ShortestPath(f, self._points(root, right, left), True)
            if step >= max_expansions:
                return ShortestPath(f, self._points(root, right, left), False)
            if root.length > self._best.get(root.corner, inf) * (1.0 + 1e-12):
                continue
            if not self._beaten(root, right, right_corner, left, left_corner, cell, portal):
                self._expand(root, right, right_corner, left, left_corner, cell, portal)
        return None

    def _beaten(
        self, root: _Root, right: complex, right_corner: int, left: complex, left_corner: int, cell: int, portal: int
    ) -> bool:
        """Whether all of the portal's interval is reached no later from a root that was expanded before.

        It sees the whole interval with the corners at its ends, and at both ends x its way is no longer:
        d' + |r' - x| <= d + |r - x|. Where its turn is the later one (d <= d') so it is in between, inside a branch of
        a hyperbola, which is convex. Otherwise the chord of |r' - x|, which is convex, is held against the least that
        |r - x| + d - d' can be above it.
        """
        key = (portal, cell)
        others = self._seen.get(key)
        if others is None:
            self._seen[key] = [(root, right, right_corner, left, left_corner)]
            return False
        length, point = root.length, root.point
        to_right, to_left = abs(right - point), abs(left - point)
        for other, its_right, its_right_corner, its_left, its_left_corner in others:
            if right_corner not in (-1, its_right_corner) or left_corner not in (-1, its_left_corner):
                continue
            lead = length - other.length
            its_to_right = abs(right - other.point)
            its_to_left = abs(left - other.point)
            if its_to_right > to_right + lead or its_to_left > to_left + lead:
                continue
            width = its_left - its_right
            # Both ends lie on the portal, so along it one number says where.
            size = width.real**2 + width.imag**2
            low, high = right - its_right, left - its_right
            if low.real * width.real + low.imag * width.imag < 0.0:
                continue
            if high.real * width.real + high.imag * width.imag > size:
                continue
            if lead <= 0.0 or _stays_below(point, lead, right, left, its_to_right, its_to_left):
                return True
        others.append((root, right, right_corner, left, left_corner))
        return False

    def _push(
        self, root: _Root, right: complex, right_corner: int, left: complex, left_corner: int, cell: int, portal: int
    ) -> None:
        # `_through` without the turn, the usual case first: the target in sight on the far side of the portal.
        point, target = root.point, self._target
        along, from_root, from_target = left - right, point - right, target - right
        x, y = along.real, along.imag
        side = x * from_root.imag - y * from_root.real
        across = x * from_target.imag - y * from_target.real
        reach = abs(along)
        if abs(side) <= 1e-12 * reach * (reach + abs(from_root)):
            bound, _ = _through(point, right, left, target)
        else:
            if side * across > 0.0:
                target = right + along * (from_target / along).conjugate()
            ahead, to_left, to_right = target - point, left - point, right - point
            if to_left.real * ahead.imag - to_left.imag * ahead.real > 0.0:
                bound = abs(to_left) + abs(target - left)
            elif to_right.real * ahead.imag - to_right.imag * ahead.real < 0.0:
                bound = abs(to_right) + abs(target - right)
            else:
                bound = abs(ahead)
        item = (root.length + bound, next(self._ties), root, right, right_corner, left, left_corner, cell, portal)
        heapq.heappush(self._queue, item)

    def _turn(self, root: _Root, point: complex, corner: int) -> _Root | None:
        """The path turned at a corner; None where a shorter way there is known."""
        length = root.length + abs(point - root.point)
        best = self._best.get(corner, inf)
        if length > best * (1.0 + 1e-12):
            return None
        self._best[corner] = min(best, length)
        return _Root(point, length, corner, root)

    def _expand(
        self, root: _Root, right: complex, right_corner: int, left: complex, left_corner: int, cell: int, entered: int
    ) -> None:
        origin = root.point
        ox, oy = origin.real, origin.imag
        lx, ly, rx, ry = left.real - ox, left.imag - oy, right.real - ox, right.imag - oy
        left_turn = right_turn = None
        turned_left = left_corner < 0
        turned_right = right_corner < 0
        for a, b, a_corner, b_corner, beyond, portal in self._cells[cell]:
            # A cell with no other way out, unless the target is in it, leads nowhere.
            if portal == entered or (beyond != self._last and len(self._cells[beyond]) == 1):
                continue
            # The part (low, high) of the portal between the two rays, from a to b.
            ax, ay, bx, by = a.real - ox, a.imag - oy, b.real - ox, b.imag - oy
            low, high = 0.0, 1.0
            at_a, at_b = lx * ay - ly * ax, lx * by - ly * bx
            if at_a > 0.0:
                high = 0.0
            elif at_b > 0.0:
                high = at_a / (at_a - at_b)
            at_a, at_b = rx * ay - ry * ax, rx * by - ry * bx
            if at_b < 0.0:
                low = 1.0
            elif at_a < 0.0:
                low = at_a / (at_a - at_b)
            # Seen straight from the root; beyond the edges of the view only by turning at the portal's own corners.
            if low < high:
                p, p_corner = (a, a_corner) if low <= 0.0 else (a + low * (b - a), -1)
                q, q_corner = (b, b_corner) if high >= 1.0 else (a + high * (b - a), -1)
                self._push(root, p, p_corner, q, q_corner, beyond, portal)
            if high < 1.0:
                if not turned_left:
                    left_turn, turned_left = self._turn(root, left, left_corner), True
                if left_turn is not None:
                    p, p_corner = (a, a_corner) if high <= 0.0 else (a + high * (b - a), -1)
                    self._push(left_turn, p, p_corner, b, b_corner, beyond, portal)
            if low > 0.0:
                if not turned_right:
                    right_turn, turned_right = self._turn(root, right, right_corner), True
                if right_turn is not None:
                    q, q_corner = (b, b_corner) if low >= 1.0 else (a + low * (b - a), -1)
                    self._push(right_turn, a, a_corner, q, q_corner, beyond, portal)

    def _points(self, root: _Root, right: complex, left: complex) -> Array:
        _, turn = _through(root.point, right, left, self._target)
        points = [self._target] if turn is None else [self._target, turn]
        link: _Root | None = root
        while link is not None:
            points.append(link.point)
            link = link.previous
        return np.array([[z.real, z.imag] for z in reversed(points)])


def _stays_below(point: complex, lead: float, right: complex, left: complex, at_right: float, at_left: float) -> bool:
    """Whether the line from ``at_right`` to ``at_left`` is below |point - x| + lead all along right to left.

    At both ends it is. With h the distance of the point from the line through them and s the slope, sqrt(h^2 + t^2) -
    s t is least at t = h s / sqrt(1 - s^2), where it is h sqrt(1 - s^2).
    """
    width = abs(left - right)
    if width == 0.0:
        return True
    along = (left - right) / width
    offset = (point - right) * along.conjugate()
    slope = (at_left - at_right) / width
    rest = 1.0 - slope * slope
    if rest <= 0.0:
        return False
    height = abs(offset.imag)
    least_at = offset.real + height * slope / sqrt(rest)
    if not 0.0 < least_at < width:
        return True
    return at_right + slope * offset.real <= height * sqrt(rest) + lead


def _through(root: complex, right: complex, left: complex, target: complex) -> tuple[float, complex | None]:
    """Length of the shortest way from ``root`` over the segment ``right``-``left`` to ``target``, and its turn."""
    along = left - right
    side = _cross(along, root - right)
    reach = abs(along)
    if abs(side) <= 1e-12 * reach * (reach + abs(root - right)):
        # The root lies on the segment's own line: over the nearest point of it.
        where = 0.0 if reach == 0.0 else ((root - right) * along.conjugate()).real / reach**2
        turn = right + min(max(where, 0.0), 1.0) * along
        return abs(turn - root) + abs(target - turn), (None if 0.0 <= where <= 1.0 else turn)
    if side * _cross(along, target - right) > 0.0:
        target = right + along * ((target - right) / along).conjugate()
    if _cross(left - root, target - root) > 0.0:
        return abs(left - root) + abs(target - left), left
    if _cross(right - root, target - root) < 0.0:
        return abs(right - root) + abs(target - right), right
    return abs(target - root), None
