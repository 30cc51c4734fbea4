"""Elevation masks: what lies too low over the horizon for an antenna to hear, as a cone above it.

            │       ╱  heard            A vehicle h above an antenna and d aside of it is heard where
          h │     ╱                         h >= slope d,    slope = tan(lowest elevation);
            │   ╱   not heard           at a lowest elevation of zero that is all above the antenna's horizon.
            │ ╱ lowest elevation
            O─────────────────── d

The only place that knows the cone's formula and the angle that stands for a station without a mask.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from planner.arrays import Array, Flags, Indices
from planner.problem import UNMASKED_DEG, Problem


@dataclass(frozen=True, eq=False)
class ElevationMask:
    """Lowest elevations of stations, ``lowest_deg`` ``(...)``: from 0 to below 90, `UNMASKED_DEG` for none.

    Every property has the shape of ``lowest_deg``; methods broadcast against it.
    """

    lowest_deg: Array

    @classmethod
    def of(cls, problem: Problem) -> ElevationMask | None:
        """Those of a problem's stations ``(M,)``; None when it gives none, and no range is narrower than its ball."""
        return None if problem.min_elevation_deg is None else cls(problem.min_elevation_deg)

    @classmethod
    def of_each(cls, lowest_deg: Iterable[float | None]) -> ElevationMask:
        """One a station, None for a station without."""
        return cls(np.array([UNMASKED_DEG if angle is None else angle for angle in lowest_deg], dtype=float))

    @classmethod
    def none(cls, count: int) -> ElevationMask:
        """``count`` stations without a mask."""
        return cls(np.full(count, UNMASKED_DEG))

    def at(self, station: int | Indices | slice) -> ElevationMask:
        """The masks of some stations: an index into ``lowest_deg``, of any shape."""
        return ElevationMask(np.asarray(self.lowest_deg[station]))

    @cached_property
    def limited(self) -> Flags:
        """Which stations have a mask; one at zero degrees is one."""
        return np.asarray(self.lowest_deg >= 0.0)

    @cached_property
    def angle_rad(self) -> Array:
        """Lowest elevation in radians, zero where there is none."""
        return np.asarray(np.radians(np.maximum(self.lowest_deg, 0.0)))

    @cached_property
    def slope(self) -> Array:
        """Height per metre of horizontal distance along the cone; zero for a horizon, and where there is no mask."""
        return np.asarray(np.tan(self.angle_rad))

    @cached_property
    def horizon(self) -> Flags:
        """Which masks are flat: a half-space above the antenna instead of a cone."""
        return np.asarray(self.limited & (self.slope == 0.0))

    @cached_property
    def cone(self) -> Flags:
        """Which masks are cones that narrow upwards from nothing: neither absent nor flat."""
        return np.asarray(self.slope > 0.0)

    def below_m(self, offset_m: Array) -> Array:
        """Metres by which points lie below the mask, measured vertically ``(...)``; minus infinity without one.

        ``offset_m`` ``(..., 3)`` counts from the antenna.
        """
        below = self.slope * np.linalg.norm(offset_m[..., :2], axis=-1) - offset_m[..., 2]
        return np.where(self.limited, below, -np.inf)

    def lowest_alt_m(self, antenna_alt_m: Array, away_m: Array) -> Array:
        """Lowest altitude heard ``away_m`` from the antenna's axis; minus infinity without a mask."""
        return np.where(self.limited, antenna_alt_m + self.slope * away_m, -np.inf)

    def reach_m(self, height_m: Array) -> Array:
        """How far from its axis a station hears at ``height_m`` above the antenna: infinite without a mask.

        Zero below a masked antenna, infinite at and above a flat one. Ranges are another matter.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            per_metre = np.cos(self.angle_rad) / np.sin(self.angle_rad)
            reach = np.where(height_m >= 0.0, np.where(np.isinf(per_metre), np.inf, height_m * per_metre), 0.0)
        return np.where(self.limited, reach, np.inf)
