"""Why a chain of ranges is broken: what is wrong with them, and the one station to change.

A vehicle can hover in every overlap of a chain of ranges, so where the ends lie in range and a chain links them there
is always a plan. What is told when there is none stands here; remedies of other kinds are sought in
`planner.infeasibility.alternatives`.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree
from scipy.spatial import Delaunay, QhullError, cKDTree

from planner.arrays import Array, Flags, Indices
from planner.coverage.disc import covering_stations, range_to_meet_m, usable_stations
from planner.coverage.overlap import MIN_OVERLAP_M, AdjacentPairs, adjacent_pairs, overlap_depth_m, overlap_point_m
from planner.errors import Infeasibility
from planner.problem import UNMASKED_DEG, Problem
from planner.remedy import End, LowerElevation, RaiseLimit, RaiseRange, SetAltitude

# A broken chain is explained from all pairs up to so many stations, from so many pairs at most above.
ALL_PAIRS_STATIONS = 1_000
MAX_PAIRS = 2_000_000
# Stations considered for one larger range, and neighbours each is measured against.
SHORTLIST = 64


def diagnose(problem: Problem) -> Infeasibility | None:
    """Why no trajectory exists, or None when the ranges chain together and the ends lie inside them.

    Looked for in this order: an end outside the altitude band, an end outside every range, a chain that is broken
    (its widest gap as narrow as any chain has it), more handovers than allowed. None is a promise: a vehicle can
    then always stop and hover in every overlap on its way.
    """
    ends: tuple[tuple[End, Array], ...] = (("start", problem.start_m), ("destination", problem.destination_m))
    for name, position in ends:
        fault = altitude_fault(problem, name, position) or _cover_fault(problem, name, position)
        if fault is not None:
            return fault
    sources = covering_stations(problem, problem.start_m)
    targets = covering_stations(problem, problem.destination_m)
    if len(np.intersect1d(sources, targets)):
        return None
    adjacent = adjacent_pairs(problem)
    labels = connected_components(_graph(problem.station_count, adjacent.pairs), directed=False)[1]
    if not len(np.intersect1d(labels[sources], labels[targets])):
        return _broken_chain(problem, sources, targets, labels)
    return _handover_fault(problem, sources, targets, adjacent)


def altitude_fault(problem: Problem, name: End, position: Array) -> Infeasibility | None:
    """That an end lies outside the altitude band, with the nearest altitude inside; None when it does not."""
    limits, altitude = problem.limits, float(position[2])
    nearest = min(max(altitude, limits.min_alt_m), limits.max_alt_m)
    if nearest == altitude:
        return None
    return Infeasibility(
        reason=f"{name}_altitude",
        message=(
            f"the {name} at altitude {altitude:.2f} m is outside the band {limits.min_alt_m:.2f} to "
            f"{limits.max_alt_m:.2f} m; move it to {nearest:.2f} m"
        ),
        gap_m=abs(altitude - nearest),
        position_m=_point(position),
        remedies=((SetAltitude(name, nearest, nearest - altitude),),),
    )


def _cover_fault(problem: Problem, name: str, position: Array) -> Infeasibility | None:
    if len(covering_stations(problem, position)):
        return None
    inside = problem.covers(position)
    if len(inside):
        return _elevation_fault(problem, name, position, inside)
    missing = np.linalg.norm(problem.station_positions_m - position, axis=1) - problem.ranges_m
    nearest = int(np.argmin(missing))
    gap = float(max(missing[nearest], 0.0))
    # The last digit of the sum must not fall short of the distance.
    by = gap + 1e-9 * float(problem.ranges_m[nearest] + gap)
    message = (
        f"the {name} is out of range of every station: the nearest, station {nearest}, misses it by {gap:.3f} m; "
        f"raise its range by {by:.3f} m or move the {name}"
    )
    remedy = (RaiseRange(nearest, by),)
    return Infeasibility(f"{name}_uncovered", message, (nearest,), gap, _point(position), (remedy,))


def _elevation_fault(problem: Problem, name: str, position: Array, inside: Indices) -> Infeasibility:
    """An end in range of stations ``inside``, all of which see it too low: the one that misses it least."""
    assert problem.min_elevation_deg is not None
    offset = position - problem.station_positions_m[inside]
    seen = np.degrees(np.arctan2(offset[:, 2], np.linalg.norm(offset[:, :2], axis=-1)))
    best = int(np.argmin(problem.min_elevation_deg[inside] - seen))
    station, angle = int(inside[best]), float(seen[best])
    lowest = float(problem.min_elevation_deg[station])
    # Below the antenna's horizon no limit will do but none.
    to = angle * (1.0 - 1e-9) if angle > 0.0 else UNMASKED_DEG
    return Infeasibility(
        f"{name}_uncovered",
        f"the {name} is in range of station {station}, which sees it at an elevation of {angle:.3f} degrees and hears "
        f"nothing below {lowest:.3f} degrees",
        (station,),
        0.0,
        _point(position),
        ((LowerElevation(station, to, lowest - to),),),
    )


def _handover_fault(
    problem: Problem, sources: Indices, targets: Indices, adjacent: AdjacentPairs
) -> Infeasibility | None:
    if problem.max_handovers is None:
        return None
    count = problem.station_count
    ends = np.concatenate([np.stack([np.full(len(e), node), e], axis=1) for node, e in ((count, sources),)])
    order, before = breadth_first_order(
        _graph(count + 1, np.concatenate([adjacent.pairs, ends])), count, directed=False, return_predecessors=True
    )
    hops = np.full(count + 1, np.inf)
    hops[count] = 0
    for node in order[1:]:
        hops[node] = hops[before[node]] + 1
    fewest = int(hops[targets].min()) - 1
    if fewest <= problem.max_handovers:
        return None
    return Infeasibility(
        "limits",
        f"at least {fewest} handover{'' if fewest == 1 else 's'} are needed and {problem.max_handovers} allowed",
        remedies=((RaiseLimit("max_handovers", fewest),),),
    )


def broken_pair(problem: Problem, i: int, j: int) -> Infeasibility:
    """That stations ``i`` and ``j`` cannot hand over to each other, for a sequence that asks them to."""
    depth = float(overlap_depth_m(problem, i, j))
    return Infeasibility(
        "broken_chain",
        f"the station sequence hands over from station {i} to station {j}, whose ranges {_apart(depth)}",
        (i, j),
        max(-depth, 0.0),
        _point(overlap_point_m(problem, i, j)),
    )


def _apart(depth_m: float) -> str:
    if depth_m < 0.0:
        return f"are {-depth_m:.3f} m apart inside the altitude band"
    return f"meet in an overlap of less than {1000.0 * MIN_OVERLAP_M:.0f} mm inside the altitude band"


def _broken_chain(problem: Problem, sources: Indices, targets: Indices, labels: Indices) -> Infeasibility:
    chain = _narrowest_chain(problem, sources, targets)
    depths = overlap_depth_m(problem, chain[:-1], chain[1:])
    worst = int(np.argmin(depths))
    first, second = int(chain[worst]), int(chain[worst + 1])
    gap = max(-float(depths[worst]), 0.0)
    broken = int(np.count_nonzero(depths < MIN_OVERLAP_M))
    others = f" (and {broken - 1} narrower gaps on the same chain)" if broken > 1 else ""
    raises = _chain_raises(problem, chain, depths)
    single = _smallest_raise(problem, np.isin(labels, labels[sources]), np.isin(labels, labels[targets]))
    # One station raised a long way, or several a little: what asks for the fewest metres in all.
    if single is not None and (not raises or single[1] <= sum(by for _, by in raises)):
        raises = [single]
    remedy = "; raise the range of " + " and ".join(f"station {k} by {by:.3f} m" for k, by in raises) if raises else ""
    return Infeasibility(
        "broken_chain",
        f"no chain of ranges links start and destination: in the best one the ranges of stations {first} and {second} "
        f"{_apart(float(depths[worst]))}{others}{remedy}",
        (first, second),
        gap,
        _point(overlap_point_m(problem, first, second)),
        (tuple(RaiseRange(station, by) for station, by in raises),) if raises else (),
    )


def _narrowest_chain(problem: Problem, sources: Indices, targets: Indices) -> Indices:
    """Stations from a source to a target along which the widest gap is least: a path in the spanning tree of gaps.

    Exact but on maps of thousands of stations with gaps so wide that the pairs across them cannot be listed; there
    the chain is the best among neighbours of the Delaunay triangulation.
    """
    usable = np.flatnonzero(usable_stations(problem))
    if len(usable) <= ALL_PAIRS_STATIONS:
        first, second = np.triu_indices(len(usable), 1)
        return _chain_among(problem, np.stack([usable[first], usable[second]], axis=1), sources, targets)
    rough = np.concatenate([adjacent_pairs(problem).pairs, _delaunay_pairs(problem, usable)])
    chain = _chain_among(problem, np.unique(rough, axis=0), sources, targets)
    widest = max(-float(overlap_depth_m(problem, chain[:-1], chain[1:]).min()), 0.0)
    tree = cKDTree(problem.station_positions_m[usable, :2])
    within = 2.0 * float(problem.ranges_m[usable].max()) + widest
    if tree.count_neighbors(tree, within) > 2 * MAX_PAIRS:
        return chain
    near = adjacent_pairs(problem, min_depth_m=-widest * (1.0 + 1e-9) - MIN_OVERLAP_M)
    return _chain_among(problem, near.pairs, sources, targets)


def route_pairs(problem: Problem, usable: Indices) -> Indices:
    """Pairs ``(E, 2)`` of the stations ``usable`` a best route is sought among: all, or on large maps neighbours."""
    if len(usable) <= ALL_PAIRS_STATIONS:
        first, second = np.triu_indices(len(usable), 1)
        return np.stack([usable[first], usable[second]], axis=1)
    near = np.concatenate([adjacent_pairs(problem).pairs, _delaunay_pairs(problem, usable)])
    return np.asarray(np.unique(near, axis=0))


def _chain_among(problem: Problem, pairs: Indices, sources: Indices, targets: Indices) -> Indices:
    count = problem.station_count
    ends = [[count, s] for s in sources] + [[count + 1, t] for t in targets]
    depths = overlap_depth_m(problem, pairs[:, 0], pairs[:, 1])
    # The graph routines read a weight of zero as no edge: everything is shifted by one.
    gaps = np.concatenate([1.0 + np.maximum(MIN_OVERLAP_M - depths, 0.0), np.ones(len(ends))])
    tree = minimum_spanning_tree(_graph(count + 2, np.concatenate([pairs, np.array(ends)]), gaps))
    _, before = breadth_first_order(tree, count, directed=False, return_predecessors=True)
    path = [int(before[count + 1])]
    while before[path[-1]] != count:
        path.append(int(before[path[-1]]))
    return np.array(path[::-1], dtype=np.int64)


def _delaunay_pairs(problem: Problem, stations: Indices) -> Indices:
    """Neighbours in the Delaunay triangulation of ``stations``, or along their line when they stand in one."""
    ground = problem.station_positions_m[stations, :2]
    try:
        corners = Delaunay(ground - ground.mean(axis=0)).simplices
    except QhullError:
        order = np.lexsort((ground[:, 1], ground[:, 0]))
        corners = np.stack([order[:-1], order[1:], order[1:]], axis=1)
    edges = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [0, 2]]])
    # Stations that share a place with another are no corner of their own; that other one is their neighbour.
    _, first, place = np.unique(ground, axis=0, return_index=True, return_inverse=True)
    edges = np.concatenate([edges, np.stack([np.arange(len(stations)), first[place.ravel()]], axis=1)])
    edges = np.sort(stations[edges[edges[:, 0] != edges[:, 1]]], axis=1)
    return np.asarray(np.unique(edges, axis=0))


def _chain_raises(problem: Problem, chain: Indices, depths_m: Array) -> list[tuple[int, float]]:
    """Stations of ``chain`` and the metres of range that close its gaps, widest gap first; empty when none can."""
    raises: dict[int, float] = {}
    for k in np.argsort(depths_m, kind="stable"):
        if depths_m[k] >= MIN_OVERLAP_M:
            continue
        ends = chain[k : k + 2]
        by = range_to_meet_m(problem, ends, ends[::-1], MIN_OVERLAP_M) - problem.ranges_m[ends]
        side = int(np.argmin(by))
        if not np.isfinite(by[side]):
            return []
        pad = 1e-9 * float(problem.ranges_m[ends[side]] + by[side])
        raises[int(ends[side])] = max(raises.get(int(ends[side]), 0.0), float(by[side]) + pad)
    return list(raises.items())


def _smallest_raise(problem: Problem, near_start: Flags, near_end: Flags) -> tuple[int, float] | None:
    """The one station whose range, raised least, touches both connected parts of the graph, and by how much."""
    usable = np.flatnonzero(usable_stations(problem))
    sides = [np.flatnonzero(side) for side in (near_start, near_end)]
    trees = [cKDTree(problem.station_positions_m[others, :2]) for others in sides]

    def nearest(stations: Indices, side: int, how_many: int) -> Indices:
        _, found = trees[side].query(
            problem.station_positions_m[stations, :2], k=np.arange(1, min(how_many, len(sides[side])) + 1)
        )
        return np.asarray(sides[side][found])

    # Gaps to the nearest few of either side rank the stations; the best of them are measured.
    gaps = np.zeros(len(usable))
    for side, inside in enumerate((near_start, near_end)):
        others = nearest(usable, side, 4)
        gap = -overlap_depth_m(problem, np.broadcast_to(usable[:, None], others.shape), others).max(axis=1)
        gaps = np.maximum(gaps, np.where(inside[usable], 0.0, gap))
    best_station, best = -1, np.inf
    for station in usable[np.argsort(gaps, kind="stable")[:SHORTLIST]]:
        raise_m = 0.0
        for side, inside in enumerate((near_start, near_end)):
            if not inside[station]:
                others = nearest(np.array([station]), side, SHORTLIST)[0]
                reach = range_to_meet_m(problem, np.full(len(others), station), others, MIN_OVERLAP_M).min()
                raise_m = max(raise_m, float(reach) - float(problem.ranges_m[station]))
        if raise_m < best:
            best_station, best = int(station), raise_m
    if not np.isfinite(best):
        return None
    by = best + 1e-9 * float(problem.ranges_m[best_station] + best)
    return best_station, by


def _graph(count: int, pairs: Indices, weights: Array | None = None) -> csr_array:
    values = np.ones(len(pairs)) if weights is None else weights
    return csr_array((values, (pairs[:, 0], pairs[:, 1])), shape=(count, count))


def _point(position: Array) -> tuple[float, float, float]:
    return float(position[0]), float(position[1]), float(position[2])
