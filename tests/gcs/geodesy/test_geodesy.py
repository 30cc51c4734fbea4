"""The map plane against geographiclib and PROJ, and the range bounds against sampled truth."""

from __future__ import annotations

import math

import numpy as np
import pyproj
import pytest
from geographiclib.geodesic import Geodesic
from hypothesis import given, settings
from hypothesis import strategies as st

from gcs.geodesy.ellipsoid import ecef_m, elevation_deg, slant_range_m
from gcs.geodesy.plane import MAX_PLANE_RADIUS_M, Plane
from gcs.geodesy.range_bounds import (
    GEOID_MAX_M,
    GEOID_MIN_M,
    GEOID_SLOPE,
    bound_range_m,
    bound_speed_factor,
    height_factor,
    plane_stretch,
    planning_elevation_deg,
    planning_range_m,
    slant_range_bound_m,
)

LATS = st.floats(-90, 90)
LONS = st.floats(-180, 180)
BEARINGS = st.floats(-180, 180)


@settings(max_examples=60, deadline=None)
@given(LATS, LONS, st.integers(0, 2**31), st.sampled_from([1e2, 1e4, 1e5, 5e5, 1.9e6]))
def test_plane_to_geodetic_agrees_with_geographiclib_to_a_micrometre(
    lat: float, lon: float, seed: int, reach: float
) -> None:
    rng = np.random.default_rng(seed)
    distance, bearing = rng.uniform(0, reach, 4), rng.uniform(-180, 180, 4)
    east, north = distance * np.sin(np.radians(bearing)), distance * np.cos(np.radians(bearing))
    plane = Plane(lat, lon)
    lats, lons = plane.to_geodetic(east, north)
    for i in range(4):
        exact = Geodesic.WGS84.Direct(lat, lon, bearing[i], distance[i])
        off = Geodesic.WGS84.Inverse(exact["lat2"], exact["lon2"], lats[i], lons[i])["s12"]
        assert off < 1e-6
        assert -180 <= lons[i] < 180
    back_east, back_north = plane.to_plane(lats, lons)
    assert np.hypot(back_east - east, back_north - north).max() < 1e-6


@pytest.mark.parametrize(("lat", "lon"), [(53.0, 5.0), (0.0, 179.99), (89.9, 10.0), (-33.0, -70.0)])
def test_plane_agrees_with_proj(lat: float, lon: float) -> None:
    """PROJ's aeqd with the same origin is an independent implementation."""
    proj = pyproj.Proj(proj="aeqd", lat_0=lat, lon_0=lon, ellps="WGS84")
    rng = np.random.default_rng(7)
    east, north = rng.uniform(-150e3, 150e3, 200), rng.uniform(-150e3, 150e3, 200)
    lats, lons = Plane(lat, lon).to_geodetic(east, north)
    lon_p, lat_p = proj(east, north, inverse=True)
    off = slant_range_m(lats, lons, 0.0, lat_p, lon_p, 0.0)
    assert off.max() < 1e-5
    east_p, north_p = proj(lons, lats)
    assert np.hypot(east_p - east, north_p - north).max() < 1e-5


def test_many_points_equal_one_by_one() -> None:
    """Chunks must not show: 70,000 points at once are those of single calls."""
    rng = np.random.default_rng(3)
    plane = Plane(52.0, 4.0)
    east, north = rng.uniform(-9e4, 9e4, 70_000), rng.uniform(-9e4, 9e4, 70_000)
    lat, lon = plane.to_geodetic(east, north)
    for i in (0, 32_767, 32_768, 69_999):
        one_lat, one_lon = plane.to_geodetic(east[i], north[i])
        assert abs(float(one_lat) - lat[i]) < 1e-12
        assert abs(float(one_lon) - lon[i]) < 1e-12
    assert plane.to_geodetic(np.zeros((2, 3)), np.zeros((2, 3)))[0].shape == (2, 3)
    assert plane.to_geodetic(np.zeros(0), np.zeros(0))[0].shape == (0,)


@settings(max_examples=40, deadline=None)
@given(st.floats(-80, 80), LONS, BEARINGS, st.floats(0, 300e3), BEARINGS)
def test_true_axes_are_the_derivative_of_the_projection(
    lat: float, lon: float, bearing: float, distance: float, heading: float
) -> None:
    """A step of 10 m in the plane is, on the ellipsoid, a step along the turned and shrunken axes."""
    plane = Plane(lat, lon)
    east, north = distance * math.sin(math.radians(bearing)), distance * math.cos(math.radians(bearing))
    step = np.array([math.sin(math.radians(heading)), math.cos(math.radians(heading))])
    half = 5.0 * step
    lat1, lon1 = plane.to_geodetic(east - half[0], north - half[1])
    lat2, lon2 = plane.to_geodetic(east + half[0], north + half[1])
    lat0, _ = plane.to_geodetic(east, north)
    inverse = Geodesic.WGS84.Inverse(float(lat1), float(lon1), float(lat2), float(lon2))
    # azimuth at the middle of the step: the geodesic's azimuth turns with longitude times sin(latitude)
    middle = Geodesic.WGS84.Direct(float(lat1), float(lon1), inverse["azi1"], inverse["s12"] / 2)
    assert abs(middle["lat2"] - float(lat0)) < 1e-9
    azimuth = math.radians(middle["azi2"])
    true = plane.true_axes(east, north) @ step
    assert true == pytest.approx(np.array([math.sin(azimuth), math.cos(azimuth)]) * inverse["s12"] / 10.0, abs=2e-8)


def test_meridian_convergence_by_hand() -> None:
    """130 km east of 53 N: dlon sin(lat) = 1.944 deg x 0.798 = 1.55 deg, so 0.81 m/s at 30 m/s; east is right."""
    axes = Plane(53.0, 5.0).true_axes(130e3, 0.0)
    velocity = axes @ np.array([0.0, 30.0])
    assert math.degrees(math.atan2(velocity[0], velocity[1])) == pytest.approx(1.55, abs=0.02)
    assert abs(velocity[0]) == pytest.approx(0.81, abs=0.01)


def test_axes_at_altitude_grow_by_the_radius() -> None:
    """At 45 N, 6,371 m up, ways are longer by about a thousandth."""
    plane = Plane(45.0, 0.0)
    ratio = plane.true_axes(0.0, 0.0, 6371.0) / (plane.true_axes(0.0, 0.0) + np.array([[0, 1], [1, 0]]))
    assert ratio[0, 0] == pytest.approx(1.001, abs=3e-6)
    assert ratio[1, 1] == pytest.approx(1.001, abs=3e-6)


@pytest.mark.parametrize("point", [(MAX_PLANE_RADIUS_M * 1.05, 0.0), (math.nan, 0.0), (0.0, math.inf)])
def test_points_off_the_plane_are_refused(point: tuple[float, float]) -> None:
    with pytest.raises(ValueError, match="of the origin"):
        Plane(50.0, 5.0).to_geodetic(*point)


def test_points_on_the_other_side_of_the_earth_are_refused() -> None:
    with pytest.raises(ValueError, match="origin"):
        Plane(50.0, 5.0).to_plane(-50.0, -175.0)
    with pytest.raises(ValueError, match="no such origin"):
        Plane(91.0, 0.0)


def test_slant_range_by_hand() -> None:
    """Straight up it is the difference of heights; a quarter round the equator it is a sqrt 2."""
    assert float(slant_range_m(53, 5, 0, 53, 5, 120)) == pytest.approx(120.0, abs=1e-9)
    assert float(slant_range_m(0, 0, 0, 0, 90, 0)) == pytest.approx(6378137.0 * math.sqrt(2), abs=1e-6)
    assert ecef_m(90.0, 0.0, 0.0)[2] == pytest.approx(6356752.314245, abs=1e-5)


def test_elevation_by_hand() -> None:
    """10 km away at the same height a point lies half the central angle below the horizon: 0.045 deg."""
    lat2 = math.degrees(10_000 / 6_335_439)  # along the meridian at the equator, radius b^2 / a
    assert float(elevation_deg(0.0, 0.0, 0.0, lat2, 0.0, 0.0)) == pytest.approx(-0.0452, abs=2e-4)
    assert float(elevation_deg(10.0, 20.0, 0.0, 10.0, 20.0, 50.0)) == pytest.approx(90.0, abs=1e-6)


PLACES = st.tuples(st.floats(-89, 89), LONS)
HEIGHTS = st.floats(-400, 9000)


@pytest.mark.slow
@settings(max_examples=300, deadline=None)
@given(
    origin=PLACES,
    station=st.tuples(BEARINGS, st.floats(0, 1.0)),
    vehicle=st.tuples(BEARINGS, st.floats(0, 1.0)),
    reach=st.sampled_from([200e3, 1000e3]),
    range_m=st.floats(500, 300e3),
    heights=st.tuples(HEIGHTS, HEIGHTS),
    geoid=st.tuples(st.floats(GEOID_MIN_M, GEOID_MAX_M), st.floats(-1, 1)),
)
def test_range_bounds_hold_on_the_real_earth(
    origin: tuple[float, float],
    station: tuple[float, float],
    vehicle: tuple[float, float],
    reach: float,
    range_m: float,
    heights: tuple[float, float],
    geoid: tuple[float, float],
) -> None:
    """Random station, vehicle and geoid: the true slant range lies between the bounds that plan and bound use."""
    plane = Plane(*origin)
    s_east, s_north = _polar(station[0], station[1] * reach)
    d_east, d_north = _polar(vehicle[0], vehicle[1] * range_m)
    if math.hypot(s_east + d_east, s_north + d_north) > MAX_PLANE_RADIUS_M:
        return
    lat, lon = plane.to_geodetic([s_east, s_east + d_east], [s_north, s_north + d_north])
    low, high = min(heights), max(heights)
    d, dh = math.hypot(d_east, d_north), high - low
    ground = Geodesic.WGS84.Inverse(lat[0], lon[0], lat[1], lon[1])["s12"]
    assert ground <= d * (1 + 1e-12) + 1e-6  # the plane never shows two points too near
    n_station = geoid[0]
    n_vehicle = float(np.clip(n_station + geoid[1] * GEOID_SLOPE * ground, GEOID_MIN_M, GEOID_MAX_M))
    true = float(slant_range_m(lat[0], lon[0], heights[0] + n_station, lat[1], lon[1], heights[1] + n_vehicle))
    assert true <= float(slant_range_bound_m(d, dh, high)) + 1e-6
    # inside the planning ball of a range, the true range is kept
    distance = math.hypot(d, dh)
    if distance <= float(planning_range_m(range_m, high, dh)):
        assert true <= range_m + 1e-6
    # whatever is truly in range lies inside the ball of the lower bound
    assert distance <= float(bound_range_m(true, math.hypot(s_east, s_north), low, dh)) + 1e-6


def _polar(bearing_deg: float, distance_m: float) -> tuple[float, float]:
    return distance_m * math.sin(math.radians(bearing_deg)), distance_m * math.cos(math.radians(bearing_deg))


def test_range_corrections_are_small() -> None:
    """A 16 km range at 120 m loses under a metre, and the bound's ball gains about half a metre near the origin."""
    assert 16_000 - 1.0 < float(planning_range_m(16_000.0, 120.0, 119.0)) < 16_000
    assert 16_000 < float(bound_range_m(16_000.0, 50e3, 0.0, 119.0)) < 16_001
    assert float(planning_range_m(0.0, 120.0, 119.0)) == 0.0
    assert float(planning_range_m(-5.0, 120.0, 119.0)) == -5.0
    assert float(height_factor(-200.0)) == 1.0


@settings(max_examples=60, deadline=None)
@given(PLACES, BEARINGS, st.floats(0, 1.5e6), BEARINGS, st.floats(-400, 5000))
def test_speed_factors_hold(
    origin: tuple[float, float], bearing: float, distance: float, heading: float, height: float
) -> None:
    """True speed lies between plane speed over the bound's factor and plane speed times the height factor."""
    axes = Plane(*origin).true_axes(*_polar(bearing, distance), height)
    true = float(np.linalg.norm(axes @ np.array(_polar(heading, 1.0))))
    assert true <= float(height_factor(height)) + 1e-9
    assert true * bound_speed_factor(distance, height) >= 1.0 - 1e-9


def test_plane_stretch_of_far_places_is_refused() -> None:
    with pytest.raises(ValueError, match="at most"):
        plane_stretch(5e6)
    with pytest.raises(ValueError, match="ranges"):
        bound_range_m(2e6, 0.0, 0.0, 0.0)


@settings(max_examples=100, deadline=None)
@given(PLACES, BEARINGS, st.floats(10, 100e3), st.floats(0, 3000), st.floats(0, 3000), st.floats(0, 60))
def test_planned_elevation_keeps_the_true_one(
    origin: tuple[float, float], bearing: float, distance: float, station_alt: float, above: float, least: float
) -> None:
    plane = Plane(*origin)
    lat, lon = plane.to_geodetic(*_polar(bearing, distance))
    true = float(elevation_deg(*origin, station_alt, float(lat), float(lon), station_alt + above))
    shown = math.degrees(math.atan2(above, distance))
    if shown >= float(planning_elevation_deg(least, distance)):
        assert true >= least
