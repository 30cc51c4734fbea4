"""The map plane of a mission, and true distances on the earth.

`Plane` is the azimuthal-equidistant projection of WGS84 about an origin: a point at geodesic distance s and azimuth A
lies at ``east = s sin A``, ``north = s cos A``. The third axis is altitude above mean sea level, counted from
the origin's. `gcs.geodesy.range_bounds` bounds what the plane does to distances.

Why not one call of geographiclib per point: a setpoint stream converts a hundred thousand points. The geodesics
that leave one origin are integrated here for all points at once, as curves on the quadric
x^2 + y^2 + z^2/b^2 = 1 (lengths in units of the equatorial radius): with g = grad F / 2 and H its (diagonal)
derivative,

    p'' = -(p' H p') g / (g g),      m'' = -K m,   K = 1 / (b^2 (g g)^2)

where m is Karney's reduced length (m12) and K the Gaussian curvature. No poles, no branches. Gragg's midpoint rule with
extrapolation over (2, 4, 6, 8) sub-steps on strides of at most 400 km leaves an error far below a micrometre; the
tests hold it against geographiclib and PROJ.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from gcs.geodesy.ellipsoid import WGS84_A_M, WGS84_B_M, WGS84_E2, ecef_m
from planner.arrays import Array

# Farthest from the origin a plane is used: beyond it distances would be stretched by more than 1.7 %.
MAX_PLANE_RADIUS_M = 2_000_000.0

_B2 = 1.0 - WGS84_E2
_STRIDE = 400_000.0 / WGS84_A_M
_SUBSTEPS = (2, 4, 6, 8)
_CHUNK = 32_768
# Nearer than this a point is the origin: divisions by the distance would only give noise.
_AT_ORIGIN_M = 1e-9


@dataclass(frozen=True)
class Plane:
    """Azimuthal-equidistant plane on WGS84 about an origin; altitudes count from ``alt_amsl_m``.

    Points farther than `MAX_PLANE_RADIUS_M` from the origin are refused with ``ValueError``.
    """

    lat_deg: float
    lon_deg: float
    alt_amsl_m: float = 0.0

    def __post_init__(self) -> None:
        if not (-90.0 <= self.lat_deg <= 90.0 and -180.0 <= self.lon_deg <= 180.0 and math.isfinite(self.alt_amsl_m)):
            raise ValueError(f"no such origin: {self}")

    @cached_property
    def _frame(self) -> tuple[Array, Array, Array]:
        # Origin at longitude zero (longitudes are added back): its position, true east and true north, unit radius.
        lat = math.radians(self.lat_deg)
        position = ecef_m(self.lat_deg, 0.0, 0.0) / WGS84_A_M
        return position, np.array([0.0, 1.0, 0.0]), np.array([-math.sin(lat), 0.0, math.cos(lat)])

    def _direct(self, east_m: Array, north_m: Array) -> tuple[Array, Array, Array]:
        """End points ``(3, N)``, unit tangents ``(3, N)`` and m12 / s12 ``(N,)`` for flat arrays ``(N,)``."""
        if not (np.hypot(east_m, north_m) <= 1.01 * MAX_PLANE_RADIUS_M).all():  # neither is NaN
            raise ValueError(f"plane coordinates must be finite and within {MAX_PLANE_RADIUS_M:.0f} m of the origin")
        metres, sine, cosine = _polar(east_m, north_m)
        distance = metres / WGS84_A_M
        origin, east, north = self._frame
        state = np.zeros((8, len(distance)))
        state[0:3] = origin[:, None]
        state[3:6] = east[:, None] * sine + north[:, None] * cosine
        state[7] = 1.0
        strides = max(1, math.ceil(float(distance.max(initial=0.0)) / _STRIDE))
        for _ in range(strides):
            state = _extrapolated_step(state, distance / strides)
        near = metres < _AT_ORIGIN_M
        stretch = np.where(near, 1.0, state[6] / np.where(near, 1.0, distance))
        return state[0:3], state[3:6], stretch

    def to_geodetic(self, east_m: ArrayLike, north_m: ArrayLike) -> tuple[Array, Array]:
        """Latitude and longitude in degrees of plane points (any shape)."""
        east, north = np.broadcast_arrays(np.asarray(east_m, float), np.asarray(north_m, float))
        shape = east.shape
        lat, lon = np.empty(east.size), np.empty(east.size)
        flat_east, flat_north = east.ravel(), north.ravel()
        for part in _parts(east.size):
            position, _, _ = self._direct(flat_east[part], flat_north[part])
            lat[part] = np.degrees(_latitude(position))
            lon[part] = _wrap_deg(np.degrees(np.arctan2(position[1], position[0])) + self.lon_deg)
        return lat.reshape(shape), lon.reshape(shape)

    def true_axes(self, east_m: ArrayLike, north_m: ArrayLike, alt_amsl_m: ArrayLike | None = None) -> Array:
        """Matrices ``(..., 2, 2)`` that take plane (east, north) velocities to true (east, north) ones at these points.

        The derivative of the projection's inverse: along the radius lengths are kept, across it they shrink by m12 /
        s12, and true north is turned by the convergence. With ``alt_amsl_m`` the velocity is that at this altitude,
        where the same change of latitude and longitude is a longer way than on the ellipsoid.
        """
        return self.geodetic_and_axes(east_m, north_m, alt_amsl_m)[2]

    def geodetic_and_axes(
        self, east_m: ArrayLike, north_m: ArrayLike, alt_amsl_m: ArrayLike | None = None
    ) -> tuple[Array, Array, Array]:
        """`to_geodetic` and `true_axes` of the same points at the price of one."""
        east, north = np.broadcast_arrays(np.asarray(east_m, float), np.asarray(north_m, float))
        shape = east.shape
        flat_east, flat_north = east.ravel(), north.ravel()
        lat, lon, axes = np.empty(east.size), np.empty(east.size), np.empty((east.size, 2, 2))
        for part in _parts(east.size):
            e, n = flat_east[part], flat_north[part]
            position, tangent, stretch = self._direct(e, n)
            _, sine, cosine = _polar(e, n)
            true_east, true_north = _components(position, tangent)
            # radius -> tangent, clockwise normal -> clockwise normal of the tangent times m12 / s12
            axes[part, 0, 0] = true_east * sine + stretch * true_north * cosine
            axes[part, 0, 1] = true_east * cosine - stretch * true_north * sine
            axes[part, 1, 0] = true_north * sine - stretch * true_east * cosine
            axes[part, 1, 1] = true_north * cosine + stretch * true_east * sine
            lat[part] = _latitude(position)
            lon[part] = np.arctan2(position[1], position[0])
        if alt_amsl_m is not None:
            height = np.broadcast_to(np.asarray(alt_amsl_m, float), shape).ravel()
            flat = 1.0 - WGS84_E2 * np.sin(lat) ** 2
            normal, meridian = WGS84_A_M / np.sqrt(flat), WGS84_A_M * (1.0 - WGS84_E2) / flat**1.5
            axes *= np.stack([1.0 + height / normal, 1.0 + height / meridian], axis=-1)[:, :, None]
        lon_deg = _wrap_deg(np.degrees(lon) + self.lon_deg)
        return np.degrees(lat).reshape(shape), lon_deg.reshape(shape), axes.reshape(*shape, 2, 2)

    def to_plane(self, lat_deg: ArrayLike, lon_deg: ArrayLike) -> tuple[Array, Array]:
        """East and north in metres of geodetic points (any shape), by Newton's method on `to_geodetic`.

        The start is the projection of a sphere, off by less than 0.6 %; each step squares the error.
        Raises ``ValueError`` for points beyond `MAX_PLANE_RADIUS_M`.
        """
        lat, lon = np.broadcast_arrays(np.asarray(lat_deg, float), np.asarray(lon_deg, float))
        east, north = np.empty(lat.size), np.empty(lat.size)
        for part in _parts(lat.size):
            east[part], north[part] = self._inverse(lat.ravel()[part], lon.ravel()[part])
        return east.reshape(lat.shape), north.reshape(lat.shape)

    def _inverse(self, lat_deg: Array, lon_deg: Array) -> tuple[Array, Array]:
        target = ecef_m(lat_deg, lon_deg - self.lon_deg, 0.0).T / WGS84_A_M
        _, axis_east, axis_north = self._frame
        # Directions by the ellipsoid's normals, distance by the sphere that fits the origin.
        normal = target / np.array([1.0, 1.0, _B2])[:, None]
        normal = normal / np.linalg.norm(normal, axis=0)
        up = np.cross(axis_east, axis_north)
        across_east, across_north = axis_east @ normal, axis_north @ normal
        sine = np.hypot(across_east, across_north)
        angle = np.arctan2(sine, up @ normal)
        if not (angle * WGS84_A_M <= MAX_PLANE_RADIUS_M * 1.005).all():
            raise ValueError(f"points must lie within {MAX_PLANE_RADIUS_M:.0f} m of the plane's origin")
        scale = np.where(sine > 0, angle / np.where(sine > 0, sine, 1.0), 1.0) * WGS84_B_M
        east, north = across_east * scale, across_north * scale
        for _ in range(4):
            position, tangent, stretch = self._direct(east, north)
            gap = (target - position) * WGS84_A_M
            _, sin_a, cos_a = _polar(east, north)
            # Along the tangent and across it (clockwise, seen from above), undone by 1 and by s12 / m12.
            outward = position / np.array([1.0, 1.0, _B2])[:, None]
            outward = outward / np.linalg.norm(outward, axis=0)
            clockwise = np.cross(tangent, outward, axis=0)
            along = np.einsum("ij,ij->j", gap, tangent)
            across = np.einsum("ij,ij->j", gap, clockwise) / stretch
            east = east + along * sin_a + across * cos_a
            north = north + along * cos_a - across * sin_a
            # The next error is about K s times the square of this one: far below a nanometre.
            if max(np.abs(along).max(initial=0.0), np.abs(across).max(initial=0.0)) < 1e-3:
                break
        return east, north

    def up_m(self, alt_amsl_m: ArrayLike) -> Array:
        """Third plane coordinate of an altitude above mean sea level."""
        return np.asarray(alt_amsl_m, float) - self.alt_amsl_m

    def altitude_amsl_m(self, up_m: ArrayLike) -> Array:
        """Altitude above mean sea level of a third plane coordinate."""
        return np.asarray(up_m, float) + self.alt_amsl_m


def _polar(east_m: Array, north_m: Array) -> tuple[Array, Array, Array]:
    """Distance from the origin in metres, sine and cosine of the azimuth (north at the origin itself)."""
    distance = np.hypot(east_m, north_m)
    near = distance < _AT_ORIGIN_M
    safe = np.where(near, 1.0, distance)
    return distance, np.where(near, 0.0, east_m / safe), np.where(near, 1.0, north_m / safe)


def _parts(size: int) -> list[slice]:
    return [slice(begin, min(begin + _CHUNK, size)) for begin in range(0, size, _CHUNK)]


def _latitude(position: Array) -> Array:
    return np.asarray(np.arctan2(position[2] / _B2, np.hypot(position[0], position[1])))


def _wrap_deg(lon_deg: Array) -> Array:
    return np.asarray((lon_deg + 180.0) % 360.0 - 180.0)


def _components(position: Array, tangent: Array) -> tuple[Array, Array]:
    """True east and north parts of unit tangents, normalised so that rounding cannot change a speed."""
    lon, lat = np.arctan2(position[1], position[0]), _latitude(position)
    east = -np.sin(lon) * tangent[0] + np.cos(lon) * tangent[1]
    north = np.cos(lat) * tangent[2] - np.sin(lat) * (np.cos(lon) * tangent[0] + np.sin(lon) * tangent[1])
    length = np.hypot(east, north)
    return east / length, north / length


def _slope(state: Array) -> Array:
    """Derivative by arc length of (position, tangent, m, m')."""
    x, y, z, tx, ty, tz, m, dm = state
    gz = z / _B2
    steep = x * x + y * y + gz * gz
    pull = -(tx * tx + ty * ty + tz * tz / _B2) / steep
    return np.stack([tx, ty, tz, pull * x, pull * y, pull * gz, dm, -m / (_B2 * steep * steep)])


def _extrapolated_step(state: Array, step: Array) -> Array:
    """One stride of Gragg's midpoint rule, extrapolated to the limit of small sub-steps (Aitken-Neville in h^2)."""
    first = _slope(state)
    table: list[Array] = []
    for row, count in enumerate(_SUBSTEPS):
        h = step / count
        before, now = state, state + h * first
        for _ in range(count - 1):
            before, now = now, before + 2.0 * h * _slope(now)
        current = 0.5 * (before + now + h * _slope(now))
        previous, table = table, [current]
        for column in range(row):
            ratio = (count / _SUBSTEPS[row - column - 1]) ** 2
            table.append(table[column] + (table[column] - previous[column]) / (ratio - 1.0))
    return table[-1]
