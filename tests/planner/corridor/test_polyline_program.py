"""P4, the shortest polyline through the overlaps: corners by hand, hard scenes, every constraint kept exactly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from planner import Problem, build_corridor
from planner.corridor.chebyshev import chebyshev_centres, slack_m
from planner.corridor.polyline_program import polyline_length_m, settled, shortest_polyline
from planner.paper.station_graph import shortest_sequence
from tests.support.missions.problems import HARD_SCENES, HARD_SEQUENCES, corridor_of, make_problem


def test_p4_on_a_straight_line(two_stations: Problem) -> None:
    waypoints = shortest_polyline(two_stations, corridor_of(two_stations))
    assert polyline_length_m(waypoints) == pytest.approx(1600.0, abs=1e-5)
    np.testing.assert_allclose(waypoints[[0, -1]], [two_stations.start_m, two_stations.destination_m])
    assert 600.0 < waypoints[1, 0] < 1000.0


def test_p4_turns_at_the_corner_of_an_overlap() -> None:
    """Flying height is the antennas', so the discs are circles of 500 m; the way from A's west to B's west bends
    round the southern corner of their overlap.

        A(0, 0), B(0, 800): the circles cross at (+-300, 400). Start (-400, 0), destination (-400, 800): straight up
        along x = -400 the corridor is left, so the path turns at (-300, 400).
    """
    problem = make_problem([-400, 0, 100], [-400, 800, 100], [[0, 0, 100, 500], [0, 800, 100, 500]])
    waypoints = shortest_polyline(problem, corridor_of(problem))
    np.testing.assert_allclose(waypoints[1, :2], [-300.0, 400.0], atol=0.01)
    assert polyline_length_m(waypoints) == pytest.approx(2 * np.hypot(100, 400), abs=0.01)


def test_p4_uses_the_whole_band_for_a_hill() -> None:
    # The hill and valley of the overlap tests: they share a strip 2 m wide at 110 m.
    problem = make_problem([0, 0, 100], [78, 0, 120], [[0, 0, 80, 50], [78, 0, 140, 50]])
    waypoints = shortest_polyline(problem, corridor_of(problem))
    assert abs(waypoints[1, 2] - 110.0) < 5.0
    assert slack_m(problem, (0, 1), waypoints[1]) >= 0.0


@pytest.mark.parametrize("name", HARD_SCENES)
@pytest.mark.parametrize("overlap_s", [0.0, 4.0])
def test_p4_keeps_every_constraint_exactly(name: str, overlap_s: float) -> None:
    problem = replace(HARD_SCENES[name], min_overlap_s=overlap_s)
    corridor = build_corridor(problem, HARD_SEQUENCES.get(name) or shortest_sequence(problem))
    waypoints = shortest_polyline(problem, corridor)
    assert waypoints.shape == (len(corridor) + 1, 3)
    for k in range(1, len(corridor)):
        assert slack_m(problem, corridor.joint_balls(k), waypoints[k]) >= 0.0
        assert problem.limits.min_alt_m <= waypoints[k, 2] <= problem.limits.max_alt_m
    straight = float(np.linalg.norm(problem.destination_m - problem.start_m))
    assert straight - 1e-6 <= polyline_length_m(waypoints) <= straight + 10.0


@pytest.mark.parametrize("angle_deg", [45.0, 60.0])
def test_p4_turns_at_the_corner_of_two_elevation_cones(angle_deg: float) -> None:
    """At the one altitude of 100 m a cone of 45 degrees is a disc of 100 m, one of 60 degrees a disc of 57.7 m.

    The discs are 1.8 radii apart and cross at (0.9 r, +-0.436 r); the straight way at 0.7 r lies above that.
    """
    r = 100.0 / np.tan(np.radians(angle_deg))
    problem = make_problem(
        [-0.6 * r, 0.7 * r, 100],
        [2.4 * r, 0.7 * r, 100],
        [[0, 0, 0, 600], [1.8 * r, 0, 0, 600]],
        band=(100.0, 100.0),
        min_elevation_deg=np.full(2, angle_deg),
    )
    waypoints = shortest_polyline(problem, corridor_of(problem))
    np.testing.assert_allclose(waypoints[1], [0.9 * r, np.sqrt(0.19) * r, 100.0], atol=0.02)
    # With room above, the cones are wider there and the way goes over the top: 100 r / 100 m at 160 m is straight.
    high = replace(problem, limits=replace(problem.limits, max_alt_m=160.0))
    over = shortest_polyline(high, corridor_of(high))
    assert polyline_length_m(over) < polyline_length_m(waypoints) - 1.0
    assert over[1, 2] > 105.0
    assert slack_m(high, (0, 1), over[1]) >= 0.0


def test_an_elevation_of_zero_is_the_antennas_horizon() -> None:
    # The second antenna is at 115 m of a band from 100 to 120 m: the way must be that high at the handover, no higher.
    problem = make_problem(
        [0, 0, 100], [900, 0, 116], [[0, 0, 0, 600], [900, 0, 115, 600]], min_elevation_deg=np.array([-90.0, 0.0])
    )
    waypoints = shortest_polyline(problem, corridor_of(problem))
    assert waypoints[1, 2] == pytest.approx(115.0, abs=0.01)
    assert waypoints[1, 2] >= 115.0


def test_a_joint_just_outside_is_drawn_in_no_farther_than_needed(two_stations: Problem) -> None:
    corridor = corridor_of(two_stations)
    centres = chebyshev_centres(two_stations, corridor)
    radius = np.sqrt(1000.0**2 - 100.0**2)
    for outside_m in (1e-9, 1e-5, 0.1):
        joint = np.array([[radius + outside_m, 0.0, 100.0 - outside_m]])
        settled_joint = settled(two_stations, corridor, centres, joint)[1]
        assert slack_m(two_stations, (0, 1), settled_joint) >= 0.0
        assert settled_joint[2] >= 100.0
        assert np.linalg.norm(settled_joint - joint[0]) < 10.0 * outside_m + 1e-5
    inside = np.array([[800.0, 5.0, 103.0]])
    np.testing.assert_array_equal(settled(two_stations, corridor, centres, inside)[1], inside[0])
