"""P5: control points with durations fixed, farthest from the limits."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from planner import Problem, build_corridor
from planner.corridor.limit_check import CorridorCheck
from planner.paper.alternating import AlternatingMinimisation
from planner.paper.boundary import control_points
from planner.paper.station_graph import shortest_sequence
from tests.support.missions.problems import HARD_SCENES, HARD_SEQUENCES, corridor_of, paper_problem


def test_p5_flattens_the_initial_trajectory_by_hand(two_stations: Problem) -> None:
    """1,600 m in 160 s on a straight line: the least largest velocity control point is between the mean speed of
    10 m/s and the 50 m/s of stopping half way, and the same whichever way it is flown.
    """
    method = AlternatingMinimisation(two_stations, corridor_of(two_stations))
    np.testing.assert_allclose(method.durations_s.sum(), 160.0, rtol=1e-3)
    boundary = method.program.solve(method.durations_s)
    speed, accel, _ = method.check.ratios(control_points(boundary, method.durations_s), method.durations_s).max(axis=1)
    assert 10.0 / 50.0 < speed < 0.5
    assert max(speed, accel) < 0.4
    assert np.abs(boundary[:, :, 1]).max() < 1e-6  # nothing to gain sideways
    assert method.check.place_excess_m(control_points(boundary, method.durations_s)).max() <= 0.0


@pytest.mark.parametrize("name", ["elevation", "tangent", "a millimetre of band", "one inside the other"])
def test_p5_answers_inside_the_ranges_by_itself(name: str) -> None:
    """Before anything is repaired: within the solver's tolerance of balls, band and elevation cones."""
    problem = replace(HARD_SCENES[name], min_overlap_s=4.0)
    corridor = build_corridor(problem, HARD_SEQUENCES.get(name) or shortest_sequence(problem))
    method = AlternatingMinimisation(problem, corridor)
    boundary = method.program.solve(method.durations_s)
    points = control_points(boundary, method.durations_s)
    assert method.check.place_excess_m(points).max() <= 1e-5
    before = method.check.ratios(control_points(method.boundary, method.durations_s), method.durations_s).max()
    assert method.check.ratios(points, method.durations_s).max() < before


def test_p5_is_a_minimum() -> None:
    """Random feasible displacements of the joints only make the worst ratio worse."""
    problem = paper_problem("M30_04")
    method = AlternatingMinimisation(problem, corridor_of(problem))
    t = method.durations_s
    best = method.program.solve(t)
    least = method.check.ratios(control_points(best, t), t).max()
    rng = np.random.default_rng(0)
    for size in (1e-2, 1.0, 30.0):
        for _ in range(20):
            other = best.copy()
            other[1:-1] += size * rng.normal(size=other[1:-1].shape) * np.array([1.0, 0.05, 0.005])[:, None]
            points = control_points(other, t)
            if method.check.place_excess_m(points).max() <= 0.0:
                assert method.check.ratios(points, t).max() >= least - 1e-6


def test_p5_in_place_update_equals_a_fresh_program() -> None:
    problem = paper_problem("M100_05")
    first, second = (AlternatingMinimisation(problem, corridor_of(problem)) for _ in range(2))
    t = first.durations_s
    rng = np.random.default_rng(1)
    for _ in range(3):
        first.program.solve(t * rng.uniform(0.7, 1.3, len(t)))
    again, fresh = first.program.solve(0.8 * t), second.program.solve(0.8 * t)
    ratios = [
        method.ratios(control_points(b, t), t).max() for method, b in ((first.check, again), (second.check, fresh))
    ]
    assert ratios[0] == pytest.approx(ratios[1], rel=1e-6)


@pytest.mark.parametrize(
    ("limits", "row"),
    [
        ({"max_jerk_m_s3": 0.05}, 2),
        ({"max_climb_m_s": 0.1}, 0),
        ({"max_airspeed_m_s": 40.0, "wind_m_s": (9.0, 9.0)}, 0),
    ],
)
def test_p5_counts_the_optional_limits(limits: dict[str, Any], row: int) -> None:
    """A limit that binds lowers its own ratio at the expense of the others."""
    free, bound = paper_problem("M30_04"), paper_problem("M30_04", limits=limits)
    corridor = corridor_of(free)
    ratios = []
    durations = AlternatingMinimisation(free, corridor).durations_s
    check = CorridorCheck(bound, corridor)
    for problem in (free, bound):
        boundary = AlternatingMinimisation(problem, corridor).program.solve(durations)
        ratios.append(check.ratios(control_points(boundary, durations), durations).max(axis=1))
    assert ratios[1].max() < ratios[0].max() - 1e-3
    assert ratios[1][row] < ratios[0][row]
