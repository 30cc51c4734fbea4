"""Other remedies for ranges that do not link start and destination, of kinds the diagnosis does not think of.

Each is found by solving for the least change after which nothing is wrong any more:

    RaiseRange        of the one station with which it is least, where that is not the first remedy
    RaiseAllRanges    every range by so much: what a smaller range margin would give
    WidenBand         a lower floor or a higher ceiling of the altitude band
    LowerElevations   every lowest elevation by so much, where antennas have one
    Move              an end that is out of range, to the nearest place in range
    AddStation        one more station, in the middle of the gap
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from planner.arrays import Array
from planner.coverage.disc import altitude_span_m, covering_stations, disc_radius_m, range_to_meet_m
from planner.coverage.grid_zoom import least_by_zooming
from planner.coverage.overlap import MIN_OVERLAP_M, adjacent_pairs
from planner.errors import Infeasibility
from planner.infeasibility.application import remedied
from planner.infeasibility.diagnosis import diagnose
from planner.infeasibility.route_faults import RouteFaults, merged, route_faults
from planner.problem import Problem
from planner.remedy import (
    AddStation,
    Change,
    End,
    LowerElevations,
    Move,
    Point,
    RaiseAllRanges,
    RaiseRange,
    Remedy,
    WidenBand,
)

# Above this many stations only the first remedy is worked out: the others take some dozens of diagnoses each.
MAX_STATIONS = 2_000
# Above this many no station is looked for that would save handovers with a larger range.
MAX_SINGLE = 300
BISECTIONS = 24
# Faults followed one behind the other.
MAX_FAULTS = 4
# Stations added together at most: beyond that it is another network.
MAX_ADDED = 6


def with_alternatives(problem: Problem, found: Infeasibility) -> Infeasibility:
    """``found`` (`planner.infeasibility.diagnosis.diagnose`), and what else would be wrong after its remedy, with
    remedies that each cure all of it.
    """
    if problem.station_count > MAX_STATIONS:
        return found
    faults = _all_faults(problem, found)
    route = route_faults(problem)
    causes = _causes(problem, route)
    crowded = any(fault.reason == "limits" for fault in (*faults, *causes))
    found = _told(found, faults, causes, route.cure)
    # More handovers than allowed: one range from end to end is the most it can take.
    span = float(np.linalg.norm(problem.destination_m - problem.start_m)) + float(problem.ranges_m.max())
    gaps_m = [fault.gap_m or 0.0 for fault in (*faults, *causes)]
    widest = span if crowded else 2.0 * max(gaps_m) + 1.0
    changes: list[Change | None] = [_all_ranges(problem, widest), _band(problem), _elevations(problem)]
    alone = len(faults) == 1 and len(causes) <= 1
    if crowded:
        changes.append(_one_range(problem, widest))
    elif alone and found.reason.endswith("_uncovered"):
        changes.append(_move(problem, found))
    alternatives: list[Remedy] = [(change,) for change in changes if change is not None]
    if not crowded:
        added = _stations(problem, causes or (found,))
        alternatives += [added] if added else []
    return replace(found, remedies=(*found.remedies, *alternatives))


def _causes(problem: Problem, route: RouteFaults) -> list[Infeasibility]:
    """All that is wrong on the best route, in flight order, and last a limit that this route would break."""
    further = diagnose(remedied(problem, route.cure)) if route.cure else None
    return [*route.faults, *([further] if further is not None and further.reason == "limits" else [])]


def _told(
    found: Infeasibility, faults: list[Infeasibility], causes: list[Infeasibility], cure: Remedy
) -> Infeasibility:
    """``found`` as the best route shows it, with all its causes and with remedies that each cure all of them."""
    limit = [change for cause in causes if cause.reason == "limits" for remedy in cause.remedies for change in remedy]
    remedies = [*_together(faults), (*cure, *limit) if cure else ()]
    same = [cause for cause in causes if cause.reason == found.reason]
    if same:
        worst = max(same, key=lambda cause: cause.gap_m or 0.0)
        found = replace(found, stations=worst.stations, gap_m=worst.gap_m, position_m=worst.position_m)
        found = replace(found, message=worst.message, masked=worst.masked)
    others = [cause for cause in (causes or faults) if cause.message != found.message]
    message = found.message + "".join(f"; besides, {cause.message}" for cause in others)
    # The same changes twice, found by two ways of looking, differ in their last digits.
    kept = {_changed(remedy): remedy for remedy in reversed(remedies) if remedy}
    remedies = list(reversed(kept.values()))
    return replace(found, message=message, remedies=tuple(remedies), causes=tuple(causes) if len(causes) > 1 else ())


def _changed(remedy: Remedy) -> frozenset[tuple[object, ...]]:
    """What a remedy changes, without by how much."""
    return frozenset((type(one), getattr(one, "station", None), getattr(one, "of", None)) for one in remedy)


def _all_faults(problem: Problem, found: Infeasibility) -> list[Infeasibility]:
    """``found`` and what would still be wrong after its remedy, and so on: an end out of range hides a broken chain."""
    faults = [found]
    while faults[-1].remedies and len(faults) < MAX_FAULTS:
        problem = remedied(problem, faults[-1].remedies[0])
        further = diagnose(problem)
        if further is None:
            break
        faults.append(further)
    return faults


def _together(faults: Sequence[Infeasibility]) -> tuple[Remedy, ...]:
    """One remedy out of the faults', carried out one after the other; none when no fault has any.

    Ranges of one station raised twice are raised once by the sum.
    """
    changes = merged([change for fault in faults for remedy in fault.remedies[:1] for change in remedy])
    return (changes,) if changes else ()


def _least(cured: Callable[[float], bool], most: float, needed: float = 0.0) -> float | None:
    """The least ``x`` up to ``most`` for which ``cured(x)``, at most a ten-millionth of it above; None when none is.

    It is known not to be less than ``needed``.
    """
    if not cured(most):
        return None
    if needed > 0.0 and cured(needed):
        return needed
    low, high = max(needed, 0.0), most
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if cured(middle) else (middle, high)
    return high


def _cures(problem: Problem, change: Change) -> bool:
    return _linked(remedied(problem, (change,)))


def _linked(problem: Problem) -> bool:
    """True when `planner.infeasibility.diagnosis.diagnose` would find nothing wrong; cheaper where it would."""
    if not problem.ends_in_band():
        return False
    sources = covering_stations(problem, problem.start_m)
    targets = covering_stations(problem, problem.destination_m)
    if not len(sources) or not len(targets):
        return False
    pairs = adjacent_pairs(problem).pairs
    count = problem.station_count
    graph = csr_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    labels = connected_components(graph, directed=False)[1]
    if not np.isin(labels[sources], labels[targets]).any():
        return False
    return problem.max_handovers is None or diagnose(problem) is None


def _all_ranges(problem: Problem, most_m: float) -> RaiseAllRanges | None:
    """Every range raised; by the widest gap of the narrowest chain would do but for slant, twice that is plenty."""
    by_m = _least(lambda by_m: _cures(problem, RaiseAllRanges(by_m)), most_m)
    return None if by_m is None else RaiseAllRanges(by_m)


def _one_range(problem: Problem, most_m: float) -> RaiseRange | None:
    """The one station whose range has to be raised least, and by how much."""
    if problem.station_count > MAX_SINGLE:
        return None
    best: RaiseRange | None = None
    for station in range(problem.station_count):

        def cured(by_m: float, station: int = station) -> bool:
            return _cures(problem, RaiseRange(station, by_m))

        # Only a station that does with less than the best so far is worth working out.
        by_m = _least(cured, most_m if best is None else best.by_m * (1.0 - 1e-3))
        if by_m is not None:
            best = RaiseRange(station, by_m)
    return best


def _elevations(problem: Problem) -> LowerElevations | None:
    """Every lowest elevation lowered by so much, down to the horizon at most."""
    angles = problem.min_elevation_deg
    if angles is None or angles.max() <= 0.0:
        return None
    by_deg = _least(lambda by_deg: _cures(problem, LowerElevations(by_deg)), float(angles.max()))
    return None if by_deg is None else LowerElevations(by_deg)


def _move(problem: Problem, found: Infeasibility) -> Move | None:
    """The end that is out of range moved to the nearest place in the band that a station covers.

    At every altitude the way to a disc is known, and the distance of the two together is convex: the best one is
    found by zooming in.
    """
    assert found.position_m is not None
    point = np.array(found.position_m)
    low, high = altitude_span_m(problem)
    usable = np.flatnonzero(low <= high)
    if not len(usable):
        return None
    masts = problem.station_positions_m[usable, :2]
    away = np.linalg.norm(masts - point[:2], axis=1)

    def aside_m(altitude: Array) -> Array:
        return np.asarray(np.maximum(away[:, None] - disc_radius_m(problem, usable[:, None], altitude), 0.0))

    def distance_m(altitude: Array) -> Array:
        return np.asarray(np.hypot(aside_m(altitude), altitude - point[2]))

    altitude, distance = least_by_zooming(distance_m, low[usable], high[usable])
    best = int(np.argmin(distance))
    aside = float(aside_m(altitude[:, None])[best, 0])
    # A billionth further in, so that rounding leaves it covered.
    inwards = min(1.0, (aside + 1e-9 * float(problem.ranges_m.max())) / max(float(away[best]), 1e-9))
    to = (*(point[:2] + inwards * (masts[best] - point[:2])), altitude[best])
    end: End = "start" if found.reason.startswith("start") else "destination"
    move = Move(end, _point(to), float(distance[best]))
    return move if _cures(problem, move) else None


def _band(problem: Problem) -> WidenBand | None:
    """The smaller of: the floor lowered towards the antennas, the ceiling raised towards them."""
    limits, heights = problem.limits, problem.station_positions_m[:, 2]
    choices: list[WidenBand] = []
    ends = sorted((float(problem.start_m[2]), float(problem.destination_m[2])))

    def lowered(by_m: float) -> WidenBand:
        return WidenBand(by_m, min_alt_m=limits.min_alt_m - by_m)

    def raised(by_m: float) -> WidenBand:
        return WidenBand(by_m, max_alt_m=limits.max_alt_m + by_m)

    down = limits.min_alt_m - min(float(heights.min()), ends[0])
    if down > 0.0:
        by_m = _least(lambda by_m: _cures(problem, lowered(by_m)), down, limits.min_alt_m - ends[0])
        choices += [] if by_m is None else [lowered(by_m)]
    up = max(float(heights.max()), ends[1]) - limits.max_alt_m
    if up > 0.0:
        by_m = _least(lambda by_m: _cures(problem, raised(by_m)), up, ends[1] - limits.max_alt_m)
        choices += [] if by_m is None else [raised(by_m)]
    return min(choices, key=lambda choice: choice.by_m) if choices else None


def _stations(problem: Problem, causes: Sequence[Infeasibility]) -> Remedy:
    """A station more in every gap of the route, all that is needed; empty where that is no help."""
    changes: list[Change] = []
    added = 0
    for cause in causes:
        if cause.reason == "limits" or cause.reason.endswith("_altitude") or not (cause.gap_m or 0.0) > 0.0:
            changes += [change for remedy in cause.remedies[:1] for change in remedy]
        elif (one := _station(problem, cause)) is not None:
            changes.append(one)
            added += 1
    remedy = merged(changes)
    return remedy if 0 < added <= MAX_ADDED and _linked(remedied(problem, remedy)) else ()


def _station(problem: Problem, found: Infeasibility) -> AddStation | None:
    """A station in the middle of the gap, as high as its neighbours' mean, with the least range that joins them."""
    if found.position_m is None or not found.stations or found.reason.endswith("_altitude"):
        return None
    neighbours = np.array(found.stations)
    place = np.array([*found.position_m[:2], float(problem.station_positions_m[neighbours, 2].mean())])
    extended = remedied(problem, (AddStation(_point(place), 1.0),))
    new = np.full(len(neighbours), problem.station_count)
    needed = float(range_to_meet_m(extended, new, neighbours, MIN_OVERLAP_M).max())
    if found.reason != "broken_chain":
        needed = max(needed, float(np.linalg.norm(place - np.array(found.position_m))))
    return AddStation(_point(place), needed * (1.0 + 1e-9) + 1e-6) if np.isfinite(needed) else None


def _point(at_m: Sequence[float] | Array) -> Point:
    return float(at_m[0]), float(at_m[1]), float(at_m[2])
