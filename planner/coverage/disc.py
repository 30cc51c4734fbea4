"""What one station covers inside the altitude band: a disc at every altitude, its radius concave in the altitude."""

from __future__ import annotations

import numpy as np

from planner.arrays import Array, Flags, Indices
from planner.problem import Problem

_ALL = slice(None)


def altitude_span_m(problem: Problem, station: int | Indices | slice = _ALL) -> tuple[Array, Array]:
    """Lowest and highest altitude of the band that ``station`` covers; upside down where it covers none."""
    limits, height, reach = problem.limits, problem.station_positions_m[station, 2], problem.ranges_m[station]
    floor = height - reach
    if problem.min_elevation_deg is not None:
        # At an elevation of zero or more a station hears nothing below its antenna.
        floor = np.where(problem.min_elevation_deg[station] >= 0.0, height, floor)
    return np.maximum(limits.min_alt_m, floor), np.minimum(limits.max_alt_m, height + reach)


def usable_stations(problem: Problem) -> Flags:
    """``(M,)``: which stations cover any point of the altitude band at all."""
    low, high = altitude_span_m(problem)
    return low <= high


def disc_radius_m(problem: Problem, station: int | Indices, alt_m: float | Array) -> Array:
    """Radius of what ``station`` covers at ``alt_m`` (arrays broadcast); zero where it covers nothing."""
    height = alt_m - problem.station_positions_m[station, 2]
    radius: Array = np.sqrt(np.maximum(problem.ranges_m[station] ** 2 - height**2, 0.0))
    if problem.min_elevation_deg is not None:
        slope = cotangent(problem, station)
        with np.errstate(invalid="ignore"):
            cone = np.where(height >= 0.0, np.where(np.isinf(slope), np.inf, height * slope), 0.0)
        cone = np.where(problem.min_elevation_deg[station] < 0.0, np.inf, cone)
        radius = np.minimum(radius, cone)
    return radius


def cotangent(problem: Problem, station: int | Indices | slice = _ALL) -> Array:
    """Horizontal reach of ``station`` per metre of height; infinite where no elevation limit narrows the range."""
    assert problem.min_elevation_deg is not None
    angle = np.radians(np.maximum(problem.min_elevation_deg[station], 0.0))
    with np.errstate(divide="ignore"):
        return np.asarray(np.cos(angle) / np.sin(angle))


def covering_stations(problem: Problem, position_m: Array) -> Indices:
    """Stations whose range, and elevation where limited, holds ``position_m`` ``(3,)``, at zero tolerance."""
    inside = problem.covers(position_m)
    if problem.min_elevation_deg is None:
        return inside
    offset = position_m - problem.station_positions_m[inside]
    angle = problem.min_elevation_deg[inside]
    slope = np.tan(np.radians(np.maximum(angle, 0.0)))
    heard = (angle < 0.0) | (slope * np.linalg.norm(offset[:, :2], axis=-1) <= offset[:, 2])
    return np.asarray(inside[heard])


def range_to_meet_m(problem: Problem, station: Indices, other: Indices, depth_m: float) -> Array:
    """Least range of ``station`` whose lens with ``other`` is ``depth_m`` deep (arrays broadcast); may be infinite.

    The least of sqrt((z - h)^2 + c(z)^2) over the altitudes ``other`` covers, with c the width its disc leaves: a
    convex function, found by zooming in on a grid.
    """
    station, other = np.broadcast_arrays(station, other)
    low, high = (bound[other][..., None] for bound in altitude_span_m(problem))
    offset = problem.station_positions_m[other, :2] - problem.station_positions_m[station, :2]
    distance = np.hypot(offset[..., 0], offset[..., 1])[..., None]
    height = problem.station_positions_m[station, 2][..., None]
    low = np.minimum(low, high)
    best = np.full(station.shape, np.inf)
    grid = np.linspace(0.0, 1.0, 17)
    for _ in range(12):
        altitude = low + grid * (high - low)
        radius = disc_radius_m(problem, other[..., None], altitude)
        width = np.maximum(distance + depth_m - radius, depth_m)
        reach = np.hypot(altitude - height, width)
        # Where the other's disc is thinner than the lens is to be deep, no range will do.
        thin = 2.0 * radius < depth_m
        reach = np.where(thin & ~thin.all(axis=-1, keepdims=True), np.inf, reach)
        if problem.min_elevation_deg is not None:
            angle = problem.min_elevation_deg[station][..., None]
            cone = cotangent(problem)[station][..., None]
            with np.errstate(invalid="ignore"):
                below = (altitude < height) | ((altitude - height) * cone < width)
            reach = np.where((angle >= 0.0) & below, np.inf, reach)
        at = np.argmin(reach, axis=-1)[..., None]
        best = np.minimum(best, np.take_along_axis(reach, at, axis=-1)[..., 0])
        first = np.take_along_axis(altitude, np.maximum(at - 1, 0), axis=-1)
        high = np.take_along_axis(altitude, np.minimum(at + 1, len(grid) - 1), axis=-1)
        low = first
    return best
