"""The upper level: which stations, in which order. Several sequences, best expected first.

Where a handover costs nothing (no minimum overlap, no minimum tenure) the best corridor holds the shortest path
through the union of ranges, so the sequence is read off that path: as few stations as cover it. Where handovers cost
time, and for further sequences to compare with, the portal graph prices every leg.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from planner.arrays import Array, Indices
from planner.coverage.chord import leg_times_s
from planner.coverage.disc import covering_stations, disc_radius_m
from planner.coverage.overlap import MIN_OVERLAP_M, AdjacentPairs, adjacent_pairs, overlap_depth_m
from planner.errors import InfeasibleError
from planner.infeasibility.diagnosis import diagnose
from planner.problem import Problem
from planner.routing.bound import LowerBound, graph_with_ends, lower_bound
from planner.routing.portal_graph import CHORD_FRACTIONS, MAX_LEGS, PortalGraph, Route, legs_of

__all__ = [
    "MIN_OVERLAP_M",
    "Route",
    "candidate_routes",
    "geodesic_route",
    "geodesic_sequence",
    "is_chain",
    "routes_and_fewest",
    "select_stations",
]

# Above this many pairs of stations that meet, a coarse graph first leaves out stations far from any good path.
MAX_PAIRS = 3_000
# How much slower than the best a chain of masts may be for its stations to stay: a part of it, and seconds.
COARSE_SLACK, COARSE_SLACK_S = 0.01, 15.0
# Stations on a path whose onward handovers are looked for together.
_BLOCK = 256
# The same for a route over the middles of chords, for its chords to get all their portals, and legs between these.
FINE_SLACK, FINE_SLACK_S = 0.003, 3.0
FINE_LEGS = 1_000_000
# At least so many stations are kept, however densely they overlap.
MIN_STATIONS = 100


def candidate_routes(problem: Problem, count: int = 1, *, bound: LowerBound | None = None) -> list[Route]:
    """Up to ``count`` different station sequences worth planning, best expected first; never empty.

    Raises `InfeasibleError` when no sequence exists.
    """
    routes: list[Route] = []
    if not problem.handovers_cost_time:
        route = geodesic_route(problem, lower_bound(problem) if bound is None else bound)
        if route is not None:
            routes.append(route)
    if len(routes) < count:
        known = {route.sequence for route in routes}
        stations, graph = _graph(problem)
        for route in graph.routes(count):
            sequence = tuple(int(stations[k]) for k in route.sequence)
            if sequence not in known:
                routes.append(Route(sequence, route.estimate_s))
    if not routes:
        infeasibility = diagnose(problem)
        if infeasibility is not None:
            raise InfeasibleError(infeasibility)
        raise AssertionError("the ranges chain together, but no route was found")
    return routes[:count]


def routes_and_fewest(problem: Problem, count: int) -> tuple[list[Route], list[Route]]:
    """Up to ``count`` routes, best expected first, and the best ones with fewer handovers than the best of these.

    Of the latter one for every number of handovers, fewest first. Both from one graph; empty where there is no route.
    """
    stations, graph = _graph(problem)

    def named(routes: list[Route]) -> list[Route]:
        return [Route(tuple(int(stations[k]) for k in route.sequence), route.estimate_s) for route in routes]

    routes = graph.routes(count)
    longest = max((len(route.sequence) for route in routes), default=0)
    most = longest if problem.max_handovers is None else min(longest, problem.max_handovers + 1)
    return named(routes), named(graph.fewest(most))


def is_chain(problem: Problem, sequence: Sequence[int]) -> bool:
    """True when the ends lie in the first and last range and every two neighbours share an overlap."""
    stations = np.asarray(sequence, dtype=np.int64)
    if stations[0] not in covering_stations(problem, problem.start_m):
        return False
    if stations[-1] not in covering_stations(problem, problem.destination_m):
        return False
    return bool((overlap_depth_m(problem, stations[:-1], stations[1:]) >= MIN_OVERLAP_M).all())


def geodesic_route(problem: Problem, bound: LowerBound) -> Route | None:
    """The stations along the bound's path: a chain, so that there is a plan as far as ranges, band and handovers go.

    None where the path is not known, the problem's own ranges leave a gap in it, an end lies outside the altitude band
    or the stations are more than allowed.
    """
    if bound.path_m is None or not problem.ends_in_band():
        return None
    sequence = geodesic_sequence(problem, bound.path_m)
    if sequence is None or (problem.max_handovers is not None and len(sequence) > problem.max_handovers + 1):
        return None
    return Route(sequence, bound.length_m / problem.limits.max_speed_m_s)


def geodesic_sequence(problem: Problem, path_m: Array) -> tuple[int, ...] | None:
    """The fewest stations whose ranges cover a path ``(k, 2)`` seen from above, in order.

    Of equally few, those whose spans along the path overlap most. None when the ranges of the problem itself (which
    may be smaller than the ones the path was found in) or the antennas' heights leave a gap.
    """
    both = np.intersect1d(
        covering_stations(problem, problem.start_m), covering_stations(problem, problem.destination_m)
    )
    if len(both):
        deepest = [float(problem.ranges_m[k] - _farthest_end(problem, k)) for k in both]
        return (int(both[int(np.argmax(deepest))]),)
    radii = disc_radius_m(problem, np.arange(problem.station_count), problem.disc_plane_m())
    enter, leave = _spans(path_m, problem.station_positions_m[:, :2], radii)
    on_path = np.flatnonzero(leave > enter)
    if not len(on_path):
        return None
    near = select_stations(problem, on_path)
    length = float(np.linalg.norm(np.diff(path_m, axis=0), axis=1).sum())
    # At a corner two ranges meet in one point, which the mesh knows up to rounding: spans may just miss each other.
    for slack in (1e-6, 1e-3, 1.0):
        sequence = _fewest(near, enter[on_path], leave[on_path], length, slack)
        if sequence is not None:
            return tuple(int(on_path[k]) for k in sequence)
    return None


def _spans(path_m: Array, centres: Array, radii: Array) -> tuple[Array, Array]:
    """Where along the path ``(k, 2)`` it enters and leaves each disc (one span: shortest paths do not come back)."""
    enter, leave = np.full(len(radii), np.inf), np.full(len(radii), -np.inf)
    tree = cKDTree(centres)
    widest = float(radii.max())
    travelled = 0.0
    for a, b in pairwise(path_m):
        length = float(np.linalg.norm(b - a))
        if length == 0.0:
            continue
        unit = (b - a) / length
        reach = (0.5 * length + widest) * (1.0 + 1e-9)
        near = np.array(tree.query_ball_point(0.5 * (a + b), reach, return_sorted=True), dtype=np.int64)
        offset = centres[near] - a
        middle = offset @ unit
        square = radii[near] ** 2 - ((offset**2).sum(axis=1) - middle**2)
        half = np.sqrt(np.maximum(square, 0.0))
        low, high = np.maximum(middle - half, 0.0), np.minimum(middle + half, length)
        hit = (square >= 0.0) & (low <= high)
        met = near[hit]
        enter[met] = np.minimum(enter[met], travelled + low[hit])
        leave[met] = np.maximum(leave[met], travelled + high[hit])
        travelled += length
    return enter, leave


def _fewest(problem: Problem, enter: Array, leave: Array, length: float, slack: float) -> tuple[int, ...] | None:
    sources = set(covering_stations(problem, problem.start_m).tolist())
    targets = set(covering_stations(problem, problem.destination_m).tolist())
    # Least (legs, sum of how thin the handovers are) to reach each span. A handover leads to a span that ends later, so
    # spans met in order of their ends are final when met.
    order = np.argsort(leave, kind="stable")
    cost = {k: (1, 0.0) for k in order.tolist() if k in sources and enter[k] <= slack}
    before: dict[int, int] = {}
    for k, nexts in _onward(problem, order, enter, leave + slack):
        if k not in cost:
            continue
        for m in nexts:
            overlap = max(float(leave[k] - enter[m]), 0.0)
            onward = (cost[k][0] + 1, cost[k][1] + 1.0 / (1.0 + overlap))
            if m not in cost or onward < cost[m]:
                cost[m] = onward
                before[m] = k
    ends = [k for k in order.tolist() if k in cost and k in targets and leave[k] >= length - slack]
    if not ends:
        return None
    path = [min(ends, key=lambda k: (cost[k], k))]
    while path[-1] in before:
        path.append(before[path[-1]])
    return tuple(path[::-1])


def _onward(problem: Problem, order: Indices, enter: Array, leave: Array) -> Iterator[tuple[int, list[int]]]:
    """Every station of ``order`` and the later ones that it can hand over to: entered before it is left."""
    for begin in range(0, len(order), _BLOCK):
        block = order[begin : begin + _BLOCK]
        later = np.arange(len(order)) > np.arange(begin, begin + len(block))[:, None]
        first, second = np.nonzero(later & (enter[order] <= leave[block][:, None]))
        met = overlap_depth_m(problem, block[first], order[second]) >= MIN_OVERLAP_M
        first, second = first[met], second[met]
        edges = np.searchsorted(first, np.arange(len(block) + 1))
        for row, k in enumerate(block.tolist()):
            yield k, order[second[edges[row] : edges[row + 1]]].tolist()


def _farthest_end(problem: Problem, station: int) -> float:
    ends = np.stack([problem.start_m, problem.destination_m])
    return float(np.linalg.norm(ends - problem.station_positions_m[station], axis=1).max())


def _graph(problem: Problem) -> tuple[Indices, PortalGraph]:
    """The portal graph, and the stations of the problem its indices stand for."""
    adjacent = _without_covered(problem, adjacent_pairs(problem))
    stations = np.arange(problem.station_count)
    if len(adjacent.pairs) <= MAX_PAIRS:
        return stations, PortalGraph(problem, adjacent.pairs)
    stations = _stations_worth_a_look(problem, adjacent)
    number = np.full(problem.station_count, -1)
    number[stations] = np.arange(len(stations))
    pairs = number[adjacent.pairs]
    pairs = pairs[(pairs >= 0).all(axis=1)]
    near = select_stations(problem, stations)
    if problem.max_handovers is None:
        pairs = _pairs_worth_all_portals(near, pairs)
    return stations, PortalGraph(near, pairs)


def _without_covered(problem: Problem, adjacent: AdjacentPairs) -> AdjacentPairs:
    """Without the pairs of stations whose range lies inside another one's, such as the weaker sectors of one mast.

    Whatever such a station covers the other one covers too, so that handing over to it is never needed. Of equal
    ranges the first stays.
    """
    first, second = adjacent.pairs[:, 0], adjacent.pairs[:, 1]
    at, ranges, mask = problem.station_positions_m, problem.ranges_m, problem.min_elevation_deg
    apart = np.linalg.norm(at[first] - at[second], axis=1)
    lowest = np.zeros(len(ranges)) if mask is None else mask

    def covers(wide: Indices, narrow: Indices, *, ties: bool) -> Indices:
        within = apart + ranges[narrow] <= ranges[wide]
        hears = (lowest[wide] <= lowest[narrow]) & ((apart == 0.0) | (mask is None) | (lowest[wide] < 0.0))
        same = (apart == 0.0) & (ranges[narrow] == ranges[wide]) & (lowest[narrow] == lowest[wide])
        return np.asarray(narrow[within & hears & (~same | ties)])

    covered = np.zeros(problem.station_count, dtype=bool)
    covered[covers(first, second, ties=True)] = True
    covered[covers(second, first, ties=False)] = True
    kept = ~(covered[first] | covered[second])
    return AdjacentPairs(adjacent.pairs[kept], adjacent.depths_m[kept]) if covered.any() else adjacent


def _pairs_worth_all_portals(problem: Problem, pairs: Indices) -> Indices:
    """Pairs whose chords lie on a route over the middles of chords that is not much slower than the fastest."""
    times_s = PortalGraph(problem, pairs, portals=1).fastest_through_s()
    order = np.argsort(times_s, kind="stable")
    least_s = float(times_s[order[0]]) if len(order) else np.inf
    if not np.isfinite(least_s):
        return pairs
    fewest, most = 0, int(np.searchsorted(times_s[order], least_s * (1.0 + FINE_SLACK) + FINE_SLACK_S, side="right"))
    while most - fewest > 1:
        middle = (fewest + most) // 2
        if legs_of(pairs[order[:middle]]) * max(CHORD_FRACTIONS) ** 2 <= FINE_LEGS:
            fewest = middle
        else:
            most = middle
    return pairs[np.sort(order[:most])]


def _stations_worth_a_look(problem: Problem, adjacent: AdjacentPairs) -> Indices:
    """Stations near the fastest chain from mast to mast, priced by its overlaps' depth; as many as can be managed.

    A path through portals is shorter than one through masts, but both go the same way.
    """
    count = problem.station_count
    first, second = adjacent.pairs[:, 0], adjacent.pairs[:, 1]
    masts = problem.station_positions_m[:, :2]
    apart = np.linalg.norm(masts[first] - masts[second], axis=1)
    half = 0.5 * adjacent.depths_m
    ends = []
    for end in (problem.start_m, problem.destination_m):
        inside = covering_stations(problem, end)
        ends.append((inside, np.linalg.norm(masts[inside] - end[:2], axis=1) / problem.limits.max_speed_m_s))
    graph = graph_with_ends(count, adjacent.pairs, leg_times_s(problem, apart, half, half), ends)
    there, back = dijkstra(graph, directed=False, indices=[count, count + 1])[:, :count]
    through = there + back
    order = np.argsort(through, kind="stable")
    near = order[through[order] <= through[order[0]] * (1.0 + COARSE_SLACK) + COARSE_SLACK_S]
    degree = np.bincount(adjacent.pairs.ravel(), minlength=count).astype(float)
    manageable = int(np.searchsorted(np.cumsum(0.5 * degree[near] ** 2), MAX_LEGS, side="right"))
    return np.sort(near[: max(manageable, MIN_STATIONS)])


def select_stations(problem: Problem, stations: Indices) -> Problem:
    """The same problem with only ``stations`` (indices) in it; theirs become 0, 1, ..."""
    return replace(
        problem,
        station_positions_m=problem.station_positions_m[stations],
        ranges_m=problem.ranges_m[stations],
        bound_ranges_m=None if problem.bound_ranges_m is None else problem.bound_ranges_m[stations],
        min_elevation_deg=None if problem.min_elevation_deg is None else problem.min_elevation_deg[stations],
    )
