"""P4: the shortest polyline through the overlaps, equation (30), as a second-order cone program.

    minimise  sum_k t_k    with  |W_k - W_{k-1}| <= t_k,  W_k in every ball of joint k and in the altitude band

The joints are unknown as offsets from their refuges, in units of the mean range: plain metres make the solver fail.
"""

from __future__ import annotations

import numpy as np

from planner.arrays import Array, Indices
from planner.corridor.chebyshev import BAND_SHRINK_M, Refuges, alike, find_refuges, slack_m
from planner.corridor.cone_program import ConeProgram
from planner.corridor.corridor import Corridor
from planner.errors import SolverError
from planner.problem import Problem


def shortest_polyline(
    problem: Problem, corridor: Corridor, refuges: Refuges | None = None, weights: Array | None = None
) -> Array:
    """Start, joints and destination ``(S + 1, 3)`` of the shortest polyline along ``corridor``.

    ``weights`` ``(S,)``: what a metre of each piece counts, 1 when not given.

    Every joint lies in all its balls and in the band at zero tolerance. Where the solver gives up, the refuges
    themselves: longer, but always there. Raises `InfeasibleError` where two neighbours of the corridor do not meet.
    """
    refuges = refuges or find_refuges(problem, corridor)
    joints = refuges.points_m.copy()
    free = np.flatnonzero(~refuges.thin)
    if len(free):
        try:
            joints[free] = _solve(problem, corridor, refuges, free, weights)
        except SolverError:
            joints = refuges.points_m.copy()
    return settled(problem, corridor, refuges, joints)


def settled(problem: Problem, corridor: Corridor, refuges: Refuges, joints_m: Array) -> Array:
    """``joints_m`` ``(S - 1, 3)`` moved to where every constraint holds exactly, between start and destination.

    Each is drawn towards its refuge just as far as it takes.
    """
    limits = problem.limits
    joints = joints_m.copy()
    joints[:, 2] = np.clip(joints[:, 2], limits.min_alt_m, limits.max_alt_m)
    for which, balls in alike(corridor):
        outside = slack_m(problem, balls, joints[which]) < 0.0
        which, balls = which[outside], balls[outside]
        wanted, refuge = joints[which], refuges.points_m[which]
        share = 1e-9
        while len(which) and share < 1.0:
            joints[which] = wanted + share * (refuge - wanted)
            outside = slack_m(problem, balls, joints[which]) < 0.0
            which, balls, wanted, refuge = which[outside], balls[outside], wanted[outside], refuge[outside]
            share *= 4.0
        joints[which] = refuge
    return np.vstack([problem.start_m, joints, problem.destination_m])


def polyline_length_m(waypoints_m: Array) -> float:
    """Length of a polyline ``(K, 3)``."""
    return float(np.linalg.norm(np.diff(waypoints_m, axis=0), axis=1).sum())


def _solve(problem: Problem, corridor: Corridor, refuges: Refuges, free: Indices, weights: Array | None) -> Array:
    """The free joints ``(F, 3)``; thin ones stay at their refuge."""
    pieces, limits = len(corridor), problem.limits
    unit = float(problem.ranges_m[list(corridor.sequence)].mean())
    known = np.vstack([problem.start_m, refuges.points_m, problem.destination_m])
    # Columns: three per free joint, then the length of every piece.
    column = np.full(pieces + 1, -1)
    column[free + 1] = 3 * np.arange(len(free))
    lengths = 3 * len(free) + np.arange(pieces)

    rows: list[int] = []
    columns: list[int] = []
    values: list[float] = []
    offset: list[float] = []
    second_order: list[int] = []

    def entry(col: int, value: float) -> None:
        rows.append(len(offset))
        columns.append(col)
        values.append(value)

    band_shrink = min(BAND_SHRINK_M, 0.25 * (limits.max_alt_m - limits.min_alt_m))
    flat = limits.max_alt_m == limits.min_alt_m
    for k in free + 1:
        if flat:
            entry(column[k] + 2, 1.0)
            offset.append((limits.min_alt_m - known[k, 2]) / unit)
    zero = len(offset)
    for k in free + 1:
        if not flat:
            for sign, edge in ((-1.0, limits.min_alt_m + band_shrink), (1.0, limits.max_alt_m - band_shrink)):
                entry(column[k] + 2, sign)
                offset.append(sign * (edge - known[k, 2]) / unit)
        for station, _ in _cones(problem, corridor.joint_balls(k), want_flat=True):
            entry(column[k] + 2, -1.0)
            offset.append((known[k, 2] - problem.station_positions_m[station, 2]) / unit)
    nonnegative = len(offset) - zero
    for k in range(pieces):
        entry(int(lengths[k]), -1.0)
        offset.append(0.0)
        for axis in range(3):
            for joint, sign in ((k + 1, -1.0), (k, 1.0)):
                if column[joint] >= 0:
                    entry(column[joint] + axis, sign)
            offset.append((known[k + 1, axis] - known[k, axis]) / unit)
        second_order.append(4)
    for k in free + 1:
        for station in corridor.joint_balls(k):
            offset.append((problem.ranges_m[station] - refuges.shrink_m[k - 1]) / unit)
            for axis in range(3):
                entry(column[k] + axis, -1.0)
                offset.append((known[k, axis] - problem.station_positions_m[station, axis]) / unit)
            second_order.append(4)
        for station, slope in _cones(problem, corridor.joint_balls(k), want_flat=False):
            # slope |xy - O_xy| <= z - h
            entry(column[k] + 2, -1.0 / slope)
            height = known[k, 2] - problem.station_positions_m[station, 2] - refuges.shrink_m[k - 1]
            offset.append(height / slope / unit)
            for axis in range(2):
                entry(column[k] + axis, -1.0)
                offset.append((known[k, axis] - problem.station_positions_m[station, axis]) / unit)
            second_order.append(3)
    cost = np.zeros(3 * len(free) + pieces)
    cost[lengths] = 1.0 if weights is None else weights
    program = ConeProgram(
        cost,
        np.array(rows),
        np.array(columns),
        np.array(values),
        np.array(offset),
        zero=zero,
        nonnegative=nonnegative,
        second_order=second_order,
    )
    solution = program.solve()
    return np.asarray(known[free + 1] + unit * solution[: 3 * len(free)].reshape(-1, 3))


def _cones(problem: Problem, balls: tuple[int, ...], *, want_flat: bool) -> list[tuple[int, float]]:
    """Stations among ``balls`` with an elevation limit and its slope; at zero degrees the cone is a half-space."""
    if problem.min_elevation_deg is None:
        return []
    angles = problem.min_elevation_deg
    return [
        (s, float(np.tan(np.radians(angles[s])))) for s in balls if angles[s] >= 0.0 and (angles[s] == 0) == want_flat
    ]
