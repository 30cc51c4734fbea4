"""P5: with the durations fixed, the trajectory that is farthest from its dynamic limits, equation (37).

    minimise J   with  every control point in its balls and in the band,
                       |dP_j| <= J v_max T/5,  |d^2 P_j| <= J a_max T^2/20,  (|d^3 P_j| <= J j_max T^3/60)

a second-order cone program in the boundary conditions of the joints (see ``boundary``): nine unknowns a joint
and J. Climb, descent and airspeed are ratios like the speed, so that time scaling repairs them as it repairs speed.

Lengths are in units of the mean range and times in units of the mean duration at the outset.
"""

from __future__ import annotations

import numpy as np

from planner.arrays import Array
from planner.corridor.chebyshev import BAND_SHRINK_M, ChebyshevCentres
from planner.corridor.cone_program import ConeProgram
from planner.corridor.corridor import Corridor
from planner.coverage.elevation_mask import ElevationMask
from planner.paper.boundary import CONTROL_FROM_BOUNDARY, rest_at
from planner.paper.cone_rows import ConeLayout
from planner.paper.initial import initial_durations
from planner.problem import Problem

_VELOCITY = np.diff(CONTROL_FROM_BOUNDARY, axis=0)
_ACCELERATION = np.diff(_VELOCITY, axis=0)
_JERK = np.diff(_ACCELERATION, axis=0)


class ControlPointProgram:
    """P5 of one corridor, laid out once and solved for many durations.

    ``waypoints_m`` ``(S + 1, 3)`` (start, joints, destination) are where the unknowns are counted from; joints that
    are thin in ``centres`` stay there.
    """

    def __init__(self, problem: Problem, corridor: Corridor, waypoints_m: Array, centres: ChebyshevCentres) -> None:
        limits = problem.limits
        # Of the corridor's own size, so that coordinates and durations are numbers around one.
        self._length = float(problem.ranges_m[list(corridor.sequence)].mean())
        self._time = float(initial_durations(problem, corridor, waypoints_m).mean())
        self._scale = np.array([self._length, self._length / self._time, self._length / self._time**2])[:, None]
        self._origin = problem.start_m
        self._reference = rest_at(waypoints_m)
        self._reference[0, 1] = problem.start_velocity_m_s
        self._reference[0, 2] = problem.start_acceleration_m_s2
        self._flat = limits.min_alt_m == limits.max_alt_m
        self._free = np.ones(self._reference.shape, dtype=bool)
        self._free[[0, -1]] = False
        self._free[1:-1][centres.thin, 0] = False
        if self._flat:
            self._free[..., 2] = False
        self.unknowns = int(self._free.sum())
        if self.unknowns:
            layout = ConeLayout(self._free)
            _lay_out(layout, problem, corridor, centres, self._origin, self._length, self._time)
            self._rows = layout.finish()
            start = self._reference.copy()
            start[:, 0] -= self._origin
            self._values_at_reference = (start / self._scale).ravel()
            self._program: ConeProgram | None = None

    def solve(self, durations_s: Array) -> Array:
        """Boundary conditions ``(S + 1, 3, 3)`` of the minimiser, to the solver's accuracy: callers check them.

        Raises `SolverError` when the solver has no answer at all.
        """
        if not self.unknowns:
            return self._reference.copy()
        rows = self._rows
        values, offset = rows.numbers(durations_s / self._time, self._values_at_reference)
        if self._program is None:
            cost = np.zeros(self.unknowns + 1)
            cost[-1] = 1.0
            self._program = ConeProgram(
                cost,
                rows.row,
                rows.column,
                values,
                offset,
                nonnegative=rows.nonnegative,
                second_order=rows.second_order,
            )
        else:
            self._program.update(values, offset)
        x = self._program.solve(accept_unfinished=True)
        boundary = self._reference.copy()
        boundary[self._free] += x[:-1] * np.broadcast_to(self._scale, boundary.shape)[self._free]
        return boundary


def _lay_out(
    layout: ConeLayout,
    problem: Problem,
    corridor: Corridor,
    centres: ChebyshevCentres,
    origin_m: Array,
    length_m: float,
    time_s: float,
) -> None:
    limits, mask, pieces = problem.limits, ElevationMask.of(problem), np.arange(len(corridor))
    shrink = np.concatenate([[np.inf], centres.shrink_m, [np.inf]])
    shrink_of_piece = np.minimum(shrink[:-1], shrink[1:])
    shrink_of_piece[~np.isfinite(shrink_of_piece)] = 0.0
    # Control points: P1 .. P4 of every piece, and its last one, the joint, which also lies in the next piece's balls.
    for j in (1, 2, 3, 4, 5):
        combination = CONTROL_FROM_BOUNDARY[j]
        where = pieces if j < 5 else pieces[:-1]
        balls = [corridor.pieces[k].balls if j < 5 else corridor.joint_balls(int(k) + 1) for k in where]
        owner = np.repeat(where, [len(b) for b in balls])
        station = np.array([s for b in balls for s in b], dtype=np.int64)
        room = shrink_of_piece[owner] if j < 5 else shrink[owner + 1]
        offset = (problem.station_positions_m[station] - origin_m) / length_m
        layout.cone(owner, combination, offset=offset, bound=(problem.ranges_m[station] - room) / length_m)
        if mask is not None:
            own = mask.at(station)
            lowest = offset[:, 2] + room / length_m
            layout.linear(owner[own.horizon], combination, 2, 1.0, -lowest[own.horizon])
            apex = np.column_stack([offset[:, :2], lowest])[own.cone]
            layout.upright_cone(owner[own.cone], combination, apex=apex, slope=own.slope[own.cone])
        band = min(BAND_SHRINK_M, 0.25 * (limits.max_alt_m - limits.min_alt_m))
        for sign, edge in ((1.0, limits.min_alt_m + band), (-1.0, limits.max_alt_m - band)):
            layout.linear(where, combination, 2, sign, -sign * (edge - origin_m[2]) / length_m)
    # The first velocity, acceleration and jerk of a piece; the last ones of velocity and acceleration belong to the
    # next piece's first.
    speed = length_m / time_s
    accel = length_m / time_s**2
    for j, combination in enumerate(_VELOCITY):
        where = pieces if j < 4 else pieces[-1:]
        layout.cone(where, combination, ratio=(limits.max_speed_m_s / speed / 5, 1))
        if limits.max_climb_m_s is not None:
            layout.linear(where, combination, 2, -1.0, 0.0, (limits.max_climb_m_s / speed / 5, 1))
        if limits.max_descent_m_s is not None:
            layout.linear(where, combination, 2, 1.0, 0.0, (limits.max_descent_m_s / speed / 5, 1))
        if limits.max_airspeed_m_s is not None:
            wind = np.array([*limits.wind_m_s, 0.0]) / speed / 5
            layout.cone(where, combination, ratio=(limits.max_airspeed_m_s / speed / 5, 1), drift=wind)
    for j, combination in enumerate(_ACCELERATION):
        layout.cone(pieces if j < 3 else pieces[-1:], combination, ratio=(limits.max_accel_m_s2 / accel / 20, 2))
    if limits.max_jerk_m_s3 is not None:
        jerk = limits.max_jerk_m_s3 * time_s / accel
        for combination in _JERK:
            layout.cone(pieces, combination, ratio=(jerk / 60, 3))
