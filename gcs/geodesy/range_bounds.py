"""What the map plane does to distances, as bounds with their proofs.

Notation: P, Q foot points on the ellipsoid of a station at height hs and a vehicle at height h; g their geodesic
distance; d their distance in the plane; D the true slant range; dh = |h - hs|. R = b^2 / a is the smallest radius of
curvature of the ellipsoid, 1 / R the largest normal curvature.

**The plane never shows two points too near: g <= d.** The plane is the exponential map of the origin. WGS84's Gaussian
curvature K is positive everywhere, so (Rauch) the map does not lengthen curves: the image of the straight segment
between two plane points has length at most d, and g is the shortest.

**Hence D^2 <= (k d)^2 + dh^2 with k = 1 + h_max / R.** Follow that image at a height that goes linearly from hs to h:
at height eta a surface step dg becomes |(1 + eta S) dg|, S the shape operator with eigenvalues in (0, 1 / R], so at
most (1 + max(eta, 0) / R) dg; and a straight line is no longer than any path. h_max is the larger of the two heights
and 0.

**And back: d <= g s / m(s), D^2 >= (q g)^2 + dh^2.** Pulled back to the plane, a curve at geodesic distance at most s
from the origin grows at most by s / m12, and by Sturm comparison with the largest curvature 1 / b^2 (at the equator),
s / m12 <= (s / b) / sin(s / b) =: c(s). Along the straight line from station to vehicle the height eta is
a convex function with eta'' <= 1 / (R + eta), so it stays above min(h, hs) - D^2 / (8 (R - 100 km)), and each of its
steps is at least sqrt((q dg)^2 + d eta^2), q = 1 + min(eta, 0) / R; integrating (Minkowski) gives the claim.

**Sea level is not the ellipsoid.** The geoid's height N lies within -107 .. +86 m (EGM2008), and its slope, the
deflection of the vertical, stays below 7e-4 (GGMplus: -109" .. +94" north-south, -83" .. +79" east-west). True
heights are h + N, so the heights above change by N and dh by at most 7e-4 g. Both are in the bounds below.

All this is a matter of some 5e-5 of a range (0.8 m of 16 km), most of it for heights.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from gcs.geodesy.ellipsoid import WGS84_A_M, WGS84_B_M
from gcs.geodesy.plane import MAX_PLANE_RADIUS_M
from planner.arrays import Array

MIN_CURVATURE_RADIUS_M = WGS84_B_M**2 / WGS84_A_M
GEOID_MAX_M = 86.0
GEOID_MIN_M = -107.0
GEOID_SLOPE = 7e-4
# Longest range the proof of the lower side holds for with room to spare.
MAX_RANGE_M = 1_000_000.0


def height_factor(max_height_m: ArrayLike) -> Array:
    """k: how much longer a way is at this height (AMSL) or below it than on the ellipsoid, at most."""
    return np.asarray(1.0 + np.maximum(np.asarray(max_height_m, float) + GEOID_MAX_M, 0.0) / MIN_CURVATURE_RADIUS_M)


def plane_stretch(distance_m: ArrayLike) -> Array:
    """c(s): how much longer than it is the plane shows a short way at distance s from the origin, at most."""
    s = np.asarray(distance_m, float)
    if not (s <= 1.5 * MAX_PLANE_RADIUS_M).all():
        raise ValueError(f"distances must be at most {1.5 * MAX_PLANE_RADIUS_M:.0f} m from the plane's origin")
    angle = s / WGS84_B_M
    return np.asarray(np.where(angle > 1e-6, angle / np.sin(np.maximum(angle, 1e-6)), 1.0 + angle**2 / 6.0))


def slant_range_bound_m(plane_distance_m: ArrayLike, height_difference_m: ArrayLike, max_height_m: ArrayLike) -> Array:
    """A length no true slant range exceeds, given distance in the plane, difference and maximum of the altitudes.

    A convex function of the offset in the plane, so its largest value on the control points of a curve holds for the
    whole curve.
    """
    d, dh = np.asarray(plane_distance_m, float), np.abs(np.asarray(height_difference_m, float))
    return np.asarray(np.hypot(height_factor(max_height_m) * d, dh + GEOID_SLOPE * d))


def planning_range_m(range_m: ArrayLike, max_height_m: ArrayLike, max_height_difference_m: ArrayLike) -> Array:
    """Radius of a ball of the plane inside which the true slant range is at most ``range_m``.

    ``max_height_difference_m`` bounds the difference of altitudes between station and vehicle. Solves
    (k r)^2 + 2 gamma H r + (gamma r)^2 = R^2, which bounds `slant_range_bound_m` for every split of r into
    distance and height. Zero or less where nothing is left.
    """
    big = np.asarray(range_m, float)
    quadratic = height_factor(max_height_m) ** 2 + GEOID_SLOPE**2
    linear = GEOID_SLOPE * np.asarray(max_height_difference_m, float)
    radius = (np.sqrt(linear**2 + quadratic * np.maximum(big, 0.0) ** 2) - linear) / quadratic
    return np.asarray(np.where(big > 0, np.minimum(radius, big) * (1.0 - 1e-12), big))


def range_needed_m(planning_m: ArrayLike, max_height_m: ArrayLike, max_height_difference_m: ArrayLike) -> Array:
    """The true range that `planning_range_m` turns into a ball of radius ``planning_m``; its inverse."""
    r = np.asarray(planning_m, float)
    quadratic = height_factor(max_height_m) ** 2 + GEOID_SLOPE**2
    linear = GEOID_SLOPE * np.asarray(max_height_difference_m, float)
    return np.asarray(np.maximum(np.sqrt(quadratic * r**2 + 2.0 * linear * r), r) * (1.0 + 4e-12))


def bound_range_m(
    range_m: ArrayLike, distance_from_origin_m: ArrayLike, min_height_m: ArrayLike, max_height_difference_m: ArrayLike
) -> Array:
    """Radius of a ball of the plane outside which the true slant range exceeds ``range_m``.

    ``distance_from_origin_m`` is the station's; ``min_height_m`` the lower of the altitudes of station and vehicle.
    """
    big = np.maximum(np.asarray(range_m, float), 0.0)
    if not (big <= MAX_RANGE_M).all():
        raise ValueError(f"ranges must be at most {MAX_RANGE_M:.0f} m")
    sag = big**2 / (8.0 * (MIN_CURVATURE_RADIUS_M - 100e3))
    lowest = np.minimum(np.asarray(min_height_m, float) + GEOID_MIN_M - sag, 0.0)
    q = 1.0 + lowest / MIN_CURVATURE_RADIUS_M
    ground = big / q
    stretch = plane_stretch(np.asarray(distance_from_origin_m, float) + ground)
    slope = GEOID_SLOPE * ground
    extra = 2.0 * slope * (np.asarray(max_height_difference_m, float) + slope) + slope**2
    return np.asarray(np.sqrt((stretch * ground) ** 2 + extra) * (1.0 + 1e-12))


def bound_speed_factor(farthest_m: float, min_alt_amsl_m: float) -> float:
    """How much faster than the vehicle's true speed the plane may show it, within ``farthest_m`` of the origin."""
    lowest = min(min_alt_amsl_m + GEOID_MIN_M, 0.0)
    return float(plane_stretch(farthest_m)) / (1.0 + lowest / MIN_CURVATURE_RADIUS_M)


def planning_elevation_deg(min_elevation_deg: ArrayLike, range_m: ArrayLike) -> Array:
    """Elevation to keep in the plane so that the true one is at least ``min_elevation_deg``.

    The ground falls away by half the central angle, g / 2R; the antenna's vertical may deviate from the ellipsoid's
    normal by the deflection of the vertical, on top of the geoid's slope; the plane's longer distances only help,
    heights and curvature change the tangent by under 1e-4.
    """
    angle = np.asarray(range_m, float) / (2.0 * MIN_CURVATURE_RADIUS_M) + 2.0 * GEOID_SLOPE + 1e-4
    return np.asarray(np.asarray(min_elevation_deg, float) + math.degrees(1.0) * angle)
