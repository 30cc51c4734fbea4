"""What a flight costs besides its time: manoeuvring and drag, in seconds of staying aloft.

A rotorcraft needs power to stay up, more to accelerate and more against drag. In units of the first, with weight w:

    cost = time + w * integral of |a|^2 / a_max^2 + |v|^3 / v_max^3

so that w = 1 stands for a vehicle that needs as much again for full acceleration, or for full speed, as for hovering.
The weight trades time for energy: 0 is the fastest flight, and cruising pays best at v_max (2 w)^(-1/3) where w > 1/2.
"""

from __future__ import annotations

import numpy as np

from planner.problem import Problem
from planner.trajectory import Trajectory

NODES = 8


def energy_s(problem: Problem, trajectory: Trajectory) -> tuple[float, float]:
    """The two integrals of the cost, for acceleration and for drag, in seconds (Gauss quadrature on every piece)."""
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    times = trajectory.knots_s[:-1, None] + 0.5 * (nodes + 1.0) * trajectory.durations_s[:, None]
    parts = 0.5 * weights * trajectory.durations_s[:, None]
    speed = np.linalg.norm(trajectory.evaluate(times, 1), axis=-1) / problem.limits.max_speed_m_s
    accel = np.linalg.norm(trajectory.evaluate(times, 2), axis=-1) / problem.limits.max_accel_m_s2
    return float((parts * accel**2).sum()), float((parts * speed**3).sum())


def cost_s(problem: Problem, trajectory: Trajectory, energy_weight: float) -> float:
    """Time plus weighted energy; the time alone for a weight of 0."""
    return trajectory.duration_s + (energy_weight * sum(energy_s(problem, trajectory)) if energy_weight else 0.0)


def slowed_to_save(problem: Problem, trajectory: Trajectory, energy_weight: float) -> Trajectory:
    """The same path flown by the one factor >= 1 slower that costs least.

    Slower by s, the integral of the acceleration divides by s^3, that of drag by s^2: s + w (A / s^3 + D / s^2) is
    convex. Only from a start at rest, and not beyond the endurance.
    """
    if not energy_weight or not problem.starts_at_rest:
        return trajectory
    time = trajectory.duration_s
    accel, drag = (energy_weight * part / time for part in energy_s(problem, trajectory))

    def slope(s: float) -> float:
        return 1.0 - 3.0 * accel / s**4 - 2.0 * drag / s**3

    if slope(1.0) >= 0.0:
        return trajectory
    low, high = 1.0, 2.0
    while slope(high) < 0.0:
        low, high = high, 2.0 * high
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if slope(middle) < 0.0 else (low, middle)
    allowed = problem.limits.max_duration_s
    factor = low if allowed is None else max(1.0, min(low, allowed * (1.0 - 1e-12) / time))
    return trajectory.scale_time(factor)
