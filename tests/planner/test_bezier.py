"""Bézier arithmetic against hand-worked numbers, polynomials in the ordinary basis and dense samples."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from planner import bezier

coordinates = st.floats(-1e4, 1e4, allow_subnormal=False)


def curves(max_degree: int = 7) -> st.SearchStrategy[np.ndarray]:
    return st.integers(1, max_degree).flatmap(lambda n: arrays(float, (n + 1, 3), elements=coordinates))


def test_a_quadratic_by_hand() -> None:
    # (0,0), (1,2), (2,0): at u = 1/2 the point is (0 + 2 + 2, 0 + 4 + 0) / 4 = (1, 1); derivative 2 (1,2) .. 2 (1,-2).
    points = np.array([[0.0, 0.0], [1.0, 2.0], [2.0, 0.0]])
    np.testing.assert_allclose(bezier.evaluate(points, np.array(0.5)), [1.0, 1.0])
    np.testing.assert_allclose(bezier.derivative(points), [[2.0, 4.0], [2.0, -4.0]])
    np.testing.assert_allclose(bezier.derivative(points, 2), [[0.0, -8.0]])
    np.testing.assert_array_equal(bezier.derivative(points, 3), [[0.0, 0.0]])
    left, right = bezier.split(points, 0.5)
    np.testing.assert_allclose(left, [[0, 0], [0.5, 1], [1, 1]])
    np.testing.assert_allclose(right, [[1, 1], [1.5, 1], [2, 0]])
    np.testing.assert_allclose(bezier.elevate(points, 3), [[0, 0], [2 / 3, 4 / 3], [4 / 3, 4 / 3], [2, 0]])


def test_basis_by_hand() -> None:
    np.testing.assert_allclose(
        bezier.bernstein(2, np.array([0.0, 0.25, 1.0])), [[1, 0, 0], [9 / 16, 6 / 16, 1 / 16], [0, 0, 1]]
    )
    np.testing.assert_allclose(bezier.bernstein(5, np.linspace(0, 1, 11)).sum(axis=1), 1.0)


def test_many_curves_at_once() -> None:
    rng = np.random.default_rng(3)
    many, u = rng.normal(size=(4, 6, 3)), rng.uniform(size=4)
    one_by_one = [bezier.evaluate(many[k], u[k]) for k in range(4)]
    np.testing.assert_allclose(bezier.evaluate(many, u), one_by_one)


@given(curves(), st.floats(0, 1), st.floats(0, 1))
@settings(deadline=None)
def test_both_halves_of_a_split_are_the_curve(points: np.ndarray, at: float, u: float) -> None:
    left, right = bezier.split(points, at)
    scale = np.abs(points).max() + 1.0
    np.testing.assert_allclose(
        bezier.evaluate(left, np.array(u)), bezier.evaluate(points, np.array(at * u)), atol=1e-11 * scale
    )
    np.testing.assert_allclose(
        bezier.evaluate(right, np.array(u)), bezier.evaluate(points, np.array(at + (1 - at) * u)), atol=1e-11 * scale
    )
    # A split curve's control points stay in the hull of the first ones: here, in its box.
    for part in (left, right):
        assert (part.max(axis=0) <= points.max(axis=0) + 1e-11 * scale).all()
        assert (part.min(axis=0) >= points.min(axis=0) - 1e-11 * scale).all()


@given(curves(5), st.integers(0, 4), st.floats(0, 1))
@settings(deadline=None)
def test_elevation_keeps_the_curve(points: np.ndarray, more: int, u: float) -> None:
    raised = bezier.elevate(points, len(points) - 1 + more)
    assert len(raised) == len(points) + more
    scale = np.abs(points).max() + 1.0
    np.testing.assert_allclose(
        bezier.evaluate(raised, np.array(u)), bezier.evaluate(points, np.array(u)), atol=1e-11 * scale
    )


def test_elevation_does_not_go_down() -> None:
    with pytest.raises(ValueError, match="cannot elevate degree 3 to 2"):
        bezier.elevate(np.zeros((4, 3)), 2)


@given(curves(), st.floats(0.001, 0.999))
@settings(deadline=None)
def test_derivative_is_the_slope(points: np.ndarray, u: float) -> None:
    h = 1e-4
    ends = bezier.evaluate(points, np.array([u - h, u + h])) if h <= u <= 1 - h else None
    if ends is None:
        return
    slope = (ends[1] - ends[0]) / (2 * h)
    third = np.abs(bezier.derivative(points, 3)).max()
    scale = np.abs(points).max() + 1.0
    np.testing.assert_allclose(
        bezier.evaluate(bezier.derivative(points), np.array(u)), slope, atol=h * h * third + 1e-8 * scale
    )


@given(st.lists(coordinates, min_size=1, max_size=7), st.lists(coordinates, min_size=1, max_size=7), st.floats(0, 1))
@settings(deadline=None)
def test_product_is_the_product(a: list[float], b: list[float], u: float) -> None:
    left, right = np.array(a)[:, None], np.array(b)[:, None]
    both = bezier.product(np.array(a), np.array(b))
    assert len(both) == len(a) + len(b) - 1
    expected = bezier.evaluate(left, np.array(u)) * bezier.evaluate(right, np.array(u))
    scale = (np.abs(a).max() + 1) * (np.abs(b).max() + 1)
    np.testing.assert_allclose(bezier.evaluate(both[:, None], np.array(u)), expected, atol=1e-12 * scale)


def from_roots(roots: list[float], sign: float = 1.0) -> np.ndarray:
    """Bernstein form of sign * prod (u - r)."""
    coefficients = np.array([sign])
    for root in roots:
        coefficients = bezier.product(coefficients, np.array([-root, 1.0 - root]))
    return coefficients


def test_roots_by_hand() -> None:
    assert bezier.roots(np.array([-1.0, 1.0])) == pytest.approx([0.5])
    assert bezier.roots(np.array([-1.0, 3.0])) == pytest.approx([0.25])
    assert bezier.roots(np.array([1.0, -1.0, 1.0])) == []  # touches zero at one half
    assert bezier.roots(np.array([1.0, -2.0, 1.0])) == pytest.approx([0.5 - np.sqrt(1 / 12), 0.5 + np.sqrt(1 / 12)])
    assert bezier.roots(np.array([1.0, 2.0, 3.0])) == []
    assert bezier.roots(np.zeros(4)) == []
    assert bezier.roots(from_roots([0.5, 0.5, 0.5])) == pytest.approx([0.5], abs=1e-4)
    assert bezier.roots(from_roots([0.25, 0.5, 0.75])) == pytest.approx([0.25, 0.5, 0.75])


def test_roots_at_the_ends_are_not_sign_changes_inside() -> None:
    assert bezier.roots(from_roots([0.0, 0.3])) == pytest.approx([0.3])
    assert bezier.roots(from_roots([1.0, 0.3])) == pytest.approx([0.3])


@given(st.lists(st.floats(-0.5, 1.5), min_size=1, max_size=5), st.sampled_from([1.0, -3.7]))
@example([0.5, 0.5], 1.0)
@example([0.25, 0.5], 1.0)
@settings(deadline=None)
def test_roots_are_found(given_roots: list[float], sign: float) -> None:
    apart = sorted(given_roots)
    if any(abs(r - edge) < 1e-3 for r in apart for edge in (0.0, 1.0)) or any(np.diff(apart) < 1e-2):
        return
    found = bezier.roots(from_roots(apart, sign))
    assert found == pytest.approx([r for r in apart if 0 < r < 1], abs=1e-8)


@given(arrays(float, 11, elements=st.floats(-1, 1, allow_subnormal=False)))
@settings(deadline=None)
def test_between_roots_the_sign_is_one(coefficients: np.ndarray) -> None:
    edges = [0.0, *bezier.roots(coefficients), 1.0]
    for low, high in pairwise(edges):
        if high - low < 1e-6:
            continue
        inside = np.linspace(low + 1e-3 * (high - low), high - 1e-3 * (high - low), 50)
        values = bezier.evaluate(coefficients[:, None], inside)[:, 0]
        assert not ((values > 1e-9).any() and (values < -1e-9).any())


@given(st.integers(0, 10_000))
def test_only_roots_are_the_roots(seed: int) -> None:
    """Coefficients that change sign once, up or down, steep or flat: one root each, the same as found alone."""
    rng = np.random.default_rng(seed)
    size = 10.0 ** rng.uniform(-6, 6, (30, 11))
    sign = np.where(np.arange(11) < rng.integers(1, 11, 30)[:, None], -1.0, 1.0) * rng.choice([-1.0, 1.0], (30, 1))
    found = bezier.only_roots(sign * size)
    for row, u in zip(sign * size, found, strict=True):
        assert [u] == pytest.approx(bezier.roots(row), abs=1e-9)
