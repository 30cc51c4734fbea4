"""WGS84 in earth-centred coordinates: true slant ranges and elevations."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from planner.arrays import Array

# WGS84 (NGA.STND.0036): semi-major axis in metres, flattening; the rest follows.
WGS84_A_M = 6378137.0
WGS84_F = 1.0 / 298.257223563
WGS84_B_M = WGS84_A_M * (1.0 - WGS84_F)
WGS84_E2 = WGS84_F * (2.0 - WGS84_F)


def ecef_m(lat_deg: ArrayLike, lon_deg: ArrayLike, height_m: ArrayLike) -> Array:
    """Earth-centred coordinates ``(..., 3)`` in metres from latitude, longitude and ellipsoidal height."""
    lat, lon = np.radians(np.asarray(lat_deg, float)), np.radians(np.asarray(lon_deg, float))
    height = np.asarray(height_m, float)
    normal = WGS84_A_M / np.sqrt(1.0 - WGS84_E2 * np.sin(lat) ** 2)
    x = (normal + height) * np.cos(lat) * np.cos(lon)
    y = (normal + height) * np.cos(lat) * np.sin(lon)
    z = (normal * (1.0 - WGS84_E2) + height) * np.sin(lat)
    return np.stack(np.broadcast_arrays(x, y, z), axis=-1)


def slant_range_m(
    lat_deg: ArrayLike,
    lon_deg: ArrayLike,
    alt_amsl_m: ArrayLike,
    to_lat_deg: ArrayLike,
    to_lon_deg: ArrayLike,
    to_alt_amsl_m: ArrayLike,
) -> Array:
    """Straight-line distance in metres between points on the earth; AMSL is taken as height above the ellipsoid."""
    difference = ecef_m(lat_deg, lon_deg, alt_amsl_m) - ecef_m(to_lat_deg, to_lon_deg, to_alt_amsl_m)
    return np.asarray(np.linalg.norm(difference, axis=-1))


def elevation_deg(
    lat_deg: float, lon_deg: float, alt_amsl_m: float, to_lat_deg: ArrayLike, to_lon_deg: ArrayLike, to_alt: ArrayLike
) -> Array:
    """Angle above the horizon of the first point (ellipsoid normal) at which it sees the others, degrees."""
    offset = ecef_m(to_lat_deg, to_lon_deg, to_alt) - ecef_m(lat_deg, lon_deg, alt_amsl_m)
    lat, lon = math.radians(lat_deg), math.radians(lon_deg)
    up = np.array([math.cos(lat) * math.cos(lon), math.cos(lat) * math.sin(lon), math.sin(lat)])
    vertical = offset @ up
    horizontal = np.linalg.norm(offset - vertical[..., None] * up, axis=-1)
    return np.asarray(np.degrees(np.arctan2(vertical, horizontal)))
