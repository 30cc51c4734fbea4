"""Control-point rows: the control points of a piece as combinations of its joints' states, linear but for the time.

Unknown are the position W, velocity V and acceleration A at every inner joint, and of every piece its duration T
and its two inner acceleration control points K_1, K_2 (degree 5). Everything else is a polynomial in them, with no
division by T:

    P_0 = W              Q_1 = V + T/4 A             K_0 = A
    P_1 = W + T/5 V      Q_2 = half from each side   K_1, K_2 free
    P_2 = W + 2T/5 V + T^2/20 A                      K_3 = A'
    P_3 .. P_5 and Q_3, Q_4 mirrored from the piece's end (W', V', A')

with two vector equations a piece, the dynamics of a curve of degree 5 (paper equations (9) and (11), summed up):

    E_1:  V' - V = T/4 (A + K_1 + K_2 + A')
    E_2:  W' - W = T V + T^2/20 (4 A + 3 K_1 + 2 K_2 + A')

Each control point is thus a *control-point row* of a table: a combination of the eight vectors (W, V, A, W', V', A',
K_1, K_2) whose coefficients are polynomials in T, the same for all three axes and all pieces.

Rows are also homogeneous. Count W, V, A and the rows P, Q, K as of dimension 0, 1, 2: then a coefficient at T is the
one at T = 1 times T^(dimension of the vector - dimension of the row). It stays so when K_1 and K_2 are eliminated by
means of E_1 and E_2 (`Table.reduced`), which is what `planner.joint.newton` does.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from planner import bezier
from planner.arrays import Array, Indices

# The eight vectors of a piece: the joint before, the joint after, the inner two.
W, V, A, W1, V1, A1, K1, K2 = range(8)
VECTORS = 8
VECTOR_DIMENSION = np.array([0, 1, 2, 0, 1, 2])

# Control-point rows that every table has, by what they are.
P_ROWS = (0, 1, 2, 3, 4, 5)
Q_ROWS = (6, 7, 8, 9)  # Q_1 .. Q_4; Q_0 is Q_4 of the piece before
K_ROWS = (10, 11, 12)  # K_1 .. K_3; K_0 is K_3 of the piece before
# Rows of a table with jerk: K_{j+1} - K_j, which is T/3 times the jerk control point.
J_ROWS = (13, 14, 15)

# Gauss-Legendre nodes and weights on 0 .. 1, exact for the integral of |acceleration|^2 over a piece.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(4)
GAUSS_NODES, GAUSS_WEIGHTS = 0.5 * (_NODES + 1.0), 0.5 * _WEIGHTS

# Above this many multiplications OpenBLAS starts threads, which cost far more here than they save.
_SERIAL_WORK = 250_000


def product(matrix: Array, values: Array) -> Array:
    """``matrix`` ``(m, n)`` times ``values`` ``(n, ...)`` over their first axis, in blocks that stay on one thread."""
    columns = values.reshape(len(values), -1)
    width, count = max(1, _SERIAL_WORK // matrix.size), columns.shape[1]
    if count <= width:
        result = matrix @ columns
    else:
        result = np.empty((len(matrix), count))
        for first in range(0, count, width):
            np.matmul(matrix, columns[:, first : first + width], out=result[:, first : first + width])
    return result.reshape(len(matrix), *values.shape[1:])


# E_1 and E_2 as K_1 + K_2 = 4/T E_1 and 3 K_1 + 2 K_2 = 20/T^2 E_2, solved.
SOLVE_INNER = np.array([[-2.0, 1.0], [3.0, -1.0]])


@dataclass(frozen=True, eq=False)
class Table:
    """Control-point rows: ``coefficients`` ``(3, R + 2, 8)`` of 1, T and T^2 in the ``R`` rows and, last, in the
    residuals of E_1, E_2.

    ``dimension`` ``(R,)`` of every row. ``jerk_rows``, ``velocity_rows``, ``acceleration_rows`` are empty where the
    table lacks them; the latter two are velocity and acceleration at the Gauss nodes.
    """

    coefficients: Array
    dimension: Indices
    jerk_rows: tuple[int, ...]
    velocity_rows: tuple[int, ...]
    acceleration_rows: tuple[int, ...]

    @property
    def rows(self) -> int:
        """Number of rows ``R``, the two equations not counted."""
        return len(self.dimension)

    @cached_property
    def stacked(self) -> Array:
        """``(3 (R + 2), 8)``: takes the vectors to the rows' factors of 1, T, T^2."""
        return np.ascontiguousarray(self.coefficients.reshape(-1, VECTORS))

    @cached_property
    def stacked_adjoint(self) -> Array:
        """``(24, R + 2)``: takes forces on rows to forces on vectors, again as factors of 1, T, T^2."""
        return np.ascontiguousarray(self.coefficients.transpose(0, 2, 1).reshape(-1, self.rows + 2))

    @cached_property
    def uses(self) -> list[list[tuple[int, bool]]]:
        """Of every row the vectors it is made of, and whether T multiplies them."""
        timed = (self.coefficients[1:] != 0.0).sum(axis=0) > 0
        used = timed | (self.coefficients[0] != 0.0)
        return [[(int(v), bool(timed[r, v])) for v in np.flatnonzero(used[r])] for r in range(self.rows)]

    @cached_property
    def inner_rows(self) -> Array:
        """``(2 R, 2)``: takes K_1, K_2 to the rows' factors of 1, T."""
        return np.ascontiguousarray(self.coefficients[:2, : self.rows, 6:].reshape(-1, 2))

    @cached_property
    def inner_rows_adjoint(self) -> Array:
        """``(4, R)``: takes forces on rows to forces on K_1, K_2, as factors of 1, T."""
        return np.ascontiguousarray(self.coefficients[:2, : self.rows, 6:].transpose(0, 2, 1).reshape(4, self.rows))

    @cached_property
    def inner(self) -> Array:
        """``(2, 6)``: K_1 and K_2 by the equations, as combinations of the joint vectors at T = 1."""
        equations = self.coefficients.sum(axis=0)[self.rows :, :6]
        return np.asarray(SOLVE_INNER @ (np.array([[4.0], [20.0]]) * equations))

    @cached_property
    def reduced(self) -> Array:
        """``(R + 2, 6)``: every row as a combination of the joint vectors at T = 1, K_1 and K_2 eliminated.

        The last two are K_1 and K_2 themselves.
        """
        at_one = self.coefficients.sum(axis=0)[: self.rows]
        return np.concatenate([at_one[:, :6] + at_one[:, 6:] @ self.inner, self.inner])

    @cached_property
    def reduced_dimension(self) -> Indices:
        """``(R + 2,)``: dimension of every row of ``reduced``."""
        return np.concatenate([self.dimension, [2, 2]])


@lru_cache(maxsize=8)
def table(*, jerk: bool = False, nodes: bool = False) -> Table:
    """The table with the rows asked for: ``jerk`` for jerk limits, ``nodes`` for an objective that integrates."""
    t = np.zeros((3, 13, VECTORS))
    t[0, 0, W] = 1
    t[0, 1, W], t[1, 1, V] = 1, 1 / 5
    t[0, 2, W], t[1, 2, V], t[2, 2, A] = 1, 2 / 5, 1 / 20
    t[0, 3, W1], t[1, 3, V1], t[2, 3, A1] = 1, -2 / 5, 1 / 20
    t[0, 4, W1], t[1, 4, V1] = 1, -1 / 5
    t[0, 5, W1] = 1
    t[0, 6, V], t[1, 6, A] = 1, 1 / 4
    t[0, 7, V], t[1, 7, A], t[1, 7, K1] = 1 / 2, 1 / 8, 1 / 8
    t[0, 7, V1], t[1, 7, A1], t[1, 7, K2] = 1 / 2, -1 / 8, -1 / 8
    t[0, 8, V1], t[1, 8, A1] = 1, -1 / 4
    t[0, 9, V1] = 1
    t[0, 10, K1] = t[0, 11, K2] = t[0, 12, A1] = 1
    start = np.zeros((3, 2, VECTORS))  # Q_0 and K_0
    start[0, 0, V] = start[0, 1, A] = 1
    accelerations = np.concatenate([start[:, 1:], t[:, 10:13]], axis=1)
    parts, dimension = [t], [0] * 6 + [1] * 4 + [2] * 3
    named: dict[str, tuple[int, ...]] = {"jerk": (), "velocity": (), "acceleration": ()}

    def add(name: str, rows: Array, order: int) -> None:
        named[name] = tuple(range(len(dimension), len(dimension) + rows.shape[1]))
        parts.append(rows)
        dimension.extend([order] * rows.shape[1])

    if jerk:
        add("jerk", np.diff(accelerations, axis=1), 2)
    if nodes:
        velocities = np.concatenate([start[:, :1], t[:, 6:10]], axis=1)
        add("velocity", bezier.bernstein(4, GAUSS_NODES) @ velocities, 1)
        add("acceleration", bezier.bernstein(3, GAUSS_NODES) @ accelerations, 2)
    equations = np.zeros((3, 2, VECTORS))
    equations[0, 0, V1], equations[0, 0, V] = 1, -1
    equations[1, 0, [A, K1, K2, A1]] = -1 / 4
    equations[0, 1, W1], equations[0, 1, W], equations[1, 1, V] = 1, -1, -1
    equations[2, 1, [A, K1, K2, A1]] = np.array([-4, -3, -2, -1]) / 20
    return Table(
        np.concatenate([*parts, equations], axis=1),
        np.array(dimension),
        named["jerk"],
        named["velocity"],
        named["acceleration"],
    )
