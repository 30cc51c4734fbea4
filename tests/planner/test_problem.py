"""A problem that makes no sense is refused where it is made, with the value and what is allowed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from planner import Limits, ProblemError
from tests.support.missions.problems import make_problem

GOOD_LIMITS = {"min_alt_m": 100.0, "max_alt_m": 120.0, "max_speed_m_s": 50.0, "max_accel_m_s2": 5.0}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"max_speed_m_s": 0.0}, "max_speed_m_s"),
        ({"max_speed_m_s": float("nan")}, "max_speed_m_s"),
        ({"max_accel_m_s2": float("inf")}, "max_accel_m_s2"),
        ({"min_alt_m": 121.0}, "upside down"),
        ({"max_alt_m": float("nan")}, "not finite"),
        ({"max_jerk_m_s3": 0.0}, "max_jerk_m_s3"),
        ({"max_climb_m_s": -1.0}, "max_climb_m_s"),
        ({"max_descent_m_s": float("nan")}, "max_descent_m_s"),
        ({"max_airspeed_m_s": 0.0}, "max_airspeed_m_s"),
        ({"max_duration_s": -5.0}, "max_duration_s"),
        ({"wind_m_s": (float("nan"), 0.0)}, "wind_m_s"),
    ],
)
def test_limits_refuse(change: dict[str, Any], said: str) -> None:
    with pytest.raises(ProblemError, match=said):
        Limits(**(GOOD_LIMITS | change))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"min_overlap_s": -1.0}, "min_overlap_s"),
        ({"min_tenure_s": float("inf")}, "min_tenure_s"),
        ({"max_handovers": -1}, "max_handovers"),
        ({"bound_speed_factor": 0.9}, "bound_speed_factor"),
        ({"min_elevation_deg": np.array([-5.0])}, "min_elevation_deg"),
        ({"min_elevation_deg": np.array([90.0])}, "min_elevation_deg"),
        ({"min_elevation_deg": np.array([5.0, 5.0])}, "min_elevation_deg"),
        ({"bound_ranges_m": np.array([np.nan])}, "bound_ranges_m"),
        ({"start_velocity_m_s": np.zeros(2)}, "start_velocity_m_s"),
    ],
)
def test_problems_refuse(change: dict[str, Any], said: str) -> None:
    with pytest.raises(ProblemError, match=said):
        make_problem([0, 0, 100], [1, 1, 100], [[0, 0, 0, 500]], **change)


def test_a_problem_without_stations_is_refused() -> None:
    with pytest.raises(ProblemError, match="at least one station"):
        make_problem([0, 0, 100], [1, 1, 100], np.zeros((0, 4)))


def test_a_problem_cannot_be_changed_behind_its_back() -> None:
    problem = make_problem([0, 0, 100], [1, 1, 100], [[0, 0, 0, 500], [0, 0, 110, 90]])
    with pytest.raises(ValueError, match="read-only"):
        problem.ranges_m[0] = 1.0
    assert problem.station_count == 2
    assert problem.disc_plane_m().tolist() == [100.0, 110.0]
    assert problem.covers(np.array([0.0, 0.0, 105.0])).tolist() == [0, 1]
    assert problem.covers(np.array([0.0, 0.0, 201.0])).tolist() == [0]
