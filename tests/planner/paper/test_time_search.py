"""Algorithm 3: the binary search over durations, its minima and the tenure."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from planner import build_corridor
from planner.corridor.corridor import Corridor, Piece
from planner.paper.alternating import AlternatingMinimisation
from planner.paper.boundary import control_points
from planner.paper.initial import leg_durations
from planner.paper.time_search import _keep_tenure, shortest_durations
from tests.support.missions.problems import corridor_of, make_problem, paper_problem


def single(length_m: float, **options: Any) -> AlternatingMinimisation:
    problem = make_problem([0, 0, 100], [length_m, 0, 100], [[0, 0, 0, 2000]], **options)
    return AlternatingMinimisation(problem, build_corridor(problem, [0]))


def test_binary_search_finds_the_rest_to_rest_time() -> None:
    # As by hand in `test_initial`: 100 m takes 20 s, from wherever the search starts.
    method = single(100.0)
    for start_s in (21.0, 100.0, 3000.0):
        found = shortest_durations(
            method.check, method.corridor, method.boundary, np.array([start_s]), method.minima_s, tolerance_s=1e-6
        )
        assert found[0] == pytest.approx(20.0, abs=1e-6)
        assert found[0] >= 20.0 - 1e-12


def test_binary_search_stops_at_the_minimum_and_the_tenure() -> None:
    problem = make_problem(
        [0, 0, 100], [900, 0, 100], [[0, 0, 0, 600], [900, 0, 0, 600]], min_overlap_s=8.0, min_tenure_s=70.0
    )
    method = AlternatingMinimisation(problem, build_corridor(problem, [0, 1]))
    long = 3.0 * method.durations_s
    found = shortest_durations(method.check, method.corridor, method.boundary, long, method.minima_s)
    assert (found[1:3] >= 4.0).all()
    assert (leg_durations(method.corridor, found) >= 70.0).all()
    assert leg_durations(method.corridor, found) == pytest.approx([70.0, 70.0], abs=1e-4)
    assert method.check.holds(control_points(method.boundary, found), found).all()


class Thresholds:
    """Stands in for the constraints: piece k holds from ``least_s[k]`` up."""

    def __init__(self, least_s: list[float]) -> None:
        self.least_s = np.array(least_s)

    def holds(self, points: np.ndarray, durations_s: np.ndarray) -> np.ndarray:
        return np.asarray(durations_s >= self.least_s)


def search(least_s: list[float], before_s: list[float], min_leg_s: float = 0.0, legs: str = "001") -> np.ndarray:
    """The binary search over pieces whose legs are given by digits, 1 s at least each."""
    pieces = tuple(Piece(0, int(leg), (0,)) for leg in legs)
    return shortest_durations(
        Thresholds(least_s),  # type: ignore[arg-type]
        Corridor((0, 1), pieces, min_leg_s),
        np.zeros((len(pieces) + 1, 3, 3)),
        np.array(before_s),
        np.ones(len(pieces)),
    )


def test_every_piece_is_searched_to_the_tolerance() -> None:
    np.testing.assert_allclose(search([2.0, 777.0, 0.1], [2.1, 900.0, 5e4]), [2.0, 777.0, 1.0], atol=2e-6)


def test_a_leg_short_of_its_tenure_keeps_what_it_takes_and_the_other_does_not() -> None:
    # Leg 0 would take 2 + 3 s and must take 12; it had 10 + 10, so 7 of the 15 s gained are given back to it.
    found = search([2.0, 3.0, 30.0], [10.0, 10.0, 60.0], min_leg_s=12.0)
    np.testing.assert_allclose(found, [2 + 8 * 7 / 15, 3 + 7 * 7 / 15, 30.0], atol=1e-5)
    assert found[:2].sum() >= 12.0
    # At its present durations it has just the tenure: nothing is gained.
    np.testing.assert_allclose(search([2.0, 3.0, 30.0], [6.0, 6.0, 60.0], min_leg_s=12.0)[:2], [6.0, 6.0], atol=1e-5)


def test_what_is_given_back_is_feasible_again() -> None:
    class Island(Thresholds):
        """Piece 0 holds at 2 s and from 8 s up, and not between."""

        def holds(self, points: np.ndarray, durations_s: np.ndarray) -> np.ndarray:
            held = durations_s >= self.least_s
            held[0] = durations_s[0] >= 8.0
            return np.asarray(held)

    check = Island([2.0, 3.0])
    found = _keep_tenure(
        check,  # type: ignore[arg-type]
        Corridor((0, 1), (Piece(0, 0, (0,)), Piece(1, 1, (1,))), 5.0),
        np.zeros((3, 3, 3)),
        np.array([10.0, 20.0]),
        np.array([2.0, 9.0]),
    )
    np.testing.assert_allclose(found, [8.0, 9.0], atol=1e-4)
    assert found[0] >= 8.0


def test_binary_search_never_lengthens_and_keeps_the_feasible_end() -> None:
    method = AlternatingMinimisation(paper_problem("M30_05"), corridor_of(paper_problem("M30_05")))
    for _ in range(4):
        before = method.durations_s
        method.step()
        assert (method.durations_s <= before).all()
        assert method.check.holds(control_points(method.boundary, method.durations_s), method.durations_s).all()
