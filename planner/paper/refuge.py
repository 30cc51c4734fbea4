"""Places where a vehicle can always stop: the deepest point of what each joint of a corridor must lie in.

Solvers answer to a tolerance, a certificate allows none. What a solver returns is first sought a little inside
(ranges and band shrunk) and then, where a constraint still fails by a rounding, drawn towards these points: the
sets are convex, so a short way is enough. Where a lens is thinner than the shrinking, the point itself is taken.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.conic import ConeProgram
from planner.corridor import Corridor
from planner.errors import Infeasibility, InfeasibleError
from planner.lens import MIN_LENS_M, broken_pair, lens_depth_m, lens_point_m
from planner.problem import Problem

Array = NDArray[np.float64]

RANGE_SHRINK = 1e-7
BAND_SHRINK_M = 1e-6


@dataclass(frozen=True)
class Refuges:
    """``points_m`` ``(S - 1, 3)`` for joints 1 .. S - 1, and ``slack_m`` ``(S - 1,)``: range left at each.

    ``thin`` ``(S - 1,)``: joints whose lens has no room for a solver; they stay at the point. ``shrink_m`` ``(S - 1,)``
    is what may come off a range at each joint.
    """

    points_m: Array
    slack_m: Array
    thin: NDArray[np.bool_]
    shrink_m: Array


def find_refuges(problem: Problem, corridor: Corridor) -> Refuges:
    """The refuges of a corridor. Raises `InfeasibleError` where a joint's balls have no point in common."""
    count = len(corridor) - 1
    points, slack, shrink = np.zeros((count, 3)), np.zeros(count), np.zeros(count)
    for k in range(count):
        balls = corridor.joint_balls(k + 1)
        centre = _deepest_point_m(problem, balls)
        points[k], slack[k] = _lift(problem, balls, centre)
        shrink[k] = RANGE_SHRINK * float(problem.ranges_m[list(balls)].max())
    thin = slack < 8.0 * shrink
    return Refuges(points, slack, thin, np.minimum(shrink, 0.25 * np.maximum(slack, 0.0)))


def slack_m(problem: Problem, balls: tuple[int, ...], point_m: Array) -> float:
    """Range left at ``point_m`` to the tightest of ``balls``, elevation cones included; the band apart."""
    stations = list(balls)
    offset = point_m - problem.station_positions_m[stations]
    left = problem.ranges_m[stations] - np.linalg.norm(offset, axis=1)
    if problem.min_elevation_deg is not None:
        angle = problem.min_elevation_deg[stations]
        slope = np.tan(np.radians(np.maximum(angle, 0.0)))
        above = offset[:, 2] - slope * np.linalg.norm(offset[:, :2], axis=1)
        left = np.minimum(left, np.where(angle < 0.0, np.inf, above))
    return float(left.min())


def _deepest_point_m(problem: Problem, balls: tuple[int, ...]) -> Array:
    if len(balls) <= 2:
        i, j = balls[0], balls[-1]
        if float(lens_depth_m(problem, i, j)) < (MIN_LENS_M if i != j else 0.0):
            raise InfeasibleError(broken_pair(problem, i, j))
        return lens_point_m(problem, i, j)
    point = _chebyshev_point_m(problem, balls)
    if slack_m(problem, balls, point) < 0.0:
        raise InfeasibleError(
            Infeasibility("broken_chain", f"the ranges of stations {list(balls)} have no point in common", balls)
        )
    return point


def _chebyshev_point_m(problem: Problem, balls: tuple[int, ...]) -> Array:
    """The point of the band with the most range left to three balls or more: a small cone program."""
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
    return point


def _lift(problem: Problem, balls: tuple[int, ...], point_m: Array) -> tuple[Array, float]:
    """``point_m`` moved off the edges of the band as far as at least half its slack remains, and its slack."""
    slack = slack_m(problem, balls, point_m)
    low, high = problem.limits.min_alt_m, problem.limits.max_alt_m
    step = min(0.25 * (high - low), 1.0)
    while step > 1e-7:
        lifted = point_m.copy()
        lifted[2] = np.clip(point_m[2], low + step, high - step)
        if slack_m(problem, balls, lifted) >= 0.5 * slack:
            return lifted, slack_m(problem, balls, lifted)
        step *= 0.5
    return point_m, slack
