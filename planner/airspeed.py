"""Speed against a wind that turns along the way.

The wind may be the same everywhere (`planner.problem.Limits`), or a field (`planner.problem.WindField`). On a piece of
a curve the wind is a curve too, nearly the one whose control points are the winds at the piece's own; by how much it
may differ is sampled and taken off the airspeed of that piece alone.
"""

from __future__ import annotations

import numpy as np

from planner import bezier
from planner.arrays import Array
from planner.problem import Problem

# Samples of the wind along a piece, and how much more than what they show is taken off.
SAMPLES = 9
SAFETY = 1.5


def air_of(problem: Problem, points_m: Array, velocity_m_s: Array) -> tuple[Array, Array, Array]:
    """Velocity and wind at the control points of pieces, and the airspeed allowed there.

    ``points_m`` ``(S, n + 1, 3)``, ``velocity_m_s`` ``(S, n, 3)`` (control points of the derivative). Returns velocity
    and wind ``(S, m, 3)`` and the airspeed ``(S, 1)``: where the norm of their difference keeps it at every control
    point, the whole curve does.
    """
    limits = problem.limits
    assert limits.max_airspeed_m_s is not None
    if problem.wind is None:
        allowed = np.full((len(points_m), 1), limits.max_airspeed_m_s)
        return velocity_m_s, winds_m_s(problem, velocity_m_s), allowed
    degree = points_m.shape[1] - 1
    wind = winds_m_s(problem, points_m)
    at = bezier.bernstein(degree, np.linspace(0.0, 1.0, SAMPLES))
    curve = np.einsum("kj,sjx->skx", at, points_m)
    off = np.linalg.norm(winds_m_s(problem, curve) - np.einsum("kj,sjx->skx", at, wind), axis=-1).max(axis=1)
    return bezier.elevate(velocity_m_s, degree), wind, limits.max_airspeed_m_s - SAFETY * off[:, None]


def winds_m_s(problem: Problem, points_m: Array) -> Array:
    """``(..., 3)``: the wind at points ``(..., 3)``, without a vertical part."""
    if problem.wind is None:
        return np.broadcast_to(np.array([*problem.limits.wind_m_s, 0.0]), points_m.shape)
    wind = problem.wind.at(points_m)
    return np.concatenate([wind, np.zeros((*wind.shape[:-1], 1))], axis=-1)
