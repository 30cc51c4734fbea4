"""A mission time no trajectory can beat, whatever its station sequence.

Seen from above, a trajectory never leaves the union of the stations' discs, each the largest cross-section of its
ball inside the altitude band. So its path is at least L = hypot(L2, dz) long, L2 the shortest path through that union,
dz the climb between the ends. And no vehicle covers L faster than one that speeds up, cruises and brakes in a line:
L/v + v/a from rest to rest, 2 sqrt(L/a) where it never reaches v, more where jerk is limited.
The bound holds for antennas at any height; it is tight for antennas below the band.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, sqrt

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from planner.arrays import Array, Flags, Indices
from planner.coverage.elevation_mask import ElevationMask
from planner.coverage.overlap import neighbours_within
from planner.problem import Problem
from planner.routing.navmesh import NavigationMesh, ShortestPath
from planner.speed_profile import fastest_time_s

# What rounding may have added to a length; taken off, so that the bound stays one.
ROUNDING = 1e-9
# Stations above which the union is not meshed for the bound alone (about 20 microseconds each).
MAX_MESH_STATIONS = 100_000
# Stations above which those too far aside are sought out, so that only the others are meshed.
CROWD = 1_000
# A path from centre to centre is sought among discs that one so much longer than the straight line can touch.
STRETCHES = (1.02, 1.1, 1.5, inf)
# How much of that path's detour the shortest one is guessed to need. Seldom more than the first; the last is certain.
SHARES = (0.25, 0.5, 1.0)


@dataclass(frozen=True)
class LowerBound:
    """``time_s`` and ``length_m``: what no trajectory can beat.

    ``path_m`` ``(k, 2)`` is the shortest path through the union of discs, seen from above, where ``exact``. Otherwise
    the search was cut short, or there is no path, and the figures bound all the same.
    """

    time_s: float
    length_m: float
    path_m: Array | None
    exact: bool


def lower_bound(problem: Problem, *, max_expansions: int = 1_000_000, upper_length_m: float = inf) -> LowerBound:
    """The bound of a problem, from its ``bound_ranges_m`` (default its ranges), limits and start state.

    ``max_expansions`` ends the search of a large map early; the bound is then weaker and ``exact`` is False.
    ``upper_length_m``: the length of a path known to exist, seen from above; stations beyond its reach are left out.
    On large maps one is looked for.
    """
    offset = problem.destination_m - problem.start_m
    straight = float(np.linalg.norm(offset))
    length, path, exact = straight, None, False
    if problem.station_count <= MAX_MESH_STATIONS:
        centres, radii = planar_discs(
            problem, problem.ranges_m if problem.bound_ranges_m is None else problem.bound_ranges_m
        )
        found = _shortest_path(problem, centres, radii, max_expansions, upper_length_m)
        if found is not None:
            length = float(np.hypot(found.length_m, offset[2])) * (1.0 - ROUNDING)
            path, exact = (found.points_m, True) if found.exact else (None, False)
    return LowerBound(max(_times_s(problem, length, offset)), length, path, exact)


def planar_discs(problem: Problem, ranges_m: Array) -> tuple[Array, Array]:
    """Largest cross-section of each station's ball in the band: centres ``(M', 2)``, radii ``(M',)``.

    An elevation mask e takes away what lies below its cone: then the widest place is at h + R sin e. Stations that
    do not reach the band are left out.
    """
    radii = planar_radii_m(problem, ranges_m)
    reach = radii >= 0
    return problem.station_positions_m[reach, :2], radii[reach]


def planar_radii_m(problem: Problem, ranges_m: Array) -> Array:
    """Radius of each station's largest cross-section in the band ``(M,)``; minus one where it does not reach it."""
    height = problem.station_positions_m[:, 2]
    low, high = problem.limits.min_alt_m, problem.limits.max_alt_m
    mask = ElevationMask.of(problem)
    if mask is None:
        widest = np.clip(height, low, high)
        cone = np.full(len(height), inf)
    else:
        widest = np.clip(height + ranges_m * np.sin(mask.angle_rad), low, high)
        cone = np.where(mask.limited & (widest < height), -1.0, mask.reach_m(widest - height))
    square = ranges_m**2 - (widest - height) ** 2
    radii = np.minimum(np.sqrt(np.maximum(square, 0.0)), cone)
    return np.where((square >= 0) & (radii >= 0), radii, -1.0)


def _times_s(problem: Problem, length_m: float, offset_m: Array) -> list[float]:
    """Every bound on the time that applies; the largest is the tightest."""
    limits, factor = problem.limits, problem.bound_speed_factor
    times = [
        fastest_time_s(
            limits,
            length_m / factor,
            float(np.linalg.norm(problem.start_velocity_m_s)),
            float(np.linalg.norm(problem.start_acceleration_m_s2)),
        )
    ]
    climb = float(offset_m[2])
    vertical = limits.max_climb_m_s if climb > 0 else limits.max_descent_m_s
    if vertical is not None:
        times.append(abs(climb) / vertical)
    if limits.max_airspeed_m_s is not None:
        # In the air's frame the vehicle ends at offset - wind T, no further than airspeed T: the least such T.
        wind = np.array([*limits.wind_m_s, 0.0])
        offset = offset_m / factor
        slack = limits.max_airspeed_m_s**2 - float(wind @ wind)
        against = -float(offset @ wind)
        if slack > 0:
            times.append((against + sqrt(against**2 + slack * float(offset @ offset))) / slack)
    return times


def _shortest_path(
    problem: Problem, centres: Array, radii: Array, max_expansions: int, upper_length_m: float
) -> ShortestPath | None:
    """The shortest path through the union of discs, meshed only where a path of that length can be.

    A path no longer than some length touches no disc beyond its reach. So on large maps a length is guessed: what is
    found among the discs within its reach is the answer if it is no longer, and otherwise a longer one is tried.
    """
    start, end = problem.start_m[:2], problem.destination_m[:2]
    guesses_m = [upper_length_m]
    if len(radii) > CROWD:
        straight = float(np.linalg.norm(end - start))
        upper_length_m = min(upper_length_m, _known_length_m(problem, centres, radii))
        guesses_m = [upper_length_m]
        if upper_length_m < inf:
            guesses_m = [straight + share * (upper_length_m - straight) for share in SHARES]
    for guess_m in guesses_m:
        near = _within_reach(problem, centres, radii, guess_m)
        if near.any():
            mesh = NavigationMesh(centres[near], radii[near])
            found = mesh.shortest_path(
                tuple(start), tuple(end), max_expansions=max_expansions, max_length_m=guess_m * (1.0 + ROUNDING)
            )
            if found is not None:
                return found
    return None


def _known_length_m(problem: Problem, centres: Array, radii: Array) -> float:
    """Length of some path through the union of discs, from centre to centre; infinite where there is none.

    Sought among the discs that a path not much longer than the straight line can touch, then farther afield.
    """
    start, end = problem.start_m[:2], problem.destination_m[:2]
    straight = float(np.linalg.norm(end - start))
    for stretch in STRETCHES:
        near = np.flatnonzero(_within_reach(problem, centres, radii, stretch * straight))
        length = _centre_path_m(start, end, centres[near], radii[near])
        if length < inf:
            return length
    return inf


def _centre_path_m(start: Array, end: Array, centres: Array, radii: Array) -> float:
    """The shortest path over centres of discs that meet, which such a path never leaves."""
    pairs = neighbours_within(centres, radii)
    apart = np.linalg.norm(centres[pairs[:, 0]] - centres[pairs[:, 1]], axis=1)
    met = apart <= radii[pairs].sum(axis=1)
    ends = []
    for point in (start, end):
        away = np.linalg.norm(centres - point, axis=1)
        inside = np.flatnonzero(away <= radii)
        ends.append((inside, away[inside]))
    count = len(radii)
    graph = graph_with_ends(count, pairs[met], apart[met], ends)
    return float(dijkstra(graph, directed=False, indices=count)[count + 1])


def graph_with_ends(count: int, pairs: Indices, weights: Array, ends: Sequence[tuple[Indices, Array]]) -> csr_array:
    """An undirected graph over ``count`` stations with edges ``pairs`` ``(E, 2)`` of ``weights`` ``(E,)``.

    Each of ``ends``, its stations and what the way to each weighs, is one node more: ``count``, ``count + 1``, ...
    """
    rows, columns, values = [pairs[:, 0]], [pairs[:, 1]], [weights]
    for node, (stations, ways) in enumerate(ends, start=count):
        rows.append(np.full(len(stations), node))
        columns.append(stations)
        values.append(ways)
    size = count + len(ends)
    # A weight of zero would read as no edge.
    positive = np.maximum(np.concatenate(values), 1e-9)
    return csr_array((positive, (np.concatenate(rows), np.concatenate(columns))), shape=(size, size))


def _within_reach(problem: Problem, centres: Array, radii: Array, upper_length_m: float) -> Flags:
    """Discs that a path of ``upper_length_m`` from start to destination can touch."""
    start, end = problem.start_m[:2], problem.destination_m[:2]
    around = np.linalg.norm(centres - start, axis=1) + np.linalg.norm(centres - end, axis=1)
    near: Flags = around - 2.0 * radii <= upper_length_m * (1.0 + 1e-9)
    return near
