"""What is to be planned: stations, ends, limits, all in one plane with altitude as the third axis.

Whoever makes a `Problem` has laid the earth out flat and taken margins off; here everything is exact.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from planner.arrays import Array, Indices
from planner.errors import ProblemError

# What stands in `Problem.min_elevation_deg` for a station without that limit (see `planner.coverage.elevation_mask`).
UNMASKED_DEG = -90.0
# Least time given up for fewer handovers where any may be.
HANDOVER_TOLERANCE_S = 1.0
# What a wider overlap may cost: a part of the mission time, and seconds at least.
OVERLAP_PRICE, OVERLAP_PRICE_S = 0.001, 1.0


@dataclass(frozen=True)
class Limits:
    """What the vehicle can and may do. SI units; ``None`` is unlimited.

    Altitudes share the reference of the problem's third axis. ``wind_m_s`` is (east, north), and
    ``max_airspeed_m_s`` bounds the speed relative to it.
    """

    min_alt_m: float
    max_alt_m: float
    max_speed_m_s: float
    max_accel_m_s2: float
    max_jerk_m_s3: float | None = None
    max_climb_m_s: float | None = None
    max_descent_m_s: float | None = None
    max_airspeed_m_s: float | None = None
    wind_m_s: tuple[float, float] = (0.0, 0.0)
    max_duration_s: float | None = None

    def __post_init__(self) -> None:
        for name in ("max_speed_m_s", "max_accel_m_s2"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise ProblemError(f"{name} must be positive and finite, not {getattr(self, name)}")
        if not (np.isfinite([self.min_alt_m, self.max_alt_m]).all() and self.min_alt_m <= self.max_alt_m):
            raise ProblemError(f"altitude band {self.min_alt_m} .. {self.max_alt_m} m is upside down or not finite")
        for name in ("max_jerk_m_s3", "max_climb_m_s", "max_descent_m_s", "max_airspeed_m_s", "max_duration_s"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value > 0):
                raise ProblemError(f"{name} must be positive and finite, or None for no limit, not {value}")
        if len(self.wind_m_s) != 2 or not np.isfinite(self.wind_m_s).all():
            raise ProblemError(f"wind_m_s must be two finite numbers (east, north), not {self.wind_m_s}")


class WindField(Protocol):
    """A wind that is not the same everywhere."""

    def at(self, points_m: Array) -> Array:
        """``(..., 2)``: where the air goes to, east and north, at points ``(..., 3)`` of the plane."""
        ...


@dataclass(frozen=True, eq=False)
class Problem:
    """A planning problem in the plane: metres (east, north, altitude), seconds.

    ``start_m``, ``destination_m`` are ``(3,)``; ``station_positions_m`` ``(M, 3)``; ``ranges_m`` ``(M,)`` are the
    ranges to plan with: whoever builds the problem has already taken margins and projection errors off.
    ``bound_ranges_m`` ``(M,)`` are ranges no true trajectory can exceed, used for the lower bound alone
    (default: ``ranges_m``); ``bound_speed_factor`` >= 1 is how much faster than ``max_speed_m_s`` the plane may show
    a vehicle that keeps the limit on the real earth. ``min_overlap_s``: around each handover both stations
    cover the vehicle at least half of it before and half after; ``min_tenure_s``: least time a station is in
    control where there is more than one. All three zero and no optional limit: the paper's (P1).
    ``handover_tolerance``: part of the fastest plan's time, and at least `HANDOVER_TOLERANCE_S`, given up for fewer
    handovers; 0 asks for the fastest plan. ``overlap_after_target_s``: how long after a handover the station it is
    handed over from is to cover the vehicle still, where that costs no more than `price_s`.

    ``min_elevation_deg`` ``(M,)`` or None: lowest elevation angle at which a station hears the vehicle, from 0 to
    below 90; `UNMASKED_DEG` for a station without that limit (angles between would make the range bulge inwards).
    ``start_velocity_m_s``, ``start_acceleration_m_s2`` ``(3,)``: state at T+0, at rest unless replanning.

    ``wind``: the wind from place to place, where ``limits.wind_m_s`` is only what it is like on the whole.

    Raises `ProblemError` for shapes that do not fit and numbers that are not finite.
    """

    start_m: Array
    destination_m: Array
    station_positions_m: Array
    ranges_m: Array
    limits: Limits
    min_overlap_s: float = 0.0
    min_tenure_s: float = 0.0
    max_handovers: int | None = None
    handover_tolerance: float = 0.0
    overlap_after_target_s: float = 0.0
    bound_ranges_m: Array | None = None
    bound_speed_factor: float = 1.0
    min_elevation_deg: Array | None = None
    wind: WindField | None = None
    start_velocity_m_s: Array = field(default_factory=lambda: np.zeros(3))
    start_acceleration_m_s2: Array = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        m = np.asarray(self.ranges_m).shape[0] if np.ndim(self.ranges_m) == 1 else -1
        if m < 1:
            raise ProblemError(f"ranges_m must be (M,) with at least one station, not {np.shape(self.ranges_m)}")
        shapes = {
            "start_m": (3,),
            "destination_m": (3,),
            "start_velocity_m_s": (3,),
            "start_acceleration_m_s2": (3,),
            "station_positions_m": (m, 3),
            "ranges_m": (m,),
            "bound_ranges_m": (m,),
            "min_elevation_deg": (m,),
        }
        for name, shape in shapes.items():
            value = getattr(self, name)
            if value is None:
                continue
            array = np.array(value, dtype=float)
            if array.shape != shape or not np.isfinite(array).all():
                raise ProblemError(f"{name} must be finite and of shape {shape}, not {array.shape}")
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        for name in ("min_overlap_s", "min_tenure_s", "handover_tolerance", "overlap_after_target_s"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) >= 0):
                raise ProblemError(f"{name} must be finite and not negative, not {getattr(self, name)}")
        if self.max_handovers is not None and self.max_handovers < 0:
            raise ProblemError(f"max_handovers must not be negative, not {self.max_handovers}")
        if not (np.isfinite(self.bound_speed_factor) and self.bound_speed_factor >= 1.0):
            raise ProblemError(f"bound_speed_factor must be at least 1, not {self.bound_speed_factor}")
        if self.min_elevation_deg is not None:
            angle = self.min_elevation_deg
            if not ((angle == UNMASKED_DEG) | ((angle >= 0.0) & (angle < 90.0))).all():
                raise ProblemError(f"min_elevation_deg must be from 0 to below 90, or {UNMASKED_DEG:.0f} for no limit")

    @property
    def station_count(self) -> int:
        """Number of stations ``M``."""
        return len(self.ranges_m)

    def covers(self, position_m: Array, *, slack_m: float = 0.0) -> Indices:
        """Indices of the stations whose ball holds ``position_m`` ``(3,)``, given ``slack_m`` of extra range."""
        distance = np.linalg.norm(self.station_positions_m - position_m, axis=1)
        return np.flatnonzero(distance <= self.ranges_m + slack_m)

    @property
    def handovers_cost_time(self) -> bool:
        """Whether a handover takes time, which sequences then differ by: a least overlap or a least tenure is asked."""
        return self.min_overlap_s > 0.0 or self.min_tenure_s > 0.0

    def slowest_s(self, fastest_s: float) -> float:
        """How long a flight with fewer handovers than the fastest, which takes ``fastest_s``, may take."""
        if self.handover_tolerance == 0.0:
            return fastest_s
        return fastest_s + max(self.handover_tolerance * fastest_s, HANDOVER_TOLERANCE_S)

    @staticmethod
    def price_s(mission_time_s: float) -> float:
        """The most that reaching ``overlap_after_target_s`` may cost, for each handover that it is reached at."""
        return max(OVERLAP_PRICE * mission_time_s, OVERLAP_PRICE_S)

    @property
    def starts_at_rest(self) -> bool:
        """Whether velocity and acceleration at T+0 are zero: then any flight may also be flown slower."""
        return not (self.start_velocity_m_s.any() or self.start_acceleration_m_s2.any())

    def ends_in_band(self) -> bool:
        """Whether start and destination lie inside the altitude band."""
        low, high = sorted((float(self.start_m[2]), float(self.destination_m[2])))
        return self.limits.min_alt_m <= low and high <= self.limits.max_alt_m

    def disc_plane_m(self) -> Array:
        """``(M,)``: altitude at which each station's cross-section inside the band is largest.

        The erratum to the paper's Proposition 1: clamp(h, z_min, z_max), which is z_min for antennas below the band.
        """
        return np.clip(self.station_positions_m[:, 2], self.limits.min_alt_m, self.limits.max_alt_m)
