"""Second-order cone programs put straight into Clarabel: minimise c'x with b - A x in a product of cones.

One pattern, many solves: a program is laid out once and its numbers are exchanged in place, which saves the
symbolic factorisation (Clarabel allows that with presolve switched off). One thread: the same program gives
the same answer, bit for bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import clarabel
import numpy as np
from scipy import sparse

from planner.arrays import Array, Indices
from planner.errors import SolverError


class ConeProgram:
    """A cone program of fixed pattern.

    ``cost`` ``(n,)``; entries of A as ``rows``, ``columns``, ``values`` ``(nnz,)`` without duplicates; ``offset``
    ``(m,)`` is b. Rows come in the order of the cones: ``zero`` equalities, ``nonnegative`` rows, then second-order
    cones of the dimensions ``second_order`` (the bound first, the vector after it).
    """

    def __init__(
        self,
        cost: Array,
        rows: Indices,
        columns: Indices,
        values: Array,
        offset: Array,
        *,
        zero: int = 0,
        nonnegative: int = 0,
        second_order: Sequence[int] = (),
        tolerance: float = 1e-8,
    ) -> None:
        m, n = len(offset), len(cost)
        if zero + nonnegative + sum(second_order) != m:
            raise ValueError("the cones do not add up to the rows")
        # Where entry k of the caller's lists sits in the column-compressed matrix.
        self._order = np.lexsort((rows, columns))
        pointers = np.concatenate([[0], np.cumsum(np.bincount(columns, minlength=n))])
        self._matrix = sparse.csc_array((values[self._order], rows[self._order], pointers), shape=(m, n))
        self._offset = np.array(offset, dtype=float)
        cones: list[Any] = []
        if zero:
            cones.append(clarabel.ZeroConeT(zero))
        if nonnegative:
            cones.append(clarabel.NonnegativeConeT(nonnegative))
        cones += [clarabel.SecondOrderConeT(d) for d in second_order]
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.presolve_enable = False
        settings.max_threads = 1
        settings.tol_feas = settings.tol_gap_abs = settings.tol_gap_rel = tolerance
        self._cost = np.array(cost, dtype=float)
        self._cones, self._settings = cones, settings
        self._solver: Any = None

    def update(self, values: Array, offset: Array) -> None:
        """New numbers for A (in the order the entries were given) and b."""
        self._matrix.data[:] = values[self._order]
        self._offset = np.array(offset, dtype=float)
        if self._solver is not None:
            self._solver.update(A=self._matrix.data, b=self._offset)

    def solve(self, *, accept_unfinished: bool = False) -> Array:
        """The minimiser ``(n,)``. Raises `SolverError` when Clarabel finds none.

        ``accept_unfinished``: also the last point of a solve that ran out of progress, for callers that check what
        they get and have something to fall back on.
        """
        if self._solver is None:
            nothing = sparse.csc_array((len(self._cost), len(self._cost)))
            self._solver = clarabel.DefaultSolver(
                nothing, self._cost, self._matrix, self._offset, self._cones, self._settings
            )
        solution = self._solver.solve()
        x = np.array(solution.x)
        solved = str(solution.status) in ("Solved", "AlmostSolved")
        if not solved:
            # A solver that stumbled keeps no promise about its next solve.
            self._solver = None
        unfinished = str(solution.status) in ("InsufficientProgress", "MaxIterations")
        if not np.isfinite(x).all() or not (solved or (accept_unfinished and unfinished)):
            raise SolverError(f"the cone solver ended with {solution.status} after {solution.iterations} iterations")
        return x
