"""Resampling: the grid, the values, the axes, the yaw, and the pace at which a streamer can ask."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from geographiclib.geodesic import Geodesic
from hypothesis import given
from hypothesis import strategies as st

from link.setpoints.sampler import CHUNK, SLOW_M_S, SetpointSampler
from planner import Trajectory
from tests.support.plans.drawn import drawn_relay_plan, make_plan, rest_to_rest, with_handovers

STRAIGHT = ((0.0, 0.0, 100.0), (1000.0, 0.0, 100.0))


def straight_plan(duration_s: float):  # type: ignore[no-untyped-def]
    return make_plan(rest_to_rest(*STRAIGHT, duration_s=duration_s))


# ---------------------------------------------------------------- the grid


@pytest.mark.parametrize(
    ("duration_s", "rate_hz", "count", "last_but_one"),
    [
        (10.0, 20.0, 201, 9.95),  # the end is on the grid: once
        (10.02, 20.0, 202, 10.0),  # it is not: one more sample
        (10.0 + 5e-10, 20.0, 201, 9.95),  # on the grid within 1e-9
        (10.0 - 5e-10, 20.0, 201, 9.95),
        (0.02, 20.0, 2, 0.0),  # shorter than one step: start and end
        (10.0, 3.0, 31, 29 / 3),
        (0.3, 10.0, 4, 0.2),  # 0.3 is not 3 * 0.1 in floating point
    ],
)
def test_times_by_hand(duration_s: float, rate_hz: float, count: int, last_but_one: float) -> None:
    stream = SetpointSampler(straight_plan(duration_s), rate_hz)
    assert len(stream) == len(stream.times_s) == count
    assert stream.times_s[0] == 0.0
    assert stream.times_s[-2] == pytest.approx(last_but_one, abs=1e-12)
    assert stream.times_s[-1] == duration_s


@given(
    duration_s=st.floats(0.011, 2000.0),
    rate_hz=st.one_of(st.floats(0.1, 200.0), st.integers(1, 200).map(float)),
)
def test_times_rise_by_the_step_and_end_at_the_end(duration_s: float, rate_hz: float) -> None:
    stream = SetpointSampler(straight_plan(duration_s), rate_hz)
    times = stream.times_s
    assert len(times) == len(stream) >= 2
    assert times[0] == 0.0
    assert times[-1] == duration_s
    steps = np.diff(times)
    np.testing.assert_allclose(steps[:-1], 1.0 / rate_hz, rtol=1e-6)
    # No second sample beside the end, and no hole before it.
    assert 1e-9 * 0.5 < steps[-1] <= 1.0 / rate_hz + 1e-9 * 1.01


@given(grid=st.integers(1, 5000), rate_hz=st.integers(1, 200), offset_s=st.floats(-0.99e-9, 0.99e-9))
def test_an_end_on_the_grid_is_sampled_once(grid: int, rate_hz: int, offset_s: float) -> None:
    stream = SetpointSampler(straight_plan(grid / rate_hz + offset_s), rate_hz)
    assert len(stream) == grid + 1


@pytest.mark.parametrize("rate_hz", [0.0, 0.05, -20.0, 201.0, math.nan, math.inf])
def test_a_rate_out_of_range_is_refused_with_the_range(rate_hz: float) -> None:
    with pytest.raises(ValueError, match=r"rate_hz is .*, allowed is 0.1 to 200"):
        SetpointSampler(straight_plan(10.0), rate_hz)


# ---------------------------------------------------------------- the stream


def test_samples_are_the_curve() -> None:
    plan = drawn_relay_plan()
    stream = SetpointSampler(plan, 7.0)
    samples = list(stream)
    assert len(samples) == len(stream)
    times = np.array([s.time_s for s in samples])
    np.testing.assert_array_equal(times, stream.times_s)
    for order, name in enumerate(("position_enu_m", "velocity_enu_m_s", "acceleration_enu_m_s2")):
        got = np.array([getattr(s, name) for s in samples])
        np.testing.assert_allclose(got, plan.trajectory.evaluate(times, order), atol=1e-9)
    lat, lon = plan.plane.to_geodetic(*np.array([s.position_enu_m for s in samples])[:, :2].T)
    np.testing.assert_allclose([(s.lat_deg, s.lon_deg) for s in samples], np.column_stack([lat, lon]), atol=1e-12)
    np.testing.assert_allclose([s.alt_amsl_m for s in samples], [10.0 + s.position_enu_m[2] for s in samples])


def test_first_and_last_sample_are_at_rest_at_start_and_destination() -> None:
    plan = drawn_relay_plan()
    first, *_, last = SetpointSampler(plan, 20.0)
    assert first.position_enu_m == pytest.approx((0.0, 0.0, 90.0))
    assert last.position_enu_m == pytest.approx((4500.0, 4500.0, 130.0))
    assert last.time_s == 300.0
    for sample in (first, last):
        assert sample.velocity_ned_m_s == pytest.approx((0, 0, 0), abs=1e-12)
        assert sample.acceleration_ned_m_s2 == pytest.approx((0, 0, 0), abs=1e-12)


def test_station_changes_at_the_handover_and_is_marked_once() -> None:
    """Handovers at 100.0 (on the 20 Hz grid) and 200.5 s."""
    samples = list(SetpointSampler(drawn_relay_plan(handovers_s=(100.0, 200.5)), 20.0))
    marked = [(s.time_s, s.handover, s.station_id, s.system_id, s.leg) for s in samples if s.handover is not None]
    assert marked == [(100.0, 1, "texel", 242, 1), (200.5, 2, "vlieland", 243, 2)]
    for sample in samples:
        expected = 241 + (sample.time_s >= 100.0) + (sample.time_s >= 200.5)
        assert sample.system_id == expected
    assert samples[0].handover is None


def test_a_handover_between_samples_is_marked_on_the_next_one() -> None:
    samples = list(SetpointSampler(drawn_relay_plan(handovers_s=(100.01, 200.04)), 10.0))
    assert [(s.time_s, s.handover) for s in samples if s.handover] == [
        (pytest.approx(100.1), 1),
        (pytest.approx(200.1), 2),
    ]


def test_two_handovers_between_two_samples_name_the_station_that_is_in_control() -> None:
    samples = list(SetpointSampler(drawn_relay_plan(handovers_s=(100.2, 100.6)), 1.0))
    assert [(s.time_s, s.handover, s.station_id) for s in samples if s.handover] == [(101.0, 2, "vlieland")]


@pytest.mark.parametrize("offset", [-1, 0, 1])
def test_a_handover_at_the_seam_of_two_blocks_is_marked_once(offset: int) -> None:
    rate_hz = 50.0
    time_s = (CHUNK + offset) / rate_hz
    samples = list(SetpointSampler(drawn_relay_plan(handovers_s=(time_s, 200.5)), rate_hz))
    assert [i for i, s in enumerate(samples) if s.handover] == [CHUNK + offset, 10025]


def test_a_station_that_comes_back_is_another_leg() -> None:
    curve = with_handovers(rest_to_rest(*STRAIGHT, duration_s=60.0), (20.0, 40.0))
    there_and_back = Trajectory(curve.control_points_m, curve.durations_s, np.array([0, 1, 0]))
    stream = SetpointSampler(make_plan(there_and_back), 10.0)
    assert [(s.handover, s.system_id) for s in stream if s.handover] == [(1, 242), (2, 241)]
    assert [stream.leg_at(t) for t in (-1.0, 19.99, 20.0, 39.0, 40.0, 61.0)] == [0, 0, 1, 1, 2, 2]


def test_blocks_are_bounded_and_computed_one_at_a_time() -> None:
    """Half an hour at 200 Hz is 360,001 samples; the first ones come before the rest is thought of."""
    plan = straight_plan(1800.0)
    calls: list[int] = []

    class CountingPlane:
        alt_amsl_m = plan.plane.alt_amsl_m
        true_axes = plan.plane.true_axes

        def geodetic_and_axes(self, east, north, alt=None):  # type: ignore[no-untyped-def]
            calls.append(np.size(east))
            return plan.plane.geodetic_and_axes(east, north, alt)

    counted = SimpleNamespace(
        trajectory=plan.trajectory, mission=plan.mission, handovers=plan.handovers, plane=CountingPlane()
    )
    stream = SetpointSampler(counted, 200.0)  # type: ignore[arg-type]
    assert len(stream) == 360_001
    list(itertools.islice(stream, 10))
    assert calls == [CHUNK]


def test_a_plan_whose_handovers_do_not_fit_its_legs_is_refused() -> None:
    plan = drawn_relay_plan()
    broken = SimpleNamespace(
        trajectory=plan.trajectory, mission=plan.mission, handovers=plan.handovers[:1], plane=plan.plane
    )
    with pytest.raises(ValueError, match="3 legs but 1 handovers"):
        SetpointSampler(broken, 20.0)  # type: ignore[arg-type]


def test_a_plan_without_a_system_id_is_refused() -> None:
    plan = drawn_relay_plan()
    nameless = replace(plan.mission, stations=tuple(replace(s, system_id=None) for s in plan.mission.stations))
    with pytest.raises(ValueError, match="station den-helder has no system id"):
        SetpointSampler(replace(plan, mission=nameless), 20.0)


# ---------------------------------------------------------------- at any time


def test_at_agrees_with_the_stream_everywhere() -> None:
    stream = SetpointSampler(drawn_relay_plan(), 9.7)
    for sample in stream:
        got = stream.at(sample.time_s)
        assert got.handover is None
        assert (got.time_s, got.station_id, got.system_id, got.leg) == (
            sample.time_s,
            sample.station_id,
            sample.system_id,
            sample.leg,
        )
        assert got.position_enu_m == pytest.approx(sample.position_enu_m, abs=1e-9)
        # 1e-9 degrees is a tenth of a millimetre.
        assert got.lat_deg == pytest.approx(sample.lat_deg, abs=1e-9)
        assert got.lon_deg == pytest.approx(sample.lon_deg, abs=1e-9)
        assert got.alt_amsl_m == pytest.approx(sample.alt_amsl_m, abs=1e-9)
        assert got.velocity_ned_m_s == pytest.approx(sample.velocity_ned_m_s, abs=2e-4)
        assert got.acceleration_ned_m_s2 == pytest.approx(sample.acceleration_ned_m_s2, abs=1e-5)
        assert (got.yaw_deg - sample.yaw_deg + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=1e-3)


def test_at_is_clamped_to_the_flight() -> None:
    stream = SetpointSampler(drawn_relay_plan(), 20.0)
    assert stream.at(-5.0) == stream.at(0.0)
    assert stream.at(1e9) == stream.at(300.0)
    assert stream.at(1e9).time_s == 300.0
    for nonsense in (math.nan, math.inf):
        with pytest.raises(ValueError, match="finite"):
            stream.at(nonsense)


def test_at_works_across_the_date_line_and_near_the_pole() -> None:
    for origin in (
        {"lat_deg": -17.0, "lon_deg": 179.999, "alt_amsl_m": 0.0},
        {"lat_deg": 89.95, "lon_deg": 10.0, "alt_amsl_m": 0.0},
    ):
        stream = SetpointSampler(make_plan(rest_to_rest(*STRAIGHT, duration_s=60.0), origin=origin), 2.0)
        for sample in stream:
            got = stream.at(sample.time_s)
            assert -180.0 <= got.lon_deg < 180.0
            inverse = Geodesic.WGS84.Inverse(sample.lat_deg, sample.lon_deg, got.lat_deg, got.lon_deg)
            assert inverse["s12"] < 2e-3


# ---------------------------------------------------------------- axes


def test_true_velocity_is_the_motion_over_the_earth() -> None:
    """130 km east of the origin the plane's north is 1.6 degrees off true north; the wire gets true axes."""
    curve = rest_to_rest((130_000, 0, 90), (131_000, 1500, 90), (130_500, 3000, 100), duration_s=200.0)
    stream = SetpointSampler(make_plan(curve), 1.0)
    h = 0.05
    for time_s in (40.0, 77.0, 100.0, 143.0):
        before, now, after = stream.at(time_s - h), stream.at(time_s), stream.at(time_s + h)
        path = Geodesic.WGS84.Inverse(before.lat_deg, before.lon_deg, after.lat_deg, after.lon_deg)
        # On the ellipsoid; at altitude the same angle is a longer way.
        speed = path["s12"] / (2 * h) * (1.0 + now.alt_amsl_m / 6.37e6)
        course = math.radians(0.5 * (path["azi1"] + path["azi2"]))
        north, east, down = now.velocity_ned_m_s
        assert (north, east) == pytest.approx((speed * math.cos(course), speed * math.sin(course)), abs=5e-3)
        assert down == pytest.approx(-(after.alt_amsl_m - before.alt_amsl_m) / (2 * h), abs=1e-3)
        acceleration = (np.array(after.velocity_ned_m_s) - before.velocity_ned_m_s) / (2 * h)
        assert now.acceleration_ned_m_s2 == pytest.approx(acceleration.tolist(), abs=3e-3)
    now = stream.at(100.0)
    turned = math.degrees(math.atan2(now.velocity_ned_m_s[1], now.velocity_ned_m_s[0])) - math.degrees(
        math.atan2(now.velocity_enu_m_s[0], now.velocity_enu_m_s[1])
    )
    assert abs(turned) == pytest.approx(1.55, abs=0.05)


# ---------------------------------------------------------------- yaw


def test_yaw_follows_the_course_and_is_held_where_slow() -> None:
    """East for 60 s, a stop, then north: at the stop the yaw stays at 90 until the vehicle moves again."""
    east = rest_to_rest((0, 0, 100), (600, 0, 100), duration_s=60.0)
    north = rest_to_rest((600, 0, 100), (600, 600, 100), duration_s=60.0)
    curve = Trajectory(
        np.concatenate([east.control_points_m, north.control_points_m]), np.array([60.0, 60.0]), np.array([0, 0])
    )
    samples = list(SetpointSampler(make_plan(curve), 10.0))
    held_at_stop = 0
    for sample in samples:
        speed = math.hypot(*sample.velocity_enu_m_s[:2])
        turn = abs((sample.yaw_deg - (90.0 if sample.time_s < 60.0 else 0.0) + 180.0) % 360.0 - 180.0)
        if speed > SLOW_M_S * 1.001:
            assert turn < 0.02
        elif 59.0 < sample.time_s < 61.5:
            held_at_stop += 1
            assert sample.yaw_deg == pytest.approx(90.0, abs=0.02)
    assert held_at_stop > 20
    # Nothing to hold before the first metre: the course to come. At the end: the course last flown.
    assert samples[0].yaw_deg == pytest.approx(90.0, abs=0.02)
    assert samples[-1].yaw_deg == pytest.approx(0.0, abs=0.02) or samples[-1].yaw_deg == pytest.approx(360.0, abs=0.02)


def test_yaw_does_not_depend_on_the_rate() -> None:
    plan = drawn_relay_plan()
    coarse = {round(s.time_s, 6): s.yaw_deg for s in SetpointSampler(plan, 1.0)}
    fine = {round(s.time_s, 6): s.yaw_deg for s in SetpointSampler(plan, 20.0)}
    assert all(fine[t] == pytest.approx(yaw, abs=1e-9) for t, yaw in coarse.items())


def test_yaw_of_a_climb_on_the_spot_is_north_and_of_a_crawl_its_direction() -> None:
    climb = make_plan(rest_to_rest((0, 0, 50), (0, 0, 150), duration_s=100.0))
    assert {s.yaw_deg for s in SetpointSampler(climb, 5.0)} == {0.0}
    crawl = make_plan(rest_to_rest((0, 0, 50), (0, -10, 50), duration_s=100.0))
    assert {s.yaw_deg for s in SetpointSampler(crawl, 5.0)} == {180.0}


# ---------------------------------------------------------------- hold and another pace


def test_hold_is_the_same_place_at_rest() -> None:
    moving = SetpointSampler(drawn_relay_plan(), 20.0).at(120.0)
    held = moving.hold()
    assert (held.lat_deg, held.lon_deg, held.alt_amsl_m) == (moving.lat_deg, moving.lon_deg, moving.alt_amsl_m)
    assert (held.position_enu_m, held.yaw_deg, held.system_id) == (
        moving.position_enu_m,
        moving.yaw_deg,
        moving.system_id,
    )
    for vector in (
        held.velocity_enu_m_s,
        held.velocity_ned_m_s,
        held.acceleration_enu_m_s2,
        held.acceleration_ned_m_s2,
    ):
        assert vector == (0.0, 0.0, 0.0)


def test_retimed_is_the_derivative_along_the_slowed_clock() -> None:
    """Plan time runs as T(t) = T0 + r t + q t^2 / 2: velocity and acceleration by finite differences of position."""
    stream = SetpointSampler(drawn_relay_plan(), 20.0)
    start, rate, change, h = 120.0, 0.6, -0.08, 1e-3

    def place(t: float) -> np.ndarray:  # type: ignore[type-arg]
        return np.array(stream.at(start + rate * t + 0.5 * change * t * t).position_enu_m)

    velocity = (place(h) - place(-h)) / (2 * h)
    acceleration = (place(h) - 2 * place(0.0) + place(-h)) / h**2
    slowed = stream.at(start).retimed(rate, change)
    assert slowed.velocity_enu_m_s == pytest.approx(velocity.tolist(), abs=1e-5)
    assert slowed.acceleration_enu_m_s2 == pytest.approx(acceleration.tolist(), abs=1e-2)
    n, e, d = slowed.acceleration_ned_m_s2
    assert math.hypot(n, e, d) == pytest.approx(math.hypot(*slowed.acceleration_enu_m_s2), rel=1e-3)
    assert slowed.position_enu_m == stream.at(start).position_enu_m
