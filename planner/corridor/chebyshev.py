"""Chebyshev centres: the deepest point of what each joint of a corridor must lie in, where a vehicle can always stop.

Solvers answer to a tolerance, a certificate allows none. What a solver returns is first sought a little inside
(ranges and band shrunk) and then, where a constraint still fails by a rounding, drawn towards these points: the
sets are convex, so a short way is enough. Where an overlap is thinner than the shrinking, the point itself is taken.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.arrays import Array, Flags, Indices
from planner.corridor.cone_program import ConeProgram
from planner.corridor.corridor import Corridor
from planner.coverage.elevation_mask import ElevationMask
from planner.coverage.overlap import MIN_OVERLAP_M, overlap_depth_m, overlap_point_m
from planner.errors import Infeasibility, InfeasibleError
from planner.infeasibility.diagnosis import broken_pair
from planner.problem import Problem

RANGE_SHRINK = 1e-7
BAND_SHRINK_M = 1e-6


@dataclass(frozen=True)
class ChebyshevCentres:
    """``points_m`` ``(S - 1, 3)`` for joints 1 .. S - 1, and ``slack_m`` ``(S - 1,)``: range left at each.

    ``thin`` ``(S - 1,)``: joints whose overlap has no room for a solver; they stay at the point. ``shrink_m``
    ``(S - 1,)`` is what may come off a range at each joint.
    """

    points_m: Array
    slack_m: Array
    thin: Flags
    shrink_m: Array


def chebyshev_centres(problem: Problem, corridor: Corridor) -> ChebyshevCentres:
    """Those of a corridor's inner joints. Raises `InfeasibleError` where a joint's balls have no point in common."""
    count = len(corridor) - 1
    points, slack, shrink = np.zeros((count, 3)), np.zeros(count), np.zeros(count)
    for joints, balls in alike(corridor):
        points[joints], slack[joints] = _lift(problem, balls, _deepest_points_m(problem, balls))
        shrink[joints] = RANGE_SHRINK * problem.ranges_m[balls].max(axis=1)
    thin = slack < 8.0 * shrink
    return ChebyshevCentres(points, slack, thin, np.minimum(shrink, 0.25 * np.maximum(slack, 0.0)))


def alike(corridor: Corridor) -> list[tuple[Indices, Indices]]:
    """Joints with equally many balls, to be looked at together: which ``(j,)``, from 0, and their balls ``(j, b)``."""
    balls = [corridor.joint_balls(joint) for joint in range(1, len(corridor))]
    counts = np.array([len(stations) for stations in balls], dtype=np.int64)
    groups = [np.flatnonzero(counts == count) for count in np.unique(counts)]
    return [(joints, np.array([balls[k] for k in joints], dtype=np.int64)) for joints in groups]


def slack_m(problem: Problem, balls: tuple[int, ...] | Indices, point_m: Array) -> Array:
    """Range left at ``point_m`` ``(..., 3)`` to the tightest of its ``balls`` ``(..., b)``; the band apart.

    Elevation cones count too. Shape ``(...)``.
    """
    stations = np.asarray(balls, dtype=np.int64)
    offset = point_m[..., None, :] - problem.station_positions_m[stations]
    left = problem.ranges_m[stations] - np.linalg.norm(offset, axis=-1)
    mask = ElevationMask.of(problem)
    if mask is not None:
        left = np.minimum(left, -mask.at(stations).below_m(offset))
    return np.asarray(left.min(axis=-1))


def _deepest_points_m(problem: Problem, balls: Indices) -> Array:
    """``(j, 3)``: for every joint the point with the most range left to all its ``balls`` ``(j, b)``."""
    if balls.shape[1] > 2:
        return np.array([_chebyshev_centre_m(problem, tuple(stations)) for stations in balls.tolist()])
    first, last = balls[:, 0], balls[:, -1]
    depth = overlap_depth_m(problem, first, last)
    apart = np.flatnonzero(depth < np.where(first == last, 0.0, MIN_OVERLAP_M))
    if len(apart):
        raise InfeasibleError(broken_pair(problem, int(first[apart[0]]), int(last[apart[0]])))
    return overlap_point_m(problem, first, last)


def _chebyshev_centre_m(problem: Problem, balls: tuple[int, ...]) -> Array:
    """The point of the band with the most range left to three balls or more: a small cone program.

    Raises `InfeasibleError` where there is none.
    """
    stations = list(balls)
    centre = problem.station_positions_m[stations].mean(axis=0)
    unit = float(problem.ranges_m[stations].max())
    low, high = problem.limits.min_alt_m, problem.limits.max_alt_m
    # Unknown: the point (3) and the slack; b - A x = (R - slack, p - O) per ball, and the band.
    matrix = np.zeros((2 + 4 * len(balls), 4))
    offset = np.zeros(len(matrix))
    matrix[0, 2], offset[0] = -1.0, (centre[2] - low) / unit
    matrix[1, 2], offset[1] = 1.0, (high - centre[2]) / unit
    for n, station in enumerate(stations):
        row = 2 + 4 * n
        matrix[row, 3], offset[row] = 1.0, problem.ranges_m[station] / unit
        matrix[row + 1 : row + 4, :3] = -np.eye(3)
        offset[row + 1 : row + 4] = (centre - problem.station_positions_m[station]) / unit
    rows, columns = np.nonzero(matrix)
    program = ConeProgram(
        np.array([0.0, 0.0, 0.0, -1.0]),
        rows,
        columns,
        matrix[rows, columns],
        offset,
        nonnegative=2,
        second_order=[4] * len(balls),
    )
    point: Array = centre + unit * program.solve()[:3]
    point[2] = np.clip(point[2], low, high)
    if slack_m(problem, balls, point) < 0.0:
        message = f"the ranges of stations {stations} have no point in common"
        raise InfeasibleError(Infeasibility("broken_chain", message, balls))
    return point


def _lift(problem: Problem, balls: Indices, points_m: Array) -> tuple[Array, Array]:
    """``points_m`` ``(j, 3)`` moved off the edges of the band as far as at least half their slack to ``balls`` remains.

    Returns them with their slack ``(j,)``.
    """
    slack = slack_m(problem, balls, points_m)
    least = 0.5 * slack
    points = points_m.copy()
    low, high = problem.limits.min_alt_m, problem.limits.max_alt_m
    step = min(0.25 * (high - low), 1.0)
    left = np.arange(len(points))
    while step > 1e-7 and len(left):
        lifted = points[left]
        lifted[:, 2] = np.clip(lifted[:, 2], low + step, high - step)
        now = slack_m(problem, balls[left], lifted)
        enough = now >= least[left]
        points[left[enough]], slack[left[enough]] = lifted[enough], now[enough]
        left = left[~enough]
        step *= 0.5
    return points, slack
