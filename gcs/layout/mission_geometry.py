"""A mission laid on its plane: where everything is, and how far it truly is from there.

`MissionGeometry` is what planning, schedule and contingencies measure with. In a WGS84 mission distances are straight
lines through space (altitudes taken as ellipsoidal heights); in a local mission they are those of the plane, which is
the world there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gcs.geodesy import range_bounds
from gcs.geodesy.ellipsoid import ecef_m
from gcs.geodesy.plane import Plane
from gcs.geodesy.range_bounds import planning_elevation_deg
from gcs.mission.model import GeoPosition, LocalPosition, Mission, Position
from planner.arrays import Array, Indices
from planner.coverage import ElevationMask


def choose_plane(mission: Mission) -> Plane:
    """The plane a mission is planned in: its own origin, or one amid start, destination and stations at sea level.

    Deterministic: the middle of the box around them in a plane about the start, rounded to 1e-4 degree (11 m).
    """
    if mission.origin is not None:
        return Plane(mission.origin.lat_deg, mission.origin.lon_deg, mission.origin.alt_amsl_m)
    places = [mission.start, mission.destination, *(s.position for s in mission.stations)]
    at = np.array([(p.lat_deg, p.lon_deg) for p in places if isinstance(p, GeoPosition)])
    about_start = Plane(float(at[0, 0]), float(at[0, 1]))
    east, north = about_start.to_plane(at[:, 0], at[:, 1])
    lat, lon = about_start.to_geodetic((east.min() + east.max()) / 2, (north.min() + north.max()) / 2)
    # Rounding must not leave the globe's numbers: -180 <= longitude < 180 and |latitude| <= 90 survive it.
    return Plane(round(float(lat), 4), round(float(lon), 4), 0.0)


@dataclass(frozen=True)
class MissionGeometry:
    """A mission and its plane."""

    mission: Mission
    plane: Plane

    def renamed(self, mission: Mission) -> MissionGeometry:
        """The geometry of ``mission``, which has the same places under the same or other names and ids."""
        other = MissionGeometry(mission, self.plane)
        for name in ("stations_enu_m", "full_ranges_m", "elevation_mask", "_antennas"):
            if name in self.__dict__:
                other.__dict__[name] = self.__dict__[name]
        return other

    @property
    def is_local(self) -> bool:
        """Whether the plane's own distances are the true ones."""
        return self.mission.origin is not None

    def enu_m(self, positions: Sequence[Position]) -> Array:
        """``(N, 3)``: east, north, up in the plane."""
        result = np.empty((len(positions), 3))
        geo = [(i, p) for i, p in enumerate(positions) if isinstance(p, GeoPosition)]
        for i, position in enumerate(positions):
            if isinstance(position, LocalPosition):
                result[i] = position.east_m, position.north_m, position.up_m
        if geo:
            index = [i for i, _ in geo]
            east, north = self.plane.to_plane([p.lat_deg for _, p in geo], [p.lon_deg for _, p in geo])
            result[index] = np.stack([east, north, self.plane.up_m([p.alt_amsl_m for _, p in geo])], axis=-1)
        return result

    def geo(self, enu_m: Array) -> GeoPosition:
        """One plane point ``(3,)`` as latitude, longitude and altitude."""
        lat, lon = self.plane.to_geodetic(enu_m[0], enu_m[1])
        return GeoPosition(float(lat), float(lon), float(self.plane.altitude_amsl_m(enu_m[2])))

    @cached_property
    def stations_enu_m(self) -> Array:
        """``(M, 3)``: antennas in the plane."""
        return self.enu_m([s.position for s in self.mission.stations])

    @cached_property
    def full_ranges_m(self) -> Array:
        """``(M,)``: ranges as given."""
        return np.array([s.range_m for s in self.mission.stations])

    @cached_property
    def elevation_mask(self) -> ElevationMask:
        """``(M,)``: lowest elevations as given."""
        return ElevationMask.of_each(s.min_elevation_deg for s in self.mission.stations)

    def planning_mask(self, stations: Indices) -> ElevationMask:
        """``(M',)``: lowest elevations to plan with, raised by what the plane may show too high."""
        mask = self.elevation_mask.at(stations)
        if self.is_local:
            return mask
        raised = np.minimum(planning_elevation_deg(mask.lowest_deg, self.full_ranges_m[stations]), 89.9)
        return ElevationMask(np.where(mask.limited, raised, mask.lowest_deg))

    @cached_property
    def _antennas(self) -> tuple[Array, Array]:
        """Earth-centred positions of the antennas and the ups at them (ellipsoid normals), each ``(M, 3)``."""
        places = [s.position for s in self.mission.stations]
        at = np.array([(p.lat_deg, p.lon_deg, p.alt_amsl_m) for p in places if isinstance(p, GeoPosition)])
        lat, lon = np.radians(at[:, 0]), np.radians(at[:, 1])
        up = np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], axis=-1)
        return ecef_m(at[:, 0], at[:, 1], at[:, 2]), up

    def offsets_m(self, stations: Indices, enu_m: Array) -> tuple[Array, Array]:
        """True distance and height above the antenna's horizon, ``(...)``, of plane points ``(..., 3)``.

        ``stations`` broadcasts against the points.
        """
        if self.is_local:
            offset = enu_m - self.stations_enu_m[stations]
            return np.asarray(np.linalg.norm(offset, axis=-1)), np.asarray(offset[..., 2])
        lat, lon = self.plane.to_geodetic(enu_m[..., 0], enu_m[..., 1])
        antennas, ups = self._antennas
        offset = ecef_m(lat, lon, self.plane.altitude_amsl_m(enu_m[..., 2])) - antennas[stations]
        height = np.einsum("...i,...i->...", offset, np.broadcast_to(ups[stations], offset.shape))
        return np.asarray(np.linalg.norm(offset, axis=-1)), np.asarray(height)

    def true_range_m(self, stations: Indices, enu_m: Array) -> Array:
        """True distance ``(...)`` of plane points ``(..., 3)`` from stations that broadcast against them."""
        return self.offsets_m(stations, enu_m)[0]

    def outside_m(self, stations: Indices, enu_m: Array) -> Array:
        """How far outside its station's full range, or below its lowest elevation, each point is; negative inside."""
        distance, height = self.offsets_m(stations, enu_m)
        outside = distance - self.full_ranges_m[stations]
        mask = self.elevation_mask.at(stations)
        if mask.limited.any():
            below = np.sin(mask.angle_rad) * distance - height
            outside = np.where(mask.limited, np.maximum(outside, below), outside)
        return np.asarray(outside)

    # Both bounds take the altitude band of the mission: the vehicle is inside it.

    def _heights_m(self) -> tuple[Array, Array, Array]:
        limits = self.mission.limits
        antenna = self.plane.altitude_amsl_m(self.stations_enu_m[:, 2])
        highest = np.maximum(antenna, limits.max_alt_amsl_m)
        lowest = np.minimum(antenna, limits.min_alt_amsl_m)
        return highest, lowest, highest - lowest

    def inner_ranges_m(self, ranges_m: Array) -> Array:
        """``(M,)``: balls of the plane inside which the true ranges keep ``ranges_m``."""
        highest, _, difference = self._heights_m()
        return ranges_m if self.is_local else range_bounds.planning_range_m(ranges_m, highest, difference)

    def needed_ranges_m(self, inner_m: Array) -> Array:
        """``(M,)``: the true ranges whose balls of the plane (`inner_ranges_m`) have radius ``inner_m``."""
        highest, _, difference = self._heights_m()
        return inner_m if self.is_local else range_bounds.range_needed_m(inner_m, highest, difference)

    def outer_ranges_m(self, ranges_m: Array) -> Array:
        """``(M,)``: balls of the plane that hold every place truly within ``ranges_m``."""
        if self.is_local:
            return ranges_m
        _, lowest, difference = self._heights_m()
        from_origin = np.hypot(self.stations_enu_m[:, 0], self.stations_enu_m[:, 1])
        return range_bounds.bound_range_m(ranges_m, from_origin, lowest, difference)

    def range_bound_m(self, stations: Indices, enu_m: Array) -> Array:
        """Lengths no true range exceeds, ``(...)``; convex in the point, so control points speak for their curve."""
        offset = enu_m - self.stations_enu_m[stations]
        if self.is_local:
            return np.asarray(np.linalg.norm(offset, axis=-1))
        highest, _, _ = self._heights_m()
        flat = np.linalg.norm(offset[..., :2], axis=-1)
        return range_bounds.slant_range_bound_m(flat, offset[..., 2], highest[stations])
