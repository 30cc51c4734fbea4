"""The curve as a function of time: joints, legs, derivatives, splitting, length."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner import ProblemError, Trajectory


def rest_to_rest(length_m: float, duration_s: float, station: int = 0) -> Trajectory:
    """Paper equation (33) on the east axis: [W, W, W, W', W', W']."""
    points = np.zeros((1, 6, 3))
    points[0, 3:, 0] = length_m
    return Trajectory(points, np.array([duration_s]), np.array([station]))


def random_trajectory(seed: int, pieces: int, degree: int) -> Trajectory:
    rng = np.random.default_rng(seed)
    return Trajectory(
        rng.normal(scale=1e3, size=(pieces, degree + 1, 3)), rng.uniform(1, 9, pieces), rng.integers(0, 3, pieces)
    )


def test_rest_to_rest_by_hand() -> None:
    # 100 m in 10 s: Q = 5 * 100 / 10 = 50 m/s once, K = 20 * 100 / 100 = +20 and -20 m/s^2,
    # jerk 60 * 100 / 1000 * (1, -2, 1) m/s^3.
    flight = rest_to_rest(100.0, 10.0)
    np.testing.assert_allclose(flight.derivative_control_points(1)[0, :, 0], [0, 0, 50, 0, 0])
    np.testing.assert_allclose(flight.derivative_control_points(2)[0, :, 0], [0, 20, -20, 0])
    np.testing.assert_allclose(flight.derivative_control_points(3)[0, :, 0], [6, -12, 6])
    # Half way: 50 m, at 1.875 times the mean speed.
    np.testing.assert_allclose(flight.evaluate(5.0), [50.0, 0, 0])
    np.testing.assert_allclose(flight.evaluate(5.0, 1), [18.75, 0, 0])
    np.testing.assert_allclose(flight.evaluate(5.0, 2), [0, 0, 0], atol=1e-12)
    assert flight.path_length_m() == pytest.approx(100.0)
    assert flight.duration_s == 10.0
    assert flight.degree == 5


def test_legs_and_handovers() -> None:
    points = np.zeros((5, 4, 3))
    flight = Trajectory(points, np.array([1.0, 2.0, 3.0, 4.0, 5.0]), np.array([7, 7, 2, 7, 7]))
    np.testing.assert_array_equal(flight.leg_index, [0, 0, 1, 2, 2])
    np.testing.assert_array_equal(flight.handover_times_s, [3.0, 6.0])
    np.testing.assert_array_equal(flight.knots_s, [0, 1, 3, 6, 10, 15])
    assert flight.sequence == (7, 2, 7)
    # At a joint the later segment is in force; outside, the ends.
    np.testing.assert_array_equal(flight.segment_at(np.array([-1.0, 0.0, 1.0, 2.9, 15.0, 99.0])), [0, 0, 1, 1, 4, 4])


def test_times_outside_stay_at_the_ends() -> None:
    flight = rest_to_rest(100.0, 10.0)
    np.testing.assert_array_equal(flight.evaluate(np.array([-5.0, 15.0])), [[0, 0, 0], [100, 0, 0]])


@given(st.integers(0, 10_000), st.integers(1, 4), st.integers(2, 7), st.lists(st.floats(-2, 40), max_size=6))
@settings(deadline=None, max_examples=40)
def test_split_and_elevate_keep_the_curve(seed: int, pieces: int, degree: int, times: list[float]) -> None:
    flight = random_trajectory(seed, pieces, degree)
    other = flight.split(times).elevate(degree + 2)
    assert other.duration_s == pytest.approx(flight.duration_s, rel=1e-12)
    # Just beside a joint these random pieces, which do not join smoothly, may be read on either side of it.
    at = np.linspace(0.0, flight.duration_s, 37)
    at = at[np.abs(flight.knots_s - at[:, None]).min(axis=1) > 1e-6]
    for order in (0, 1):
        np.testing.assert_allclose(other.evaluate(at, order), flight.evaluate(at, order), atol=1e-6)
    inner = [t for t in times if 0 < t < flight.duration_s]
    assert all(np.abs(other.knots_s - t).min() < 1e-8 for t in inner)


def test_split_ignores_joints_and_outside() -> None:
    flight = random_trajectory(1, 2, 5)
    joint = float(flight.knots_s[1])
    assert len(flight.split([0.0, joint, joint + 1e-12, flight.duration_s, -3.0, 1e9])) == 2
    assert len(flight.split([0.5 * joint, 0.5 * joint])) == 3
    np.testing.assert_array_equal(
        flight.split([0.5 * joint]).station_index, np.r_[flight.station_index[:1], flight.station_index]
    )


@given(st.integers(0, 10_000), st.floats(0.2, 5.0))
@settings(deadline=None, max_examples=30)
def test_scaled_time_divides_speed_and_its_square_acceleration(seed: int, factor: float) -> None:
    flight = random_trajectory(seed, 3, 5)
    slower = flight.scale_time(factor)
    for order in (1, 2, 3):
        np.testing.assert_allclose(
            slower.derivative_control_points(order), flight.derivative_control_points(order) / factor**order, rtol=1e-9
        )
    np.testing.assert_array_equal(slower.control_points_m, flight.control_points_m)
    assert slower.path_length_m() == pytest.approx(flight.path_length_m())


@given(st.integers(0, 10_000))
@settings(deadline=None, max_examples=20)
def test_path_length_against_a_fine_polyline(seed: int) -> None:
    flight = random_trajectory(seed, 2, 5)
    polyline = 0.0
    for k in range(2):
        times = np.linspace(flight.knots_s[k] + 1e-9, flight.knots_s[k + 1] - 1e-9, 4001)
        polyline += float(np.linalg.norm(np.diff(flight.evaluate(times), axis=0), axis=1).sum())
    assert flight.path_length_m() == pytest.approx(polyline, rel=1e-4)


@pytest.mark.parametrize(
    ("points", "durations", "stations", "said"),
    [
        (np.zeros((1, 6, 2)), [1.0], [0], "n \\+ 1, 3"),
        (np.zeros((0, 6, 3)), [], [], "n \\+ 1, 3"),
        (np.zeros((1, 1, 3)), [1.0], [0], "n \\+ 1, 3"),
        (np.zeros((2, 6, 3)), [1.0], [0, 0], "one entry per segment"),
        (np.zeros((1, 6, 3)), [0.0], [0], "durations positive"),
        (np.zeros((1, 6, 3)), [np.nan], [0], "durations positive"),
        (np.full((1, 6, 3), np.inf), [1.0], [0], "finite"),
    ],
)
def test_nonsense_is_refused(points: np.ndarray, durations: list[float], stations: list[int], said: str) -> None:
    with pytest.raises(ProblemError, match=said):
        Trajectory(points, np.array(durations), np.array(stations, dtype=int))


def test_a_trajectory_cannot_be_changed() -> None:
    flight = rest_to_rest(100.0, 10.0)
    with pytest.raises(ValueError, match="read-only"):
        flight.control_points_m[0, 0, 0] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        flight.durations_s[0] = 1.0
