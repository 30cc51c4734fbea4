"""EM, the paper's enumeration: every simple station sequence planned, the best one kept (section 4.2).

The number of sequences explodes with the map, so the enumeration is a generator: take as many steps as there is time
for, and go on later. With pruning, what cannot beat the best plan so far is passed over: nothing flies a corridor
faster than its shortest polyline at full speed with ramps at both ends, and whatever begins with a partial sequence is
bounded by the polyline through that and a straight line on to the destination.

The first and the last piece are slower than that, which prunes far more. A piece of degree 5 from rest has
Q_0 = Q_1 = 0, so it spans l <= T/5 (|Q_2| + |Q_3| + |Q_4|) with |Q_1+k| <= min(v, k a T/4): never more than 0.6 v on
average. The T that takes is concave in l, hence above its chord between the nearest and the farthest l there can be,
and a chord is a constant and a weight on that piece's length in the polyline's program.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.bound import fastest_time_s
from planner.corridor import Corridor, Piece
from planner.discs import covering_stations
from planner.errors import SolverError
from planner.paper.am import Clock, plan_paper
from planner.paper.boundary import DEGREE
from planner.paper.station_graph import shortest_sequence, weighted_edges
from planner.paper.waypoints import polyline_length_m, shortest_polyline
from planner.problem import Problem
from planner.solution import Solution

Array = NDArray[np.float64]
Sequence = tuple[int, ...]

# What the shortest polyline may be too long by: it is sought a little inside the ranges.
_POLYLINE_EXCESS = 1e-5


@dataclass(frozen=True)
class Evaluation:
    """One step of the enumeration: ``sequence`` was planned, or pruned together with all that begins with it.

    ``mission_time_s`` is that of this sequence, infinite where it was pruned or no trajectory was found; ``best`` is
    the best solution so far. ``planned`` and ``pruned`` count steps.
    """

    sequence: Sequence
    mission_time_s: float
    best: Solution | None
    planned: int
    pruned: int
    elapsed_s: float


def enumerate_plans(
    problem: Problem, *, prune: bool = True, delta_t_s: float = 1.0, clock: Clock = time.perf_counter
) -> Iterator[Evaluation]:
    """Every simple sequence in turn, neighbours nearer the destination first.

    With ``prune``, Dijkstra's sequence is planned before all others and the best plan at the end is the same as
    without, up to the ``delta_t_s`` at which each stops. Deterministic but for ``elapsed_s``. The first step raises
    `InfeasibleError` when no sequence exists.
    """
    started = clock()
    best: Solution | None = None
    planned = pruned = 0
    first = shortest_sequence(problem)
    targets = {int(s) for s in covering_stations(problem, problem.destination_m)}
    most = math.inf if problem.max_handovers is None else problem.max_handovers + 1

    def plan(sequence: Sequence) -> Evaluation:
        nonlocal best, planned
        planned += 1
        try:
            found = plan_paper(problem, sequence, delta_t_s=delta_t_s)
        except SolverError:
            return Evaluation(sequence, math.inf, best, planned, pruned, clock() - started)
        if best is None or found.trajectory.duration_s < best.trajectory.duration_s:
            best = found
        return Evaluation(sequence, found.trajectory.duration_s, best, planned, pruned, clock() - started)

    if prune:
        yield plan(first)
    neighbours = _neighbours(problem)
    walk = [iter(_nearest_first(problem, covering_stations(problem, problem.start_m).tolist()))]
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
        sequence = (*path, station)
        if prune and best is not None and sequence_bound_s(problem, sequence) >= best.trajectory.duration_s:
            pruned += 1
            yield Evaluation(sequence, math.inf, best, planned, pruned, clock() - started)
            continue
        if station in targets and not (prune and sequence == first):
            if prune and best is not None:
                whole_s = sequence_bound_s(problem, sequence, complete=True)
            if prune and best is not None and whole_s >= best.trajectory.duration_s:
                pruned += 1
                yield Evaluation(sequence, math.inf, best, planned, pruned, clock() - started)
            else:
                yield plan(sequence)
        if len(sequence) < most:
            path.append(station)
            walk.append(iter(neighbours[station]))


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


def sequence_bound_s(problem: Problem, sequence: Sequence, *, complete: bool = False) -> float:
    """A time nothing that begins with ``sequence`` can beat, and so none for the sequence itself.

    ``complete``: for this sequence alone, with no more to follow, which bounds it more tightly.
    """
    pieces = tuple(Piece(station, leg, (station,)) for leg, station in enumerate(sequence))
    # The destination is where the polyline ends, not asked to be inside the last range.
    corridor = Corridor(sequence, pieces, 0.0)
    length_m = polyline_length_m(shortest_polyline(problem, corridor)) * (1.0 - _POLYLINE_EXCESS)
    bound_s = fastest_time_s(
        problem.limits,
        length_m,
        float(np.linalg.norm(problem.start_velocity_m_s)),
        float(np.linalg.norm(problem.start_acceleration_m_s2)),
    )
    at_rest = not (problem.start_velocity_m_s.any() or problem.start_acceleration_m_s2.any())
    if problem.min_overlap_s > 0.0 or not at_rest or len(sequence) < 2:
        return bound_s
    weights, seconds = np.ones(len(sequence)), 0.0
    ends = [(0, problem.start_m, sequence[0], sequence[1])]
    if complete:
        ends.append((-1, problem.destination_m, sequence[-1], sequence[-2]))
    for piece, end_m, station, neighbour in ends:
        constant_s, weights[piece] = _chord_from_rest(problem, end_m, station, neighbour)
        seconds += constant_s
    # The last piece of a partial sequence is followed by others, and is then not the one that ends at rest.
    polyline = shortest_polyline(problem, corridor, weights=weights)
    weighted_m = float(weights @ np.linalg.norm(np.diff(polyline, axis=0), axis=1)) * (1.0 - _POLYLINE_EXCESS)
    return max(bound_s, seconds + weighted_m / problem.limits.max_speed_m_s)


def _chord_from_rest(problem: Problem, end_m: Array, station: int, neighbour: int) -> tuple[float, float]:
    """(c, w): from rest at ``end_m`` into the lens of two stations, a piece of length l takes at least c + w l / v."""
    away = np.linalg.norm(problem.station_positions_m[[station, neighbour]] - end_m, axis=1)
    ranges = problem.ranges_m[[station, neighbour]]
    nearest, farthest = max(0.0, float((away - ranges).max())), float((away + ranges).min())
    low_s, high_s = (shortest_from_rest_s(problem, length_m) for length_m in (nearest, farthest))
    slope = (high_s - low_s) / (farthest - nearest) if farthest > nearest else 0.0
    return low_s - slope * nearest, slope * problem.limits.max_speed_m_s


def shortest_from_rest_s(problem: Problem, length_m: float) -> float:
    """The least T with T/5 (min(v, a T/4) + min(v, 2 a T/4) + min(v, 3 a T/4)) >= length."""
    speed, accel = problem.limits.max_speed_m_s, problem.limits.max_accel_m_s2
    counts = np.arange(1, 4)

    def spans_m(duration_s: float) -> float:
        return float(duration_s / DEGREE * np.minimum(speed, counts * accel * duration_s / 4.0).sum())

    low, high = 0.0, max(length_m / (0.6 * speed), 4.0 * speed / accel)
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if spans_m(middle) < length_m else (low, middle)
    return low


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
