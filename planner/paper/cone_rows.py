"""Rows of a cone program in the boundary conditions of a corridor, with numbers that follow the durations.

Every row is s = constant + sum of coefficient * T[piece]^power * unknown, where an unknown is one coordinate of a
joint's position, velocity or acceleration, or the ratio J. So the pattern is laid out once, and new durations only
exchange the numbers.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner.arrays import Array, Flags, Indices

# Powers of T that go with position, velocity and acceleration at the start and at the end of a piece.
_POWERS = np.array([0, 1, 2, 0, 1, 2])
_RATIO = -1


@dataclass
class _Block:
    """Rows of one kind of cone: entries as (row, state, coefficient, power, piece), and constants."""

    entries: list[tuple[NDArray[Any], ...]] = field(default_factory=list)
    constants: list[Array] = field(default_factory=list)
    dimensions: list[int] = field(default_factory=list)
    count: int = 0

    def begin(self, cones: int, dimension: int) -> Indices:
        """The first row of each of ``cones`` new cones."""
        rows = self.count + dimension * np.arange(cones)
        self.count += dimension * cones
        self.dimensions += [dimension] * cones
        return np.asarray(rows)

    def add(self, rows: Indices, state: Indices | int, coefficient: Array | float, power: int, pieces: Indices) -> None:
        """One entry in each of ``rows``."""
        shape = rows.shape
        self.entries.append((rows, *(np.broadcast_to(part, shape) for part in (state, coefficient, power)), pieces))


@dataclass(frozen=True)
class ConeRows:
    """Finished rows, linear ones first; ``row`` and ``column`` are where the values of `numbers` stand in A."""

    row: Indices
    column: Indices
    nonnegative: int
    second_order: list[int]
    _all_rows: Indices
    _coefficient: Array
    _power: Indices
    _piece: Indices
    _state: Indices
    _unknown: Flags
    _constant: Array

    def numbers(self, durations: Array, reference: Array) -> tuple[Array, Array]:
        """Values of A and b for ``durations`` ``(S,)``; unknowns count from ``reference``, all states in a row.

        States that are not unknowns have their value there.
        """
        value = self._coefficient * durations[self._piece] ** self._power
        stands = self._state != _RATIO
        shift = np.bincount(
            self._all_rows[stands],
            weights=value[stands] * reference[self._state[stands]],
            minlength=len(self._constant),
        )
        return -value[self._unknown], self._constant + shift


class ConeLayout:
    """Collects the rows. ``free`` ``(S + 1, 3, 3)`` says which boundary conditions are unknown."""

    def __init__(self, free: Flags) -> None:
        states = np.arange(free.size).reshape(free.shape)
        # (S, 6, 3): where W, V, A at the start and at the end of each piece stand among all states.
        self._state = np.concatenate([states[:-1], states[1:]], axis=1)
        self._is_free = free.ravel()
        self._linear, self._conic = _Block(), _Block()

    def linear(
        self,
        pieces: Indices,
        combination: Array,
        axis: int,
        sign: float,
        constant: Array | float,
        ratio: tuple[float, int] | None = None,
    ) -> None:
        """Rows sign * combination + constant + ratio * J >= 0, one for each of ``pieces``.

        ``combination`` ``(6,)`` weighs a piece's states, e.g. a row of `CONTROL_FROM_BOUNDARY`; ``constant`` ``(P,)``
        or a number; ``ratio`` is (factor, power of T). Rows without an unknown are left out.
        """
        keep = self._touched(pieces, combination, [axis])
        pieces = pieces[keep]
        rows = self._linear.begin(len(pieces), 1)
        self._combine(self._linear, rows, pieces, sign * combination, axis)
        if ratio is not None:
            self._linear.add(rows, _RATIO, ratio[0], ratio[1], pieces)
        self._linear.constants.append(np.broadcast_to(constant, keep.shape)[keep])

    def cone(
        self,
        pieces: Indices,
        combination: Array,
        *,
        offset: Array | None = None,
        bound: Array | None = None,
        ratio: tuple[float, int] | None = None,
        drift: Array | None = None,
    ) -> None:
        """Cones |combination - offset| <= bound, or |combination - J drift| <= ratio * J, one for each of ``pieces``.

        ``offset`` ``(P, 3)``, ``bound`` ``(P,)``; ``ratio`` is (factor, power of T), ``drift`` ``(3,)`` goes with the
        same power. Cones without an unknown are left out.
        """
        keep = self._touched(pieces, combination, [0, 1, 2])
        pieces = pieces[keep]
        rows = self._conic.begin(len(pieces), 4)
        constants = np.zeros((len(pieces), 4))
        for axis in range(3):
            self._combine(self._conic, rows + 1 + axis, pieces, combination, axis)
            if drift is not None and ratio is not None and drift[axis] != 0.0:
                self._conic.add(rows + 1 + axis, _RATIO, -float(drift[axis]), ratio[1], pieces)
        if offset is not None:
            constants[:, 1:] = -offset[keep]
        if bound is not None:
            constants[:, 0] = bound[keep]
        if ratio is not None:
            self._conic.add(rows, _RATIO, ratio[0], ratio[1], pieces)
        self._conic.constants.append(constants.ravel())

    def upright_cone(self, pieces: Indices, combination: Array, *, apex: Array, slope: Array) -> None:
        """Cones slope * |horizontal part| <= vertical part of combination - apex.

        ``apex`` ``(P, 3)``, ``slope`` ``(P,)``.
        """
        keep = self._touched(pieces, combination, [0, 1, 2])
        pieces, apex, slope = pieces[keep], apex[keep], slope[keep]
        rows = self._conic.begin(len(pieces), 3)
        self._combine(self._conic, rows, pieces, combination, 2, 1.0 / slope)
        for axis in range(2):
            self._combine(self._conic, rows + 1 + axis, pieces, combination, axis)
        self._conic.constants.append(np.column_stack([-apex[:, 2] / slope, -apex[:, :2]]).ravel())

    def finish(self) -> ConeRows:
        """All rows; the unknowns are numbered in the order of the states, J last."""
        parts = []
        for block, shift in ((self._linear, 0), (self._conic, self._linear.count)):
            for row, *rest in block.entries:
                parts.append((row + shift, *rest))
        row, state, coefficient, power, piece = (np.concatenate(part) for part in zip(*parts, strict=True))
        number = np.full(self._is_free.size, -1)
        number[self._is_free] = np.arange(int(self._is_free.sum()))
        column = np.where(state == _RATIO, int(self._is_free.sum()), number[state])
        unknown = column >= 0
        return ConeRows(
            row=row[unknown],
            column=column[unknown],
            nonnegative=self._linear.count,
            second_order=self._conic.dimensions,
            _all_rows=row,
            _coefficient=coefficient,
            _power=power,
            _piece=piece,
            _state=state,
            _unknown=unknown,
            _constant=np.concatenate([*self._linear.constants, *self._conic.constants]),
        )

    def _touched(self, pieces: Indices, combination: Array, axes: list[int]) -> Flags:
        used = np.flatnonzero(combination)
        return np.asarray(self._is_free[self._state[pieces][:, used][:, :, axes]].any(axis=(1, 2)))

    def _combine(
        self, block: _Block, rows: Indices, pieces: Indices, combination: Array, axis: int, factor: Array | float = 1.0
    ) -> None:
        for slot in np.flatnonzero(combination):
            block.add(rows, self._state[pieces, slot, axis], combination[slot] * factor, int(_POWERS[slot]), pieces)
