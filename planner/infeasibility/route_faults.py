"""Everything wrong along the best route, in flight order, each with what would mend it alone.

The best route asks for the fewest metres of missing range, and is no long way round for them: a path in the graph of
stations whose edges cost the gap between two ranges, a fixed price where only an elevation mask stands between them,
and a small part of the way itself.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from planner.arrays import Array, Indices
from planner.coverage.disc import covering_stations, range_to_meet_m
from planner.coverage.overlap import MIN_OVERLAP_M, overlap_depth_m, overlap_point_m, usable_stations
from planner.errors import Infeasibility
from planner.infeasibility.application import remedied
from planner.infeasibility.diagnosis import altitude_fault, diagnose, route_pairs
from planner.problem import UNMASKED_DEG, Problem
from planner.remedy import Change, End, LowerElevation, RaiseRange, Remedy

# Metres of missing range that a metre of the way is worth, and a mask in the way.
WAY_PRICE = 0.25
MASK_PRICE_M = 50.0
# And a metre of missing range where masks alone are at fault.
FAULTLESS_PRICE = 1_000.0
# A mask is lowered to this many halvings.
MASK_BISECTIONS = 30


@dataclass(frozen=True)
class _Link:
    """A step of the route that may be broken: an end and its station, or two stations that hand over."""

    stations: tuple[int, ...]
    end: End | None = None

    def point_m(self, problem: Problem) -> Array:
        if self.end is not None:
            return problem.start_m if self.end == "start" else problem.destination_m
        return overlap_point_m(problem, *self.stations)

    def holds(self, problem: Problem) -> bool:
        if self.end is not None:
            return self.stations[0] in covering_stations(problem, self.point_m(problem))
        return bool(overlap_depth_m(problem, *self.stations) >= MIN_OVERLAP_M)


@dataclass(frozen=True)
class RouteFaults:
    """What is wrong on the best route, in flight order, each with what mends it (masks named before it lowered); and
    one remedy for all of it, empty where there is none.
    """

    faults: tuple[Infeasibility, ...] = ()
    cure: Remedy = ()


def route_faults(problem: Problem) -> RouteFaults:
    """What is wrong with altitudes, ranges and masks on the best route; no faults when nothing is."""
    ends: tuple[tuple[End, Array], ...] = (("start", problem.start_m), ("destination", problem.destination_m))
    tilted = {end: fault for end, at in ends if (fault := altitude_fault(problem, end, at)) is not None}
    levelled = tuple(change for fault in tilted.values() for change in fault.remedies[0])
    problem = remedied(problem, levelled)
    broken = [link for link in _route(problem) if not link.holds(problem)]
    links: list[Infeasibility] = []
    seen = problem
    for link in broken:
        # A mask that is in the way twice is told once.
        if not link.holds(seen):
            links.append(_link_fault(seen, link))
            changes = [change for remedy in links[-1].remedies for change in remedy]
            seen = remedied(seen, tuple(change for change in changes if isinstance(change, LowerElevation)))
    faults = [tilted.get("start"), *links, tilted.get("destination")]
    told = tuple(fault for fault in faults if fault is not None)
    cured = _cure(problem, broken)
    return RouteFaults(told, merged((*levelled, *cured)) if cured is not None else ())


def _cure(problem: Problem, broken: list[_Link]) -> list[Change] | None:
    """What mends every broken link, one after the other: ends first, then the widest gaps; None when one has none."""
    changes: list[Change] = []
    gaps = {link: -1.0 if link.end else float(overlap_depth_m(unmasked(problem), *link.stations)) for link in broken}
    for link in sorted(broken, key=lambda link: (link.end is None, gaps[link])):
        if not link.holds(problem):
            fault = _link_fault(problem, link)
            if not fault.remedies:
                return None
            changes += fault.remedies[0]
            problem = remedied(problem, fault.remedies[0])
    return changes


def merged(changes: Sequence[Change]) -> Remedy:
    """Changes carried out one after the other, those of one station's range or mask made one."""
    kept: dict[tuple[object, ...], Change] = {}
    for k, change in enumerate(changes):
        key: tuple[object, ...] = (k,)
        if isinstance(change, RaiseRange | LowerElevation):
            key = (type(change), change.station)
            before = kept.get(key)
            if isinstance(before, RaiseRange | LowerElevation):
                change = replace(change, **_added(before, change))
        kept[key] = change
    return tuple(kept.values())


def _added(before: RaiseRange | LowerElevation, change: RaiseRange | LowerElevation) -> dict[str, Any]:
    if isinstance(before, RaiseRange) and isinstance(change, RaiseRange):
        return {"by_m": before.by_m + change.by_m}
    assert isinstance(before, LowerElevation)
    assert isinstance(change, LowerElevation)
    return {"by_deg": before.by_deg + change.by_deg}


def unmasked(problem: Problem) -> Problem:
    """The problem without elevation masks."""
    return replace(problem, min_elevation_deg=None)


def _route(problem: Problem) -> list[_Link]:
    """The links of the best route; empty where no station reaches the band at all."""
    bare, count = unmasked(problem), problem.station_count
    usable = np.flatnonzero(usable_stations(bare))
    if not len(usable):
        return []
    pairs = route_pairs(bare, usable)
    # Where masks alone are at fault no range is asked to be larger.
    price = FAULTLESS_PRICE if problem.min_elevation_deg is not None and diagnose(bare) is None else 1.0
    ways = _way_m(problem, pairs[:, 0], problem.station_positions_m[pairs[:, 1]])
    costs = [price * _gap_m(bare, pairs) + _masked_m(problem, pairs) + ways]
    edges = [pairs]
    for node, point in ((count, problem.start_m), (count + 1, problem.destination_m)):
        missing = np.linalg.norm(bare.station_positions_m[usable] - point, axis=1) - bare.ranges_m[usable]
        masked = (missing <= 0.0) & ~np.isin(usable, covering_stations(problem, point))
        edges.append(np.stack([np.full(len(usable), node), usable], axis=1))
        costs.append(price * np.maximum(missing, 0.0) + MASK_PRICE_M * masked + _way_m(problem, usable, point))
    row, column = np.concatenate(edges).T
    # The graph routines read a weight of zero as no edge.
    graph = csr_array((np.concatenate(costs) + 1e-6, (row, column)), shape=(count + 2, count + 2))
    distance, before = dijkstra(graph, directed=False, indices=count, return_predecessors=True)
    if not np.isfinite(distance[count + 1]):
        return []
    path = [int(before[count + 1])]
    while before[path[-1]] != count:
        path.append(int(before[path[-1]]))
    path.reverse()
    between = [_Link((i, j)) for i, j in itertools.pairwise(path)]
    return [_Link((path[0],), "start"), *between, _Link((path[-1],), "destination")]


def _way_m(problem: Problem, stations: Indices, to_m: Array) -> Array:
    return np.asarray(WAY_PRICE * np.linalg.norm((problem.station_positions_m[stations] - to_m)[..., :2], axis=-1))


def _gap_m(bare: Problem, pairs: Indices) -> Array:
    """Missing range between two stations, masks left aside."""
    return np.asarray(np.maximum(MIN_OVERLAP_M - overlap_depth_m(bare, pairs[:, 0], pairs[:, 1]), 0.0))


def _masked_m(problem: Problem, pairs: Indices) -> Array:
    """The price of a mask between two stations."""
    if problem.min_elevation_deg is None:
        return np.zeros(len(pairs))
    return np.asarray(MASK_PRICE_M * (overlap_depth_m(problem, pairs[:, 0], pairs[:, 1]) < MIN_OVERLAP_M))


def _link_fault(problem: Problem, link: _Link) -> Infeasibility:
    """What is wrong with a link that does not hold."""
    changes: list[Change] = []
    gap, words = _raise(problem, link, changes)
    masked: tuple[int, ...] = ()
    ranged = remedied(problem, tuple(changes))
    if not link.holds(ranged):
        lowered = _lowered(ranged, link)
        masked = tuple(change.station for change in lowered)
        changes += lowered
    mended = link.holds(remedied(problem, tuple(changes)))
    if masked and gap == 0.0:
        words += f"; only the lowest elevation of station {' and '.join(map(str, masked))} stands in the way"
    return Infeasibility(
        "broken_chain" if link.end is None else f"{link.end}_uncovered",
        words,
        link.stations,
        gap,
        _point(link.point_m(problem)),
        (tuple(changes),) if changes and mended else (),
        masked=masked if gap == 0.0 else (),
    )


def _raise(problem: Problem, link: _Link, changes: list[Change]) -> tuple[float, str]:
    """Adds the range that is missing, masks left aside; the gap, and words for it."""
    bare = unmasked(problem)
    if link.end is not None:
        (station,) = link.stations
        offset = problem.station_positions_m[station] - link.point_m(problem)
        missing = float(np.linalg.norm(offset) - problem.ranges_m[station])
        if missing <= 0.0:
            return 0.0, f"the {link.end} is in range of station {station}"
        changes.append(RaiseRange(station, missing + 1e-9 * float(problem.ranges_m[station] + missing)))
        return missing, f"the {link.end} is {missing:.3f} m out of range of station {station}"
    first, second = link.stations
    depth = float(overlap_depth_m(bare, first, second))
    if depth >= MIN_OVERLAP_M:
        return 0.0, f"the ranges of stations {first} and {second} overlap"
    ends = np.array(link.stations)
    by = range_to_meet_m(problem, ends, ends[::-1], MIN_OVERLAP_M) - problem.ranges_m[ends]
    if not np.isfinite(by).any():
        by = range_to_meet_m(bare, ends, ends[::-1], MIN_OVERLAP_M) - problem.ranges_m[ends]
    side = int(np.argmin(by))
    if np.isfinite(by[side]):
        station = link.stations[side]
        changes.append(RaiseRange(station, float(by[side]) + 1e-9 * float(problem.ranges_m[station] + by[side])))
    return max(-depth, 0.0), f"the ranges of stations {first} and {second} are {-depth:.3f} m apart"


def _lowered(problem: Problem, link: _Link) -> list[LowerElevation]:
    """The mask, or both, that stand in the way of a link, lowered as little as will do; empty where that is no help."""
    masks = problem.min_elevation_deg
    if masks is None:
        return []
    limited = [station for station in link.stations if masks[station] > UNMASKED_DEG]
    alone = [change for station in limited if (change := _least(problem, link, (station,)))]
    if alone:
        return min(alone, key=lambda changes: changes[0].by_deg)
    return _least(problem, link, tuple(limited))


def _least(problem: Problem, link: _Link, stations: tuple[int, ...]) -> list[LowerElevation]:
    """The masks of ``stations`` lowered by the least that makes a link hold; empty when dropping them does not."""
    masks = problem.min_elevation_deg
    assert masks is not None

    def lowered(by_deg: float) -> list[LowerElevation]:
        return [_lowering(float(masks[k]), k, by_deg) for k in stations]

    def holds(by_deg: float) -> bool:
        return link.holds(remedied(problem, tuple(lowered(by_deg))))

    most = max((float(masks[k]) for k in stations), default=0.0)
    dropped = most + 1e-9
    if not stations or not holds(dropped):
        return []
    if not holds(most):
        return lowered(dropped)
    low, high = 0.0, most
    for _ in range(MASK_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if holds(middle) else (middle, high)
    return lowered(high)


def _lowering(mask_deg: float, station: int, by_deg: float) -> LowerElevation:
    """Below its horizon an antenna with a mask hears nothing: there the mask is dropped."""
    if by_deg > mask_deg:
        return LowerElevation(station, UNMASKED_DEG, mask_deg - UNMASKED_DEG)
    return LowerElevation(station, max(mask_deg - by_deg, 0.0), by_deg)


def _point(position: Array) -> tuple[float, float, float]:
    return float(position[0]), float(position[1]), float(position[2])
