"""The funnel algorithm: against hand-worked corners and a general minimiser."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.optimize import minimize

from planner.corridor.funnel import shortest_crossings

Array = NDArray[np.float64]


def upright(*gates: tuple[float, float, float]) -> tuple[Array, Array]:
    """Left and right ends of gates across the way east: (east, right end's north, left end's north)."""
    ends = np.array(gates)
    return ends[:, [0, 2]], ends[:, [0, 1]]


def length(*points: Array) -> float:
    return float(np.linalg.norm(np.diff(np.vstack(points), axis=0), axis=1).sum())


def test_a_straight_way_crosses_gates_where_it_meets_them() -> None:
    left, right = upright((1.0, -1.0, 1.0), (3.0, -1.0, 5.0))
    crossings = shortest_crossings(np.array([0.0, 0.0]), left, right, np.array([4.0, 2.0]))
    assert crossings is not None
    np.testing.assert_allclose(crossings, [[1.0, 0.5], [3.0, 1.5]])


def test_it_turns_at_the_ends_of_gates_only() -> None:
    # Up round (2, 3), down round (4, -1); the gate between is crossed on the way, at half the height.
    left, right = upright((2.0, 3.0, 9.0), (3.0, -9.0, 9.0), (4.0, -9.0, -1.0))
    crossings = shortest_crossings(np.zeros(2), left, right, np.array([6.0, 0.0]))
    assert crossings is not None
    np.testing.assert_allclose(crossings, [[2.0, 3.0], [3.0, 1.0], [4.0, -1.0]])


def test_gates_that_cross_matter_where_the_string_would_turn_at_the_crossing() -> None:
    """Two gates that cross at (2, 2). A polyline below meets them in their order; one that is drawn up does not."""
    left, right = np.array([[3.0, 3.0], [1.0, 3.0]]), np.array([[0.0, 0.0], [4.0, 0.0]])
    crossings = shortest_crossings(np.array([-1.0, 1.0]), left, right, np.array([5.0, 1.0]))
    np.testing.assert_allclose(crossings, [[1.0, 1.0], [3.0, 1.0]])
    assert shortest_crossings(np.array([-1.0, 3.0]), left, right, np.array([5.0, 3.0])) is None


@pytest.mark.parametrize(("start_m", "end_m"), [(2.0, 5.0), (0.0, 0.5)])
def test_none_where_an_end_lies_on_the_wrong_side(start_m: float, end_m: float) -> None:
    left, right = upright((1.0, -1.0, 1.0))
    assert shortest_crossings(np.array([start_m, 0.0]), left, right, np.array([end_m, 0.0])) is None


def test_none_where_the_gates_come_in_the_wrong_order() -> None:
    left, right = upright((3.0, -1.0, 1.0), (2.0, -1.0, 1.0))
    assert shortest_crossings(np.zeros(2), left, right, np.array([4.0, 0.0])) is None


@given(st.integers(0, 2**32 - 1))
def test_no_polyline_through_the_gates_is_shorter(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 9))
    middle = np.column_stack([np.cumsum(rng.uniform(1.0, 3.0, count)), rng.normal(0.0, 2.0, count)])
    tilt, half = rng.normal(0.0, 0.2, count), rng.uniform(0.0, 2.0, count)
    reach = half[:, None] * np.column_stack([-np.sin(tilt), np.cos(tilt)])
    left, right = middle + reach, middle - reach
    start = np.array([middle[0, 0] - 2.0, rng.normal(0.0, 2.0)])
    end = np.array([middle[-1, 0] + 2.0, rng.normal(0.0, 2.0)])
    crossings = shortest_crossings(start, left, right, end)
    if crossings is None:
        return
    share = ((crossings - right) * (2.0 * reach)).sum(axis=1) / np.maximum(4.0 * half**2, 1e-12)
    assert (share > -1e-9).all()
    assert (share < 1.0 + 1e-9).all()
    np.testing.assert_allclose(right + share[:, None] * 2.0 * reach, crossings, atol=1e-6)
    best = minimize(
        lambda t: length(start, right + t[:, None] * 2.0 * reach, end),
        np.full(count, 0.5),
        bounds=[(0.0, 1.0)] * count,
        method="L-BFGS-B",
    )
    assert length(start, crossings, end) <= best.fun * (1.0 + 1e-9)
