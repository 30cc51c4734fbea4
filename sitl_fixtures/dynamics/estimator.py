"""What the autopilot believes: its own local frame, laid by its own projection.

Each autopilot turns latitude and longitude into metres north and east of its EKF origin with its own constants, and
neither is WGS84. A ground station that forgets this is hundreds of metres off at 100 km, so both are kept here exactly.

- PX4: azimuthal equidistant on a sphere of 6,371,000 m.
- ArduPilot: 0.011131884502145034 m per 1e-7 degree, longitude times the cosine of the mean latitude of the origin and
  the place.

Velocity is along true north, east and down at the aircraft in both, as GPS gives it.
"""

from __future__ import annotations

import math
from typing import Protocol

PX4_EARTH_RADIUS_M = 6371000.0
ARDUPILOT_M_PER_RAD = 0.011131884502145034 * 1e7 * 180.0 / math.pi


class Projection(Protocol):
    """Metres north and east of an origin, and back."""

    def to_local(self, lat_rad: float, lon_rad: float) -> tuple[float, float]:
        """(north_m, east_m) of a place."""

    def to_geodetic(self, north_m: float, east_m: float) -> tuple[float, float]:
        """(lat_rad, lon_rad) of a place."""


def _wrap(angle_rad: float) -> float:
    """An angle between -pi and pi."""
    return math.remainder(angle_rad, 2.0 * math.pi)


class SphereProjection:
    """PX4's: azimuthal equidistant on a sphere."""

    def __init__(self, lat_rad: float, lon_rad: float) -> None:
        self._lat = lat_rad
        self._lon = lon_rad
        self._sin = math.sin(lat_rad)
        self._cos = math.cos(lat_rad)

    def to_local(self, lat_rad: float, lon_rad: float) -> tuple[float, float]:
        """(north_m, east_m) of a place."""
        sin_lat, cos_lat = math.sin(lat_rad), math.cos(lat_rad)
        d_lon = lon_rad - self._lon
        cos_d_lon = math.cos(d_lon)
        cos_c = max(-1.0, min(1.0, self._sin * sin_lat + self._cos * cos_lat * cos_d_lon))
        c = math.acos(cos_c)
        # Near the origin acos has no digits left; sin c / c is 1 there.
        if c < 1e-4:
            y = cos_lat * math.sin(d_lon)
            x = self._cos * sin_lat - self._sin * cos_lat * cos_d_lon
            c = math.asin(min(1.0, math.hypot(x, y)))
        k = c / math.sin(c) if c > 1e-12 else 1.0
        north = k * (self._cos * sin_lat - self._sin * cos_lat * cos_d_lon) * PX4_EARTH_RADIUS_M
        return north, k * cos_lat * math.sin(d_lon) * PX4_EARTH_RADIUS_M

    def to_geodetic(self, north_m: float, east_m: float) -> tuple[float, float]:
        """(lat_rad, lon_rad) of a place."""
        x, y = north_m / PX4_EARTH_RADIUS_M, east_m / PX4_EARTH_RADIUS_M
        c = math.hypot(x, y)
        if c < 1e-12:
            return self._lat, self._lon
        sin_c, cos_c = math.sin(c), math.cos(c)
        lat = math.asin(max(-1.0, min(1.0, cos_c * self._sin + x * sin_c * self._cos / c)))
        lon = self._lon + math.atan2(y * sin_c, c * self._cos * cos_c - x * self._sin * sin_c)
        return lat, _wrap(lon)


class OffsetProjection:
    """ArduPilot's: scaled differences of latitude and longitude, the cosine taken at the mean latitude."""

    def __init__(self, lat_rad: float, lon_rad: float) -> None:
        self._lat = lat_rad
        self._lon = lon_rad

    def _scale(self, lat_rad: float) -> float:
        return max(math.cos(lat_rad), 0.01)

    def to_local(self, lat_rad: float, lon_rad: float) -> tuple[float, float]:
        """(north_m, east_m) of a place."""
        scale = self._scale(0.5 * (lat_rad + self._lat))
        d_lon = lon_rad - self._lon
        if not -math.pi <= d_lon <= math.pi:
            d_lon = _wrap(d_lon)
        return (lat_rad - self._lat) * ARDUPILOT_M_PER_RAD, d_lon * ARDUPILOT_M_PER_RAD * scale

    def to_geodetic(self, north_m: float, east_m: float) -> tuple[float, float]:
        """(lat_rad, lon_rad) of a place."""
        d_lat = north_m / ARDUPILOT_M_PER_RAD
        scale = self._scale(self._lat + 0.5 * d_lat)
        return self._lat + d_lat, _wrap(self._lon + east_m / ARDUPILOT_M_PER_RAD / scale)


class Estimator:
    """The position estimate in the local frame (north, east, down of the origin, m) and the origin itself.

    ``healthy`` false means the estimate is frozen where it was, as after a filter failure. ``bias_*`` shift the
    estimate away from the truth (a fault).
    """

    def __init__(self, projection: type[SphereProjection] | type[OffsetProjection]) -> None:
        self._make = projection
        self.origin: tuple[float, float, float] | None = None
        self.projection: Projection | None = None
        self.healthy = True
        self.n = self.e = self.d = 0.0
        self.bias_n_m = self.bias_e_m = self.bias_d_m = 0.0

    def set_origin(self, lat_rad: float, lon_rad: float, alt_amsl_m: float) -> None:
        """Lays the local frame's origin: degrees go in and out of messages as 1e-7 degree, so it is rounded to that."""
        lat = math.radians(round(math.degrees(lat_rad) * 1e7) / 1e7)
        lon = math.radians(round(math.degrees(lon_rad) * 1e7) / 1e7)
        self.origin = (lat, lon, round(alt_amsl_m * 1e3) / 1e3)
        self.projection = self._make(lat, lon)

    def update(self, lat_rad: float, lon_rad: float, alt_amsl_m: float) -> None:
        """Takes a fix of the true place."""
        if self.projection is None or self.origin is None or not self.healthy:
            return
        north, east = self.projection.to_local(lat_rad, lon_rad)
        self.n = north + self.bias_n_m
        self.e = east + self.bias_e_m
        self.d = self.origin[2] - alt_amsl_m + self.bias_d_m
