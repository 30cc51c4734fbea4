"""P4 and P5 written down as the paper writes them, in cvxpy: what the direct assembly is held against.

Here every control point is an unknown and continuity is a constraint; `planner.corridor.polyline_program` and
`planner.paper.control_points` know only the joints. Needs cvxpy (the optional extra ``bench``); imported when called.
"""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

from planner.arrays import Array
from planner.corridor.corridor import Corridor, build_corridor
from planner.corridor.polyline_program import settled
from planner.errors import SolverError
from planner.paper.alternating import AlternatingMinimisation, Clock, Iteration, certified
from planner.paper.station_graph import check_sequence, shortest_sequence
from planner.problem import Problem
from planner.solution import Solution
from planner.trajectory import DEGREE


def shortest_polyline_cvxpy(problem: Problem, corridor: Corridor) -> Array:
    """P4, equation (30): start, joints and destination ``(S + 1, 3)`` of the shortest polyline.

    Raises `SolverError`.
    """
    import cvxpy as cp

    unit = float(problem.ranges_m[list(corridor.sequence)].mean())
    centres = (problem.station_positions_m - problem.start_m) / unit
    radii = problem.ranges_m / unit
    low, high = (
        (altitude - problem.start_m[2]) / unit for altitude in (problem.limits.min_alt_m, problem.limits.max_alt_m)
    )
    joints = cp.Variable((len(corridor) + 1, 3))
    constraints = [joints[0] == 0, joints[-1] == (problem.destination_m - problem.start_m) / unit]
    for k in range(1, len(corridor)):
        constraints += [cp.norm(joints[k] - centres[s]) <= radii[s] for s in corridor.joint_balls(k)]  # (30b), (30c)
        constraints += [joints[k, 2] >= low, joints[k, 2] <= high]  # (30d)
    length = cp.sum(cp.norm(joints[1:] - joints[:-1], axis=1))
    _solve(cp.Problem(cp.Minimize(length), constraints))
    return np.asarray(problem.start_m + unit * joints.value)


class ControlPointReference:
    """P5, equation (37), as a parametrised program: one compilation, many durations.

    ``solve(durations_s)`` returns boundary conditions as `ControlPointProgram.solve` does; ``ratio`` is then J.
    """

    def __init__(self, problem: Problem, corridor: Corridor) -> None:
        import cvxpy as cp

        limits, n, pieces = problem.limits, DEGREE, len(corridor)
        self._length = limits.max_speed_m_s**2 / limits.max_accel_m_s2
        self._time = limits.max_speed_m_s / limits.max_accel_m_s2
        self._origin = problem.start_m
        centres = (problem.station_positions_m - self._origin) / self._length
        radii = problem.ranges_m / self._length
        low, high = ((z - self._origin[2]) / self._length for z in (limits.min_alt_m, limits.max_alt_m))

        # In these units v_max = a_max = 1. Parameters stand where T does, each as the product it appears in.
        self.ratio = math.nan
        self._worst = cp.Variable(nonneg=True)
        self._points = [cp.Variable((n + 1, 3)) for _ in range(pieces)]
        self._t = cp.Parameter(pieces, nonneg=True)
        self._t2 = cp.Parameter(pieces, nonneg=True)
        first, last = self._points[0], self._points[-1]
        end = (problem.destination_m - self._origin) / self._length
        # (13), for a vehicle that starts at rest as in the paper.
        constraints: list[Any] = [first[0] == 0, first[1] == first[0], first[2] == first[1]]
        constraints += [last[n] == end, last[n - 1] == last[n], last[n - 2] == last[n - 1]]
        for k, points in enumerate(self._points):
            if k + 1 < pieces:  # (15), both sides times T_k T_k+1 and its square
                after = self._points[k + 1]
                constraints += [
                    points[n] == after[0],
                    self._t[k + 1] * (points[n] - points[n - 1]) == self._t[k] * (after[1] - after[0]),
                    self._t2[k + 1] * (points[n] - 2 * points[n - 1] + points[n - 2])
                    == self._t2[k] * (after[2] - 2 * after[1] + after[0]),
                ]
            for station in corridor.pieces[k].balls:  # (17)
                constraints.append(cp.norm(points - centres[station][None, :], axis=1) <= radii[station])
            constraints += [points[:, 2] >= low, points[:, 2] <= high]  # (19)
            first_difference = points[1:] - points[:-1]
            second_difference = first_difference[1:] - first_difference[:-1]
            constraints.append(n * cp.norm(first_difference, axis=1) <= self._t[k] * self._worst)  # formula A
            constraints.append(
                n * (n - 1) * cp.norm(second_difference, axis=1) <= self._t2[k] * self._worst
            )  # formula B
        self._problem = cp.Problem(cp.Minimize(self._worst), constraints)

    def solve(self, durations_s: Array) -> Array:
        """Boundary conditions ``(S + 1, 3, 3)`` of the minimiser. Raises `SolverError`."""
        t = durations_s / self._time
        self._t.value, self._t2.value = t, t**2
        _solve(self._problem)
        self.ratio = float(self._worst.value)
        points = self._origin + self._length * np.array([p.value for p in self._points])
        boundary = np.zeros((len(t) + 1, 3, 3))
        boundary[:-1, 0], boundary[-1, 0] = points[:, 0], points[-1, -1]
        seconds = durations_s[:, None]
        boundary[:-1, 1] = DEGREE * (points[:, 1] - points[:, 0]) / seconds
        boundary[:-1, 2] = DEGREE * (DEGREE - 1) * (points[:, 2] - 2 * points[:, 1] + points[:, 0]) / seconds**2
        boundary[[0, -1], 1:] = 0.0
        return boundary


def plan_paper_cvxpy(
    problem: Problem,
    sequence: Sequence[int] | None = None,
    *,
    delta_t_s: float = 1.0,
    max_runtime_s: float | None = None,
    lower_bound_s: float = math.nan,
    record: list[Iteration] | None = None,
    clock: Clock = time.perf_counter,
) -> Solution:
    """The whole of the paper's method with cvxpy solving P4 and P5, for comparison; the paper's limits only.

    Parameters and errors as `planner.paper.alternating.plan_paper`.
    """
    started = clock()
    stations = shortest_sequence(problem) if sequence is None else check_sequence(problem, sequence)
    corridor = build_corridor(problem, stations)
    method = AlternatingMinimisation(problem, corridor)
    program = ControlPointReference(problem, corridor)
    polyline = shortest_polyline_cvxpy(problem, corridor)
    method.restart_from(settled(problem, corridor, method.centres, polyline[1:-1]))
    iterations, gain, notes = 0, math.inf, []
    if record is not None:
        record.append(method.snapshot(0, clock() - started))
    while gain > delta_t_s and not (max_runtime_s is not None and clock() - started >= max_runtime_s):
        try:
            gain = method.step(program.solve)
        except SolverError as error:
            notes.append(f"alternating minimisation stopped early: {error}")
            break
        iterations += 1
        if record is not None:
            record.append(method.snapshot(iterations, clock() - started))
    return certified(problem, method.finish(), "paper-cvxpy", lower_bound_s, iterations, tuple(notes))


def _solve(program: Any) -> None:
    import cvxpy as cp

    try:
        with warnings.catch_warnings():
            # An answer that "may be inaccurate" is checked, and paid for in time, by the alternating minimisation.
            warnings.simplefilter("ignore", UserWarning)
            program.solve(solver=cp.CLARABEL)
    except cp.error.SolverError as error:
        raise SolverError(f"cvxpy: {error}") from error
    if program.status not in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE):
        raise SolverError(f"cvxpy ended with {program.status}")
