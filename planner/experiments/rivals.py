"""The methods the paper compares with: other optimisers over the durations T, with P5 inside (section 4.3, Table 4).

Each starts from the paper's initial durations and minimises

    f(T) = sum T + weight * sum T(0) * max(0, J(T) - 1)

where J(T) is the optimum of P5: the limits of speed and acceleration are softened and penalised, everything else P5
keeps. What counts is the shortest T met on the way whose J is at most 1. Six derivative-free optimisers come from NLopt
(the optional extra ``bench``, imported when called); backtracking gradient descent takes its gradient by
finite differences, one P5 a piece.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from planner.arrays import Array
from planner.corridor.corridor import build_corridor
from planner.errors import ProblemError, SolverError
from planner.paper.alternating import AlternatingMinimisation, Clock, Iteration, certified, feasible_in_time
from planner.paper.boundary import control_points
from planner.paper.initial import stretch_legs
from planner.paper.station_graph import check_sequence, shortest_sequence
from planner.problem import Problem
from planner.solution import Solution
from planner.trajectory import Trajectory

# Name in the paper's Table 4 -> algorithm of NLopt. NLopt's own NEWUOA_BOUND can loop for ever between two evaluations
# (its issue 117, and in a third of our runs), so NEWUOA gets its bounds from a quadratic penalty here.
NLOPT_ALGORITHMS = {
    "COBYLA": "LN_COBYLA",
    "BOBYQA": "LN_BOBYQA",
    "NEWUOA-BOUND": "LN_NEWUOA",
    "PRAXIS": "LN_PRAXIS",
    "NELDERMEAD": "LN_NELDERMEAD",
    "SBPLX": "LN_SBPLX",
}
RIVALS = (*NLOPT_ALGORITHMS, "BGD")

PENALTY_WEIGHT = 10.0
# J of a feasible answer; what a solver's tolerance puts on top is paid for in time at the end.
_FEASIBLE_RATIO = 1.0 + 1e-6
# Steps of the finite differences, well above the solver's noise.
_DIFFERENCE_S = 0.05


class _StopError(Exception):
    """Time or evaluations are used up."""


def plan_by_rival(
    problem: Problem,
    rival: str,
    sequence: Sequence[int] | None = None,
    *,
    time_limit_s: float | None = 3.0,
    max_evaluations: int | None = None,
    lower_bound_s: float = math.nan,
    record: list[Iteration] | None = None,
    clock: Clock = time.perf_counter,
) -> Solution:
    """A certified plan by one of `RIVALS` on Dijkstra's sequence (or ``sequence``).

    Stops at ``time_limit_s`` (of ``clock``) or after ``max_evaluations`` of P5, whichever is first; both are looked at
    between evaluations, and native code that never comes back can only be ended with its process. ``record`` collects
    every improvement; an entry's number counts evaluations. `Solution.iterations` counts evaluations too.

    Raises `InfeasibleError` where the ranges do not chain together, `ProblemError` for a rival that does not exist and
    for a start that is not at rest, `ImportError` without NLopt.
    """
    if rival not in RIVALS:
        raise ProblemError(f"no rival called {rival!r}; there are {', '.join(RIVALS)}")
    if time_limit_s is None and max_evaluations is None:
        raise ProblemError("a rival needs a time limit or a number of evaluations to stop at")
    if not problem.starts_at_rest:
        raise ProblemError("the rivals start from rest, as in the paper")
    minimise = _gradient_descent if rival == "BGD" else _nlopt(NLOPT_ALGORITHMS[rival])
    stations = shortest_sequence(problem) if sequence is None else check_sequence(problem, sequence)
    objective = TimeAllocation(problem, stations, time_limit_s, max_evaluations, record, clock)
    with suppress(_StopError):
        minimise(objective)
    return certified(problem, objective.best, f"paper-{rival.lower()}", lower_bound_s, objective.evaluations)


class TimeAllocation:
    """The penalised objective over durations, and the best feasible trajectory met so far."""

    def __init__(
        self,
        problem: Problem,
        stations: tuple[int, ...],
        time_limit_s: float | None,
        max_evaluations: int | None,
        record: list[Iteration] | None,
        clock: Clock,
    ) -> None:
        self._started, self._clock = clock(), clock
        self._method = AlternatingMinimisation(problem, build_corridor(problem, stations))
        self.time_limit_s, self._max_evaluations, self._record = time_limit_s, max_evaluations, record
        self.start_s = self._method.durations_s
        self.minima_s = self._method.minima_s
        self.evaluations = 0
        self.best: Trajectory = self._method.finish()
        self._note()

    def __call__(self, durations_s: Array) -> float:
        """f at ``durations_s`` ``(S,)``, which count as at least their minima and the tenure."""
        elapsed_s = self._clock() - self._started
        if self.time_limit_s is not None and elapsed_s >= self.time_limit_s:
            raise _StopError
        if self._max_evaluations is not None and self.evaluations >= self._max_evaluations:
            raise _StopError
        self.evaluations += 1
        method = self._method
        durations = stretch_legs(method.corridor, np.maximum(durations_s, self.minima_s))
        try:
            boundary = method.drawn_inside(method.program.solve(durations), durations)
        except SolverError:
            # Worse than anything P5 can return, and still a number that models can be fitted to.
            return 1e3 * float(self.start_s.sum())
        worst = float(method.check.ratios(control_points(boundary, durations), durations).max())
        if worst <= _FEASIBLE_RATIO and durations.sum() < self.best.duration_s:
            # These durations, not shorter ones: scaling down is not the rivals' own.
            found = feasible_in_time(
                method.check, method.corridor, boundary, durations, self.minima_s, least_factor=1.0
            )
            if found.duration_s < self.best.duration_s:
                self.best = found
                self._note()
        penalty = PENALTY_WEIGHT * float(self.start_s.sum()) * max(0.0, worst - 1.0)
        return float(durations.sum()) + penalty

    def _note(self) -> None:
        if self._record is not None:
            elapsed_s = self._clock() - self._started
            self._record.append(Iteration(self.evaluations, elapsed_s, self.best.duration_s, self.best))


def _nlopt(algorithm: str) -> Callable[[TimeAllocation], None]:
    import nlopt

    def minimise(objective: TimeAllocation) -> None:
        # Unknowns of order one, as these methods like them.
        unit = float(objective.start_s.mean())
        low, high = objective.minima_s / unit, 2.0 * objective.start_s / unit
        optimiser: Any = nlopt.opt(getattr(nlopt, algorithm), len(objective.start_s))

        def value(x: Array, _gradient: Array) -> float:
            inside = np.clip(x, low, high)
            try:
                return objective(unit * inside) / unit + float(np.square(x - inside).sum())
            except _StopError:
                # Not raised through NLopt: PRAXIS would go on calling with the exception pending.
                optimiser.force_stop()
                return math.inf

        # PRAXIS draws random directions.
        nlopt.srand(1)
        optimiser.set_min_objective(value)
        if algorithm != "LN_NEWUOA":
            optimiser.set_lower_bounds(low)
            optimiser.set_upper_bounds(high)
        optimiser.set_xtol_rel(1e-6)
        # Told to stop, out of digits, or unable to go on: what was found so far counts.
        with suppress(nlopt.ForcedStop, nlopt.RoundoffLimited, RuntimeError):
            optimiser.optimize(objective.start_s / unit)

    return minimise


def _gradient_descent(objective: TimeAllocation) -> None:
    """Gradient descent with backtracking (BGD): the step is halved until f falls as the gradient promises."""
    durations = objective.start_s.copy()
    value = objective(durations)
    while True:
        gradient = np.zeros_like(durations)
        for k in range(len(durations)):
            ahead = durations.copy()
            ahead[k] += _DIFFERENCE_S
            gradient[k] = (objective(ahead) - value) / _DIFFERENCE_S
        norm = float(np.linalg.norm(gradient))
        if not math.isfinite(norm) or norm == 0.0:
            return
        step = 0.25 * float(durations.max()) / norm
        while True:
            trial = np.maximum(durations - step * gradient, objective.minima_s)
            trial_value = objective(trial)
            if trial_value <= value - 1e-4 * step * norm**2:
                break
            step *= 0.5
            if step * norm < 1e-6:
                return
        durations, value = trial, trial_value
