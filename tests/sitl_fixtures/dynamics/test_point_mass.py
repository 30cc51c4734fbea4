"""The aircraft: numbers worked by hand, and the ellipsoid against geographiclib."""

from __future__ import annotations

import math

import pytest
from geographiclib.geodesic import Geodesic
from hypothesis import given, settings
from hypothesis import strategies as st

from sitl_fixtures.dynamics.point_mass import GRAVITY_M_S2, PointMass, radii_m


def flying(lat: float = 53.0, lon: float = 5.0, height: float = 100.0, **options: float) -> PointMass:
    body = PointMass(lat, lon, 0.0, **options)
    body.height_m = height
    body.on_ground = False
    return body


def top_speed_m_s(tilt_rad: float, drag_linear_1_s: float, drag_quadratic_1_m: float) -> float:
    """Speed through the air at which drag takes the whole horizontal thrust of a lean angle, m/s."""
    push = GRAVITY_M_S2 * math.tan(tilt_rad)
    if drag_quadratic_1_m <= 0.0:
        return push / drag_linear_1_s if drag_linear_1_s > 0.0 else math.inf
    root = math.sqrt(drag_linear_1_s * drag_linear_1_s + 4.0 * drag_quadratic_1_m * push)
    return (root - drag_linear_1_s) / (2.0 * drag_quadratic_1_m)


def test_falls_as_a_stone_without_rotors() -> None:
    """No drag: after 2 s v = 19.6 m/s and 19.6 m lower. The thrust dies away through the jerk limit and the lag."""
    body = flying(drag_linear_1_s=0.0, drag_quadratic_1_m=0.0, lag_s=1e-6, jerk_m_s3=1e9)
    for _ in range(2000):
        body.step(0.0, 0.0, 0.0, 0.001, rotors=False)
    assert body.vd == pytest.approx(2 * GRAVITY_M_S2, rel=1e-3)
    assert 100.0 - body.height_m == pytest.approx(2 * GRAVITY_M_S2, rel=2e-3)


def test_top_speed_is_where_lean_and_drag_balance() -> None:
    """30 degrees of lean push 9.80665 tan 30 = 5.662 m/s^2; with c2 = 5.662 / 10.5^2 that is 10.5 m/s."""
    c2 = GRAVITY_M_S2 * math.tan(math.radians(30.0)) / 10.5**2
    assert top_speed_m_s(math.radians(30.0), 0.0, c2) == pytest.approx(10.5)
    body = flying(tilt_rad=math.radians(30.0))
    body.cap_speed(10.5)
    assert (body.drag_linear_1_s, body.drag_quadratic_1_m) == (0.0, c2)
    for _ in range(6000):
        body.step(99.0, 0.0, 0.0, 0.01, rotors=True)
    assert body.vn == pytest.approx(10.5, abs=0.01)


def test_top_speed_with_both_kinds_of_drag() -> None:
    """45 degrees push g; 0.01 v + 0.001 v^2 = 9.80665 at v = 94.155 m/s."""
    assert top_speed_m_s(math.radians(45.0), 0.01, 0.001) == pytest.approx(94.155, abs=1e-3)
    assert top_speed_m_s(math.radians(45.0), 0.25, 0.0) == pytest.approx(GRAVITY_M_S2 / 0.25)
    assert top_speed_m_s(math.radians(45.0), 0.0, 0.0) == math.inf


def test_lean_bounds_the_acceleration_and_the_lag_delays_it() -> None:
    """A step of command is reached to 1 - 1/e after one time constant, and never passes g tan(lean)."""
    body = flying(tilt_rad=math.radians(20.0), lag_s=0.25, jerk_m_s3=1e9)
    for _ in range(25):
        body.step(3.0, 0.0, 0.0, 0.01, rotors=True)
    assert body.an == pytest.approx(3.0 * (1 - math.exp(-1)), rel=1e-6)
    for _ in range(500):
        body.step(50.0, 50.0, 0.0, 0.01, rotors=True)
    assert math.hypot(body.an, body.ae) == pytest.approx(GRAVITY_M_S2 * math.tan(math.radians(20.0)), rel=1e-6)
    assert body.an == pytest.approx(body.ae)


def test_wind_carries_a_drifting_vehicle_along() -> None:
    body = flying(drag_linear_1_s=0.5, drag_quadratic_1_m=0.0)
    body.wind_e_m_s = 8.0
    for _ in range(3000):
        body.step(0.0, 0.0, 0.0, 0.01, rotors=True)
    assert body.ve == pytest.approx(8.0, abs=0.01)


@pytest.mark.parametrize(("lat", "azimuth"), [(0.0, 0.0), (53.0, 90.0), (53.0, 37.0), (-70.0, 200.0)])
def test_flight_follows_the_ellipsoid(lat: float, azimuth: float) -> None:
    """20 km at 50 m/s along a constant heading: the way from end to end on the ellipsoid is right to centimetres."""
    body = flying(lat=lat, height=0.0, drag_linear_1_s=0.0, drag_quadratic_1_m=0.0)
    body.ground_m = -1e9
    body.vn, body.ve = 50.0 * math.cos(math.radians(azimuth)), 50.0 * math.sin(math.radians(azimuth))
    for _ in range(40_000):
        body.step(0.0, 0.0, 0.0, 0.01, rotors=True)
    line = Geodesic.WGS84.Inverse(lat, 5.0, body.lat_deg, body.lon_deg)
    assert line["s12"] == pytest.approx(20_000.0, abs=0.05)


def test_radii_of_curvature() -> None:
    """Meridian at the equator a(1 - e^2) = 6335439.327 m, both at the pole a / sqrt(1 - e^2) = 6399593.626 m."""
    assert radii_m(0.0) == pytest.approx((6335439.327, 6378137.0), abs=1e-3)
    assert radii_m(math.pi / 2) == pytest.approx((6399593.626, 6399593.626), abs=1e-3)


def test_crosses_the_date_line() -> None:
    body = flying(lat=0.0, lon=179.9999, drag_linear_1_s=0.0, drag_quadratic_1_m=0.0)
    body.ve = 20.0
    for _ in range(200):
        body.step(0.0, 0.0, 0.0, 0.01, rotors=True)
    assert -180.0 <= body.lon_deg < -179.99


def test_the_ground_stops_a_landing_and_remembers_how_hard() -> None:
    body = flying(height=1.0)
    body.vd = 2.0
    while not body.on_ground:
        body.step(0.0, 0.0, 0.0, 0.01, rotors=True)
    assert body.height_m == 0.0
    assert body.vd == 0.0
    assert body.impact_m_s == pytest.approx(2.0, abs=0.05)


def test_stands_until_the_thrust_lifts_it() -> None:
    body = PointMass(53.0, 5.0, 12.0)
    for _ in range(100):
        body.step(5.0, 0.0, 0.0, 0.01, rotors=True)
    assert (body.on_ground, body.vn, body.height_m) == (True, 0.0, 12.0)
    for _ in range(100):
        body.step(0.0, 0.0, -3.0, 0.01, rotors=True)
    assert not body.on_ground
    assert body.height_m > 12.3


@settings(max_examples=60, deadline=None)
@given(
    st.floats(-20, 20),
    st.floats(-20, 20),
    st.floats(-15, 15),
    st.floats(-30, 30),
    st.floats(-30, 30),
    st.sampled_from([0.01, 0.02, 0.025]),
)
def test_drag_never_adds_speed_and_the_thrust_stays_in_bounds(
    n: float, e: float, d: float, vn: float, ve: float, dt: float
) -> None:
    body = flying(height=5000.0)
    body.vn, body.ve = vn, ve
    for _ in range(200):
        before = (body.vn, body.ve)
        body.step(n, e, d, dt, rotors=True)
        assert math.hypot(body.an, body.ae) <= GRAVITY_M_S2 * math.tan(body.tilt_rad) + 1e-9
        assert -body.max_up_m_s2 - 1e-9 <= body.ad <= body.max_down_m_s2 + 1e-9
        assert body.drag_n * before[0] <= 0.0
        assert body.drag_e * before[1] <= 0.0
    assert all(map(math.isfinite, (body.lat_rad, body.lon_rad, body.height_m, body.vn, body.ve, body.vd)))


def test_attitude_leans_into_the_acceleration() -> None:
    """g to the east while heading north: 45 degrees of roll to the right, no pitch."""
    body = flying()
    body.ae = GRAVITY_M_S2
    roll, pitch = body.attitude_rad(0.0)
    assert (math.degrees(roll), math.degrees(pitch)) == pytest.approx((45.0, 0.0), abs=1e-9)
    roll, pitch = body.attitude_rad(math.radians(90.0))
    assert (math.degrees(roll), math.degrees(pitch)) == pytest.approx((0.0, -45.0), abs=1e-9)
