"""The reference: consistent at every rate, and never beyond a limit it could stop before."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from link.setpoints.local_projection import LocalProjection
from link.setpoints.reference import BRAKING_SHARE, ReferenceTrajectory
from link.setpoints.sampler import SetpointSampler
from link.setpoints.straight_line import StraightLine
from tests.support.plans.planned import relay_plan

ACCEL_M_S2 = 2.5
DT_S = 0.05


def on_plan(time_s: float = 0.0, rate: float = 1.0) -> ReferenceTrajectory:
    return ReferenceTrajectory(SetpointSampler(relay_plan(), 20.0), accel_m_s2=ACCEL_M_S2, time_s=time_s, rate=rate)


def test_at_full_rate_it_is_the_plans_own_stream_to_the_last_digit() -> None:
    stream = SetpointSampler(relay_plan(), 20.0)
    reference = on_plan()
    for k in range(1, 200):
        reference.step(DT_S, 1.0)
        assert reference.setpoint() == stream.at(reference.time_s)
        assert reference.time_s == pytest.approx(k * DT_S, abs=1e-9)


def test_what_is_told_about_velocity_and_acceleration_is_how_the_position_moves() -> None:
    """Finite differences of the streamed positions, while the rate falls and rises again."""
    reference = on_plan(10.0)
    wanted = [1.0] * 20 + [0.2] * 120 + [-0.6] * 160 + [1.0] * 160
    places, speeds = [], []
    for rate in wanted:
        reference.step(DT_S, rate)
        setpoint = reference.setpoint()
        places.append(setpoint.position_enu_m)
        speeds.append(setpoint.velocity_enu_m_s)
    flown = np.gradient(np.array(places), DT_S, axis=0)[2:-2]
    told = np.array(speeds)[2:-2]
    # The rate changes linearly within a tick, so differences agree to half a tick's change of speed.
    assert np.abs(flown - told).max() < 0.5 * ACCEL_M_S2 * DT_S
    along = np.diff(np.linalg.norm(np.array(speeds), axis=-1)) / DT_S
    assert np.abs(along).max() < 2.0 * ACCEL_M_S2


@pytest.mark.parametrize("backwards", [False, True])
def test_a_limit_that_comes_up_suddenly_is_braked_for_as_hard_as_the_plan_allows(backwards: bool) -> None:
    """At 15 m/s 2.5 m/s^2 stop within 45 m; the usual 0.55 of it would take 82 m. A limit 60 m ahead must hold."""
    reference = on_plan(25.0, -1.0 if backwards else 1.0)
    assert reference.speed_m_s(25.0) > 14.5
    limit_s = reference.time_at_way(25.0, -60.0 if backwards else 60.0)
    speeds = []
    for _ in range(400):
        if backwards:
            reference.step(DT_S, -1.0, low_s=limit_s)
        else:
            reference.step(DT_S, 1.0, high_s=limit_s)
        speeds.append(reference.rate * reference.speed_m_s(reference.time_s))
        assert reference.time_s >= limit_s - 0.02 if backwards else reference.time_s <= limit_s + 0.02
    assert abs(reference.way_m(reference.time_s, limit_s)) < 1.0
    assert reference.stands
    assert np.abs(np.diff(speeds) / DT_S).max() < 1.05 * ACCEL_M_S2


@pytest.mark.slow
@settings(max_examples=25)
@given(
    start_s=st.floats(3.0, 45.0),
    limit_s=st.floats(0.5, 40.0),
    rate=st.floats(0.1, 1.0),
    tick_s=st.sampled_from([0.02, 0.05, 0.1]),
)
def test_a_limit_far_enough_ahead_is_never_passed_and_always_reached(
    start_s: float, limit_s: float, rate: float, tick_s: float
) -> None:
    reference = on_plan(start_s, rate)
    high_s = min(start_s + limit_s, relay_plan().mission_time_s - 1.0)
    speed = rate * reference.speed_m_s(start_s)
    room_m = reference.way_m(start_s, high_s)
    if room_m < speed * speed / (2.0 * BRAKING_SHARE * ACCEL_M_S2) + 2.0 * speed * tick_s + 1.0:
        return  # too near to stop before; the next test
    for _ in range(int(80.0 / tick_s)):
        reference.step(tick_s, 1.0, high_s=high_s)
        assert reference.way_m(reference.time_s, high_s) > -0.05
    assert reference.stands
    assert reference.way_m(reference.time_s, high_s) < 0.5


def test_a_limit_that_comes_too_late_is_passed_braking_and_returned_to() -> None:
    reference = on_plan(30.0)
    high_s, passed = 31.0, 0.0
    for _ in range(1200):
        reference.step(DT_S, 1.0, high_s=high_s)
        passed = max(passed, reference.way_m(high_s, reference.time_s))
    # 15 m/s with 15 m to go: v^2 / 2a is 45 m, all of the plan's acceleration used.
    assert 28.0 < passed < 60.0
    assert reference.stands
    assert abs(reference.way_m(reference.time_s, high_s)) < 0.5


def test_backwards_a_limit_below_is_kept_too_and_the_start_ends_it() -> None:
    reference = on_plan(30.0)
    for _ in range(1500):
        reference.step(DT_S, -1.0, low_s=20.0)
        assert reference.time_s > 20.0 - 0.01
    assert reference.stands
    for _ in range(1500):
        reference.step(DT_S, -1.0)
    assert reference.time_s == 0.0


@settings(max_examples=30)
@given(st.floats(1.0, 60.0))
def test_a_stop_ends_about_where_it_was_foretold(start_s: float) -> None:
    reference = on_plan(start_s)
    foretold = min(start_s + reference.stopping_s(), relay_plan().mission_time_s)
    for _ in range(600):
        reference.step(DT_S, 0.0)
    assert reference.rate == 0.0
    # Foretold with the gentler braking, so never short of the truth.
    assert reference.time_s <= foretold + 0.2
    setpoint = reference.setpoint()
    assert setpoint.velocity_ned_m_s == pytest.approx((0.0, 0.0, 0.0))
    assert setpoint.acceleration_ned_m_s2 == pytest.approx((0.0, 0.0, 0.0))


def test_a_straight_line_keeps_its_limits_and_starts_and_ends_at_rest() -> None:
    line = StraightLine(
        relay_plan(), 0, (0.0, 0.0, 30.0), (60.0, -80.0, 35.0), speed_m_s=5.0, climb_m_s=1.0, accel_m_s2=1.0
    )
    # 100.125 m at a mean of 8/15 of 5 m/s.
    assert line.duration_s == pytest.approx(1.875 * math.hypot(100.0, 5.0) / 5.0)
    samples = [line.at(t) for t in np.linspace(0.0, line.duration_s, 400)]
    speeds = [math.hypot(*s.velocity_enu_m_s) for s in samples]
    assert max(speeds) == pytest.approx(5.0, rel=1e-3)
    assert max(math.hypot(*s.acceleration_enu_m_s2) for s in samples) <= 1.0 + 1e-9
    assert speeds[0] == speeds[-1] == 0.0
    assert samples[-1].position_enu_m == pytest.approx((60.0, -80.0, 35.0))
    assert samples[0].alt_amsl_m == pytest.approx(30.0)


def test_a_line_of_no_length_is_a_hover() -> None:
    place = (5.0, 6.0, 40.0)
    line = StraightLine(relay_plan(), 1, place, place, speed_m_s=5.0, climb_m_s=1.0, accel_m_s2=1.0)
    assert line.duration_s == 0.0
    assert line.at(3.0).position_enu_m == place
    assert line.at(3.0).velocity_enu_m_s == (0.0, 0.0, 0.0)
    assert line.at(0.0).station_id == "s2"


@given(st.floats(-60_000.0, 60_000.0), st.floats(-60_000.0, 60_000.0), st.floats(-390.0, 390.0), st.floats(0.0, 6.28))
def test_the_fast_map_agrees_with_the_exact_one(east: float, north: float, off: float, angle: float) -> None:
    plane = relay_plan().plane
    fast = LocalProjection(plane)
    fast.to_geodetic(east, north)
    e, n = east + off * math.cos(angle), north + off * math.sin(angle)
    lat, lon, axes = fast.to_geodetic(e, n)
    exact_lat, exact_lon = plane.to_geodetic(e, n)
    # 2 cm in degrees of latitude, and at 53 N of longitude
    assert lat == pytest.approx(float(exact_lat), abs=2e-7)
    assert lon == pytest.approx(float(exact_lon), abs=3.3e-7)
    assert axes == pytest.approx(plane.true_axes(e, n), abs=1e-4)
    assert fast.to_plane(lat, lon) == pytest.approx((e, n), abs=1e-6)
    assert fast.to_plane(float(exact_lat), float(exact_lon)) == pytest.approx((e, n), abs=0.03)
