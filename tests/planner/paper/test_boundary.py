"""Boundary conditions at the joints, and the shortest piece their arithmetic bears."""

from __future__ import annotations

import numpy as np

from planner import build_corridor
from planner.paper.boundary import CONTROL_FROM_BOUNDARY, control_points, shortest_piece_s
from planner.paper.initial import initial_durations
from tests.support.missions.problems import make_problem


def test_boundary_conditions_are_those_of_the_curve() -> None:
    rng = np.random.default_rng(2)
    boundary, durations = rng.normal(size=(4, 3, 3)), rng.uniform(0.5, 3.0, 3)
    points = control_points(boundary, durations)
    t = durations[:, None]
    np.testing.assert_allclose(points[:, 0], boundary[:-1, 0])
    np.testing.assert_allclose(points[:, 5], boundary[1:, 0])
    np.testing.assert_allclose(5 * (points[:, 1] - points[:, 0]) / t, boundary[:-1, 1])  # equation (9)
    np.testing.assert_allclose(5 * (points[:, 5] - points[:, 4]) / t, boundary[1:, 1])
    second = points[:, 2:] - 2 * points[:, 1:-1] + points[:, :-2]
    np.testing.assert_allclose(20 * second[:, 0] / t**2, boundary[:-1, 2], atol=1e-9)  # equation (11)
    np.testing.assert_allclose(20 * second[:, -1] / t**2, boundary[1:, 2], atol=1e-9)
    np.testing.assert_allclose(CONTROL_FROM_BOUNDARY[:, [0, 3]].sum(axis=1), 1.0)


def test_no_piece_is_too_short_for_its_coordinates() -> None:
    near = make_problem([0, 0, 100], [0, 0, 100], [[0, 0, 0, 600]])
    far = make_problem([3e5, 0, 100], [3e5, 0, 100], [[3e5, 0, 0, 600]])
    assert 0.0 < shortest_piece_s(near) < shortest_piece_s(far) < 1.0
    corridor = build_corridor(far, [0])
    durations = initial_durations(far, corridor, np.vstack([far.start_m, far.destination_m]))
    assert durations.tolist() == [shortest_piece_s(far)]
