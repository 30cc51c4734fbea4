"""The upper level: a graph of stations and Dijkstra's shortest path through it (paper section 3.1).

Two stations are adjacent when their ranges meet inside the altitude band (Proposition 1, with "<=" and exact for
antennas above the band's floor, see ``planner.coverage.overlap``). An edge weighs the horizontal distance between the
stations; the edges of start and destination weigh nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from planner.arrays import Array, Indices
from planner.coverage.disc import covering_stations
from planner.coverage.overlap import MIN_OVERLAP_M, adjacent_pairs, overlap_depth_m
from planner.errors import Infeasibility, InfeasibleError, ProblemError
from planner.infeasibility.diagnosis import broken_pair, diagnose
from planner.problem import Problem


def shortest_sequence(problem: Problem) -> tuple[int, ...]:
    """Stations of the shortest path, in flight order.

    Raises `InfeasibleError` when no chain of ranges links the ends, or none with so few handovers as allowed.
    """
    pairs, lengths = weighted_edges(problem)
    sources = covering_stations(problem, problem.start_m)
    targets = covering_stations(problem, problem.destination_m)
    path = _dijkstra(problem.station_count, pairs, lengths, sources, targets)
    if path is not None and problem.max_handovers is not None and len(path) - 1 > problem.max_handovers:
        path = _fewest_hops(problem.station_count, pairs, lengths, sources, targets, problem.max_handovers)
    if path is None:
        fault = diagnose(problem)
        # The search and the diagnosis read the same graph, so one without the other is a fault of ours.
        if fault is None:
            raise AssertionError("no path, yet nothing is wrong")
        raise InfeasibleError(fault)
    return path


def weighted_edges(problem: Problem) -> tuple[Indices, Array]:
    """Edges ``(E, 2)`` between adjacent stations and their weights ``(E,)``: horizontal distances in metres."""
    pairs = adjacent_pairs(problem).pairs
    ground = problem.station_positions_m[:, :2]
    return pairs, np.asarray(np.linalg.norm(ground[pairs[:, 0]] - ground[pairs[:, 1]], axis=1))


def check_sequence(problem: Problem, sequence: Sequence[int]) -> tuple[int, ...]:
    """``sequence`` as a tuple, once it is known to be a corridor of ``problem``.

    Raises `ProblemError` for stations that do not exist or follow themselves, `InfeasibleError` where an end is not
    covered by its station or two neighbours do not meet.
    """
    stations = tuple(int(s) for s in sequence)
    if not stations or not all(0 <= s < problem.station_count for s in stations):
        raise ProblemError(
            f"a station sequence needs indices from 0 to {problem.station_count - 1}, not {list(sequence)}"
        )
    if any(a == b for a, b in pairwise(stations)):
        raise ProblemError(f"a station cannot hand over to itself: {list(stations)}")
    for name, position, station in (
        ("start", problem.start_m, stations[0]),
        ("destination", problem.destination_m, stations[-1]),
    ):
        limits = problem.limits
        if not limits.min_alt_m <= position[2] <= limits.max_alt_m:
            fault = diagnose(problem)
            assert fault is not None
            raise InfeasibleError(fault)
        if station not in covering_stations(problem, position):
            gap = float(np.linalg.norm(position - problem.station_positions_m[station]) - problem.ranges_m[station])
            raise InfeasibleError(
                Infeasibility(
                    f"{name}_uncovered",
                    f"the {name} is not covered by station {station}, which the sequence asked for; it misses it by "
                    f"{max(gap, 0.0):.3f} m",
                    (station,),
                    max(gap, 0.0),
                    (float(position[0]), float(position[1]), float(position[2])),
                )
            )
    for i, j in pairwise(stations):
        if float(overlap_depth_m(problem, i, j)) < MIN_OVERLAP_M:
            raise InfeasibleError(broken_pair(problem, i, j))
    return stations


def _dijkstra(count: int, pairs: Indices, lengths: Array, sources: Indices, targets: Indices) -> tuple[int, ...] | None:
    if not len(sources) or not len(targets):
        return None
    # Coincident stations are zero apart, which a sparse graph keeps as an edge only when it is stored as a number.
    graph = csr_array((np.maximum(lengths, 1e-300), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    distance, before, _ = dijkstra(graph, directed=False, indices=sources, return_predecessors=True, min_only=True)
    target = int(targets[np.argmin(distance[targets])])
    if not np.isfinite(distance[target]):
        return None
    path = [target]
    while before[path[-1]] >= 0:
        path.append(int(before[path[-1]]))
    return tuple(path[::-1])


def _fewest_hops(
    count: int, pairs: Indices, lengths: Array, sources: Indices, targets: Indices, handovers: int
) -> tuple[int, ...] | None:
    """The shortest path of at most ``handovers`` edges: one relaxation of every edge a handover (Bellman and Ford)."""
    tails, heads = np.concatenate([pairs, pairs[:, ::-1]]).T
    weights = np.concatenate([lengths, lengths])
    order = np.lexsort((tails, heads))
    tails, heads, weights = tails[order], heads[order], weights[order]
    distance = np.full((handovers + 1, count), np.inf)
    before = np.full((handovers + 1, count), -1)
    distance[0, sources] = 0.0
    for hop in range(1, handovers + 1):
        distance[hop] = distance[hop - 1]
        reached = distance[hop - 1, tails] + weights
        for edge in np.flatnonzero(reached < distance[hop, heads]):
            if reached[edge] < distance[hop, heads[edge]]:
                distance[hop, heads[edge]] = reached[edge]
                before[hop, heads[edge]] = tails[edge]
    target = int(targets[np.argmin(distance[-1, targets])])
    if not np.isfinite(distance[-1, target]):
        return None
    path, hop = [target], handovers
    while True:
        while hop > 0 and before[hop, path[-1]] < 0:
            hop -= 1
        if hop == 0:
            return tuple(path[::-1])
        path.append(int(before[hop, path[-1]]))
        hop -= 1
