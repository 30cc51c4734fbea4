"""Zooming in on the least value: parabolas, ends, and functions that are nowhere defined."""

from __future__ import annotations

import numpy as np
import pytest

from planner.coverage.grid_zoom import least_by_zooming


def test_the_least_of_parabolas_inside_and_at_either_end() -> None:
    centre = np.array([[0.3], [-2.0], [7.0]])
    where, least = least_by_zooming(lambda x: (x - centre) ** 2 + centre, np.full(3, -1.0), np.full(3, 5.0))
    assert where == pytest.approx([0.3, -1.0, 5.0], abs=1e-7)
    assert least == pytest.approx([0.3, -1.0, 11.0])


def test_a_function_that_is_infinite_outside_a_sliver_or_everywhere() -> None:
    where, least = least_by_zooming(
        lambda x: np.where(np.abs(x - 0.5) < np.array([[0.1], [0.0]]), np.abs(x - 0.45), np.inf),
        np.zeros(2),
        np.ones(2),
    )
    assert where[0] == pytest.approx(0.45, abs=1e-9)
    assert least[1] == np.inf


def test_an_interval_of_no_length() -> None:
    where, least = least_by_zooming(np.square, np.array(3.0), np.array(3.0))
    assert (where, least) == (3.0, 9.0)
