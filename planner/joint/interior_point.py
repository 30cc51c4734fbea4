"""A primal-dual interior-point method for `Transcription`: minimise sum T subject to c <= 0 and e = 0.

The usual method (Waechter and Biegler 2006: slacks, barrier, filter line search with second-order correction,
inertia correction), shaped to this problem: the Newton system is banded once K_1 and K_2 are eliminated
(`planner.joint.newton`) and factorised by LAPACK's banded Cholesky. Cholesky failing *is* the test of inertia: the
reduced Hessian must be positive definite on the equations' null space. Work grows linearly with the number of pieces,
nothing is compiled, and the only native code in the loop is LAPACK, so that it cannot hang.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack

from planner.arrays import Array
from planner.joint.newton import NewtonSystem, Step
from planner.joint.objective import Objective
from planner.joint.transcription import Point, Transcription

# Filter constants of Waechter and Biegler 2006, section 2.3.
_GAMMA = 1e-5
_ARMIJO = 1e-4
_SWITCH_OBJECTIVE = 2.3
_SWITCH_VIOLATION = 1.1
# So many steps that gain less than so much of the tolerance, relative to the objective, are the end.
STALL_STEPS, STALL_GAIN = 5, 0.1


@dataclass(frozen=True)
class InteriorPointResult:
    """Where the method stopped: unknowns, the largest scaled KKT residual, the largest violation, and steps taken."""

    x: Array
    inner: Array
    error: float
    violation: float
    iterations: int
    converged: bool


class _Trial(NamedTuple):
    violation: float
    logarithms: float
    barrier: float
    at: Point
    slack: Array
    x: Array
    inner: Array


class BarrierRule(NamedTuple):
    """A barrier problem is solved to ``accuracy`` times its parameter, which then falls to ``power`` of itself.

    ``least_evenness`` is the floor of the objective's evenness term: lower, and steps get lost in directions that
    change nothing. For the last barrier problem the term holds the durations in the proportions found by then, so that
    it costs next to nothing.
    """

    accuracy: float
    power: float
    least_evenness: float


# On missions of the paper's kind `BRISK` takes a third fewer steps to the same plans; on hostile ones (ranges and
# limits a thousandfold apart) it goes astray now and then, and `CAREFUL` does not.
BRISK, CAREFUL = BarrierRule(100.0, 1.8, 2e-2), BarrierRule(10.0, 1.5, 1e-3)


class Start(NamedTuple):
    """A guess, the barrier's first parameter, the least slack (the larger, the further from the boundary), the rule."""

    x: Array
    inner: Array
    barrier: float
    slack: float
    rule: BarrierRule = BRISK


def minimise_duration(
    problem: Transcription,
    objective: Objective,
    start: Start,
    *,
    tolerance: float = 1e-4,
    feasibility: float = 1e-8,
    max_iterations: int = 150,
) -> InteriorPointResult:
    """Solve from ``start``, which need not be feasible; its durations must be positive.

    Stops when the KKT residual is below ``tolerance`` and the violation below ``feasibility``, after
    ``max_iterations``, or when numbers overflow. The objective's ``evenness`` is set here, in step with the barrier.
    Deterministic. Never raises for a hard problem: look at ``converged`` and ``violation``, which is infinite where
    nothing came out.
    """
    solver = _InteriorPoint(problem, objective, start, tolerance, feasibility)
    try:
        return solver.run(max_iterations)
    except FloatingPointError:
        violation = np.inf
        return InteriorPointResult(solver.x, solver.inner, np.inf, violation, solver.iteration, False)


class _InteriorPoint:
    def __init__(
        self, problem: Transcription, objective: Objective, start: Start, tolerance: float, feasibility: float
    ) -> None:
        self.problem, self.x, self.inner = problem, start.x.copy(), start.inner.copy()
        self.tolerance, self.feasibility, self.rule = tolerance, feasibility, start.rule
        self.smallest_barrier = tolerance / 10.0
        self.at = problem.evaluate(self.x, self.inner)
        self.slack = np.maximum(-self.at.inequalities, start.slack)
        self.multiplier = start.barrier / self.slack
        self.equation = np.zeros_like(self.at.equations)
        self.regularisation = 0.0
        self.iteration = 0
        self.objective, self.pace = objective, objective.pace
        self._set_barrier(start.barrier)
        self.violation, self.logarithms = self._violation(self.at, self.slack), float(np.log(self.slack).sum())
        self.max_violation = 10.0 * max(1.0, self.violation)
        self.small_violation = 1e-4 * max(1.0, self.violation)

    def _set_barrier(self, barrier: float) -> None:
        self.barrier = barrier
        self.filter: list[tuple[float, float]] = []

    def _violation(self, at: Point, slack: Array) -> float:
        return float(np.abs(at.inequalities + slack).sum() + np.abs(at.equations).sum())

    def run(self, max_iterations: int) -> InteriorPointResult:
        """Iterate."""
        values: list[float] = []
        error = np.inf
        for self.iteration in range(max_iterations + 1):
            evenness = max(self.barrier, self.rule.least_evenness)
            if evenness != self.objective.evenness or self.pace is not self.objective.pace:
                self.objective = replace(self.objective, evenness=evenness, pace=self.pace)
            system = NewtonSystem(self.problem, self.objective, self.at, self.multiplier, self.equation)
            gap = self.at.inequalities + self.slack
            dual = max(float(np.abs(system.gradient).max()), float(np.abs(system.inner_gradient).max()))
            primal = max(float(np.abs(gap).max()), float(np.abs(self.at.equations).max()))
            size = max(1.0, float(self.multiplier.mean()))
            complementarity = self.slack * self.multiplier / size
            error = max(dual / size, primal, float(complementarity.max()))
            values.append(self.objective.value(self.at) if self.barrier <= self.smallest_barrier else np.inf)
            if error < self.tolerance or self._stalls(values):
                done = self._settled(error)
                if done.converged:
                    return done
            if self.iteration < max_iterations:
                self._lower_barrier(max(dual / size, primal), complementarity, size)
                self._step(system, gap)
        return replace(self._settled(error), converged=False)

    def _stalls(self, values: list[float]) -> bool:
        """True when the last steps at the smallest barrier gained next to nothing.

        Where no limit binds, curves that take the same time differ in shape, and the method may creep along them.
        """
        if len(values) <= STALL_STEPS:
            return False
        gain = abs(values[-1 - STALL_STEPS] - values[-1])
        return bool(gain < STALL_GAIN * self.tolerance * abs(values[-1]))

    def _settled(self, error: float) -> InteriorPointResult:
        """The current joints as an answer, with the K_1 and K_2 that the equations give: converged if feasible."""
        inner = self.problem.consistent_inner(self.x)
        violation = float(self.problem.evaluate(self.x, inner).inequalities.max())
        return InteriorPointResult(self.x, inner, float(error), violation, self.iteration, violation < self.feasibility)

    def _lower_barrier(self, residual: float, complementarity: Array, size: float) -> None:
        """Monotone rule: once the barrier problem is solved well enough for its parameter, go on to a smaller one."""
        barrier = self.barrier
        while barrier > self.smallest_barrier:
            if max(residual, float(np.abs(complementarity - barrier / size).max())) >= self.rule.accuracy * barrier:
                break
            barrier = max(self.smallest_barrier, min(0.2 * barrier, barrier**self.rule.power))
        if barrier < self.barrier:
            self._set_barrier(barrier)
            if barrier == self.smallest_barrier:
                self.pace = self.at.durations

    def _step(self, system: NewtonSystem, gap: Array) -> None:
        ratio, centring = self.multiplier / self.slack, self.barrier / self.slack
        factor = self._factorise(system.condense(ratio))

        def direction(gap: Array, equations: Array) -> Step:
            return system.direction(factor, ratio, gap, equations, centring)

        step = direction(gap, self.at.equations)
        self._search(step, system.slope(step), gap, direction)

    def _factorise(self, band: Array) -> Array:
        """Banded Cholesky of ``band`` plus as much of the identity as makes it positive definite."""
        shift = 0.0 if self.regularisation < 1e-2 else self.regularisation / 4.0
        diagonal = band[0].copy()
        while True:
            band[0] = diagonal + shift
            factor, info = lapack.dpbtrf(band, lower=1)
            if info == 0:
                self.regularisation = shift
                return np.asarray(factor)
            shift = max(8.0 * shift, 1e-3)
            if not np.isfinite(diagonal).all() or shift > 1e40:
                raise FloatingPointError("the reduced Hessian is not finite")

    def _longest(self, value: Array, change: Array) -> float:
        """Longest step in (0, 1] that keeps ``value`` positive, less the fraction to the boundary."""
        keep = max(0.99, 1.0 - self.barrier)
        fastest = float((change / value).min())
        return 1.0 if fastest >= -keep else -keep / fastest

    def _try(self, length: float, step: Step) -> _Trial:
        x, inner = self.x + length * step.x, self.inner + length * step.inner
        at = self.problem.evaluate(x, inner)
        # A slack may always grow to what its constraint has to spare: that lowers the barrier and the violation.
        slack = np.maximum(self.slack + length * step.slack, -at.inequalities)
        logarithms = float(np.log(slack).sum())
        value = self.objective.value(at) - self.barrier * logarithms
        return _Trial(self._violation(at, slack), logarithms, value, at, slack, x, inner)

    def _search(
        self, step: Step, objective_slope: float, residual: Array, direction: Callable[[Array, Array], Step]
    ) -> None:
        violation, value = self.violation, self.objective.value(self.at) - self.barrier * self.logarithms
        slope = objective_slope - self.barrier * float((step.slack / self.slack).sum())

        def descends(length: float) -> bool:
            return (
                violation <= self.small_violation
                and slope < 0
                and length * (-slope) ** _SWITCH_OBJECTIVE > violation**_SWITCH_VIOLATION
            )

        def acceptable(trial: _Trial, length: float) -> bool:
            if not np.isfinite(trial.barrier) or not trial.violation <= self.max_violation:
                return False
            if any(trial.violation >= v and trial.barrier >= b for v, b in self.filter):
                return False
            if descends(length):
                return trial.barrier <= value + _ARMIJO * length * slope + 1e-12 * abs(value)
            return trial.violation <= (1 - _GAMMA) * violation or trial.barrier <= value - _GAMMA * violation

        def feasible_length(candidate: Step) -> float:
            durations = self._longest(self.at.durations, candidate.x[0::10])
            return min(durations, self._longest(self.slack, candidate.slack))

        length = feasible_length(step)
        trial = self._try(length, step)
        accepted = acceptable(trial, length)
        if not accepted and trial.violation >= violation:
            # Second-order correction: aim again with the constraints' curvature seen at the trial point.
            gap = length * residual + trial.at.inequalities + trial.slack
            corrected = direction(gap, length * self.at.equations + trial.at.equations)
            corrected_length = feasible_length(corrected)
            corrected_trial = self._try(corrected_length, corrected)
            if acceptable(corrected_trial, length):
                step, trial, length, accepted = corrected, corrected_trial, corrected_length, True
        while not accepted and length > 1e-6:
            length *= 0.5
            trial = self._try(length, step)
            accepted = acceptable(trial, length)
        if not accepted:
            self.filter = []
        elif not descends(length):
            self.filter.append(((1 - _GAMMA) * violation, value - _GAMMA * violation))
        self._accept(step, trial, length)

    def _accept(self, step: Step, trial: _Trial, length: float) -> None:
        self.x, self.inner, self.slack, self.at = trial.x, trial.inner, trial.slack, trial.at
        self.violation, self.logarithms = trial.violation, trial.logarithms
        self.multiplier = self.multiplier + self._longest(self.multiplier, step.multiplier) * step.multiplier
        self.equation = self.equation + length * (step.equation - self.equation)
        centre = self.barrier / self.slack
        self.multiplier = np.minimum(np.maximum(self.multiplier, 1e-10 * centre), 1e10 * centre)
