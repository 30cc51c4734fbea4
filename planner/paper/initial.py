"""The initial trajectory, Algorithm 2: along the shortest polyline, at rest in every joint, equations (31) to (36).

Each piece runs from rest to rest on a straight line of length l, P = [W, W, W, W', W', W'] (equation (33)), so its
largest speed, acceleration and jerk control points are 5 l / T, 20 l / T^2 and 120 l / T^3. Everything else the
corridor asks for is met by taking longer: a piece of no length hovers.
"""

from __future__ import annotations

import numpy as np

from planner.arrays import Array
from planner.corridor.corridor import Corridor
from planner.corridor.limit_check import speed_ratio
from planner.paper.boundary import shortest_piece_s
from planner.problem import Problem
from planner.trajectory import DEGREE


def initial_durations(problem: Problem, corridor: Corridor, waypoints_m: Array) -> Array:
    """Durations ``(S,)`` of equation (35), lengthened to the pieces' minima and the legs' tenure.

    Limits of jerk, climb, descent and airspeed count where given.
    """
    n, limits = DEGREE, problem.limits
    steps = np.diff(waypoints_m, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    durations = np.maximum(n * speed_ratio(limits, steps), np.sqrt(n * (n - 1) * lengths / limits.max_accel_m_s2))
    if limits.max_jerk_m_s3 is not None:
        durations = np.maximum(durations, np.cbrt(2 * n * (n - 1) * (n - 2) * lengths / limits.max_jerk_m_s3))
    return stretch_legs(corridor, np.maximum(durations, piece_minima(problem, corridor)))


def piece_minima(problem: Problem, corridor: Corridor) -> Array:
    """Least durations ``(S,)`` the corridor and the arithmetic allow."""
    asked = np.array([piece.min_duration_s for piece in corridor.pieces])
    return np.asarray(np.maximum(asked, shortest_piece_s(problem)))


def leg_durations(corridor: Corridor, durations_s: Array) -> Array:
    """Time each station of the sequence is in control, ``(L,)``."""
    legs = np.array([piece.leg for piece in corridor.pieces])
    return np.asarray(np.bincount(legs, weights=durations_s), dtype=float)


def stretch_legs(corridor: Corridor, durations_s: Array) -> Array:
    """Durations with the pieces of every leg shorter than the tenure slowed by one factor; at rest that is feasible."""
    legs = np.array([piece.leg for piece in corridor.pieces])
    # A tolerance more than asked, so that sums over the pieces keep the tenure in spite of rounding.
    factor = np.maximum(1.0, corridor.min_leg_s * (1.0 + 1e-12) / leg_durations(corridor, durations_s))
    return np.asarray(durations_s * factor[legs])
