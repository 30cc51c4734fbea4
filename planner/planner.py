"""`Planner`: from a problem to a certified trajectory, whatever it takes.

    ranges and limits ──► lower bound ──► sequences ──► joint problem on each ──► the fastest certified
         │ explained when infeasible                        │ alternating minimisation where that fails

This is the one place of the product that calls the seed paper's method: as the fall-back, and where it is asked for.
A problem whose ranges chain together always gets a plan from rest: a vehicle may stop and wait in every overlap.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import isfinite
from typing import Literal

import numpy as np

from planner.arrays import Array
from planner.certificate import certify
from planner.corridor.corridor import build_corridor
from planner.corridor.handover_polyline import polyline_along
from planner.coverage.elevation_mask import ElevationMask
from planner.coverage.overlap import overlap_depth_m
from planner.coverage.window import Stations, leaves_s
from planner.energy import cost_s, slowed_to_save
from planner.errors import InfeasibleError, SolverError
from planner.infeasibility.explanation import infeasibility_of
from planner.infeasibility.limit_faults import no_way_from_moving_start, too_long
from planner.joint.levelling import levelled
from planner.joint.sequence_planner import Attempt, Effort, plan_joint, within_limits
from planner.paper.alternating import plan_paper
from planner.problem import Problem
from planner.routing.bound import LowerBound, lower_bound
from planner.routing.portal_graph import Route
from planner.routing.station_sequence import candidate_routes, geodesic_route, is_chain, routes_and_fewest
from planner.solution import Solution

Method = Literal["joint", "fast", "paper"]
METHODS: tuple[Method, ...] = ("joint", "fast", "paper")

# Where they cost time: routes looked at for every sequence planned, and how much slower than the best one a sequence
# may be expected to be and still be planned. Expectations are good to two per cent.
SHORTLIST = 3
HOPELESS = 1.03
# Sequences with fewer handovers planned at most, and with one number of handovers; and how much faster than expected,
# as a part of the time, one may turn out to be.
FEWER_TRIES, FEWER_TRIES_EACH, FEWER_HOPE = 8, 2, 0.002
# Plans with wider overlaps tried at most.
WIDER_TRIES = 5
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
        fastest = best
        if self.problem.handover_tolerance > 0.0 and len(best.sequence) > 1 and best.converged:
            fastest, best = self._fewer(best)
        narrow = best
        if self.problem.overlap_after_target_s > 0.0 and len(best.sequence) > 1 and best.converged:
            best = self._wider(best)
        notes: tuple[str, ...] = ()
        if best.method != "joint":
            notes = ("the joint problem gave no better plan; this one is alternating minimisation's",)
        elif not best.converged:
            notes = ("the solver stopped before converging; the plan is feasible, a faster one may exist",)
        trajectory = levelled(self.problem, best.trajectory)
        certificate = best.certificate if trajectory is best.trajectory else certify(self.problem, trajectory)
        solution = Solution(trajectory, certificate, best.method, self.bound.time_s, best.iterations, notes)
        solution = replace(solution, overlap_cost_s=max(0.0, best.duration_s - narrow.duration_s))
        if len(best.sequence) == len(fastest.sequence):
            return solution
        return replace(
            solution,
            fastest_s=fastest.duration_s,
            fastest_handovers=len(fastest.sequence) - 1,
            fewer_cost_s=max(0.0, narrow.duration_s - fastest.duration_s),
        )

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
        sequences = self._ranking.best(self.strategy.compared)
        best: Attempt | None = None
        for sequence in sequences:
            if best is not None and not self.in_time():
                break
            best = _cheapest([best, self._joint(sequence)])
        return sequences, best

    @cached_property
    def _ranking(self) -> _Ranking:
        return _Ranking.of(self.problem, self.strategy.compared, self.bound)

    def _fewer(self, fastest: Attempt) -> tuple[Attempt, Attempt]:
        """The fastest plan, and the one with the fewest handovers that is no slower than the tolerance allows.

        Of those with equally few the one with the widest overlaps. A sequence with fewer handovers may turn out to be
        faster, too.
        """
        chosen, tries = fastest, 0
        known = {fastest.sequence}
        offset_s = fastest.cost_s - self._ranking.expected_s(fastest.sequence)
        shorter = [*self._ranking.all, *_without_one(self.problem, fastest.sequence)]
        while True:
            shorter = [q for q in dict.fromkeys(shorter) if len(q) < len(chosen.sequence) and q not in known]
            expected = {q: self._ranking.expected_s(q) + offset_s for q in shorter}
            found: list[Attempt] = []
            count, tried_of_count = 0, 0
            for sequence in sorted(shorter, key=lambda q: (len(q), expected[q])):
                slowest = self.problem.slowest_s(fastest.cost_s)
                if len(sequence) != count:
                    if found:
                        break
                    count, tried_of_count = len(sequence), 0
                if expected[sequence] > slowest + FEWER_HOPE * fastest.cost_s or tried_of_count == FEWER_TRIES_EACH:
                    continue
                if tries == FEWER_TRIES or not self.in_time():
                    break
                tries, tried_of_count = tries + 1, tried_of_count + 1
                known.add(sequence)
                attempt = self._joint(sequence)
                if attempt is None or not attempt.converged:
                    continue
                if attempt.cost_s < fastest.cost_s:
                    fastest = attempt
                if attempt.cost_s <= self.problem.slowest_s(fastest.cost_s):
                    found.append(attempt)
            if not found:
                return fastest, chosen
            chosen = max(
                found, key=lambda attempt: float(_depths_m(self.problem, attempt.sequence).min(initial=np.inf))
            )
            shorter = _without_one(self.problem, chosen.sequence)

    def _wider(self, narrow: Attempt) -> Attempt:
        """The plan whose overlaps last as long after handovers as aimed at, wherever that is worth its price.

        The dearest are taken to be those of the narrowest overlaps, and left out one after the other.
        """
        target_s, sequence = self.problem.overlap_after_target_s, narrow.sequence
        depth = _depths_m(self.problem, sequence)
        asked = self._left_after_s(narrow) < target_s
        given_up = np.zeros_like(asked)
        for _ in range(WIDER_TRIES):
            if not asked.any() or not self.in_time():
                break
            wide = self._joint(sequence, tuple(np.where(asked, target_s, 0.0).tolist()))
            if wide is not None and wide.converged:
                cut_short = ~asked & ~given_up & (self._left_after_s(wide) < target_s)
                dear = wide.cost_s - narrow.cost_s > asked.sum() * self.problem.price_s(narrow.cost_s)
                if not dear and not cut_short.any():
                    return wide
                if not dear:
                    asked |= cut_short
                    continue
            dearest = int(np.argmin(np.where(asked, depth, np.inf)))
            asked[dearest], given_up[dearest] = False, True
        return narrow

    def _left_after_s(self, attempt: Attempt) -> Array:
        """How long after every handover the station handed over from goes on covering."""
        problem, trajectory = self.problem, attempt.trajectory
        before, times = np.array(trajectory.sequence[:-1]), trajectory.handover_times_s
        mask = ElevationMask.of(problem)
        covering = Stations(
            problem.station_positions_m[before], problem.ranges_m[before], None if mask is None else mask.at(before)
        )
        left: Array = leaves_s(trajectory, covering, times, ahead=True, slack_m=0.0) - times
        return np.nan_to_num(left, nan=0.0)

    def _joint(self, sequence: tuple[int, ...], after_s: tuple[float, ...] = ()) -> Attempt | None:
        effort = replace(self.strategy.effort, max_iterations=self.max_iterations)
        return plan_joint(self.problem, sequence, effort, energy_weight=self.energy_weight, after_s=after_s)

    def _alternating(self, sequence: tuple[int, ...]) -> Attempt | None:
        return plan_alternating(self.problem, sequence, energy_weight=self.energy_weight)


@dataclass(frozen=True)
class _Ranking:
    """Sequences worth a look, and the time expected of each along its own polyline."""

    problem: Problem
    all: list[tuple[int, ...]]
    _expected_s: dict[tuple[int, ...], float] = field(default_factory=dict)

    @classmethod
    def of(cls, problem: Problem, compared: int, bound: LowerBound) -> _Ranking:
        """The routes expected to be fastest, and the best ones with fewer handovers than those."""
        routes, fewest = routes_and_fewest(problem, SHORTLIST * compared)
        if not routes and not fewest:
            routes = candidate_routes(problem, SHORTLIST * compared, bound=bound)
        return cls(problem, list(dict.fromkeys(route.sequence for route in [*routes, *fewest])))

    def expected_s(self, sequence: tuple[int, ...]) -> float:
        """How long a flight along ``sequence`` is expected to take."""
        if sequence not in self._expected_s:
            self._expected_s[sequence] = polyline_along(self.problem, sequence)[1]
        return self._expected_s[sequence]

    def best(self, count: int) -> list[tuple[int, ...]]:
        """Up to ``count`` sequences, the one expected to be fastest first."""
        order = sorted(self.all, key=self.expected_s)
        return [q for q in order[:count] if self.expected_s(q) <= HOPELESS * self.expected_s(order[0])]


def _without_one(problem: Problem, sequence: tuple[int, ...]) -> list[tuple[int, ...]]:
    """The chains that one station less makes of a sequence."""
    shorter = [sequence[:k] + sequence[k + 1 :] for k in range(len(sequence))]
    return [q for q in shorter if q and is_chain(problem, q)]


def _depths_m(problem: Problem, sequence: tuple[int, ...]) -> Array:
    """How deep every overlap of a sequence is ``(handovers,)``."""
    stations = np.array(sequence)
    return np.asarray(overlap_depth_m(problem, stations[:-1], stations[1:]))


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
