"""Chebyshev centres of joints: inside everything, and where three ranges meet."""

from __future__ import annotations

import numpy as np
import pytest

from planner import InfeasibleError
from planner.corridor.chebyshev import chebyshev_centres, slack_m
from planner.corridor.corridor import Corridor, Piece
from planner.corridor.polyline_program import shortest_polyline
from tests.support.missions.problems import corridor_of, make_problem, paper_problem


def test_chebyshev_centres_are_inside_everything() -> None:
    problem = paper_problem("M100_04", min_overlap_s=5.0)
    corridor = corridor_of(problem)
    centres = chebyshev_centres(problem, corridor)
    for k in range(len(corridor) - 1):
        assert slack_m(problem, corridor.joint_balls(k + 1), centres.points_m[k]) == pytest.approx(centres.slack_m[k])
        assert centres.slack_m[k] > 0.0
        assert 100.0 < centres.points_m[k, 2] < 120.0


def test_three_balls_at_a_joint() -> None:
    """Three ranges that meet in the middle only: their deepest point is found, and missed when they do not meet."""
    side = 1000.0
    rows = [[0, 0, 110, 590], [side, 0, 110, 590], [side / 2, side * np.sqrt(3) / 2, 110, 590]]
    problem = make_problem([0, 0, 110], [side, 0, 110], rows)
    corridor = Corridor((0, 1), (Piece(0, 0, (0,)), Piece(0, 0, (0, 2)), Piece(1, 1, (1, 0)), Piece(1, 1, (1,))), 0.0)
    assert corridor.joint_balls(2) == (0, 2, 1)
    centres = chebyshev_centres(problem, corridor)
    np.testing.assert_allclose(centres.points_m[1], [500.0, side * np.sqrt(3) / 6, 110.0], atol=0.5)
    waypoints = shortest_polyline(problem, corridor)
    assert slack_m(problem, (0, 1, 2), waypoints[2]) >= 0.0
    # From antennas far above the band the most range is left at its top, where less is left the wider the triangle.
    raised = make_problem([0, 0, 110], [side, 0, 110], np.array(rows) + np.array([0, 0, 190, 60]))
    assert chebyshev_centres(raised, corridor).points_m[1, 2] == pytest.approx(120.0, abs=6.0)
    apart = make_problem([0, 0, 110], [side, 0, 110], np.array(rows) - np.array([0, 0, 0, 15.0]))
    with pytest.raises(InfeasibleError, match="no point in common"):
        chebyshev_centres(apart, corridor)
