"""A time that nothing beginning with a given station sequence can beat: what lets an enumeration pass sequences over.

Nothing flies a corridor faster than its shortest polyline at full speed and a ramp at either end, and whatever begins
with a partial sequence is bounded by the polyline through that and a straight line on to the destination. Seen from
above, every handover lies where two discs meet, the largest cross-sections of the two balls inside the band.

The first and the last piece are slower than that, which prunes far more. A piece of degree 5 from rest has
Q_0 = Q_1 = 0, so it spans l <= T/5 (|Q_2| + |Q_3| + |Q_4|) with |Q_1+k| <= min(v, k a T/4): never more than 0.6 v on
average. The least T for l is concave, t(l), and where the piece ends while the vehicle is still slow the next ones lose
the rest of the v / 2a that any start from rest loses. With l and l' the lengths of the first and the last piece,

    time >= t(l) + t(l') + R(l, l') / v,    R the length of all others, at least F(w, w') - w l - w' l' for any w, w'

where F(w, w') is the length of the shortest polyline whose first and last piece count w and w' times: a cone program.
A few of these planes below R are enough, each laid where the bound is least so far. What is least over l and l' is
found on a grid: concave and linear, the sum is least in a corner of each of its cells. While it is not known which
piece will be the last, the least it can lose is taken.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from planner.arrays import Array, Indices
from planner.corridor.cone_program import ConeProgram
from planner.coverage.disc import covering_stations
from planner.coverage.overlap import adjacent_pairs
from planner.errors import SolverError
from planner.problem import Problem
from planner.routing.bound import planar_radii_m
from planner.speed_profile import fastest_time_s
from planner.trajectory import DEGREE

# What the shortest polyline may be too long by: it is a solver's answer, to a tolerance.
_POLYLINE_EXCESS = 1e-6
# Points of the grid of lengths of an end piece, planes laid below the length of the others, and what a plane must gain.
_GRID, _PLANES, _GAIN_S = 17, 4, 0.05
# Discs are grown by this part of their radius, so that the thinnest overlaps leave a solver room.
_GROWTH = 1e-6


class SequenceBounds:
    """Bounds for the sequences of one problem; what many sequences share is worked out once."""

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self._centres = problem.station_positions_m[:, :2]
        self._radii = planar_radii_m(problem, problem.ranges_m) * (1.0 + _GROWTH)
        self._unit = float(problem.ranges_m.max())
        self._programs: dict[int, _Polyline] = {}
        self._ends: dict[tuple[str, int, int, bool], tuple[Array, Array]] = {}
        self._slow_ends = problem.starts_at_rest and problem.min_overlap_s == 0.0

    def time_s(self, sequence: Sequence[int], *, complete: bool = False, enough_s: float = math.inf) -> float:
        """A time nothing that begins with ``sequence`` can beat, and so none for the sequence itself.

        ``complete``: for this sequence alone, with no more to follow, which bounds it more tightly. Neighbours of
        the sequence must meet. A bound of ``enough_s`` is not made tighter. Zero where the solver finds no polyline.
        """
        problem = self._problem
        speed = problem.limits.max_speed_m_s
        weights = np.ones(len(sequence))
        length_m = self._length_m(sequence, weights)
        start = np.linalg.norm([problem.start_velocity_m_s, problem.start_acceleration_m_s2], axis=1)
        bound_s = fastest_time_s(problem.limits, length_m, float(start[0]), float(start[1]))
        if len(sequence) < 2 or not self._slow_ends:
            return bound_s
        roomy = self._roomy(sequence, complete)
        first_m, first_s = self._end("start", sequence[0], sequence[1], roomy)
        if complete:
            last_m, last_s = self._end("destination", sequence[-1], sequence[-2], roomy)
        else:
            last_m, last_s = np.zeros(1), np.array([self._least_loss_s(roomy)])
        pieces_s = first_s[:, None] + last_s
        floor_s = np.full(np.maximum(np.array(pieces_s.shape) - 1, 1), -np.inf)
        for _ in range(_PLANES):
            others_m = length_m - weights[0] * first_m[:, None] - (weights[-1] * last_m if complete else 0.0)
            floor_s = np.maximum(floor_s, _least_in_cells(pieces_s + others_m / speed))
            least_s = float(floor_s.min())
            if least_s < bound_s + _GAIN_S:
                bound_s = max(bound_s, least_s)
                break
            bound_s = least_s
            if bound_s >= enough_s:
                break
            row, column = np.unravel_index(int(np.argmin(floor_s)), floor_s.shape)
            weights[0] = speed * _slope(first_m, first_s, int(row))
            if complete:
                weights[-1] = speed * _slope(last_m, last_s, int(column))
            length_m = self._length_m(sequence, weights)
        return bound_s

    def _length_m(self, sequence: Sequence[int], weights: Array) -> float:
        """Length of the shortest polyline with a corner in every overlap of the sequence, its pieces weighted."""
        start, end = self._problem.start_m[:2], self._problem.destination_m[:2]
        joints = len(sequence) - 1
        if joints == 0:
            return float(weights[0] * np.linalg.norm(end - start))
        if joints not in self._programs:
            self._programs[joints] = _Polyline(joints)
        stations = np.asarray(sequence)
        try:
            length = self._programs[joints].length(
                start / self._unit,
                end / self._unit,
                self._centres[stations] / self._unit,
                self._radii[stations] / self._unit,
                weights,
            )
        except SolverError:
            return 0.0
        return max(length * self._unit * (1.0 - _POLYLINE_EXCESS), 0.0)

    def _end(self, end: str, station: int, neighbour: int, roomy: bool) -> tuple[Array, Array]:
        """Lengths a piece between an end and the overlap of two stations may have ``(G,)``, and the least time of each.

        Between them the time is concave. ``roomy``: times may hold what the pieces beside it lose.
        """
        key = (end, station, neighbour, roomy)
        if key not in self._ends:
            problem = self._problem
            point = problem.start_m if end == "start" else problem.destination_m
            away = np.linalg.norm(problem.station_positions_m[[station, neighbour]] - point, axis=1)
            ranges = problem.ranges_m[[station, neighbour]]
            # The time bends most where pieces are shortest.
            nearest = self._planar_length_m(float((away - ranges).max()))
            farthest = max(float((away + ranges).min()), nearest)
            lengths_m = nearest + np.linspace(0.0, 1.0, _GRID) ** 2 * (farthest - nearest)
            if roomy:
                lengths_m = np.append(lengths_m, np.clip(self._slow_m, nearest, farthest))
            # One piece's time is concave between any two of these, also where it stops being the ramp's.
            lengths_m = np.unique(np.append(lengths_m, farthest))
            if len(lengths_m) == 1:
                lengths_m = np.repeat(lengths_m, 2)
            times_s = shortest_from_rest_s(problem, lengths_m)
            if roomy:
                times_s = np.maximum(times_s, lengths_m / problem.limits.max_speed_m_s + self._ramp_s)
            self._ends[key] = lengths_m, times_s
        return self._ends[key]

    def _planar_length_m(self, length_m: float) -> float:
        """The least a piece of that length can be long seen from above."""
        band_m = self._problem.limits.max_alt_m - self._problem.limits.min_alt_m
        return math.sqrt(max(length_m, 0.0) ** 2 - band_m**2) if length_m > band_m else 0.0

    @property
    def _ramp_s(self) -> float:
        """What speeding up from rest to full speed takes more than flying as far at full speed."""
        return self._problem.limits.max_speed_m_s / (2.0 * self._problem.limits.max_accel_m_s2)

    @cached_property
    def _slow_m(self) -> float:
        """Length of an end piece that loses just as much."""
        speed = self._problem.limits.max_speed_m_s
        low, high = 0.0, 0.6 * speed * 4.0 * speed / self._problem.limits.max_accel_m_s2
        for _ in range(60):
            middle = 0.5 * (low + high)
            loss_s = float(shortest_from_rest_s(self._problem, np.array(middle))) - middle / speed
            low, high = (middle, high) if loss_s < self._ramp_s else (low, middle)
        return low

    def _roomy(self, sequence: Sequence[int], complete: bool) -> bool:
        """Whether there is room for a ramp at either end beside the other end's piece, wherever the handovers are."""
        problem = self._problem
        ramp_m = problem.limits.max_speed_m_s * self._ramp_s
        ends = [(problem.destination_m, sequence[0])]
        if complete:
            ends.append((problem.start_m, sequence[-1]))
        return all(
            self._planar_length_m(
                float(np.linalg.norm(problem.station_positions_m[station] - point) - problem.ranges_m[station])
            )
            >= 2.0 * ramp_m
            for point, station in ends
        )

    def _least_loss_s(self, roomy: bool) -> float:
        """What the flight's end takes more than its length at full speed, whichever the last stations are."""
        return max(self._loss_s, self._ramp_s) if roomy else self._loss_s

    @cached_property
    def _loss_s(self) -> float:
        """The same for the last piece alone, as short as any may be."""
        problem = self._problem
        targets = covering_stations(problem, problem.destination_m)
        pairs = adjacent_pairs(problem).pairs
        pairs = np.concatenate([pairs, pairs[:, ::-1]])
        before = pairs[np.isin(pairs[:, 1], targets), 0]
        if not len(before):
            return 0.0
        away = np.linalg.norm(problem.station_positions_m[before] - problem.destination_m, axis=1)
        nearest_m = self._planar_length_m(float((away - problem.ranges_m[before]).min()))
        loss_s = float(shortest_from_rest_s(problem, np.array(nearest_m))) - nearest_m / problem.limits.max_speed_m_s
        return max(loss_s, 0.0)


def sequence_bound_s(problem: Problem, sequence: Sequence[int], *, complete: bool = False) -> float:
    """The best that `SequenceBounds` knows of one sequence, or of all that begin with it."""
    bounds = SequenceBounds(problem)
    bound_s = bounds.time_s(sequence)
    return max(bound_s, bounds.time_s(sequence, complete=True)) if complete else bound_s


def shortest_from_rest_s(problem: Problem, length_m: Array) -> Array:
    """The least T with T/5 (min(v, a T/4) + min(v, 2 a T/4) + min(v, 3 a T/4)) >= length (of any shape)."""
    speed, accel = problem.limits.max_speed_m_s, problem.limits.max_accel_m_s2
    counts = np.arange(1, 4)
    low = np.zeros(np.shape(length_m))
    high = np.maximum(length_m / (0.6 * speed), 4.0 * speed / accel)
    for _ in range(60):
        middle = 0.5 * (low + high)
        spans_m = middle / DEGREE * np.minimum(speed, counts * accel * middle[..., None] / 4.0).sum(axis=-1)
        short = spans_m < length_m
        low, high = np.where(short, middle, low), np.where(short, high, middle)
    return low


def _least_in_cells(values: Array) -> Array:
    """Least of the corners of every cell of a grid ``(G, H)``: ``(G - 1, H - 1)``, or ``(G - 1, 1)`` for H = 1."""
    rows = np.minimum(values[:-1], values[1:])
    return rows if values.shape[1] == 1 else np.minimum(rows[:, :-1], rows[:, 1:])


def _slope(lengths_m: Array, times_s: Array, cell: int) -> float:
    run = float(lengths_m[cell + 1] - lengths_m[cell])
    return float(times_s[cell + 1] - times_s[cell]) / run if run > 0.0 else 0.0


class _Polyline:
    """min sum_k w_k |W_k - W_{k-1}| with W_k in two discs each, for one number of joints: laid out once."""

    def __init__(self, joints: int) -> None:
        self._joints = joints
        rows, columns = _pattern(joints)
        pieces = joints + 1
        self._cost = np.concatenate([np.zeros(2 * joints), np.ones(pieces)])
        self._rows, self._columns = rows, columns
        self._program: ConeProgram | None = None

    def length(self, start: Array, end: Array, centres: Array, radii: Array, weights: Array) -> float:
        """The minimum. Raises `SolverError` where there is none, or none was found."""
        joints = self._joints
        pieces = joints + 1
        # Rows of piece k: t_k, then w_k (W_k - W_{k-1}); of a joint's disc: its radius, then W_k - centre.
        values = np.concatenate(
            [-np.ones(pieces), np.repeat(-weights[:-1], 2), np.repeat(weights[1:], 2), -np.ones(4 * joints)]
        )
        offset = np.zeros(3 * pieces + 6 * joints)
        offset[1:3] = -weights[0] * start
        offset[3 * joints + 1 : 3 * joints + 3] = weights[-1] * end
        discs = offset[3 * pieces :].reshape(joints, 2, 3)
        for side in (0, 1):
            discs[:, side, 0] = radii[side : side + joints]
            discs[:, side, 1:] = -centres[side : side + joints]
        if self._program is None:
            cones = [3] * (pieces + 2 * joints)
            self._program = ConeProgram(self._cost, self._rows, self._columns, values, offset, second_order=cones)
        else:
            self._program.update(values, offset)
        return float(self._cost @ self._program.solve())


def _pattern(joints: int) -> tuple[Indices, Indices]:
    """Rows and columns of A: unknown are the joints (x, y, x, y, ...) and then the length of every piece."""
    pieces = joints + 1
    k = np.arange(joints)
    axes = np.arange(2)
    xy = (2 * k[:, None] + axes).ravel()
    # b - A x = (t_k, w_k (W_k - W_{k-1})): the joint ends piece k and begins piece k + 1.
    ends = (3 * k[:, None] + 1 + axes).ravel()
    begins = (3 * (k[:, None] + 1) + 1 + axes).ravel()
    discs = (3 * pieces + 6 * k[:, None] + 1 + np.array([0, 1, 3, 4])).ravel()
    rows = np.concatenate([3 * np.arange(pieces), ends, begins, discs])
    columns = np.concatenate(
        [2 * joints + np.arange(pieces), xy, xy, (2 * k[:, None] + np.array([0, 1, 0, 1])).ravel()]
    )
    return rows, columns
