"""P4: the shortest polyline through the overlaps, equation (30), as a second-order cone program.

    minimise  sum_k t_k    with  |W_k - W_{k-1}| <= t_k,  W_k in every ball of joint k and in the altitude band

The joints are unknown as offsets from their Chebyshev centres, in units of the mean range: plain metres make the
solver fail.
"""

from __future__ import annotations

import numpy as np

from planner.arrays import Array, Indices
from planner.corridor.chebyshev import BAND_SHRINK_M, ChebyshevCentres, alike, chebyshev_centres, slack_m
from planner.corridor.cone_program import ConeProgram
from planner.corridor.corridor import Corridor
from planner.coverage.elevation_mask import ElevationMask
from planner.errors import SolverError
from planner.problem import Problem


def shortest_polyline(
    problem: Problem, corridor: Corridor, centres: ChebyshevCentres | None = None, weights: Array | None = None
) -> Array:
    """Start, joints and destination ``(S + 1, 3)`` of the shortest polyline along ``corridor``.

    ``weights`` ``(S,)``: what a metre of each piece counts, 1 when not given.

    Every joint lies in all its balls and in the band at zero tolerance. Where the solver gives up, the Chebyshev
    centres themselves: longer, but always there. Raises `InfeasibleError` where two neighbours of the corridor do not
    meet.
    """
    centres = centres or chebyshev_centres(problem, corridor)
    joints = centres.points_m.copy()
    free = np.flatnonzero(~centres.thin)
    if len(free):
        try:
            joints[free] = _PolylineProgram(problem, corridor, centres, free).joints(weights)
        except SolverError:
            joints = centres.points_m.copy()
    return settled(problem, corridor, centres, joints)


def settled(problem: Problem, corridor: Corridor, centres: ChebyshevCentres, joints_m: Array) -> Array:
    """``joints_m`` ``(S - 1, 3)`` moved to where every constraint holds exactly, between start and destination.

    Each is drawn towards its Chebyshev centre just as far as it takes.
    """
    limits = problem.limits
    joints = joints_m.copy()
    joints[:, 2] = np.clip(joints[:, 2], limits.min_alt_m, limits.max_alt_m)
    for which, balls in alike(corridor):
        outside = slack_m(problem, balls, joints[which]) < 0.0
        which, balls = which[outside], balls[outside]
        wanted, centre = joints[which], centres.points_m[which]
        share = 1e-9
        while len(which) and share < 1.0:
            joints[which] = wanted + share * (centre - wanted)
            outside = slack_m(problem, balls, joints[which]) < 0.0
            which, balls, wanted, centre = which[outside], balls[outside], wanted[outside], centre[outside]
            share *= 4.0
        joints[which] = centre
    return np.vstack([problem.start_m, joints, problem.destination_m])


def polyline_length_m(waypoints_m: Array) -> float:
    """Length of a polyline ``(K, 3)``."""
    return float(np.linalg.norm(np.diff(waypoints_m, axis=0), axis=1).sum())


class _PolylineProgram:
    """P4's rows b - A x in a product of cones, laid out joint by joint and piece by piece.

    Unknown are three offsets for each of the ``free`` joints ``(F,)`` (from 0), then the length of every piece; thin
    joints stay at their Chebyshev centre. Rows must be added in the order of their cones: equalities, inequalities,
    second-order cones.
    """

    def __init__(self, problem: Problem, corridor: Corridor, centres: ChebyshevCentres, free: Indices) -> None:
        self._problem, self._corridor, self._shrink_m = problem, corridor, centres.shrink_m
        self._unit = float(problem.ranges_m[list(corridor.sequence)].mean())
        self._known = np.vstack([problem.start_m, centres.points_m, problem.destination_m])
        self._free = free + 1
        self._column = np.full(len(corridor) + 1, -1)
        self._column[self._free] = 3 * np.arange(len(free))
        self._lengths = 3 * len(free) + np.arange(len(corridor))
        self._mask = ElevationMask.of(problem)
        self._rows: list[int] = []
        self._columns: list[int] = []
        self._values: list[float] = []
        self._offset: list[float] = []
        self._second_order: list[int] = []

    def joints(self, weights: Array | None) -> Array:
        """The free joints ``(F, 3)`` of the minimiser. Raises `SolverError`."""
        limits = self._problem.limits
        if limits.min_alt_m == limits.max_alt_m:
            self._add_flat_band()
        zero = len(self._offset)
        for joint in self._free:
            if limits.min_alt_m < limits.max_alt_m:
                self._add_band(joint)
            self._add_horizons(joint)
        nonnegative = len(self._offset) - zero
        for piece in range(len(self._corridor)):
            self._add_length(piece)
        for joint in self._free:
            self._add_balls(joint)
            self._add_elevation_cones(joint)
        cost = np.zeros(3 * len(self._free) + len(self._corridor))
        cost[self._lengths] = 1.0 if weights is None else weights
        program = ConeProgram(
            cost,
            np.array(self._rows),
            np.array(self._columns),
            np.array(self._values),
            np.array(self._offset),
            zero=zero,
            nonnegative=nonnegative,
            second_order=self._second_order,
        )
        offsets = program.solve()[: 3 * len(self._free)].reshape(-1, 3)
        return np.asarray(self._known[self._free] + self._unit * offsets)

    def _add(self, constant_m: float, *entries: tuple[int, float]) -> None:
        """One row: a constant in metres, and entries of A as columns and values."""
        for column, value in entries:
            self._rows.append(len(self._offset))
            self._columns.append(column)
            self._values.append(value)
        self._offset.append(constant_m / self._unit)

    def _from_antenna_m(self, joint: int, station: int) -> Array:
        """The place a joint is counted from, less the station's antenna ``(3,)``."""
        return np.asarray(self._known[joint] - self._problem.station_positions_m[station])

    def _add_flat_band(self) -> None:
        for joint in self._free:
            self._add(self._problem.limits.min_alt_m - self._known[joint, 2], (self._column[joint] + 2, 1.0))

    def _add_band(self, joint: int) -> None:
        limits = self._problem.limits
        shrink = min(BAND_SHRINK_M, 0.25 * (limits.max_alt_m - limits.min_alt_m))
        for sign, edge in ((-1.0, limits.min_alt_m + shrink), (1.0, limits.max_alt_m - shrink)):
            self._add(sign * (edge - self._known[joint, 2]), (self._column[joint] + 2, sign))

    def _add_horizons(self, joint: int) -> None:
        """At a lowest elevation of zero the cone is the half-space above the antenna."""
        for station in self._corridor.joint_balls(joint):
            if self._mask is not None and self._mask.horizon[station]:
                self._add(self._from_antenna_m(joint, station)[2], (self._column[joint] + 2, -1.0))

    def _add_length(self, piece: int) -> None:
        self._add(0.0, (int(self._lengths[piece]), -1.0))
        step = self._known[piece + 1] - self._known[piece]
        ends = [(joint, sign) for joint, sign in ((piece + 1, -1.0), (piece, 1.0)) if self._column[joint] >= 0]
        for axis in range(3):
            self._add(step[axis], *((self._column[joint] + axis, sign) for joint, sign in ends))
        self._second_order.append(4)

    def _add_balls(self, joint: int) -> None:
        for station in self._corridor.joint_balls(joint):
            self._add(self._problem.ranges_m[station] - self._shrink_m[joint - 1])
            offset = self._from_antenna_m(joint, station)
            for axis in range(3):
                self._add(offset[axis], (self._column[joint] + axis, -1.0))
            self._second_order.append(4)

    def _add_elevation_cones(self, joint: int) -> None:
        """|xy - O_xy| <= (z - h) / slope."""
        for station in self._corridor.joint_balls(joint):
            if self._mask is not None and self._mask.cone[station]:
                slope = float(self._mask.slope[station])
                offset = self._from_antenna_m(joint, station)
                self._add((offset[2] - self._shrink_m[joint - 1]) / slope, (self._column[joint] + 2, -1.0 / slope))
                for axis in range(2):
                    self._add(offset[axis], (self._column[joint] + axis, -1.0))
                self._second_order.append(3)
