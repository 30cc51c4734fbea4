"""Control points against a corridor's limits: ratios, and the same figures as the certificate."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner import Limits, Trajectory, build_corridor, certify
from planner.corridor.limit_check import CorridorCheck, speed_ratio
from tests.support.missions.problems import make_problem


@given(st.tuples(*[st.floats(-30, 30)] * 3), st.tuples(*[st.floats(-10, 10)] * 2), st.floats(0.1, 10.0), st.booleans())
@settings(deadline=None)
def test_speed_ratio_is_one_exactly_at_the_limit(
    velocity: tuple[float, ...], wind: tuple[float, ...], slower: float, vertical: bool
) -> None:
    extra = {"max_climb_m_s": 4.0, "max_descent_m_s": 3.0} if vertical else {}
    limits = Limits(0.0, 1.0, 40.0, 1.0, max_airspeed_m_s=20.0, wind_m_s=(wind[0], wind[1]), **extra)
    v = np.array(velocity)
    ratio = float(speed_ratio(limits, v))
    assert float(speed_ratio(limits, v / slower)) == pytest.approx(ratio / slower, rel=1e-6, abs=1e-12)
    if ratio < 1e-6:
        return
    at_limit = v / ratio
    air = float(np.linalg.norm(at_limit - [*wind, 0.0]))
    tight = [np.linalg.norm(at_limit) / 40.0, air / 20.0]
    if vertical:
        tight += [at_limit[2] / 4.0, -at_limit[2] / 3.0]
    assert max(tight) == pytest.approx(1.0, abs=1e-6)


def test_no_speed_is_slow_enough_when_the_wind_is_too_strong() -> None:
    limits = Limits(0.0, 1.0, 40.0, 1.0, max_airspeed_m_s=10.0, wind_m_s=(10.0, 0.0))
    assert float(speed_ratio(limits, np.array([1.0, 0, 0]))) == np.inf


@given(st.integers(0, 100_000))
@settings(deadline=None, max_examples=40)
def test_the_check_measures_what_the_certificate_does(seed: int) -> None:
    rng = np.random.default_rng(seed)
    limits = {"max_jerk_m_s3": 2.0, "max_climb_m_s": 3.0, "max_descent_m_s": 2.0}
    rows = np.column_stack([rng.uniform(-300, 300, (3, 2)), rng.uniform(0, 110, 3), rng.uniform(200, 500, 3)])
    problem = make_problem(
        [0, 0, 100], [0, 0, 100], rows, limits=limits, min_elevation_deg=rng.choice([-90.0, 0.0, 20.0], 3)
    )
    corridor = build_corridor(problem, [0, 1, 2])
    points, durations = rng.uniform([-400, -400, 90], [400, 400, 130], (3, 6, 3)), rng.uniform(5, 60, 3)
    worst = certify(problem, Trajectory(points, durations, np.arange(3))).worst
    check = CorridorCheck(problem, corridor)
    places = [worst["range_m"], worst["altitude_m"], worst["elevation_m"]]
    assert check.place_excess_m(points).max() == pytest.approx(max(places), abs=1e-9)
    speed, accel, jerk = check.ratios(points, durations).max(axis=1)
    named = [(worst["speed_m_s"], 50.0), (worst["climb_m_s"], 3.0), (worst["descent_m_s"], 2.0)]
    assert speed == pytest.approx(max(excess / limit + 1.0 for excess, limit in named))
    assert accel == pytest.approx(worst["accel_m_s2"] / 5.0 + 1.0)
    assert jerk == pytest.approx(worst["jerk_m_s3"] / 2.0 + 1.0)
    # Slowed by the largest slowdown, the fastest piece is exactly at a limit.
    slower = durations * check.slowdown(points, durations).max()
    assert check.ratios(points, slower).max() == pytest.approx(1.0)
