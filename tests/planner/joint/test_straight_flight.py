"""One station and a straight way: as fast as the formula, whatever the limits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from planner import Limits, Planner, Problem, certify
from planner.joint.straight_flight import straight_flight
from planner.speed_profile import fastest_time_s


def _drawn(seed: int) -> Problem:
    rng = np.random.default_rng(seed)
    length, speed, accel = 10.0 ** rng.uniform(0.0, 5.0), 10.0 ** rng.uniform(0.3, 2.0), 10.0 ** rng.uniform(-0.3, 1.0)
    windy = bool(seed % 3 == 0)
    limits = Limits(
        0.0,
        500.0,
        speed,
        accel,
        max_jerk_m_s3=10.0 ** rng.uniform(-0.5, 1.5) if seed % 2 else None,
        max_airspeed_m_s=speed * rng.uniform(0.6, 1.2) if windy else None,
        wind_m_s=(0.2 * speed, -0.3 * speed) if windy else (0.0, 0.0),
        max_climb_m_s=0.2 * speed if seed % 5 == 0 else None,
    )
    angle = rng.uniform(0.0, 2.0 * np.pi)
    up = min(length, 300.0) * rng.uniform(0.0, 1.0)
    there = np.array([length * np.cos(angle), length * np.sin(angle), 100.0 + up])
    return Problem(
        np.array([0.0, 0.0, 100.0]), there, np.array([[0.0, 0.0, 50.0]]), np.array([2.0 * length + 500.0]), limits
    )


@pytest.mark.parametrize("seed", range(60))
def test_keeps_every_limit(seed: int) -> None:
    problem = _drawn(seed)
    trajectory = straight_flight(problem, 0)
    # Where climbing bounds the speed the formula is not the fastest, and none is given (`test_options` has one).
    way = problem.destination_m - problem.start_m
    steep = float(way[2] / np.linalg.norm(way))
    unbound = straight_flight(replace(problem, limits=replace(problem.limits, max_climb_m_s=None)), 0)
    assert unbound is not None
    climb = steep * float(np.linalg.norm(unbound.evaluate(np.linspace(0.0, unbound.duration_s, 400), 1), axis=1).max())
    if trajectory is None:
        assert problem.limits.max_climb_m_s is not None
        assert steep * problem.limits.max_speed_m_s > problem.limits.max_climb_m_s
        return
    assert problem.limits.max_climb_m_s is None or climb <= problem.limits.max_climb_m_s * (1.0 + 1e-9)
    assert certify(problem, trajectory).feasible, certify(problem, trajectory).broken


@pytest.mark.parametrize("seed", [s for s in range(60) if s % 3 and s % 5])
def test_as_fast_as_the_formula(seed: int) -> None:
    """But for the time the acceleration takes to come and go: a fiftieth of a ramp or so."""
    problem = _drawn(seed)
    trajectory = straight_flight(problem, 0)
    assert trajectory is not None
    length = float(np.linalg.norm(problem.destination_m - problem.start_m))
    least_s = fastest_time_s(problem.limits, length)
    ramp_s = problem.limits.max_speed_m_s / problem.limits.max_accel_m_s2
    assert least_s <= trajectory.duration_s * (1.0 + 1e-9)
    assert trajectory.duration_s <= least_s + max(0.05 * min(ramp_s, least_s), 1.0)


def test_the_planner_flies_it() -> None:
    limits = Limits(100.0, 200.0, 30.0, 3.58)
    problem = Problem(
        np.array([0.0, 0.0, 155.0]),
        np.array([21_798.0, 0.0, 176.0]),
        np.array([[9_000.0, 4_000.0, 20.0]]),
        np.array([20_000.0]),
        limits,
    )
    solution = Planner().plan(problem)
    assert solution.trajectory.duration_s <= 1.0005 * fastest_time_s(limits, 21_798.0)
    # As straight up as along: the altitude is left for nothing.
    points = solution.trajectory.control_points_m
    assert points[..., 2] == pytest.approx(155.0 + 21.0 * points[..., 0] / 21_798.0, abs=1e-6)
