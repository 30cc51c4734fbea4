"""Where two ranges meet inside the altitude band.

A station covers, at altitude z, the disc of radius sqrt(R^2 - (z - h)^2) around it (less below its lowest
elevation angle). Seen from above two stations meet at z when their discs do:

          r_i(z)      r_j(z)                  depth(z) = r_i(z) + r_j(z) - d
        O_i ──────►│  │◄────── O_j            > 0: an overlap so deep; < 0: a gap so wide
        └────────── d ───────────┘

Both radii are concave in z, so the depth is largest where a closed form or an end of the shared altitudes says.
With antennas at or below the band that is z_min and the test is Proposition 1 of Qi, Dou and Xin 2023 (with
"<=", its erratum); with a station on a hill, the plane through z_min alone would miss overlaps that exist.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from planner.arrays import Array, Indices
from planner.coverage.disc import altitude_span_m, disc_radius_m, usable_stations
from planner.coverage.elevation_mask import ElevationMask
from planner.problem import Problem

__all__ = [
    "MIN_OVERLAP_M",
    "AdjacentPairs",
    "adjacent_pairs",
    "overlap_altitude_m",
    "overlap_depth_m",
    "overlap_point_m",
    "usable_stations",
]

# An overlap less deep than this counts as none: below it, rounding and not geometry decides what fits inside.
MIN_OVERLAP_M = 1e-3


@dataclass(frozen=True)
class AdjacentPairs:
    """Pairs of stations ``pairs`` ``(E, 2)`` with i < j, sorted, and their overlap depths ``depths_m`` ``(E,)``."""

    pairs: Indices
    depths_m: Array


def overlap_altitude_m(problem: Problem, i: int | Indices, j: int | Indices) -> Array:
    """Altitude inside the band at which the ranges of stations ``i`` and ``j`` overlap most (arrays broadcast).

    Where they share no altitude of the band, the lower end of the upper one.
    """
    return _deepest(problem, i, j)[0]


def _antennas_below_band(problem: Problem) -> bool:
    """Whether every disc is widest at the bottom of the band, the usual case, for which nothing is to be sought."""
    if problem.min_elevation_deg is not None or float(problem.ranges_m.min()) < 0.0:
        return False
    return float(problem.station_positions_m[:, 2].max()) <= problem.limits.min_alt_m


def overlap_depth_m(problem: Problem, i: int | Indices, j: int | Indices) -> Array:
    """How deep the overlap of stations ``i`` and ``j`` is inside the band, horizontally; negative is the gap.

    Scalars or index arrays (broadcast). The sign is exact: at least zero if and only if some point of the band is
    covered by both, whatever the antennas' heights. A disc inside the other is as deep as it is wide. Stations that
    share no altitude of the band are minus the distance between their axes and altitudes apart; minus infinity where
    one of them does not reach the band.
    """
    return _deepest(problem, i, j)[1]


def _deepest(problem: Problem, i: int | Indices, j: int | Indices) -> tuple[Array, Array]:
    """`overlap_altitude_m` and `overlap_depth_m`."""
    (low_i, high_i), (low_j, high_j) = altitude_span_m(problem, i), altitude_span_m(problem, j)
    low, high = np.maximum(low_i, low_j), np.minimum(high_i, high_j)
    candidates = [low] if _antennas_below_band(problem) else _candidates_m(problem, i, j, low, high)
    altitudes = np.maximum(np.minimum(np.stack(np.broadcast_arrays(*candidates)), high), low)
    depths = _depth_at_m(problem, i, j, altitudes)
    best = np.expand_dims(np.argmax(depths, axis=0), 0)
    altitude, depth = (np.take_along_axis(values, best, axis=0)[0] for values in (altitudes, depths))
    offset = problem.station_positions_m[j, :2] - problem.station_positions_m[i, :2]
    distance = np.hypot(offset[..., 0], offset[..., 1])
    depth = np.where(low <= high, depth, -np.hypot(distance, low - high))
    usable = (low_i <= high_i) & (low_j <= high_j)
    return np.asarray(altitude), np.asarray(np.where(usable, depth, -np.inf))


def _candidates_m(problem: Problem, i: int | Indices, j: int | Indices, low: Array, high: Array) -> list[Array]:
    """Altitudes of which one, moved into ``low`` to ``high``, is that of the deepest overlap."""
    # A range of nothing or less (a margin larger than the range) is unusable; it must not divide by zero here.
    height_i, height_j = problem.station_positions_m[i, 2], problem.station_positions_m[j, 2]
    reach_i, reach_j = np.maximum(problem.ranges_m[i], 1e-9), np.maximum(problem.ranges_m[j], 1e-9)
    # The maximum of two circles' radii is where both make the same angle: on the line between the antennas.
    candidates = [(height_i * reach_j + height_j * reach_i) / (reach_i + reach_j), height_i, height_j]
    # One disc inside the other: the smaller is widest where both are as wide, in the spheres' radical plane.
    apart = np.where(np.abs(height_i - height_j) < 1e-6, 1.0, height_j - height_i)
    candidates.append(0.5 * ((reach_i**2 - reach_j**2) / apart + height_i + height_j))
    mask = ElevationMask.of(problem)
    if mask is not None:
        # Circle against cone, the corners of each, and the ends: the sum is concave, so one of these is the maximum.
        angle_i, angle_j = mask.at(i).angle_rad, mask.at(j).angle_rad
        candidates += [height_i + reach_i * np.cos(angle_j), height_i + reach_i * np.sin(angle_i)]
        candidates += [height_j + reach_j * np.cos(angle_i), height_j + reach_j * np.sin(angle_j)]
        candidates += [low, high]
    return candidates


def _depth_at_m(problem: Problem, i: int | Indices, j: int | Indices, alt_m: Array) -> Array:
    offset = problem.station_positions_m[j, :2] - problem.station_positions_m[i, :2]
    radius_i, radius_j = disc_radius_m(problem, i, alt_m), disc_radius_m(problem, j, alt_m)
    depth: Array = radius_i + radius_j - np.hypot(offset[..., 0], offset[..., 1])
    return np.minimum(depth, 2.0 * np.minimum(radius_i, radius_j))


def overlap_point_m(problem: Problem, i: int | Indices, j: int | Indices) -> Array:
    """The middle ``(..., 3)`` of the overlap of stations ``i`` and ``j`` ``(...)`` at its deepest altitude; of the gap
    where they share none."""
    a, b = problem.station_positions_m[i], problem.station_positions_m[j]
    altitude = overlap_altitude_m(problem, i, j)
    offset = (b - a)[..., :2]
    distance = np.hypot(offset[..., 0], offset[..., 1])
    direction = offset / np.where(distance > 0.0, distance, 1.0)[..., None]
    radius_i, radius_j = disc_radius_m(problem, i, altitude), disc_radius_m(problem, j, altitude)
    first, last = np.maximum(-radius_i, distance - radius_j), np.minimum(radius_i, distance + radius_j)
    middle = a[..., :2] + 0.5 * (first + last)[..., None] * direction
    return np.concatenate([middle, altitude[..., None]], axis=-1)


def adjacent_pairs(problem: Problem, *, min_depth_m: float = MIN_OVERLAP_M) -> AdjacentPairs:
    """Every pair of stations whose overlap is at least ``min_depth_m`` deep (negative: gaps up to that wide)."""
    usable = np.flatnonzero(usable_stations(problem))
    low, high = altitude_span_m(problem)
    height = problem.station_positions_m[:, 2]
    if problem.min_elevation_deg is None:
        widest = disc_radius_m(problem, usable, np.clip(height, low, high)[usable])
    else:
        widest = problem.ranges_m[usable]
    near = neighbours_within(problem.station_positions_m[usable, :2], widest, slack_m=max(-min_depth_m, 0.0))
    pairs = usable[near]
    pairs = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
    depths = overlap_depth_m(problem, pairs[:, 0], pairs[:, 1])
    keep = depths >= min_depth_m
    return AdjacentPairs(pairs[keep].astype(np.int64), depths[keep])


def neighbours_within(points_m: Array, reaches_m: Array, *, slack_m: float = 0.0) -> Indices:
    """Pairs ``(E, 2)``, i < j, of points ``(M, 2)`` that may be no farther apart than their reaches add up to.

    Every such pair is among them, and others a little farther apart: the caller looks closely.
    """
    # KD-trees over points of like reach, so that one far-reaching point does not make all pairs candidates.
    _, classes = np.frexp(np.maximum(reaches_m, 1e-3))
    kinds = np.unique(classes)
    groups = [np.flatnonzero(classes == c) for c in kinds]
    widest = [float(reaches_m[group].max()) for group in groups]
    trees = [cKDTree(points_m[group]) for group in groups]
    found: list[Indices] = []
    for a in range(len(groups)):
        for b in range(a, len(groups)):
            within = (widest[a] + widest[b] + slack_m) * (1.0 + 1e-12)
            if a == b:
                pairs = groups[a][trees[a].query_pairs(within, output_type="ndarray")]
            else:
                near = trees[a].sparse_distance_matrix(trees[b], within, output_type="ndarray")
                pairs = np.sort(np.stack([groups[a][near["i"]], groups[b][near["j"]]], axis=1), axis=1)
            found.append(pairs.reshape(-1, 2))
    return np.concatenate(found).astype(np.int64) if found else np.zeros((0, 2), dtype=np.int64)
