"""The transcription of the joint problem over positions and times: smooth functions of the states at the joints.

The paper alternates between control points with times fixed and times with boundary states fixed. Here both move
at once: unknown are the states at the inner joints, the durations and two acceleration control points a piece, and
every control point is a control-point row of `planner.joint.control_rows.Table`, a row for short. A constraint is a
function of one row (and of T): the norm of a row less a centre (range, speed, acceleration, jerk, airspeed, elevation
cone), or bounds on its third axis (altitude, climb, descent). Its gradient is a vector of space for the row and a
number for T, so a few products with the constant table replace the Jacobian, which is never formed.

Arrays have the pieces last: vectors ``(8, 3, K)``, rows ``(R + 2, 3, K)``. Lengths and times are scaled
(`planner.joint.program.Scale`); nothing in this module is in metres or seconds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import TypeVar

import numpy as np

from planner.arrays import Array, Flags, Indices
from planner.joint.control_rows import A1, SOLVE_INNER, V1, VECTORS, W1, A, Table, V, W, product

# Entries (first axis, second axis) of a symmetric 3 x 3 matrix, kept as six numbers, its diagonal first.
FIRST_AXIS, SECOND_AXIS = np.array([0, 1, 2, 0, 0, 1]), np.array([0, 1, 2, 1, 2, 2])
THIRD_SQUARED = 2


@dataclass(frozen=True)
class NormConstraints:
    """``(sum_d weight_d (row_d - centre_d)^2 - radius^2 - (time_radius T)^2) / (2 scale) <= 0``, ``n`` of them.

    ``rows``, ``pieces`` ``(n,)`` say which row of which piece; ``centre``, ``weight`` ``(3, n)``; ``radius``,
    ``time_radius``, ``scale`` ``(n,)``. With weights 1 and ``scale = radius`` values near the boundary are distances.
    """

    rows: Indices
    pieces: Indices
    centre: Array
    weight: Array
    radius: Array
    time_radius: Array
    scale: Array


@dataclass(frozen=True)
class HeightConstraints:
    """``low <= third axis of a row <= high``, divided by ``scale``: ``(h,)`` each."""

    rows: Indices
    pieces: Indices
    low: Array
    high: Array
    scale: Array


_Constraints = TypeVar("_Constraints", NormConstraints, HeightConstraints)


@dataclass(frozen=True)
class Point:
    """Everything known at one value of the unknowns.

    ``inequalities`` ``(m,)`` are the norms, the heights' upper and then lower sides, and the least durations, all
    ``<= 0`` where they hold. ``rows`` ``(R + 2, 3, K)`` and their derivatives by T, ``rows_dtt`` constant in T.
    ``pull`` ``(3, n)`` are the norms' gradients by their rows, ``pull_time`` ``(n,)`` those by T at fixed rows.
    """

    durations: Array
    inequalities: Array
    rows: Array
    rows_dt: Array
    rows_dtt: Array
    pull: Array
    pull_time: Array

    @property
    def equations(self) -> Array:
        """Residuals ``(2, 3, K)`` of E_1 and E_2."""
        return self.rows[-2:]


class Transcription:
    """The scaled joint problem with ``K`` pieces between fixed end states ``(9,)`` (W, V, A).

    Unknowns: ``x`` ``(10 K - 9,)``: T of piece 0, the state after it, T of piece 1, ...; and ``inner`` ``(2, 3, K)``,
    being K_1 and K_2. Constraints that no unknown moves, such as the first control points of a start at rest, are
    left out.
    """

    def __init__(
        self,
        table: Table,
        first: Array,
        last: Array,
        norms: NormConstraints,
        heights: HeightConstraints,
        min_durations: Array,
    ) -> None:
        self.table, self.rows = table, table.rows
        self.first, self.last = np.asarray(first, dtype=float), np.asarray(last, dtype=float)
        self.min_durations = np.asarray(min_durations, dtype=float)
        self.pieces = len(self.min_durations)
        self.unknowns = 10 * self.pieces - 9
        self.norms = n = _select(norms, ~self._constant_rows()[norms.rows, norms.pieces])
        # A level start moves, but not in height.
        level = self._constant_rows(slice(2, 3))
        self.heights = h = _select(heights, ~level[heights.rows, heights.pieces])
        self.constraints = len(n.rows) + 2 * len(h.rows) + self.pieces
        self.curvature = n.weight / n.scale
        self.time_curvature = n.time_radius**2 / n.scale
        self.timed = np.flatnonzero(n.time_radius)
        self._half_square = 0.5 * n.radius**2 / n.scale
        # Where the rows of norms and heights lie in an array (R + 2, 3, K), flattened.
        self.norm_index = (3 * n.rows + np.arange(3)[:, None]) * self.pieces + n.pieces
        self._height_index = (3 * h.rows + 2) * self.pieces + h.pieces
        self._force_index = np.concatenate([self.norm_index.ravel(), self._height_index])
        # The same for a symmetric matrix a row, (R, 6, K).
        norm_matrix = (6 * n.rows + np.arange(6)[:, None]) * self.pieces + n.pieces
        height_matrix = (6 * h.rows + THIRD_SQUARED) * self.pieces + h.pieces
        self._matrix_index = np.concatenate([norm_matrix.ravel(), height_matrix])

    def _constant_rows(self, axes: slice = slice(None)) -> Flags:
        """``(R, K)``: rows that no unknown moves, as seen in some ``axes`` alone."""
        constant = np.zeros((self.rows, self.pieces), dtype=bool)
        for piece in {0, self.pieces - 1}:
            fixed: dict[int, Array] = {}
            if piece == 0:
                fixed |= dict(zip((W, V, A), self.first.reshape(3, 3), strict=True))
            if piece == self.pieces - 1:
                fixed |= dict(zip((W1, V1, A1), self.last.reshape(3, 3), strict=True))
            moves = {v for v, value in fixed.items() if value[axes].any()}
            for row, uses in enumerate(self.table.uses):
                constant[row, piece] = all(v in fixed and not (timed and v in moves) for v, timed in uses)
        return constant

    def vectors(self, x: Array, inner: Array, *, step: bool = False) -> tuple[Array, Array]:
        """Durations ``(K,)`` and vectors ``(8, 3, K)``; with ``step``, of a change of the unknowns (the ends stay)."""
        padded = np.empty(10 * self.pieces)
        padded[: self.unknowns] = x
        padded[self.unknowns :] = 0.0 if step else self.last
        by_piece = padded.reshape(self.pieces, 10).T
        vectors = np.empty((VECTORS, 3, self.pieces))
        before, after = vectors[:6].reshape(2, 9, self.pieces)
        after[:] = by_piece[1:]
        before[:, 1:] = after[:, :-1]
        before[:, 0] = 0.0 if step else self.first
        vectors[6:] = inner
        return by_piece[0].copy(), vectors

    def evaluate(self, x: Array, inner: Array) -> Point:
        """Constraints and first derivatives at ``x``, ``inner``."""
        t, vectors = self.vectors(x, inner)
        constant, linear, square = self._powers(vectors)
        bent = t * square
        rows = constant + t * (linear + bent)
        n, h = self.norms, self.heights
        flat = rows.ravel()
        offset = flat[self.norm_index] - n.centre
        pull = offset * self.curvature
        norm = 0.5 * (offset * pull).sum(0) - self._half_square
        pull_time = np.zeros(len(norm))
        if len(self.timed):
            own = t[n.pieces]
            pull_time = -self.time_curvature * own
            norm += 0.5 * pull_time * own
        height = flat[self._height_index]
        inequalities = np.concatenate(
            [norm, (height - h.high) / h.scale, (h.low - height) / h.scale, self.min_durations - t]
        )
        return Point(t, inequalities, rows, linear + 2.0 * bent, 2.0 * square, pull, pull_time)

    def _powers(self, vectors: Array) -> Array:
        """Factors of 1, T and T^2 in the rows, ``(3, R + 2, 3, K)``."""
        return product(self.table.stacked, vectors).reshape(3, self.rows + 2, 3, self.pieces)

    def row_step(self, at: Point, durations: Array, vectors: Array) -> Array:
        """First-order change of the rows ``(R + 2, 3, K)`` by a change of durations and vectors."""
        t = at.durations
        constant, linear, square = self._powers(vectors)
        change: Array = constant + t * (linear + t * square) + at.rows_dt * durations
        return change

    def change(self, at: Point, durations: Array, rows: Array) -> Array:
        """First-order change ``(m,)`` of the inequalities by one of durations ``(K,)`` and rows ``(>= R, 3, K)``."""
        flat = rows.ravel()
        norm = (at.pull * flat[self.norm_index]).sum(0)
        if len(self.timed):
            norm += at.pull_time * durations[self.norms.pieces]
        height = flat[self._height_index] / self.heights.scale
        return np.concatenate([norm, height, -height, -durations])

    def _parts(self, values: Array) -> tuple[Array, Array, Array, Array]:
        """Values of the inequalities ``(m,)``: norms, heights' upper sides, their lower sides, durations."""
        n, h = len(self.norms.rows), len(self.heights.rows)
        return values[:n], values[n : n + h], values[n + h : n + 2 * h], values[n + 2 * h :]

    def forces(self, at: Point, multipliers: Array) -> tuple[Array, Array]:
        """Sum of the inequalities' gradients times ``multipliers`` ``(m,)``: on rows ``(R + 2, 3, K)``, on T ``(K,)``.

        The part on T is the explicit one, rows held.
        """
        norm, upper, lower, least = self._parts(multipliers)
        weights = np.concatenate([(at.pull * norm).ravel(), (upper - lower) / self.heights.scale])
        pushed = _sum_at(self._force_index, weights, (self.rows + 2, 3, self.pieces))
        time = -least
        if len(self.timed):
            time += _sum_at(self.norms.pieces, at.pull_time * norm, (self.pieces,))
        return pushed, time

    def squares(self, at: Point, weights: Array) -> tuple[Array, Array | None, Array]:
        """Sum of the gradients' squares times ``weights`` ``(m,)``, row by row.

        Returns the rows' symmetric matrices ``(R, 6, K)``, their mixed part with T ``(R, 3, K)`` (None where there is
        none) and the part of T alone ``(K,)``.
        """
        norm, upper, lower, least = self._parts(weights)
        pulled = norm * at.pull
        entries = np.concatenate(
            [(pulled[FIRST_AXIS] * at.pull[SECOND_AXIS]).ravel(), (upper + lower) / self.heights.scale**2]
        )
        matrix = _sum_at(self._matrix_index, entries, (self.rows, 6, self.pieces))
        if not len(self.timed):
            return matrix, None, least
        mixed = _sum_at(self.norm_index, pulled * at.pull_time, (self.rows, 3, self.pieces))
        return matrix, mixed, least + _sum_at(self.norms.pieces, norm * at.pull_time**2, (self.pieces,))

    def curvatures(self, multipliers: Array) -> tuple[Array, Array]:
        """Second derivatives of the norms times ``multipliers``: by rows ``(R, 3, K)``, diagonal, and T ``(K,)``."""
        norm = self._parts(multipliers)[0]
        rows = _sum_at(self.norm_index, norm * self.curvature, (self.rows, 3, self.pieces))
        time = np.zeros(self.pieces)
        if len(self.timed):
            time -= _sum_at(self.norms.pieces, norm * self.time_curvature, (self.pieces,))
        return rows, time

    def adjoint(self, at: Point, forces: Array) -> tuple[Array, Array, Array]:
        """Forces on rows as forces on the vectors ``(8, 3, K)``, their derivative by T, and the force on T ``(K,)``."""
        t = at.durations
        constant, linear, square = product(self.table.stacked_adjoint, forces).reshape(3, VECTORS, 3, self.pieces)
        bent = t * square
        return constant + t * (linear + bent), linear + 2.0 * bent, sum_over_rows(forces * at.rows_dt)

    def scatter(self, vectors: Array, durations: Array) -> Array:
        """Sum of the pieces' forces on joint vectors ``(>= 6, 3, K)`` and T ``(K,)`` into one over the unknowns."""
        before, after = vectors[:6].reshape(2, 9, self.pieces)
        total = np.empty((self.pieces, 10))
        total[:, 0] = durations
        total[:, 1:] = after.T
        total[:-1, 1:] += before[:, 1:].T
        return total.ravel()[: self.unknowns]

    def consistent_inner(self, x: Array, limit: float = np.inf) -> Array:
        """K_1, K_2 ``(2, 3, K)`` that satisfy the equations at ``x``, cut to ``limit`` where they would be longer."""
        t, vectors = self.vectors(x, np.zeros((2, 3, self.pieces)))
        constant, linear, square = self._powers(vectors)[:, self.rows :]
        inner = solve_inner(inner_scale(t), constant + t * (linear + t * square))
        length = np.sqrt((inner * inner).sum(1, keepdims=True))
        limited: Array = inner / np.maximum(1.0, length / limit)
        return limited


def _select(constraints: _Constraints, kept: Flags) -> _Constraints:
    return type(constraints)(*(getattr(constraints, field.name)[..., kept] for field in fields(constraints)))


def _sum_at(index: Indices, values: Array, shape: tuple[int, ...]) -> Array:
    """Array of ``shape`` with every one of ``values`` added at its place in ``index``."""
    total: Array = np.bincount(index.ravel(), values.ravel(), math.prod(shape)).astype(float, copy=False)
    return total.reshape(shape)


def sum_over_rows(values: Array) -> Array:
    """``(..., K)`` summed over all but the pieces."""
    total: Array = values.reshape(-1, values.shape[-1]).sum(0)
    return total


def inner_scale(durations: Array) -> Array:
    """4/T and 20/T^2, ``(2, 1, K)``: what E_1 and E_2 are multiplied with to give the sums of K_1, K_2."""
    inverse = 1.0 / durations
    return np.array([4.0 * inverse, 20.0 * inverse * inverse])[:, None]


def solve_inner(scale: Array, residual: Array) -> Array:
    """Change of K_1, K_2 ``(2, 3, K)`` that takes ``residual`` ``(2, 3, K)`` off the two equations."""
    return product(SOLVE_INNER, scale * residual)


def solve_inner_transposed(scale: Array, force: Array) -> Array:
    """Multipliers ``(2, 3, K)`` of the equations that balance ``force`` ``(2, 3, K)`` on K_1 and K_2."""
    return scale * product(SOLVE_INNER.T, force)
