"""What one station covers inside the altitude band: a disc at every altitude, its radius concave in the altitude."""

from __future__ import annotations

import numpy as np

from planner.arrays import Array, Flags, Indices
from planner.coverage.elevation_mask import ElevationMask
from planner.coverage.grid_zoom import least_by_zooming
from planner.problem import Problem

_ALL = slice(None)


def altitude_span_m(problem: Problem, station: int | Indices | slice = _ALL) -> tuple[Array, Array]:
    """Lowest and highest altitude of the band that ``station`` covers; upside down where it covers none."""
    limits, height, reach = problem.limits, problem.station_positions_m[station, 2], problem.ranges_m[station]
    floor = height - reach
    mask = ElevationMask.of(problem)
    if mask is not None:
        # At an elevation of zero or more a station hears nothing below its antenna.
        floor = np.where(mask.at(station).limited, height, floor)
    return np.maximum(limits.min_alt_m, floor), np.minimum(limits.max_alt_m, height + reach)


def usable_stations(problem: Problem) -> Flags:
    """``(M,)``: which stations cover any point of the altitude band at all."""
    low, high = altitude_span_m(problem)
    return low <= high


def disc_radius_m(problem: Problem, station: int | Indices, alt_m: float | Array) -> Array:
    """Radius of what ``station`` covers at ``alt_m`` (arrays broadcast); zero where it covers nothing."""
    height = alt_m - problem.station_positions_m[station, 2]
    radius: Array = np.sqrt(np.maximum(problem.ranges_m[station] ** 2 - height**2, 0.0))
    mask = ElevationMask.of(problem)
    return radius if mask is None else np.minimum(radius, mask.at(station).reach_m(height))


def covering_stations(problem: Problem, position_m: Array) -> Indices:
    """Stations whose range, and elevation where limited, holds ``position_m`` ``(3,)``, at zero tolerance."""
    inside, mask = problem.covers(position_m), ElevationMask.of(problem)
    if mask is None:
        return inside
    below = mask.at(inside).below_m(position_m - problem.station_positions_m[inside])
    return np.asarray(inside[below <= 0.0])


def range_to_meet_m(problem: Problem, station: Indices, other: Indices, depth_m: float) -> Array:
    """Least range of ``station`` whose overlap with ``other`` is ``depth_m`` > 0 deep (arrays broadcast).

    Infinite where no range will do. The least of sqrt((z - h)^2 + c(z)^2) over the altitudes ``other`` covers, with c
    the width its disc leaves: a convex function.
    """
    station, other = np.broadcast_arrays(station, other)
    low, high = (bound[other] for bound in altitude_span_m(problem))
    offset = problem.station_positions_m[other, :2] - problem.station_positions_m[station, :2]
    distance = np.hypot(offset[..., 0], offset[..., 1])[..., None]
    height = problem.station_positions_m[station, 2][..., None]
    mask = ElevationMask.of(problem)

    def range_at(altitude: Array) -> Array:
        radius = disc_radius_m(problem, other[..., None], altitude)
        width = np.maximum(distance + depth_m - radius, depth_m)
        reach = np.hypot(altitude - height, width)
        # Where the other's disc is thinner than the overlap is to be deep, no range will do.
        thin = 2.0 * radius < depth_m
        reach = np.where(thin & ~thin.all(axis=-1, keepdims=True), np.inf, reach)
        if mask is not None:
            heard = mask.at(station[..., None]).reach_m(altitude - height)
            reach = np.where(heard < width, np.inf, reach)
        return reach

    return least_by_zooming(range_at, np.minimum(low, high), high)[1]
