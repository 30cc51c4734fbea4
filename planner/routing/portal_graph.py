"""The portal graph: stations priced by time, not by the distance between their masts.

Every pair of stations whose ranges overlap shares a chord; five points on it are its portals, for a handover.
A leg of a station runs straight from a portal of one neighbour to a portal of the next, and costs what
`planner.coverage.chord` says: its length at full speed, and the time its two handovers lose.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from planner.arrays import Array, Indices
from planner.coverage.chord import chords, leaves_after, leg_times_s
from planner.coverage.disc import covering_stations
from planner.coverage.overlap import adjacent_pairs
from planner.problem import Problem

# Where on half a chord its portals lie: the outer ones are kept a little inside the overlap.
CHORD_FRACTIONS = {1: (0.0,), 3: (-0.999, 0.0, 0.999), 5: (-0.999, -0.5, 0.0, 0.5, 0.999)}
# Above this many legs in the graph fewer portals are used.
MAX_LEGS = 3_000_000
# How much slower than the best a route with fewer legs may be expected to be and still be looked at.
FEWEST_SLACK, FEWEST_SLACK_S = 0.015, 5.0
# How many portals are tried for every further sequence wanted.
MAX_TRIALS = 100


@dataclass(frozen=True)
class Route:
    """A station sequence, and the time the graph expects of it (s)."""

    sequence: tuple[int, ...]
    estimate_s: float


class PortalGraph:
    """Portals and legs of one problem. Building it costs most; `routes` may be asked several times."""

    def __init__(self, problem: Problem, pairs: Indices | None = None, *, portals: int | None = None) -> None:
        """``pairs`` ``(E, 2)`` of stations that meet, if known already; ``portals`` on each chord: 1, 3 or 5.

        By default 5, fewer where legs would be too many.
        """
        self._problem = problem
        self._pairs = adjacent_pairs(problem).pairs if pairs is None else pairs
        self._sources = covering_stations(problem, problem.start_m)
        self._targets = covering_stations(problem, problem.destination_m)
        legs = legs_of(self._pairs)
        # A point a chord at least; where even that is too many, `planner.routing.station_sequence` has left stations
        # out.
        if portals is None:
            portals = next((n for n in (5, 3) if legs * n * n <= MAX_LEGS), 1)
        self._fractions = np.array(CHORD_FRACTIONS[portals])
        self._build_points()
        self._build_legs()

    def _build_points(self) -> None:
        """Points of every portal ``(E n + sources + targets, 2)`` and the one or two stations each belongs to."""
        problem = self._problem
        first, second = self._pairs[:, 0], self._pairs[:, 1]
        pair_chords = chords(problem, first, second)
        points = pair_chords.points(np.broadcast_to(self._fractions, (len(first), len(self._fractions))))
        ends = [
            np.broadcast_to(end[:2], (len(stations), 2))
            for end, stations in ((problem.start_m, self._sources), (problem.destination_m, self._targets))
        ]
        count = len(self._fractions)
        self._points = np.concatenate([points.reshape(-1, 2), *ends])
        self._pair_of = np.concatenate(
            [np.repeat(np.arange(len(first)), count), np.full(len(ends[0]) + len(ends[1]), -1)]
        )
        lone = np.concatenate([self._sources, self._targets])
        # The two stations of a portal; an end has one, given twice.
        self._stations = np.concatenate([np.repeat(self._pairs, count, axis=0), np.stack([lone, lone], axis=1)])
        radii = np.stack([pair_chords.radius_first, pair_chords.radius_second], axis=1)
        self._radii = np.concatenate([np.repeat(radii, count, axis=0), np.full((len(lone), 2), np.inf)])
        inner = len(first) * count
        self._start_nodes = np.arange(inner, inner + len(self._sources))
        self._end_nodes = np.arange(inner + len(self._sources), inner + len(lone))

    def _build_legs(self) -> None:
        """All pairs of portals of one station, from different chords: a leg flown under that station."""
        nodes = np.arange(len(self._points))
        is_end = self._pair_of < 0
        owner = np.concatenate([self._stations[:, 0], self._stations[~is_end, 1]])
        node = np.concatenate([nodes, nodes[~is_end]])
        order = np.lexsort((node, owner))
        owner, node = owner[order], node[order]
        # Every entry of a station's run is paired with each later one of the run.
        last = np.searchsorted(owner, owner, side="right")
        later = last - np.arange(len(owner)) - 1
        first = np.repeat(np.arange(len(owner)), later)
        offset = np.arange(len(first)) - np.repeat(np.cumsum(later) - later, later)
        second = first + 1 + offset
        a, b, station = node[first], node[second], owner[first]
        apart = (self._pair_of[a] != self._pair_of[b]) | (self._pair_of[a] < 0)
        self._from, self._to, self._leg_station = a[apart], b[apart], station[apart]
        offset = self._points[self._to] - self._points[self._from]
        self._length = np.hypot(offset[:, 0], offset[:, 1])
        if self._problem.min_overlap_s > 0.0:
            self._out = self._inside_length(self._from, self._to)
            self._into = self._inside_length(self._to, self._from)
        else:
            self._out = self._into = np.full(len(self._length), np.inf)

    def _inside_length(self, at: Indices, towards: Indices) -> Array:
        """How far a leg stays in the overlap it starts (or ends) in: to where it leaves the other station's disc."""
        side = np.where(self._stations[at, 0] == self._leg_station, 1, 0)
        row = 2 * at + side
        radius = self._radii.ravel()[row]
        centres = self._problem.station_positions_m[self._stations.ravel(), :2]
        inside = leaves_after(
            self._points[at],
            self._points[towards],
            self._length,
            centres[row],
            np.where(np.isinf(radius), 0.0, radius),
        )
        # An end is in no overlap.
        return np.where(np.isinf(radius), np.inf, inside)

    def fastest_through_s(self) -> Array:
        """``(E,)``: the time expected of the fastest route with a handover on each chord; infinite where none is."""
        graph = self._graph(leg_times_s(self._problem, self._length, self._out, self._into))
        through = _distances(graph, self._start_nodes)[0] + _distances(graph, self._end_nodes)[0]
        times: Array = through[self._pair_of >= 0].reshape(len(self._pairs), -1).min(axis=1)
        return times

    def routes(self, count: int, *, slowdown: float = 1.0) -> list[Route]:
        """Up to ``count`` different sequences, best expected first.

        After the shortest path come the shortest ones through one given portal each: with the distances from the
        start and from the destination known, that is a lookup. They differ from the best where a station more, or
        another one, costs little.
        """
        single = self._single_station_routes()
        if single:
            return single[:count]
        graph = self._graph(leg_times_s(self._problem, self._length, self._out, self._into, slowdown=slowdown))
        limit = self._problem.max_handovers
        forth, befores = _distances(graph, self._start_nodes)
        back, afters = _distances(graph, self._end_nodes)
        through = forth + back
        # Lists are quicker to walk along than arrays.
        before, after = befores.tolist(), afters.tolist()
        found: dict[tuple[int, ...], Route] = {}
        seen: set[bytes] = set()
        for node in np.argsort(through, kind="stable")[: MAX_TRIALS * count].tolist():
            if not np.isfinite(through[node]) or len(found) == count:
                break
            path = _walk(before, node)[::-1] + _walk(after, node)[1:]
            sequence = self._sequence(path)
            key = np.array(sequence).tobytes()
            # A station met twice only adds a detour to the path that stays with it.
            if key in seen or len(set(sequence)) < len(sequence) or (limit is not None and len(sequence) > limit + 1):
                continue
            seen.add(key)
            found[sequence] = Route(sequence, float(through[node]))
        if not found and limit is not None:
            path, time = self._shortest_within(graph, limit + 1)
            if path:
                sequence = self._sequence(path)
                found[sequence] = Route(sequence, time)
        return list(found.values())

    def _single_station_routes(self) -> list[Route]:
        both = np.intersect1d(self._sources, self._targets)
        straight = float(np.linalg.norm(self._problem.destination_m - self._problem.start_m))
        time = straight / self._problem.limits.max_speed_m_s
        # The station whose ends lie deepest inside its range first.
        ends = np.stack([self._problem.start_m, self._problem.destination_m])
        reach = np.linalg.norm(ends[:, None] - self._problem.station_positions_m[both], axis=-1).max(axis=0)
        order = np.argsort(reach - self._problem.ranges_m[both], kind="stable")
        return [Route((int(k),), time) for k in both[order]]

    def _graph(self, times: Array) -> csr_array:
        nodes = len(self._points)
        rows = np.concatenate([self._from, self._to])
        columns = np.concatenate([self._to, self._from])
        # A weight of zero would read as no leg.
        return csr_array((np.maximum(np.tile(times, 2), 1e-9), (rows, columns)), shape=(nodes, nodes))

    def _sequence(self, path: list[int]) -> tuple[int, ...]:
        """Stations of the legs between the nodes of ``path``: the one both ends of a leg belong to.

        A leg may bend at a portal where nothing is handed over, to come into the next overlap at a better angle.
        """
        stations = self._stations[path]
        here, there = stations[:-1], stations[1:]
        # (leg, which station of the one end, which of the other)
        same = here[:, :, None] == there[:, None, :]
        shared = np.where(same, here[:, :, None], self._problem.station_count).min(axis=(1, 2))
        return tuple(shared[np.append(True, shared[1:] != shared[:-1])].tolist())

    def fewest(self, most_legs: int, *, slack: float = FEWEST_SLACK, slack_s: float = FEWEST_SLACK_S) -> list[Route]:
        """The best route of every number of legs up to ``most_legs``, fewest first, as far as more legs are faster.

        Routes that are slower than the best one by more than a part ``slack`` and ``slack_s`` are left out.
        """
        single = self._single_station_routes()
        if single:
            return single[:1]
        graph = self._graph(leg_times_s(self._problem, self._length, self._out, self._into))
        through = _distances(graph, self._start_nodes)[0] + _distances(graph, self._end_nodes)[0]
        slowest = float(through.min()) * (1.0 + slack) + slack_s
        kept = np.flatnonzero(through <= slowest)
        number = np.full(len(through), -1)
        number[kept] = np.arange(len(kept))
        starts, ends = (number[nodes][number[nodes] >= 0] for nodes in (self._start_nodes, self._end_nodes))
        routes: dict[tuple[int, ...], Route] = {}
        for path, time in _layered(csr_array(graph[kept][:, kept]), starts, ends, most_legs):
            sequence = self._sequence(kept[path].tolist())
            if time <= slowest and len(set(sequence)) == len(sequence):
                routes.setdefault(sequence, Route(sequence, time))
        return list(routes.values())

    def _shortest_within(self, graph: csr_array, max_legs: int) -> tuple[list[int], float]:
        """The shortest path of at most ``max_legs`` legs; empty when none."""
        found = _layered(graph, self._start_nodes, self._end_nodes, max_legs)
        return found[-1] if found else ([], np.inf)


def _layered(graph: csr_array, sources: Indices, targets: Indices, max_legs: int) -> list[tuple[list[int], float]]:
    """The shortest paths of 1, 2, ... up to ``max_legs`` legs (Bellman and Ford, one layer a leg), each with its time.

    Only those faster than all with fewer legs, so that the last is the best.
    """
    nodes = graph.shape[0]
    starts, rows, weights = graph.indptr, graph.indices, graph.data
    heads = np.flatnonzero(np.diff(starts))
    owner = np.repeat(np.arange(nodes), np.diff(starts))
    distance = np.full(nodes, np.inf)
    distance[sources] = 0.0
    layers: list[Indices] = []
    found: list[tuple[list[int], float]] = []
    reached = np.inf
    for _ in range(max_legs if len(rows) and len(targets) else 0):
        # The graph is symmetric: its rows list the legs into a node as well as those out of it.
        through = distance[rows] + weights
        best = np.full(nodes, np.inf)
        best[heads] = np.minimum.reduceat(through, starts[heads])
        hit = np.flatnonzero(through == best[owner])[::-1]
        source = np.full(nodes, -1)
        source[owner[hit]] = rows[hit]
        better = best < distance
        if not better.any():
            break
        layers.append(np.where(better, source, -1))
        distance = np.where(better, best, distance)
        end = int(targets[np.argmin(distance[targets])])
        if distance[end] < reached:
            reached = float(distance[end])
            path = [end]
            for before in reversed(layers):
                if before[path[-1]] >= 0:
                    path.append(int(before[path[-1]]))
            found.append((path[::-1], reached))
    return found


def legs_of(pairs: Indices) -> float:
    """About how many legs a graph of these pairs of stations has with one portal a chord."""
    counts = np.bincount(pairs.ravel()).astype(float)
    return float((counts * counts).sum()) / 2.0


def _distances(graph: csr_array, sources: Indices) -> tuple[Array, Indices]:
    distance, before, _ = dijkstra(graph, directed=True, indices=sources, return_predecessors=True, min_only=True)
    return distance, before


def _walk(before: list[int], node: int) -> list[int]:
    path = [node]
    while before[path[-1]] >= 0:
        path.append(int(before[path[-1]]))
    return path
