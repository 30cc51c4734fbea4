"""One Newton step of the joint problem, condensed to the states at the joints.

Each piece's inner unknowns K_1, K_2 are eliminated by its own two equations before anything is assembled: linearised,
they are combinations of the piece's joints and T. What is left couples neighbouring joints alone, one banded matrix
of half-width 19. A piece's part of it is a sum over its control-point rows, of products of two coefficients times the
row's 3 x 3 matrix; since rows are homogeneous in T (`planner.joint.control_rows`), that sum is one product with a
constant matrix for all pieces.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack

from planner.arrays import Array, Indices
from planner.joint.control_rows import VECTOR_DIMENSION, Table, product
from planner.joint.objective import Objective
from planner.joint.transcription import (
    Point,
    Transcription,
    inner_scale,
    solve_inner,
    solve_inner_transposed,
    sum_over_rows,
)

# A piece's unknowns that neighbours share: nine of the joint before, T, nine of the joint after.
JOINT = 19
_PAIRS = [(v, w) for v in range(6) for w in range(v, 6)]
_PAIR_DIMENSION = np.array([VECTOR_DIMENSION[v] + VECTOR_DIMENSION[w] for v, w in _PAIRS])
# T and the joint after it: by how much one piece's unknowns lie after those of the piece before.
STRIDE = 10
_BLOCKS = 6 * len(_PAIRS)
# Of a piece: blocks of two joint vectors, joint vectors with T, T alone, and a zero.
_NUMBERS = _BLOCKS + 20
# A symmetric 3 x 3 matrix from its six numbers.
_SYMMETRIC = np.array([[0, 3, 4], [3, 1, 5], [4, 5, 2]])


@lru_cache(maxsize=8)
def _pair_product(table: Table) -> Array:
    """``(21, R)``: products of the rows' reduced coefficients of two vectors, at T = 1."""
    rows = table.reduced[: table.rows]
    return np.array([rows[:, v] * rows[:, w] for v, w in _PAIRS])


def _band_layout() -> Indices:
    """``(19, 19)``: where entry (i + d, i) of a piece's matrix lies among the numbers that `_assemble` lists."""
    layout = np.full((JOINT, JOINT), _NUMBERS - 1)
    vector = [0, 0, 0, 1, 1, 1, 2, 2, 2, -1, 3, 3, 3, 4, 4, 4, 5, 5, 5]
    axis = [0, 1, 2] * 3 + [0] + [0, 1, 2] * 3
    for i in range(JOINT):
        for j in range(i, JOINT):
            v, w = vector[i], vector[j]
            if v >= 0 and w >= 0:
                layout[i, j - i] = 6 * _PAIRS.index((v, w)) + _SYMMETRIC[axis[i], axis[j]]
            elif v < 0 and w < 0:
                layout[i, j - i] = _BLOCKS + 18
            else:
                layout[i, j - i] = _BLOCKS + 3 * max(v, w) + axis[i] + axis[j]
    return layout


@lru_cache(maxsize=16)
def _band_places(pieces: int) -> tuple[Indices, Indices]:
    """``(19, unknowns)`` each: the two places, among all pieces' numbers, whose sum every entry of the band is.

    An unknown of a joint is in two pieces' matrices. Each starts at the joint before it, nine unknowns before its T.
    """
    layout = _band_layout()
    places = np.full((2, (pieces + 1) * STRIDE, JOINT), _NUMBERS - 1)
    for piece in range(pieces):
        first = piece * STRIDE
        places[0, first : first + STRIDE] = piece * _NUMBERS + layout[:STRIDE]
        places[1, first + STRIDE : first + JOINT] = piece * _NUMBERS + layout[STRIDE:]
    unknowns = slice(STRIDE - 1, STRIDE - 1 + STRIDE * pieces - 9)
    one, other = (np.ascontiguousarray(side[unknowns]) for side in places)
    return one, other


class Step(NamedTuple):
    """A change of all unknowns, slacks and multipliers; ``equation`` is the new value of the equations' multipliers."""

    x: Array
    inner: Array
    slack: Array
    multiplier: Array
    equation: Array


class NewtonSystem:
    """The Lagrangian's second-order model at a point.

    ``multipliers`` ``(m,)`` and ``equation`` ``(2, 3, K)`` are those of inequalities and equations. ``gradient``
    ``(unknowns,)`` and ``inner_gradient`` ``(2, 3, K)``, by K_1 and K_2, are the Lagrangian's.
    """

    def __init__(
        self, problem: Transcription, objective: Objective, at: Point, multipliers: Array, equation: Array
    ) -> None:
        self.problem, self.objective, self.at, self.multipliers = problem, objective, at, multipliers
        self._table = problem.table
        t, rows = at.durations, problem.rows
        forces, time = problem.forces(at, multipliers)
        forces[rows:] = equation
        self._objective_time = objective.durations_gradient(at)
        self._energy = _Energy(objective, at) if objective.energy_weight else None
        if self._energy is not None:
            forces[self._energy.rows] += self._energy.forces
        # The force on the vectors, and its derivative by T: the Hessian's part that mixes vectors and T.
        vectors, self._mixed, force_time = problem.adjoint(at, forces)
        self.gradient = problem.scatter(vectors, time + force_time + self._objective_time)
        self.inner_gradient = vectors[6:]
        self._row_curvature, time_curvature = problem.curvatures(multipliers)
        self._time_curvature = time_curvature + sum_over_rows(forces * at.rows_dtt)
        # Along the equations K_1 and K_2 move with T by inner_dt, and rows in all by total_dt.
        self._inner_scale = inner_scale(t)
        self._inner_dt = solve_inner(self._inner_scale, at.rows_dt[rows:])
        self._total_dt = at.rows_dt[:rows] + self._inner_rows(self._inner_dt)
        self._power = np.ones((5, problem.pieces))
        for k in range(1, 5):
            np.multiply(self._power[k - 1], t, out=self._power[k])
        self._inverse_power = 1.0 / self._power
        self._row_power = self._inverse_power[self._table.reduced_dimension][:, None]
        self._vector_power = self._power[VECTOR_DIMENSION][:, None]

    def slope(self, step: Step) -> float:
        """The objective's first-order change along ``step``."""
        slope = float(self._objective_time @ step.x[0::STRIDE])
        if self._energy is not None:
            durations, vectors = self.problem.vectors(step.x, step.inner, step=True)
            rows = self.problem.row_step(self.at, durations, vectors)[self._energy.rows]
            slope += float((self._energy.forces * rows).sum())
        return slope

    def condense(self, ratio: Array) -> Array:
        """The reduced Hessian with barrier weights ``ratio`` ``(m,)``, as LAPACK's lower band ``(19, unknowns)``."""
        # The 3 x 3 matrix of every row: barrier weights times the gradients' squares, and the norms' own curvature.
        matrix, mixed, time = self.problem.squares(self.at, ratio)
        matrix[:, :3] += self._row_curvature
        if self._energy is not None:
            matrix[self._energy.rows] += self._energy.hessian
            mixed = np.zeros_like(self._total_dt) if mixed is None else mixed
            mixed[self._energy.rows] += self._energy.gradient
        pulled = (matrix[:, _SYMMETRIC] * self._total_dt[:, None]).sum(2)
        time = time + self._time_curvature + sum_over_rows(self._total_dt * pulled)
        time += 2.0 * sum_over_rows(self._inner_dt * self._mixed[6:])
        if mixed is not None:
            time += 2.0 * sum_over_rows(self._total_dt * mixed)
            pulled += mixed
        return self._assemble(matrix, pulled, time)

    def _assemble(self, matrix: Array, pulled: Array, time: Array) -> Array:
        """The band from the rows' matrices ``(R, 6, K)``, their products with total_dt, and the part of T alone."""
        pieces = self.problem.pieces
        evenness, tie = self.objective.evenness_hessian
        numbers = np.empty((_NUMBERS, pieces))
        squares = product(_pair_product(self._table), matrix * self._inverse_power[2 * self._table.dimension][:, None])
        blocks = numbers[:_BLOCKS].reshape(len(_PAIRS), 6, pieces)
        np.multiply(squares, self._power[_PAIR_DIMENSION][:, None], out=blocks)
        mixed = self._mixed[:6] + self._to_joints(np.concatenate([pulled, self._mixed[6:]]))
        numbers[_BLOCKS:-2] = mixed.reshape(18, pieces)
        numbers[-2] = time + evenness
        numbers[-1] = 0.0
        listed = numbers.T.ravel()
        one, other = _band_places(pieces)
        lower: Array = (listed.take(one) + listed.take(other)).T
        lower[STRIDE, :-1:STRIDE] += tie
        return lower

    def _to_joints(self, forces: Array) -> Array:
        """Forces on rows, K_1 and K_2 ``(R + 2, 3, K)`` as forces on the joint vectors, K_1 and K_2 moving along."""
        return np.asarray(product(self._table.reduced.T, forces * self._row_power) * self._vector_power)

    def _from_joints(self, vectors: Array) -> Array:
        """Change of rows, K_1 and K_2 ``(R + 2, 3, K)`` along the equations with the six joint vectors."""
        return np.asarray(product(self._table.reduced, vectors * self._vector_power) * self._row_power)

    def _inner_rows(self, inner: Array) -> Array:
        """Change of the rows ``(R, 3, K)`` with K_1 and K_2."""
        constant, linear = product(self._table.inner_rows, inner).reshape(2, self.problem.rows, 3, -1)
        return np.asarray(constant + self.at.durations * linear)

    def _on_inner(self, forces: Array) -> Array:
        """Forces on rows ``(R, 3, K)`` as forces on K_1 and K_2."""
        constant, linear = product(self._table.inner_rows_adjoint, forces).reshape(2, 2, 3, -1)
        return np.asarray(constant + self.at.durations * linear)

    def _row_forces(self, multipliers: Array, rows: Array, durations: Array) -> tuple[Array, Array]:
        """Forces on the rows ``(R + 2, 3, K)`` and on T ``(K,)`` after a change of rows ``(R, 3, K)`` and T.

        Those of the inequalities times ``multipliers``, of the objective, and of the curvature the change meets.
        """
        forces, time = self.problem.forces(self.at, multipliers)
        forces[:-2] += self._row_curvature * rows
        time += self._objective_time
        if self._energy is not None:
            at_nodes = rows[self._energy.rows]
            forces[self._energy.rows] += self._energy.forces + self._energy.change(at_nodes, durations)
            time += sum_over_rows(self._energy.gradient * at_nodes)
        return forces, time

    def direction(self, factor: Array, ratio: Array, gap: Array, equations: Array, centring: Array) -> Step:
        """The Newton step that closes ``gap`` ``(m,)`` and ``equations`` ``(2, 3, K)`` to first order.

        ``factor`` is the banded Cholesky factor of what `condense` made of the barrier weights ``ratio``, ``centring``
        the barrier's parameter over the slacks.
        """
        problem, at = self.problem, self.at
        still = np.zeros_like(at.durations)
        # First the part of K_1, K_2 that the equations fix, whatever the joints do.
        shift = solve_inner(self._inner_scale, equations)
        shifted = self._inner_rows(shift)
        forces, time = self._row_forces(centring + ratio * (gap + problem.change(at, still, shifted)), shifted, still)
        time += sum_over_rows(forces[:-2] * self._total_dt) + sum_over_rows(self._mixed[6:] * shift)
        x, _ = lapack.dpbtrs(factor, -problem.scatter(self._to_joints(forces), time), lower=1)
        # Then everything else follows from the joints.
        durations, vectors = problem.vectors(x, shift, step=True)
        moved = self._from_joints(vectors[:6])
        inner = shift + moved[-2:] + self._inner_dt * durations
        rows = shifted + moved[:-2] + self._total_dt * durations
        change = problem.change(at, durations, rows)
        multiplier = centring + ratio * (gap + change)
        forces, _ = self._row_forces(multiplier, rows, durations)
        balance = self._on_inner(forces[:-2]) + self._mixed[6:] * durations
        return Step(
            x,
            inner,
            -gap - change,
            multiplier - self.multipliers,
            solve_inner_transposed(self._inner_scale, balance),
        )


class _Energy:
    """The energy's derivatives at the rows of the nodes ``rows``, those by rows divided by T in ``gradient``."""

    def __init__(self, objective: Objective, at: Point) -> None:
        self.rows = list(objective.table.velocity_rows + objective.table.acceleration_rows)
        self.gradient = objective.row_gradient(at)
        self.forces = at.durations * self.gradient
        self.hessian = at.durations * objective.row_hessian(at)

    def change(self, rows: Array, durations: Array) -> Array:
        """First-order change of the forces with the nodes' rows and T."""
        return np.asarray((self.hessian[:, _SYMMETRIC] * rows[:, None]).sum(2) + self.gradient * durations)
