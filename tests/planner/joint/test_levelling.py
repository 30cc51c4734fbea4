"""Altitude is left only where that gains time or a limit asks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from planner import Limits, Planner, Problem, certify
from planner.joint.levelling import levelled

CHAIN = np.array([[0.0, 500.0, 5.0], [9_000.0, -800.0, 5.0], [18_000.0, 700.0, 5.0]])


def _problem(start_alt_m: float, there_alt_m: float, **changes: object) -> Problem:
    problem = Problem(
        np.array([-4_000.0, 0.0, start_alt_m]),
        np.array([22_000.0, 0.0, there_alt_m]),
        CHAIN,
        np.full(3, 6_000.0),
        Limits(50.0, 400.0, 25.0, 2.5),
        min_overlap_s=5.0,
        min_tenure_s=10.0,
    )
    return replace(problem, **changes)  # type: ignore[arg-type]


@pytest.mark.parametrize("method", ["joint", "fast"])
@pytest.mark.parametrize(("low", "high"), [(100.0, 100.0), (60.0, 390.0), (380.0, 70.0)])
def test_between_the_ends(method: str, low: float, high: float) -> None:
    problem = _problem(low, high)
    solution = Planner().plan(problem, method=method)  # type: ignore[arg-type]
    altitude = solution.trajectory.control_points_m[..., 2]
    assert altitude.min() >= min(low, high) - 0.5
    assert altitude.max() <= max(low, high) + 0.5
    assert certify(problem, solution.trajectory).feasible


def test_climbs_where_a_mask_asks_and_comes_down_again() -> None:
    problem = _problem(60.0, 60.0, min_elevation_deg=np.array([-90.0, 2.0, -90.0]))
    trajectory = Planner().plan(problem).trajectory
    assert certify(problem, trajectory).feasible
    points = trajectory.control_points_m
    assert points[..., 2].max() > 100.0
    assert points[points[..., 0] < -3_500.0][:, 2].max() < 75.0
    assert points[points[..., 0] > 21_500.0][:, 2].max() < 75.0


def test_time_and_way_stay() -> None:
    problem = _problem(100.0, 100.0)
    trajectory = Planner().plan(problem).trajectory
    points = trajectory.control_points_m.copy()
    # A bump in the middle of a piece, gone again at its ends, that no limit minds.
    points[8, 2:4, 2] += 3.0
    bumpy = replace(trajectory, control_points_m=points)
    level = levelled(problem, bumpy)
    assert np.array_equal(level.durations_s, bumpy.durations_s)
    assert np.array_equal(level.control_points_m[..., :2], bumpy.control_points_m[..., :2])
