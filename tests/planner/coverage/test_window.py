"""Coverage windows against hand-worked crossings and dense samples."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner import Trajectory
from planner.coverage.elevation_mask import ElevationMask
from planner.coverage.window import Stations, coverage_window, coverage_windows, held_s, range_excess


def line(start: list[float], end: list[float], duration_s: float) -> Trajectory:
    """Constant speed on a straight line, as a curve of degree 1."""
    return Trajectory(np.array([[start, end]], dtype=float), np.array([duration_s]), np.array([0]))


ORIGIN = np.zeros(3)


def test_a_straight_pass_by_hand() -> None:
    """Past a station at 3 m, 5 m in range: inside from x = -4 to x = 4.

    x = -10 ──── -4 ═════ 0 ═════ 4 ──── 10, one metre a second from t = 0
    """
    flight = line([-10, 3, 0], [10, 3, 0], 20.0)
    assert coverage_window(flight, ORIGIN, 5.0, 10.0, slack_m=0.0) == pytest.approx((6.0, 14.0), abs=1e-9)
    assert coverage_window(flight, ORIGIN, 5.0, 6.5, slack_m=0.0) == pytest.approx((6.0, 14.0), abs=1e-9)
    assert coverage_window(flight, ORIGIN, 5.0, 3.0) == (3.0, 3.0)
    assert coverage_window(flight, ORIGIN, 50.0, 3.0) == (0.0, 20.0)
    np.testing.assert_allclose(range_excess(flight, 0, ORIGIN, 5.0), [84.0, -116.0, 84.0])


def test_the_window_crosses_joints() -> None:
    flight = line([-10, 3, 0], [10, 3, 0], 20.0).split([2.0, 6.5, 9.9, 10.0, 13.9, 17.0])
    assert coverage_window(flight, ORIGIN, 5.0, 10.0, slack_m=0.0) == pytest.approx((6.0, 14.0), abs=1e-9)
    assert coverage_window(flight, ORIGIN, 5.0, 13.9, slack_m=0.0) == pytest.approx((6.0, 14.0), abs=1e-9)


def test_only_the_stay_around_the_asked_time_counts() -> None:
    # Out and back: x from 0 to 10 and back to 0; in range (5 m) before t = 5 and after t = 15.
    flight = Trajectory(
        np.array([[[0, 0, 0], [10, 0, 0]], [[10, 0, 0], [0, 0, 0]]], dtype=float),
        np.array([10.0, 10.0]),
        np.array([0, 0]),
    )
    assert coverage_window(flight, ORIGIN, 5.0, 1.0, slack_m=0.0) == pytest.approx((0.0, 5.0), abs=1e-9)
    assert coverage_window(flight, ORIGIN, 5.0, 19.0, slack_m=0.0) == pytest.approx((15.0, 20.0), abs=1e-9)
    assert coverage_window(flight, ORIGIN, 5.0, 10.0) == (10.0, 10.0)


def test_touching_the_edge_from_inside_does_not_leave() -> None:
    # A parabola that just reaches the circle's edge: y = 5 at its top, x = 0; the station is at the origin.
    top = Trajectory(np.array([[[-1, 3, 0], [0, 7, 0], [1, 3, 0]]], dtype=float), np.array([4.0]), np.array([0]))
    assert top.evaluate(2.0).tolist() == [0.0, 5.0, 0.0]
    assert coverage_window(top, ORIGIN, 5.0, 0.5) == (0.0, 4.0)
    # A micrometre and more beyond it, it leaves twice.
    start, end = coverage_window(top, ORIGIN, 5.0 - 1e-3, 0.5)
    assert start == 0.0
    assert 1.9 < end < 2.0


def test_passing_tangentially_outside_is_a_moment_at_most() -> None:
    flight = line([-10, 5, 0], [10, 5, 0], 20.0)
    start, end = coverage_window(flight, ORIGIN, 5.0, 10.0, slack_m=0.0)
    assert start <= 10.0 <= end
    assert end - start < 1e-3


def test_riding_along_the_edge_stays_inside() -> None:
    # Hovering exactly on the edge of range, with coordinates whose squares do not add up exactly.
    spot = np.array([0.1, 0.2, 0.3])
    radius = float(np.linalg.norm(spot))
    hover = Trajectory(np.broadcast_to(spot, (3, 6, 3)), np.ones(3), np.zeros(3, dtype=int))
    assert coverage_window(hover, ORIGIN, radius, 1.5) == (0.0, 3.0)
    # Away from the edge outwards, the window ends there and then.
    leaving = Trajectory(np.array([[spot, spot], [spot, 2 * spot]]), np.ones(2), np.zeros(2, dtype=int))
    start, end = coverage_window(leaving, ORIGIN, radius, 0.5)
    assert start == 0.0
    assert end == pytest.approx(1.0, abs=1e-5)


def test_an_elevation_limit_ends_the_window_at_the_cone() -> None:
    # 100 m up at one metre a second past a station: above 45 degrees from x = -100 to 100, in range from -300 to 300.
    flight = line([-400, 0, 100], [400, 0, 100], 800.0)
    reach = float(np.hypot(300, 100))
    assert coverage_window(flight, ORIGIN, reach, 400.0, slack_m=0.0) == pytest.approx((100, 700), abs=1e-6)
    cone = coverage_window(flight, ORIGIN, reach, 400.0, min_elevation_deg=45.0, slack_m=0.0)
    assert cone == pytest.approx((300, 500), abs=1e-6)
    assert coverage_window(flight, ORIGIN, reach, 400.0, min_elevation_deg=-90.0) == pytest.approx((100, 700), abs=1e-3)
    # Level with the antenna the horizon is the limit, below it nothing is heard.
    assert coverage_window(flight, np.array([0, 0, 100.0]), 300.0, 400.0, min_elevation_deg=0.0) == pytest.approx(
        (100, 700), abs=1e-3
    )
    assert coverage_window(flight, np.array([0, 0, 101.0]), 300.0, 400.0, min_elevation_deg=0.0) == (400.0, 400.0)


@given(st.integers(0, 100_000), st.floats(0.05, 0.95), st.floats(0.3, 2.5), st.sampled_from([None, 5.0, 20.0]))
@settings(deadline=None, max_examples=80)
def test_windows_agree_with_dense_samples(seed: int, share: float, size: float, elevation: float | None) -> None:
    rng = np.random.default_rng(seed)
    waypoints = rng.normal(scale=1.0, size=(4, 3))
    points = np.stack([np.concatenate([[a], rng.normal(size=(3, 3)), [b]]) for a, b in pairwise(waypoints)])
    flight = Trajectory(points, rng.uniform(1, 3, 3), np.zeros(3, dtype=int))
    station, around = np.array([0.0, 0.0, -1.0]), share * flight.duration_s
    start, end = coverage_window(flight, station, size, around, min_elevation_deg=elevation, slack_m=0.0)

    def outside(times: np.ndarray) -> np.ndarray:
        offset = flight.evaluate(times) - station
        excess = np.linalg.norm(offset, axis=-1) - size
        if elevation is not None:
            slope = np.tan(np.radians(elevation))
            excess = np.maximum(excess, slope * np.linalg.norm(offset[:, :2], axis=-1) - offset[:, 2])
        return excess

    assert start <= around <= end
    if end > start:
        assert outside(np.linspace(start, end, 2001)).max() <= 1e-7
    elif outside(np.array([around]))[0] < -1e-6:
        pytest.fail("inside, yet the window is empty")
    # And it is the longest: just beyond an end inside the flight, the vehicle is outside somewhere.
    if end > start:
        for edge, step in ((start, -1.0), (end, 1.0)):
            if 1e-6 < edge < flight.duration_s - 1e-6:
                assert outside(edge + step * np.linspace(0, 1e-5, 11)).max() > -1e-9


@pytest.mark.slow
@given(st.integers(0, 100_000))
@settings(deadline=None, max_examples=20)
def test_many_windows_are_the_single_ones(seed: int) -> None:
    """Forty windows at once, of flights longer than a walk's stride, are what each of them is alone."""
    rng = np.random.default_rng(seed)
    waypoints = np.cumsum(rng.normal(size=(13, 3)), axis=0)
    points = np.stack([np.concatenate([[a], a + rng.normal(size=(3, 3)), [b]]) for a, b in pairwise(waypoints)])
    flight = Trajectory(points, rng.uniform(1, 3, 12), np.zeros(12, dtype=int))
    at, size = rng.normal(scale=2.0, size=(40, 3)), rng.uniform(0.5, 8.0, 40)
    times = rng.choice([rng.uniform(0, flight.duration_s), *flight.knots_s], 40)
    angles = rng.choice([-90.0, 0.0, 20.0], 40)
    early, late = coverage_windows(flight, Stations(at, size, ElevationMask(angles)), times)
    for k in range(40):
        alone = coverage_window(flight, at[k], size[k], times[k], min_elevation_deg=angles[k])
        assert (early[k], late[k]) == pytest.approx(alone, abs=1e-9)
    early, late = coverage_windows(flight, Stations(at, np.full(40, 1e3)), times)
    assert (early == 0.0).all()
    assert (late == flight.duration_s).all()


def test_whole_segments_held_end_at_the_first_that_is_not() -> None:
    """Ten segments of 1 s along x, 1 m each; a station at x = 3 with 2.5 m holds those from 1 to 5 as a whole."""
    points = np.array([[[k, 0, 0], [k + 1, 0, 0]] for k in range(10)], dtype=float)
    flight = Trajectory(points, np.ones(10), np.zeros(10, dtype=int))
    stations = Stations(np.array([[3.0, 0.0, 0.0]] * 4), np.full(4, 2.5))
    first = np.array([2, 4, 5, 0])
    assert held_s(flight, stations, first, ahead=True).tolist() == [3.0, 1.0, 0.0, 0.0]
    assert held_s(flight, stations, first, ahead=False).tolist() == [2.0, 4.0, 0.0, 0.0]
    wide = Stations(stations.at_m, np.full(4, 100.0))
    assert held_s(flight, wide, first, ahead=True).tolist() == [8.0, 6.0, 5.0, 10.0]
