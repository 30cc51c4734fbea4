"""What the vehicle says of places, believed or not: 0/0, INT32_MAX, far from the plan, impossible jumps are no place.

Autopilots and radios do send such: a position before there is one, the integer's end for "unknown", an estimate that
was reset. What is not believed changes nothing and is kept as a reason to tell; it never raises.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from link.autopilot.local_frame import EkfOrigin
from link.autopilot.profile import ALTITUDE_BAND_AMSL_M

MOST_SPEED_M_S = 200.0
"""No rotorcraft; 327.67 is the field's end."""
JUMP_M = 20.0
JUMP_SHARE = 1.5
JUMP_MORE_M_S = 10.0
"""A place may differ from the one before by `JUMP_M` and this share of the way its speed, and so much more, takes."""
JUMP_TOLD = 3
"""A jump is believed when so many places in a row agree with it: the estimate has been laid anew."""
EARTH_M = 6_371_000.0
SAME_PLACE_M = 0.2


@dataclass(frozen=True, slots=True)
class Position:
    """GLOBAL_POSITION_INT (33): degrees, metres AMSL, m/s true north/east/down.

    ``boot_s`` is the vehicle's clock, ``heard_s`` ours when it came.
    """

    boot_s: float
    heard_s: float
    lat_deg: float
    lon_deg: float
    alt_amsl_m: float
    velocity_ned_m_s: tuple[float, float, float]

    @classmethod
    def from_message(cls, heard_s: float, m: Any) -> Position:
        """From a GLOBAL_POSITION_INT that came at ``heard_s``."""
        velocity = (m.vx * 0.01, m.vy * 0.01, m.vz * 0.01)
        return cls(m.time_boot_ms * 1e-3, heard_s, m.lat * 1e-7, m.lon * 1e-7, m.alt * 1e-3, velocity)

    @property
    def speed_m_s(self) -> float:
        """Speed over ground and up, together."""
        return math.hypot(*self.velocity_ned_m_s)


@dataclass(frozen=True, slots=True)
class HomePlace:
    """HOME_POSITION (242): where the vehicle returns to, and when that was told."""

    heard_s: float
    lat_deg: float
    lon_deg: float
    alt_amsl_m: float


@dataclass(frozen=True, slots=True)
class Reach:
    """How far from a flight's plan anything of the vehicle may be: a circle about a place."""

    lat_deg: float
    lon_deg: float
    radius_m: float


def apart_m(lat_deg: float, lon_deg: float, other_lat_deg: float, other_lon_deg: float) -> float:
    """Distance of two places over a sphere, metres: right to half a per cent."""
    a, b = math.radians(lat_deg), math.radians(other_lat_deg)
    half = math.sin(0.5 * (b - a)) ** 2
    half += math.cos(a) * math.cos(b) * math.sin(0.5 * math.radians(other_lon_deg - lon_deg)) ** 2
    return 2.0 * EARTH_M * math.asin(min(1.0, math.sqrt(half)))


def no_place(lat_deg: float, lon_deg: float, alt_amsl_m: float, reach: Reach | None) -> str:
    """Why this is no place a vehicle of the flight can be at; empty where it can."""
    if not (abs(lat_deg) <= 90.0 and abs(lon_deg) <= 180.0):
        return f"latitude {lat_deg:g}, longitude {lon_deg:g} is no place on earth"
    if lat_deg == 0.0 and lon_deg == 0.0:
        return "latitude 0, longitude 0 means that there is none"
    low_m, high_m = ALTITUDE_BAND_AMSL_M
    if not low_m <= alt_amsl_m <= high_m:
        return f"altitude {alt_amsl_m:g} m AMSL is outside {low_m:g} to {high_m:g}"
    if reach is not None:
        away_m = apart_m(lat_deg, lon_deg, reach.lat_deg, reach.lon_deg)
        if away_m > reach.radius_m:
            return f"it is {away_m / 1000.0:.0f} km from the plan"
    return ""


def same_origin(one: EkfOrigin, other: EkfOrigin) -> bool:
    """Whether two EKF origins are the same place, to `SAME_PLACE_M`."""
    away_m = apart_m(one.lat_deg, one.lon_deg, other.lat_deg, other.lon_deg)
    return math.hypot(away_m, one.alt_amsl_m - other.alt_amsl_m) <= SAME_PLACE_M


class PositionGate:
    """The newest position that is believed. `take` what is told, in the order of its stamps."""

    def __init__(self, reach: Reach | None = None) -> None:
        self.position: Position | None = None
        self.refused = ""
        """Why the last position told was not believed; empty where it was."""
        self.jumps = 0
        """How often the estimate was laid anew."""
        self.jumped_m = 0.0
        self.still_since_s = math.inf
        """Since when the vehicle has not moved."""
        self.same_since_s = math.inf
        """Since when the very same place has been told, whatever speed was told with it."""
        self._reach = reach
        self._suspect: Position | None = None
        self._told = 0

    def forget(self) -> None:
        """The vehicle restarted: nothing is known."""
        self.position = self._suspect = None
        self.still_since_s = self.same_since_s = math.inf
        self.refused = ""

    def take(self, new: Position) -> bool:
        """Judge a position; whether it is believed."""
        self.refused = no_place(new.lat_deg, new.lon_deg, new.alt_amsl_m, self._reach)
        if not self.refused and max(map(abs, new.velocity_ned_m_s)) > MOST_SPEED_M_S:
            self.refused = f"a speed of {new.speed_m_s:.0f} m/s"
        if self.refused:
            return False
        before = self.position
        if before is not None and not _follows(before, new):
            self._told = self._told + 1 if self._suspect is not None and _follows(self._suspect, new) else 1
            self._suspect = new
            if self._told < JUMP_TOLD:
                self.refused = f"a jump of {_away_m(before, new):.0f} m"
                return False
            self.jumps += 1
            self.jumped_m = _away_m(before, new)
        same = before is not None and _place(before) == _place(new)
        self.same_since_s = min(self.same_since_s, new.heard_s) if same else new.heard_s
        self._suspect, self.position = None, new
        if new.speed_m_s > STILL_M_S:
            self.still_since_s = math.inf
        else:
            self.still_since_s = min(self.still_since_s, new.heard_s)
        return True


STILL_M_S = 0.5
"""Slower than this a vehicle does not move."""


def _place(one: Position) -> tuple[float, float, float]:
    return one.lat_deg, one.lon_deg, one.alt_amsl_m


def _away_m(one: Position, other: Position) -> float:
    flat_m = apart_m(one.lat_deg, one.lon_deg, other.lat_deg, other.lon_deg)
    return math.hypot(flat_m, other.alt_amsl_m - one.alt_amsl_m)


def _follows(before: Position, after: Position) -> bool:
    """Whether a vehicle can have got from one place to the other between their stamps."""
    between_s = max(0.0, after.boot_s - before.boot_s)
    speed_m_s = max(before.speed_m_s, after.speed_m_s) + JUMP_MORE_M_S
    return _away_m(before, after) <= JUMP_M + JUMP_SHARE * speed_m_s * between_s
