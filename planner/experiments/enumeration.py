"""EM, the paper's enumeration: every simple station sequence planned, the best one kept (section 4.2).

The number of sequences explodes with the map, so the enumeration is a generator: take as many steps as there is time
for, and go on later.

The paper's EM plans them all. With pruning, which is not the paper's, what cannot beat the best plan so far is passed
over by a bound for the paper's problem itself (`planner.experiments.sequence_bound`), and sequences are begun in the
order of their bounds: good plans come early, and nothing is planned but what a search that knew the best plan from the
start would have to plan as well.
"""

from __future__ import annotations

import heapq
import math
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count

import numpy as np

from planner.coverage.disc import covering_stations
from planner.errors import SolverError
from planner.experiments.sequence_bound import SequenceBounds
from planner.paper.alternating import Clock, plan_paper
from planner.paper.station_graph import shortest_sequence, weighted_edges
from planner.problem import Problem
from planner.solution import Solution

Sequence = tuple[int, ...]

# Begun sequences kept in the order of their bounds (under a kilobyte each). Beyond that many, the next one's whole
# branch is walked depth first, which needs no more memory than its sequence is long.
MAX_FRONTIER = 100_000


@dataclass(frozen=True)
class Evaluation:
    """One step of the enumeration: ``sequence`` was planned, or passed over with all that begins with it, or begun.

    ``mission_time_s`` is that of this sequence, infinite where it was not planned or no trajectory was found; ``best``
    is the best solution so far. ``planned`` and ``pruned`` count steps; a sequence that was begun, which is to say
    that those one station longer were looked at, counts as neither.
    """

    sequence: Sequence
    mission_time_s: float
    best: Solution | None
    planned: int
    pruned: int
    elapsed_s: float


class _Enumeration:
    """What the steps of one enumeration share."""

    def __init__(self, problem: Problem, delta_t_s: float, clock: Clock) -> None:
        self._problem, self._delta_t_s, self._clock = problem, delta_t_s, clock
        self._started = clock()
        self._first = shortest_sequence(problem)
        self._best: Solution | None = None
        self._best_s = math.inf
        self._planned = self._pruned = 0
        self._sources = _nearest_first(problem, covering_stations(problem, problem.start_m).tolist())
        self._targets = {int(s) for s in covering_stations(problem, problem.destination_m)}
        self._neighbours = _neighbours(problem)
        self._most = math.inf if problem.max_handovers is None else problem.max_handovers + 1

    def every_sequence(self) -> Iterator[Evaluation]:
        """All of them, depth first."""
        walk = [iter(self._sources)]
        path: list[int] = []
        while walk:
            station = next(walk[-1], None)
            if station is None:
                walk.pop()
                if path:
                    path.pop()
                continue
            if station in path:
                continue
            if station in self._targets:
                yield self._plan((*path, station))
            if len(path) + 1 < self._most:
                path.append(station)
                walk.append(iter(self._neighbours[station]))

    def best_first(self) -> Iterator[Evaluation]:
        """Those that may be the best, least bound first, after Dijkstra's."""
        yield self._plan(self._first)
        bounds = SequenceBounds(self._problem)
        ties = count()
        # Entries: bound, number of the entry, sequence, and whether it is that alone or all that begins with it.
        frontier: list[tuple[float, int, Sequence, bool]] = []
        branch: list[tuple[float, int, Sequence, bool]] = []
        for station in self._sources:
            heapq.heappush(frontier, (bounds.time_s((station,)), next(ties), (station,), False))
        while frontier or branch:
            bound_s, _, sequence, alone = branch.pop() if branch else heapq.heappop(frontier)
            if bound_s >= self._best_s:
                yield self._pass_over(sequence)
                continue
            if alone:
                yield self._plan(sequence)
                continue
            found: list[tuple[float, int, Sequence, bool]] = []
            if sequence[-1] in self._targets and sequence != self._first:
                whole_s = max(bound_s, bounds.time_s(sequence, complete=True, enough_s=self._best_s))
                found.append((whole_s, next(ties), sequence, True))
            if len(sequence) < self._most:
                for station in self._neighbours[sequence[-1]]:
                    if station not in sequence:
                        longer = (*sequence, station)
                        longer_s = max(bound_s, bounds.time_s(longer, enough_s=self._best_s))
                        found.append((longer_s, next(ties), longer, False))
            yield self._step(sequence)
            for entry in found:
                if entry[0] >= self._best_s:
                    yield self._pass_over(entry[2])
            found = [entry for entry in found if entry[0] < self._best_s]
            if branch or len(frontier) + len(found) > MAX_FRONTIER:
                branch += sorted(found, reverse=True)
            else:
                for entry in found:
                    heapq.heappush(frontier, entry)

    def _plan(self, sequence: Sequence) -> Evaluation:
        self._planned += 1
        try:
            found = plan_paper(self._problem, sequence, delta_t_s=self._delta_t_s)
        except SolverError:
            return self._step(sequence)
        duration_s = found.trajectory.duration_s
        if duration_s < self._best_s:
            self._best, self._best_s = found, duration_s
        return self._step(sequence, duration_s)

    def _pass_over(self, sequence: Sequence) -> Evaluation:
        self._pruned += 1
        return self._step(sequence)

    def _step(self, sequence: Sequence, mission_time_s: float = math.inf) -> Evaluation:
        elapsed_s = self._clock() - self._started
        return Evaluation(sequence, mission_time_s, self._best, self._planned, self._pruned, elapsed_s)


def enumerate_plans(
    problem: Problem, *, prune: bool = True, delta_t_s: float = 1.0, clock: Clock = time.perf_counter
) -> Iterator[Evaluation]:
    """Every simple sequence planned in turn, depth first, neighbours nearer the destination first.

    With ``prune``, Dijkstra's sequence is planned before all others, the rest in the order of their bounds, and the
    best plan at the end is the same as without, up to the ``delta_t_s`` at which each stops; at most `MAX_FRONTIER`
    sequences are kept begun. There is a step at least for every sequence begun, which takes a few milliseconds for
    each neighbour of its last station, so that a time limit is kept. Deterministic but for ``elapsed_s``. The first
    step raises `InfeasibleError` when no sequence exists.
    """
    enumeration = _Enumeration(problem, delta_t_s, clock)
    yield from enumeration.best_first() if prune else enumeration.every_sequence()


def plan_by_enumeration(
    problem: Problem,
    *,
    prune: bool = True,
    delta_t_s: float = 1.0,
    time_limit_s: float = 1800.0,
    max_sequences: int | None = None,
    record: list[Evaluation] | None = None,
    clock: Clock = time.perf_counter,
) -> Solution:
    """The best plan of all sequences, or of those planned within the time limit; its notes say which.

    ``max_sequences`` stops after so many plans, which unlike the time limit gives the same answer on every machine.
    Raises `InfeasibleError` when no sequence exists and `SolverError` when no trajectory was found.
    """
    last: Evaluation | None = None
    complete = True
    for step in enumerate_plans(problem, prune=prune, delta_t_s=delta_t_s, clock=clock):
        last = step
        if record is not None:
            record.append(step)
        if step.elapsed_s >= time_limit_s or (max_sequences is not None and step.planned >= max_sequences):
            complete = False
            break
    if last is None or last.best is None:
        raise SolverError("no sequence of stations was planned")
    best = last.best
    note = f"{last.planned} sequences planned, {last.pruned} branches pruned" + ("" if complete else ", cut short")
    return Solution(best.trajectory, best.certificate, "enumeration", best.lower_bound_s, last.planned, (note,))


def _neighbours(problem: Problem) -> list[list[int]]:
    pairs, _ = weighted_edges(problem)
    neighbours: list[list[int]] = [[] for _ in range(problem.station_count)]
    for i, j in pairs.tolist():
        neighbours[i].append(j)
        neighbours[j].append(i)
    return [_nearest_first(problem, stations) for stations in neighbours]


def _nearest_first(problem: Problem, stations: list[int]) -> list[int]:
    def away(station: int) -> tuple[float, int]:
        return float(np.linalg.norm(problem.station_positions_m[station] - problem.destination_m)), station

    return sorted(stations, key=away)
