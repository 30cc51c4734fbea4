"""How each autopilot turns latitude and longitude into its own local north and east.

Local NED is the vehicle's, from its EKF origin (GPS_GLOBAL_ORIGIN, message 49), with constants of its own. Against a
WGS84 azimuthal-equidistant plane at 53 N they differ by 0.2-0.3 % east: 330 m at 100 km. A local setpoint must
therefore be computed with the formula of the autopilot that will read it.

Sources: ArduPilot `libraries/AP_Common/Location.cpp` (get_distance_NE, longitude_scale), PX4 `src/lib/geo/geo.cpp`
(MapProjection). Both in degrees, metres north and east.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

ARDUPILOT_M_PER_E7_DEG = 0.011131884502145034
"""Metres per 1e-7 degree of latitude: a sphere of 6,378,100 m."""
_ARDUPILOT_MIN_SCALE = 0.01
PX4_RADIUS_M = 6_371_000.0


@dataclass(frozen=True)
class EkfOrigin:
    """Origin of a vehicle's local frame as it reported it; altitude above mean sea level."""

    lat_deg: float
    lon_deg: float
    alt_amsl_m: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.alt_amsl_m) and abs(self.lat_deg) <= 90.0 and abs(self.lon_deg) <= 180.0):
            raise ValueError(f"EKF origin {self} is no place on earth")

    @classmethod
    def from_message(cls, message: object) -> EkfOrigin:
        """From GPS_GLOBAL_ORIGIN (49): degE7 and millimetres."""
        return cls(
            message.latitude * 1e-7,  # type: ignore[attr-defined]
            message.longitude * 1e-7,  # type: ignore[attr-defined]
            message.altitude * 1e-3,  # type: ignore[attr-defined]
        )


def _wrap_deg(degrees: float) -> float:
    return (degrees + 180.0) % 360.0 - 180.0


def _longitude_scale(lat_deg: float) -> float:
    return max(math.cos(math.radians(lat_deg)), _ARDUPILOT_MIN_SCALE)


def ardupilot_north_east_m(origin: EkfOrigin, lat_deg: float, lon_deg: float) -> tuple[float, float]:
    """ArduPilot's offset from its origin: longitudes scaled by the cosine of the *mean* latitude of the two points.

    (Before 4.1 it was the origin's latitude alone; 100 km north of the origin the two differ by 1 % of the easting.)
    """
    north = (lat_deg - origin.lat_deg) * 1e7 * ARDUPILOT_M_PER_E7_DEG
    scale = _longitude_scale(0.5 * (lat_deg + origin.lat_deg))
    east = _wrap_deg(lon_deg - origin.lon_deg) * 1e7 * ARDUPILOT_M_PER_E7_DEG * scale
    return north, east


def ardupilot_lat_lon_deg(origin: EkfOrigin, north_m: float, east_m: float) -> tuple[float, float]:
    """Inverse of `ardupilot_north_east_m`."""
    lat = origin.lat_deg + north_m / (1e7 * ARDUPILOT_M_PER_E7_DEG)
    scale = _longitude_scale(0.5 * (lat + origin.lat_deg))
    return lat, _wrap_deg(origin.lon_deg + east_m / (1e7 * ARDUPILOT_M_PER_E7_DEG * scale))


def px4_north_east_m(origin: EkfOrigin, lat_deg: float, lon_deg: float) -> tuple[float, float]:
    """PX4's azimuthal-equidistant projection on a sphere of 6,371,000 m about its origin."""
    lat, lat0 = math.radians(lat_deg), math.radians(origin.lat_deg)
    turn = math.radians(_wrap_deg(lon_deg - origin.lon_deg))
    north = math.cos(lat0) * math.sin(lat) - math.sin(lat0) * math.cos(lat) * math.cos(turn)
    east = math.cos(lat) * math.sin(turn)
    # The angle by atan2, not by acos: exact near the origin too.
    sine = math.hypot(north, east)
    cosine = math.sin(lat0) * math.sin(lat) + math.cos(lat0) * math.cos(lat) * math.cos(turn)
    stretch = PX4_RADIUS_M * (math.atan2(sine, cosine) / sine if sine > 0.0 else 1.0)
    return stretch * north, stretch * east


def px4_lat_lon_deg(origin: EkfOrigin, north_m: float, east_m: float) -> tuple[float, float]:
    """Inverse of `px4_north_east_m`."""
    angle = math.hypot(north_m, east_m) / PX4_RADIUS_M
    if angle == 0.0:
        return origin.lat_deg, origin.lon_deg
    course = math.atan2(east_m, north_m)
    lat0 = math.radians(origin.lat_deg)
    lat = math.asin(math.sin(lat0) * math.cos(angle) + math.cos(lat0) * math.sin(angle) * math.cos(course))
    turn = math.atan2(
        math.sin(angle) * math.sin(course),
        math.cos(lat0) * math.cos(angle) - math.sin(lat0) * math.sin(angle) * math.cos(course),
    )
    return math.degrees(lat), _wrap_deg(origin.lon_deg + math.degrees(turn))
