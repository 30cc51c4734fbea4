"""Alternating minimisation, Algorithm 1: control points with durations fixed, then durations with the joints fixed.

(The loop of the printed algorithm must read "and": it goes on while there is time *and* it still gains.)
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from planner.arrays import Array
from planner.certificate import certify
from planner.corridor.chebyshev import ChebyshevCentres, chebyshev_centres
from planner.corridor.corridor import Corridor, build_corridor
from planner.corridor.limit_check import CorridorCheck
from planner.corridor.polyline_program import shortest_polyline
from planner.errors import SolverError
from planner.paper.boundary import as_trajectory, control_points, rest_at
from planner.paper.control_points import ControlPointProgram
from planner.paper.initial import initial_durations, leg_durations, piece_minima, stretch_legs
from planner.paper.station_graph import check_sequence, shortest_sequence
from planner.paper.time_search import shortest_durations
from planner.problem import Problem
from planner.solution import Solution
from planner.trajectory import Trajectory

Clock = Callable[[], float]

# The gain of an iteration halves and halves; far beyond any use.
MAX_ITERATIONS = 1000


@dataclass(frozen=True)
class Iteration:
    """One point of a method's convergence: after ``number`` steps and ``elapsed_s``, the best plan it had."""

    number: int
    elapsed_s: float
    mission_time_s: float
    trajectory: Trajectory


def plan_paper(
    problem: Problem,
    sequence: Sequence[int] | None = None,
    corridor: Corridor | None = None,
    *,
    delta_t_s: float = 1.0,
    max_runtime_s: float | None = None,
    max_iterations: int = MAX_ITERATIONS,
    bisection_tolerance_s: float = 1e-6,
    lower_bound_s: float = math.nan,
    record: list[Iteration] | None = None,
    clock: Clock = time.perf_counter,
) -> Solution:
    """The paper's decoupling approach: Dijkstra's sequence (or ``sequence``, or ``corridor``), then AM.

    Stops when an iteration gains no more than ``delta_t_s``, or before the one that would start after
    ``max_runtime_s``, which alone makes the result depend on the machine. ``record`` collects every iteration, the
    initial trajectory first. The result is certified at zero tolerance; a corridor whose overlaps are `MIN_OVERLAP_M`
    deep always has one when the vehicle starts at rest.

    Raises `InfeasibleError` where the ranges do not chain together, `SolverError` when no trajectory was found all
    the same (a moving start, or an endurance that is too short), `ProblemError` for a sequence that makes no sense.
    """
    started = clock()
    if corridor is None:
        stations = shortest_sequence(problem) if sequence is None else check_sequence(problem, sequence)
        corridor = build_corridor(problem, stations)
    else:
        check_sequence(problem, corridor.sequence)
    method = AlternatingMinimisation(problem, corridor, bisection_tolerance_s=bisection_tolerance_s)
    iterations, notes = 0, []
    if record is not None:
        record.append(method.snapshot(iterations, clock() - started))
    gain = math.inf
    while gain > delta_t_s and iterations < max_iterations:
        if max_runtime_s is not None and clock() - started >= max_runtime_s:
            break
        try:
            gain = method.step()
        except SolverError as error:
            notes.append(f"alternating minimisation stopped early: {error}")
            break
        iterations += 1
        if record is not None:
            record.append(method.snapshot(iterations, clock() - started))
    return certified(problem, method.finish(), "paper", lower_bound_s, iterations, tuple(notes))


def certified(
    problem: Problem,
    trajectory: Trajectory,
    method: str,
    lower_bound_s: float = math.nan,
    iterations: int = 0,
    notes: tuple[str, ...] = (),
) -> Solution:
    """A `Solution` around ``trajectory``; `SolverError` when it breaks a constraint."""
    certificate = certify(problem, trajectory)
    if not certificate.feasible:
        raise SolverError(f"the trajectory found breaks {certificate.broken}")
    return Solution(trajectory, certificate, method, lower_bound_s, iterations, notes)


class AlternatingMinimisation:
    """The state of Algorithm 1 on one corridor; at every moment a trajectory that keeps all constraints.

    ``boundary`` ``(S + 1, 3, 3)`` and ``durations_s`` ``(S,)`` are the present iterate.
    """

    def __init__(self, problem: Problem, corridor: Corridor, *, bisection_tolerance_s: float = 1e-6) -> None:
        self.problem, self.corridor = problem, corridor
        self.tolerance_s = bisection_tolerance_s
        self.check = CorridorCheck(problem, corridor)
        self.centres: ChebyshevCentres = chebyshev_centres(problem, corridor)
        self.waypoints_m = shortest_polyline(problem, corridor, self.centres)
        self.program = ControlPointProgram(problem, corridor, self.waypoints_m, self.centres)
        self.minima_s = piece_minima(problem, corridor)
        self.durations_s = initial_durations(problem, corridor, self.waypoints_m)
        self.boundary = rest_at(self.waypoints_m)
        self.moving = not problem.starts_at_rest
        if self.moving:
            self._catch_moving_start()

    def restart_from(self, waypoints_m: Array) -> None:
        """Back to the initial trajectory, through other waypoints ``(S + 1, 3)``."""
        self.waypoints_m = waypoints_m
        self.durations_s = initial_durations(self.problem, self.corridor, waypoints_m)
        self.boundary = rest_at(waypoints_m)

    def step(self, solve: Callable[[Array], Array] | None = None) -> float:
        """One P-step and one T-step; returns the seconds gained.

        ``solve`` stands in for the P-step: from durations to boundary conditions. A step that gains nothing leaves the
        iterate as it was. Raises `SolverError`, the iterate untouched.
        """
        boundary = self.drawn_inside((solve or self.program.solve)(self.durations_s), self.durations_s)
        durations = shortest_durations(
            self.check, self.corridor, boundary, self.durations_s, self.minima_s, tolerance_s=self.tolerance_s
        )
        # In terms of what can be flown: a solver's answer may break a limit by its tolerance, and pays for it here.
        gain = self._feasible_s(self.boundary, self.durations_s) - self._feasible_s(boundary, durations)
        if not gain > 0.0:
            return 0.0
        self.boundary, self.durations_s = boundary, durations
        return gain

    def _feasible_s(self, boundary: Array, durations_s: Array) -> float:
        points = control_points(boundary, durations_s)
        if self.moving:
            return float(durations_s.sum()) if self.check.holds(points, durations_s).all() else math.inf
        return float(durations_s.sum() * max(1.0, self.check.slowdown(points, durations_s).max()))

    def drawn_inside(self, boundary: Array, durations_s: Array) -> Array:
        """``boundary`` drawn towards rest in the Chebyshev centres just as far as keeps range and band exactly."""
        still = rest_at(np.vstack([self.problem.start_m, self.centres.points_m, self.problem.destination_m]))
        share = 0.0
        drawn = boundary
        while self.check.place_excess_m(control_points(drawn, durations_s)).max() > 0.0 and share < 1.0:
            share = min(max(4.0 * share, 1e-10), 1.0)
            drawn = boundary.copy()
            drawn[1:-1] += share * (still - boundary)[1:-1]
        return drawn

    def finish(self) -> Trajectory:
        """The iterate as a trajectory that keeps every limit at zero tolerance.

        From rest, all durations are scaled by max(A, sqrt B) (and what minima ask): the joints stay continuous,
        because speeds divide by the factor and accelerations by its square everywhere.
        """
        if self.moving:
            return as_trajectory(self.corridor, self.boundary, self._nudged())
        return feasible_in_time(self.check, self.corridor, self.boundary, self.durations_s, self.minima_s)

    def snapshot(self, number: int, elapsed_s: float) -> Iteration:
        """The iterate as a point of the convergence record."""
        trajectory = self.finish()
        return Iteration(number, elapsed_s, trajectory.duration_s, trajectory)

    def _nudged(self) -> Array:
        """Durations lengthened by roundings until every piece holds: scaling would change the speed at the start."""
        durations, nudge = self.durations_s.copy(), 1e-9
        while nudge < 1e-2:
            failing = ~self.check.holds(control_points(self.boundary, durations), durations)
            if not failing.any():
                break
            durations[failing] = self.durations_s[failing] * (1.0 + nudge)
            nudge *= 2.0
        return durations

    def _catch_moving_start(self) -> None:
        """A first piece that takes the given velocity and acceleration up: the first duration that P5 can serve."""
        self.boundary[0, 1] = self.problem.start_velocity_m_s
        self.boundary[0, 2] = self.problem.start_acceleration_m_s2
        low = max(float(self.minima_s[0]), 0.02 * float(np.median(self.durations_s)))
        if len(self.corridor.leg_pieces(0)) == 1:
            low = max(low, self.corridor.min_leg_s * (1.0 + 1e-12))
        worst = math.inf
        for first_s in low * 1.12 ** np.arange(64):
            durations = self.durations_s.copy()
            durations[0] = first_s
            if len(self.corridor.leg_pieces(0)) > 1:
                durations[1:] = stretch_legs(self.corridor, durations)[1:]
                durations[1] += max(0.0, self.corridor.min_leg_s - leg_durations(self.corridor, durations)[0])
            try:
                boundary = self.drawn_inside(self.program.solve(durations), durations)
            except SolverError:
                continue
            points = control_points(boundary, durations)
            if self.check.holds(points, durations).all():
                self.boundary, self.durations_s = boundary, durations
                return
            worst = min(worst, float(self.check.ratios(points, durations).max()))
        raise SolverError(
            f"no first piece of this corridor takes up the speed at the start; the best needs {worst:.3f} of the limits"
        )


def feasible_in_time(
    check: CorridorCheck,
    corridor: Corridor,
    boundary: Array,
    durations_s: Array,
    minima_s: Array,
    *,
    least_factor: float = 0.0,
) -> Trajectory:
    """The curve flown just as slowly as the limits, the pieces' minima and the tenure ask, from rest to rest.

    All durations are multiplied by one factor, at least ``least_factor``.
    """
    slowdown = float(check.slowdown(control_points(boundary, durations_s), durations_s).max())
    asked = [least_factor, slowdown, float((minima_s / durations_s).max())]
    if corridor.min_leg_s > 0.0:
        asked.append(corridor.min_leg_s / float(leg_durations(corridor, durations_s).min()))
    factor = max(asked) * (1.0 + 1e-9)
    return as_trajectory(corridor, boundary, durations_s).scale_time(factor)
