"""`Planner`: from a problem to a certified trajectory, whatever it takes.

    ranges and limits ──► lower bound ──► sequences ──► joint problem on each ──► the fastest certified
         │ explained when infeasible                        │ alternating minimisation where that fails

This is the one place of the product that calls the seed paper's method: as the fall-back, and where it is asked for.
A problem whose ranges chain together always gets a plan from rest: a vehicle may stop and wait in every overlap.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import isfinite
from typing import Literal

from planner.certificate import certify
from planner.corridor.corridor import build_corridor
from planner.corridor.handover_polyline import polyline_along
from planner.energy import cost_s, slowed_to_save
from planner.errors import InfeasibleError, SolverError
from planner.infeasibility.explanation import infeasibility_of
from planner.infeasibility.limit_faults import no_way_from_moving_start, too_long
from planner.joint.sequence_planner import Attempt, Effort, plan_joint, within_limits
from planner.paper.alternating import plan_paper
from planner.problem import Problem
from planner.routing.bound import LowerBound, lower_bound
from planner.routing.portal_graph import Route
from planner.routing.station_sequence import candidate_routes, geodesic_route
from planner.solution import Solution

Method = Literal["joint", "fast", "paper"]
METHODS: tuple[Method, ...] = ("joint", "fast", "paper")

# Where they cost time: routes looked at for every sequence planned, and how much slower than the best one a sequence
# may be expected to be and still be planned. Expectations are good to two per cent.
SHORTLIST = 3
HOPELESS = 1.03
# Parts of an energy weight tried in turn, until the flight is short enough for the endurance.
ENDURANCE_WEIGHTS = (1.0, 0.25, 0.05, 0.0)


@dataclass(frozen=True)
class Strategy:
    """How a method divides its work: ``compared`` sequences are planned, each with ``effort``.

    Where handovers cost nothing it is one sequence, and others only for a plan ``suspicious`` times the bound.
    """

    effort: Effort
    compared: int
    suspicious: float


STRATEGIES = {
    "joint": Strategy(Effort(4, 6, 24, tolerance=3e-4), compared=3, suspicious=1.02),
    "fast": Strategy(Effort(2, 4, tolerance=1e-3), compared=2, suspicious=1.05),
}


class Planner:
    """Plans problems. Deterministic: the same problem gives the same plan, unless a time limit cuts in.

    ``clock`` is read for time limits alone. ``max_iterations`` bounds every run of the interior-point method.
    """

    def __init__(self, *, clock: Callable[[], float] = time.monotonic, max_iterations: int = 200) -> None:
        self._clock = clock
        self._max_iterations = max_iterations

    def plan(
        self,
        problem: Problem,
        *,
        method: Method = "joint",
        time_limit_s: float | None = None,
        energy_weight: float = 0.0,
    ) -> Solution:
        """The fastest trajectory found, or the cheapest for an ``energy_weight``; certified at zero tolerance.

        ``method``: ``"joint"`` (within about half a per cent of the bound where handovers cost nothing), ``"fast"``
        (a little more, in three quarters of the time), ``"paper"`` (Qi, Dou and Xin 2023). After ``time_limit_s`` no
        further sequence is begun; the first is always finished. ``energy_weight`` w > 0 asks for the least time plus w
        times the energy of `planner.energy` instead of the least time; ``lower_bound_s`` stays that of the time.

        Raises `InfeasibleError` when there is no plan, and says why and what would help; `SolverError` when there
        should be one and nothing found it; ``ValueError`` for an unknown method.
        """
        if method not in METHODS:
            raise ValueError(f"unknown method {method!r}: one of {', '.join(METHODS)}")
        if not (isfinite(energy_weight) and energy_weight >= 0.0):
            raise ValueError(f"energy_weight must be finite and not negative, not {energy_weight}")
        started = self._clock()
        bound = lower_bound(problem)
        route = None if problem.handovers_cost_time else geodesic_route(problem, bound)
        infeasibility = infeasibility_of(problem, bound.time_s, chained=route is not None)
        if infeasibility is not None:
            raise InfeasibleError(infeasibility)

        def in_time() -> bool:
            return time_limit_s is None or self._clock() - started < time_limit_s

        # No method can aim at an endurance: the fastest plan either keeps it or shows by how much it is missed.
        free = replace(problem, limits=replace(problem.limits, max_duration_s=None))
        if method == "paper":
            solution = plan_paper(free, max_runtime_s=time_limit_s, lower_bound_s=bound.time_s)
            solution = replace(solution, trajectory=slowed_to_save(problem, solution.trajectory, energy_weight))
        else:
            for weight in ENDURANCE_WEIGHTS:
                part = weight * energy_weight
                search = _Search(free, bound, route, STRATEGIES[method], part, self._max_iterations, in_time)
                solution = search.run()
                if energy_weight == 0.0 or too_long(problem, solution.trajectory.duration_s) is None:
                    break
        infeasibility = too_long(problem, solution.trajectory.duration_s)
        if infeasibility is not None:
            raise InfeasibleError(infeasibility)
        if method != "paper" and problem.limits.max_duration_s is None:
            return solution  # certified on the way, against this very problem
        return replace(solution, certificate=certify(problem, solution.trajectory))


@dataclass(frozen=True)
class _Search:
    """One problem, planned along as many sequences as it takes; ``route`` is `geodesic_route`'s."""

    problem: Problem
    bound: LowerBound
    route: Route | None
    strategy: Strategy
    energy_weight: float
    max_iterations: int
    in_time: Callable[[], bool]

    def run(self) -> Solution:
        """The cheapest plan of all sequences, from the first method that has one."""
        sequences, best = self._priced() if self.problem.handovers_cost_time else self._free()
        if best is None or not best.converged:
            tried = sequences if best is None else [best.sequence]
            best = _cheapest([best, *(self._alternating(sequence) for sequence in tried)])
        if best is None:
            if not self.problem.starts_at_rest:
                raise InfeasibleError(no_way_from_moving_start(self.problem))
            raise SolverError(f"no method found a plan along any of {len(sequences)} sequences")
        notes: tuple[str, ...] = ()
        if best.method != "joint":
            notes = ("the joint problem gave no better plan; this one is alternating minimisation's",)
        elif not best.converged:
            notes = ("the solver stopped before converging; the plan is feasible, a faster one may exist",)
        return Solution(best.trajectory, best.certificate, best.method, self.bound.time_s, best.iterations, notes)

    def _free(self) -> tuple[list[tuple[int, ...]], Attempt | None]:
        """Where handovers cost nothing the shortest path's sequence is best, and others only looked at in doubt."""
        routes = [self.route] if self.route else candidate_routes(self.problem, 1, bound=self.bound)
        best = self._joint(routes[0].sequence)
        doubtful = best is None or not best.converged
        if best is not None and self.energy_weight == 0.0:
            doubtful = doubtful or best.duration_s > self.strategy.suspicious * self.bound.time_s
        if doubtful and self.in_time():
            routes = candidate_routes(self.problem, 1 + self.strategy.compared, bound=self.bound)
            best = _cheapest([best, *(self._joint(route.sequence) for route in routes[1:])])
        return [route.sequence for route in routes], best

    def _priced(self) -> tuple[list[tuple[int, ...]], Attempt | None]:
        """Where handovers cost time, the most promising sequences are planned and compared."""
        sequences = ranked_sequences(self.problem, self.strategy.compared, self.bound)
        best: Attempt | None = None
        for sequence in sequences:
            if best is not None and not self.in_time():
                break
            best = _cheapest([best, self._joint(sequence)])
        return sequences, best

    def _joint(self, sequence: tuple[int, ...]) -> Attempt | None:
        effort = replace(self.strategy.effort, max_iterations=self.max_iterations)
        return plan_joint(self.problem, sequence, effort, energy_weight=self.energy_weight)

    def _alternating(self, sequence: tuple[int, ...]) -> Attempt | None:
        return plan_alternating(self.problem, sequence, energy_weight=self.energy_weight)


def ranked_sequences(problem: Problem, count: int, bound: LowerBound) -> list[tuple[int, ...]]:
    """Up to ``count`` sequences, the one expected to be fastest along its own polyline first."""
    routes = candidate_routes(problem, SHORTLIST * count, bound=bound)
    estimates = sorted((polyline_along(problem, route.sequence)[1], k) for k, route in enumerate(routes))
    return [routes[k].sequence for estimate, k in estimates[:count] if estimate <= HOPELESS * estimates[0][0]]


def _cheapest(attempts: list[Attempt | None]) -> Attempt | None:
    found = [attempt for attempt in attempts if attempt is not None]
    return min(found, key=lambda attempt: attempt.cost_s) if found else None


def plan_alternating(
    problem: Problem, sequence: Sequence[int], *, energy_weight: float = 0.0, max_iterations: int = 10
) -> Attempt | None:
    """The paper's method on the same sequence: slower flights, but from rest it always has one. None when it fails."""
    corridor = build_corridor(problem, sequence)
    try:
        solution = plan_paper(problem, corridor=corridor, delta_t_s=0.5, max_iterations=max_iterations)
    except SolverError:
        return None
    trajectory = slowed_to_save(problem, solution.trajectory, energy_weight)
    if problem.wind is not None:
        # The method knows of one wind alone.
        trajectory = within_limits(problem, corridor, trajectory)
    return Attempt(
        tuple(sequence),
        trajectory,
        certify(problem, trajectory),
        "alternating minimisation",
        solution.iterations,
        converged=False,
        cost_s=cost_s(problem, trajectory, energy_weight),
    )
