"""A polyline along a station sequence: where each handover could be.

It is the first guess of the joint problem and prices a sequence before anything is solved. Where handovers cost
nothing it is the shortest one, by the funnel algorithm on the overlaps' chords, or where these cross each other the
paper's P4. Otherwise every overlap gets a grid of points, and dynamic programming finds the fastest way through them,
at the prices of `planner.coverage.chord`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from planner.arrays import Array, Indices
from planner.corridor.chebyshev import chebyshev_centres
from planner.corridor.corridor import Corridor, build_corridor
from planner.corridor.funnel import shortest_crossings
from planner.corridor.polyline_program import polyline_length_m, shortest_polyline
from planner.coverage.chord import Chords, chords, leaves_after, leg_times_s
from planner.coverage.elevation_mask import ElevationMask
from planner.problem import Problem
from planner.speed_profile import fastest_time_s

# How far out on its half of a chord a handover may be.
OUTERMOST = 1.0 - 1e-6
# Points of an overlap: along its chord, and across.
ALONG = np.linspace(-OUTERMOST, OUTERMOST, 11)
ACROSS = np.array([0.1, 0.5, 0.9])


def polyline_along(problem: Problem, sequence: Sequence[int], *, inwards: float = 0.0) -> tuple[Array, float]:
    """Start, a point in every overlap of the sequence, destination: ``(L + 1, 3)``, and the mission time expected (s).

    ``inwards`` from 0 to 1 moves the handovers towards the Chebyshev centres of their overlaps: a less direct polyline
    with more room around its bends. The expected time is without that.
    """
    limits = problem.limits
    stations = np.asarray(sequence, dtype=np.int64)
    if len(stations) == 1:
        polyline = np.stack([problem.start_m, problem.destination_m])
        return polyline, fastest_time_s(limits, polyline_length_m(polyline))
    at_chords = chords(problem, stations[:-1], stations[1:])
    if problem.handovers_cost_time:
        flat, estimate = _best_on_grid(problem, stations, at_chords)
        # Speeding up and braking lose half of v/a each.
        estimate += limits.max_speed_m_s / limits.max_accel_m_s2
        polyline = _lifted(problem, stations, at_chords, flat)
    else:
        gates = at_chords.points(np.broadcast_to([OUTERMOST, -OUTERMOST], (len(at_chords.half), 2)))
        left, right = gates.swapaxes(0, 1)
        crossings = shortest_crossings(problem.start_m[:2], left, right, problem.destination_m[:2])
        if crossings is None:
            polyline = shortest_polyline(problem, _plain(problem, sequence))
        else:
            polyline = _lifted(problem, stations, at_chords, crossings)
        estimate = fastest_time_s(limits, polyline_length_m(polyline))
    if inwards > 0.0:
        polyline[1:-1] += inwards * (chebyshev_centres(problem, _plain(problem, sequence)).points_m - polyline[1:-1])
    return polyline, estimate


def _plain(problem: Problem, sequence: Sequence[int]) -> Corridor:
    """The corridor of one piece a station, a joint in every overlap."""
    return build_corridor(replace(problem, min_overlap_s=0.0, min_tenure_s=0.0), sequence)


def _lifted(problem: Problem, stations: Indices, at_chords: Chords, flat: Array) -> Array:
    """The polyline of the handovers ``flat`` ``(E, 2)``, seen from above."""
    inner = np.column_stack([flat, _altitudes(problem, stations, at_chords, flat)])
    return np.concatenate([problem.start_m[None], inner, problem.destination_m[None]])


def _best_on_grid(problem: Problem, stations: Indices, at_chords: Chords) -> tuple[Array, float]:
    """Dynamic programming: where every handover is, seen from above, and the time expected at full speed otherwise."""
    layers = at_chords.overlap_points(ALONG, ACROSS)
    centres = problem.station_positions_m[:, :2]
    cost = np.zeros(1)
    choices: list[Indices] = []
    points = [problem.start_m[None, :2], *layers, problem.destination_m[None, :2]]
    for leg in range(len(stations)):
        p, q = points[leg][:, None], points[leg + 1][None]
        length = np.linalg.norm(q - p, axis=-1)
        out = into = np.full(length.shape, np.inf)
        if leg > 0:
            out = leaves_after(p, q, length, centres[stations[leg - 1]], at_chords.radius_first[leg - 1])
        if leg < len(stations) - 1:
            into = leaves_after(q, p, length, centres[stations[leg + 1]], at_chords.radius_second[leg])
        total = cost[:, None] + leg_times_s(problem, length, out, into)
        choice = np.argmin(total, axis=0)
        cost = total[choice, np.arange(total.shape[1])]
        choices.append(choice)
    best = np.empty((len(layers), 2))
    at = int(choices[-1][0])
    for leg in range(len(layers) - 1, -1, -1):
        best[leg] = layers[leg][at]
        at = int(choices[leg][at])
    return best, float(cost[0])


def _altitudes(problem: Problem, stations: Indices, at_chords: Chords, flat: Array) -> Array:
    """Altitudes of the handovers: on the line from start to destination where both ranges allow, else nearest to it."""
    ends = np.concatenate([problem.start_m[None, :2], flat, problem.destination_m[None, :2]])
    travelled = np.cumsum(np.linalg.norm(np.diff(ends, axis=0), axis=1))
    share = travelled[:-1] / max(float(travelled[-1]), 1e-9)
    wanted = problem.start_m[2] + share * (problem.destination_m[2] - problem.start_m[2])
    mask = ElevationMask.of(problem)
    low = np.full(len(flat), problem.limits.min_alt_m)
    high = np.full(len(flat), problem.limits.max_alt_m)
    for side in (stations[:-1], stations[1:]):
        position = problem.station_positions_m[side]
        away = np.linalg.norm(flat - position[:, :2], axis=1)
        reach = np.sqrt(np.maximum(problem.ranges_m[side] ** 2 - away**2, 0.0))
        low, high = np.maximum(low, position[:, 2] - reach), np.minimum(high, position[:, 2] + reach)
        if mask is not None:
            low = np.maximum(low, mask.at(side).lowest_alt_m(position[:, 2], away))
    return np.where(low <= high, np.clip(wanted, low, high), at_chords.alt_m)
