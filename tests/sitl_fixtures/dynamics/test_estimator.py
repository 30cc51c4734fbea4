"""Each autopilot's own projection, by hand and against the ellipsoid."""

from __future__ import annotations

import math

import pytest
from geographiclib.geodesic import Geodesic
from hypothesis import given, settings
from hypothesis import strategies as st

from sitl_fixtures.dynamics.estimator import Estimator, OffsetProjection, SphereProjection

ORIGIN = (math.radians(53.0), math.radians(5.0))


def test_ardupilot_scale_by_hand() -> None:
    """0.1 degree north is 1e6 units of 0.011131884502145034 m; east it is times cos of the mean latitude."""
    projection = OffsetProjection(*ORIGIN)
    assert projection.to_local(math.radians(53.1), ORIGIN[1]) == pytest.approx((11131.884502, 0.0), abs=1e-6)
    north, east = projection.to_local(math.radians(53.2), math.radians(5.1))
    assert north == pytest.approx(22263.769004, abs=1e-6)
    assert east == pytest.approx(11131.884502 * math.cos(math.radians(53.1)), abs=1e-6)


def test_px4_scale_by_hand() -> None:
    """A degree north on a sphere of 6,371,000 m is 6371000 pi / 180 = 111194.9266 m."""
    projection = SphereProjection(*ORIGIN)
    assert projection.to_local(math.radians(54.0), ORIGIN[1]) == pytest.approx((111194.92664, 0.0), abs=1e-4)
    east_at_equator = SphereProjection(0.0, 0.0).to_local(0.0, math.radians(1.0))
    assert east_at_equator == pytest.approx((0.0, 111194.92664), abs=1e-4)


@pytest.mark.parametrize(
    ("projection", "east_excess_m", "north_excess_m"),
    [(SphereProjection, -330.0, -80.0), (OffsetProjection, -214.0, 29.0)],
)
def test_neither_is_the_ellipsoid(projection: type, east_excess_m: float, north_excess_m: float) -> None:
    """100 km east and north of 53 N the autopilots read some 330 and 214 m less than WGS84 eastwards, by design."""
    p = projection(*ORIGIN)
    east_place = Geodesic.WGS84.Direct(53.0, 5.0, 90.0, 100_000.0)
    north_place = Geodesic.WGS84.Direct(53.0, 5.0, 0.0, 100_000.0)
    east = p.to_local(math.radians(east_place["lat2"]), math.radians(east_place["lon2"]))[1]
    north = p.to_local(math.radians(north_place["lat2"]), math.radians(north_place["lon2"]))[0]
    assert east - 100_000.0 == pytest.approx(east_excess_m, abs=10.0)
    assert north - 100_000.0 == pytest.approx(north_excess_m, abs=10.0)


@settings(max_examples=200, deadline=None)
@given(
    st.sampled_from([SphereProjection, OffsetProjection]),
    st.floats(-80, 80),
    st.floats(-180, 180),
    st.floats(-150_000, 150_000),
    st.floats(-150_000, 150_000),
)
def test_there_and_back(projection: type, lat: float, lon: float, north: float, east: float) -> None:
    """Both projections undo themselves to a tenth of a millimetre over 150 km, across the date line too."""
    p = projection(math.radians(lat), math.radians(lon))
    place = p.to_geodetic(north, east)
    assert -math.pi <= place[1] <= math.pi
    assert p.to_local(*place) == pytest.approx((north, east), abs=1e-4)


def test_small_offsets_lose_no_digits() -> None:
    """A millimetre from the origin is a millimetre: the arc cosine alone would not see it."""
    p = SphereProjection(*ORIGIN)
    place = p.to_geodetic(0.001, 0.0)
    assert p.to_local(*place)[0] == pytest.approx(0.001, rel=1e-4)


def test_origin_is_rounded_as_its_message_is() -> None:
    estimate = Estimator(SphereProjection)
    estimate.set_origin(math.radians(53.12345678912), math.radians(5.1), 12.34567)
    assert estimate.origin is not None
    assert math.degrees(estimate.origin[0]) == pytest.approx(53.1234568, abs=1e-12)
    assert estimate.origin[2] == 12.346


def test_a_failed_estimate_stands_still_and_a_bias_shifts_it() -> None:
    estimate = Estimator(OffsetProjection)
    estimate.set_origin(*ORIGIN, 0.0)
    estimate.update(*ORIGIN, 10.0)
    assert (estimate.n, estimate.e, estimate.d) == (0.0, 0.0, -10.0)
    estimate.bias_e_m = 30.0
    estimate.update(*ORIGIN, 10.0)
    assert estimate.e == 30.0
    estimate.healthy = False
    estimate.update(math.radians(53.1), ORIGIN[1], 99.0)
    assert (estimate.n, estimate.d) == (0.0, -10.0)
