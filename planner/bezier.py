"""Bézier curves of any degree, as plain arrays of control points.

A curve of degree ``n`` is an array ``(..., n + 1, d)``: any number of curves at once, ``n + 1`` control
points each, in ``d`` dimensions. The parameter ``u`` runs from 0 to 1. Equations (3), (4), (8) and (10) of
Qi, Dou and Xin 2023; the rest is textbook (Farin, Curves and Surfaces for CAGD).
"""

from __future__ import annotations

from functools import lru_cache
from math import comb

import numpy as np

from planner.arrays import Array


@lru_cache(maxsize=64)
def _binomials(degree: int) -> Array:
    row = np.array([comb(degree, j) for j in range(degree + 1)], dtype=float)
    row.setflags(write=False)
    return row


def bernstein(degree: int, u: Array) -> Array:
    """Values of the Bernstein basis, ``(..., degree + 1)`` for ``u`` of shape ``(...)``, paper equation (4)."""
    u = np.asarray(u, dtype=float)[..., None]
    j = np.arange(degree + 1)
    basis: Array = _binomials(degree) * u**j * (1.0 - u) ** (degree - j)
    return basis


def evaluate(control_points: Array, u: Array) -> Array:
    """Points ``(..., d)`` of a curve ``(n + 1, d)`` at ``u`` ``(...)``; curves ``(m, n + 1, d)`` pair with ``(m,)``."""
    basis = bernstein(control_points.shape[-2] - 1, u)
    points: Array = np.einsum("...j,...jd->...d", basis, control_points)
    return points


def derivative(control_points: Array, order: int = 1) -> Array:
    """Control points of the derivative by ``u`` (not by time), degree ``n - order``; zero beyond the degree."""
    points = np.asarray(control_points, dtype=float)
    for _ in range(order):
        degree = points.shape[-2] - 1
        points = degree * np.diff(points, axis=-2) if degree else np.zeros_like(points)
    return points


def split(control_points: Array, u: float) -> tuple[Array, Array]:
    """The two curves left and right of ``u`` (de Casteljau): same degree, same points of space."""
    points = np.asarray(control_points, dtype=float)
    left, right = [points[..., 0, :]], [points[..., -1, :]]
    while points.shape[-2] > 1:
        points = (1.0 - u) * points[..., :-1, :] + u * points[..., 1:, :]
        left.append(points[..., 0, :])
        right.append(points[..., -1, :])
    return np.stack(left, axis=-2), np.stack(right[::-1], axis=-2)


def elevate(control_points: Array, degree: int) -> Array:
    """The same curve with more control points: ``degree`` not below the present one (else ``ValueError``)."""
    points = np.asarray(control_points, dtype=float)
    if degree < points.shape[-2] - 1:
        raise ValueError(f"cannot elevate degree {points.shape[-2] - 1} to {degree}")
    while (n := points.shape[-2] - 1) < degree:
        weight = (np.arange(1, n + 1) / (n + 1))[:, None]
        inner = weight * points[..., :-1, :] + (1.0 - weight) * points[..., 1:, :]
        points = np.concatenate([points[..., :1, :], inner, points[..., -1:, :]], axis=-2)
    return points


def product(a: Array, b: Array) -> Array:
    """Bernstein coefficients ``(m + n + 1,)`` of the product of polynomials ``(m + 1,)`` and ``(n + 1,)``."""
    m, n = len(a) - 1, len(b) - 1
    scaled = np.convolve(_binomials(m) * a, _binomials(n) * b)
    result: Array = scaled / _binomials(m + n)
    return result


def roots(coefficients: Array, *, tolerance: float = 1e-12) -> list[float]:
    """Every ``u`` in [0, 1] where a scalar polynomial in Bernstein form ``(n + 1,)`` changes sign, ascending.

    Sign changes of the control polygon bound the roots (variation diminishing); intervals are split until
    ``tolerance`` wide. A root where the polynomial only touches zero is no sign change and is not listed.
    """
    found: list[float] = []
    stack = [(0.0, 1.0, np.asarray(coefficients, dtype=float)[:, None])]
    while stack:
        low, high, points = stack.pop()
        signs = np.sign(points[:, 0])
        signs = signs[signs != 0]
        changes = int(np.count_nonzero(signs[1:] != signs[:-1]))
        if changes == 0:
            continue
        if changes == 1:
            found.append(low + (high - low) * _only_root(points[:, 0].tolist(), tolerance / (high - low)))
            continue
        if high - low <= tolerance:
            if changes % 2:
                found.append(0.5 * (low + high))
            continue
        middle = 0.5 * (low + high)
        left, right = split(points, 0.5)
        if left[-1, 0] == 0.0 and np.sign(_last_nonzero(left)) * np.sign(_last_nonzero(right[::-1])) < 0:
            found.append(middle)
        stack.append((middle, high, right))
        stack.append((low, middle, left))
    return sorted(found)


def _only_root(coefficients: list[float], tolerance: float) -> float:
    """The one sign change in [0, 1] of a polynomial in Bernstein form whose coefficients change sign once.

    Regula falsi with the Illinois rule, bisection where that stalls; plain floats, since arrays this small cost more.
    """
    degree = len(coefficients) - 1
    weighted = [float(b) * c for b, c in zip(_binomials(degree), coefficients, strict=True)]
    backwards = weighted[::-1]

    def value(u: float) -> float:
        # Horner in u / (1 - u) or its inverse, whichever is at most one; the positive factor left out is put back.
        near, terms = (u, weighted) if u <= 0.5 else (1.0 - u, backwards)
        ratio, total = near / (1.0 - near), 0.0
        for term in reversed(terms):
            total = total * ratio + term
        return total * (1.0 - near) ** degree

    rising = next(c for c in reversed(coefficients) if c != 0.0) > 0.0
    low, high = 0.0, 1.0
    at_low, at_high = value(low), value(high)
    for step in range(200):
        if high - low <= tolerance:
            break
        middle = 0.5 * (low + high)
        if step % 3 != 2 and at_high != at_low:
            guess = high - at_high * (high - low) / (at_high - at_low)
            middle = guess if low < guess < high else middle
        at_middle = value(middle)
        if (at_middle > 0.0) == rising and at_middle != 0.0:
            high, at_high, at_low = middle, at_middle, 0.5 * at_low
        else:
            low, at_low, at_high = middle, at_middle, 0.5 * at_high
    return 0.5 * (low + high)


def only_roots(coefficients: Array, *, tolerance: float = 1e-12) -> Array:
    """``(C,)``: the roots in [0, 1] of polynomials ``(C, n + 1)`` whose coefficients change sign exactly once each.

    Newton's method for all of them together from where the control polygons cross zero, inside brackets that every
    eighth step bisects.
    """
    falling = coefficients[:, 0] > 0.0
    points = np.where(falling[:, None], -coefficients, coefficients).T
    degree = len(points) - 1
    low, high = np.zeros(points.shape[1]), np.ones(points.shape[1])
    each = np.arange(points.shape[1])
    after = (points > 0.0).argmax(axis=0)
    left, right = points[after - 1, each], points[after, each]
    u: Array = (after - right / (right - left)) / degree
    settled = np.zeros(points.shape[1], dtype=bool)
    weighted = _binomials(degree)[:, None] * points
    steps = degree * _binomials(degree - 1)[:, None] * np.diff(points, axis=0)
    powers = np.ones((2, degree + 1, points.shape[1]))
    for step in range(8 * 48):
        powers[0, 1:], powers[1, 1:] = u, 1.0 - u
        ahead, behind = np.multiply.accumulate(powers, axis=1)
        value = (weighted * ahead * behind[::-1]).sum(axis=0)
        slope = (steps * ahead[:-1] * behind[-2::-1]).sum(axis=0)
        above = value > 0.0
        low, high = np.where(above, low, u), np.where(above, u, high)
        with np.errstate(divide="ignore", invalid="ignore"):
            newton = u - value / slope
        good = (newton >= low) & (newton <= high) & (step % 8 != 7)
        moved = np.where(good, newton, 0.5 * (low + high))
        settled |= np.where(good, np.abs(moved - u), high - low) <= tolerance
        if settled.all():
            break
        u = np.where(settled, u, moved)
    return np.asarray(u)


def _last_nonzero(points: Array) -> float:
    values = points[:, 0]
    nonzero = values[values != 0]
    return float(nonzero[-1]) if len(nonzero) else 0.0
