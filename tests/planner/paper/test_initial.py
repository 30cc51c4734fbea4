"""Algorithm 2: durations of the initial trajectory, by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from planner import Problem, build_corridor
from planner.corridor.limit_check import CorridorCheck
from planner.paper.boundary import control_points, rest_at
from planner.paper.initial import initial_durations, leg_durations
from tests.support.missions.problems import corridor_of, make_problem


def test_initial_durations_by_hand(two_stations: Problem) -> None:
    # 800 m a piece: 5 * 800 / 50 = 80 s for the speed, sqrt(20 * 800 / 5) = 56.6 s for the acceleration.
    waypoints = np.array([[0, 0, 100], [800, 0, 100], [1600, 0, 100.0]])
    np.testing.assert_allclose(initial_durations(two_stations, corridor_of(two_stations), waypoints), [80.0, 80.0])
    # 100 m: 10 s for the speed, sqrt(20 * 100 / 5) = 20 s for the acceleration.
    short = np.array([[0, 0, 100], [100, 0, 100], [900, 0, 100.0]])
    np.testing.assert_allclose(initial_durations(two_stations, corridor_of(two_stations), short), [20.0, 80.0])


@pytest.mark.parametrize(
    ("limits", "expected_s"),
    [
        ({"max_jerk_m_s3": 0.1}, np.cbrt(120 * 100 / 0.1)),
        ({"max_climb_m_s": 0.5}, 5 * 12 / 0.5),
        ({"max_descent_m_s": 0.5}, 20.0),
        # Head wind of 5 m/s and an airspeed of 8: 3 m/s over ground, and 5 * 100 / 3 s.
        ({"max_airspeed_m_s": 8.0, "wind_m_s": (-5.0, 0.0)}, 5 * np.hypot(100, 0) / 3.0),
    ],
)
def test_initial_durations_keep_the_optional_limits(limits: dict[str, Any], expected_s: float) -> None:
    rise = 12.0 if "max_climb_m_s" in limits or "max_descent_m_s" in limits else 0.0
    length = float(np.sqrt(100.0**2 - rise**2))
    problem = make_problem([0, 0, 100], [length, 0, 100 + rise], [[0, 0, 0, 600]], limits=limits)
    corridor = build_corridor(problem, [0])
    waypoints = np.vstack([problem.start_m, problem.destination_m])
    durations = initial_durations(problem, corridor, waypoints)
    assert durations[0] == pytest.approx(expected_s)
    assert (
        CorridorCheck(problem, corridor).slowdown(control_points(rest_at(waypoints), durations), durations) <= 1 + 1e-12
    )


def test_initial_durations_hover_and_stay_for_the_tenure() -> None:
    problem = make_problem(
        [0, 0, 100], [10, 0, 100], [[0, 0, 0, 600], [10, 0, 0, 600]], min_overlap_s=6.0, min_tenure_s=100.0
    )
    corridor = build_corridor(problem, [0, 1])
    waypoints = np.array([[0, 0, 100], [5, 0, 100], [5, 0, 100], [5, 0, 100], [10, 0, 100.0]])
    durations = initial_durations(problem, corridor, waypoints)
    assert (durations[1:3] >= 3.0).all()
    np.testing.assert_allclose(leg_durations(corridor, durations), [100.0, 100.0])
    # Without tenure, sqrt(20 * 5 / 5) = 4.47 s to move and 3 s to hover.
    free = make_problem([0, 0, 100], [10, 0, 100], [[0, 0, 0, 600], [10, 0, 0, 600]], min_overlap_s=6.0)
    np.testing.assert_allclose(
        initial_durations(free, corridor_of_pair(free), waypoints), [np.sqrt(20), 3, 3, np.sqrt(20)]
    )


def corridor_of_pair(problem: Problem) -> Any:
    return build_corridor(problem, [0, 1])
