"""Boundary conditions at the joints, and what follows from them: the paper's D of equation (29).

A degree-5 segment has six control points, and position, velocity and acceleration at both ends fix all of them:
equations (9) and (11) turned round. With W, V, A at its start, W', V', A' at its end and duration T

    P0 = W                P1 = W + T V/5            P2 = W + 2 T V/5 + T^2 A/20
    P5 = W'               P4 = W' - T V'/5          P3 = W' - 2 T V'/5 + T^2 A'/20

so a trajectory is its boundary conditions and durations, and constraints (13) and (15) hold by construction.
"""

from __future__ import annotations

import numpy as np

from planner.arrays import Array
from planner.corridor.corridor import Corridor
from planner.problem import Problem
from planner.trajectory import Trajectory

# Rows: control points; columns: W, T V, T^2 A at the start, then at the end.
CONTROL_FROM_BOUNDARY: Array = np.array(
    [
        [1, 0, 0, 0, 0, 0],
        [1, 1 / 5, 0, 0, 0, 0],
        [1, 2 / 5, 1 / 20, 0, 0, 0],
        [0, 0, 0, 1, -2 / 5, 1 / 20],
        [0, 0, 0, 1, -1 / 5, 0],
        [0, 0, 0, 1, 0, 0],
    ]
)


def control_points(boundary: Array, durations_s: Array) -> Array:
    """Control points ``(S, 6, 3)`` from boundary conditions ``(S + 1, 3, 3)`` and durations ``(S,)``.

    ``boundary[k]`` holds position, velocity and acceleration (rows) of joint ``k`` along the three axes.
    """
    powers = durations_s[:, None] ** np.arange(3)
    ends = np.concatenate([boundary[:-1] * powers[..., None], boundary[1:] * powers[..., None]], axis=1)
    points: Array = CONTROL_FROM_BOUNDARY @ ends
    return points


def rest_at(waypoints_m: Array) -> Array:
    """Boundary conditions ``(K, 3, 3)`` of standing still in every one of ``waypoints_m`` ``(K, 3)``, equation (31)."""
    boundary = np.zeros((len(waypoints_m), 3, 3))
    boundary[:, 0] = waypoints_m
    return boundary


def as_trajectory(corridor: Corridor, boundary: Array, durations_s: Array) -> Trajectory:
    """The trajectory with these boundary conditions and durations, flown along ``corridor``."""
    stations = np.array([piece.station for piece in corridor.pieces])
    return Trajectory(control_points(boundary, durations_s), durations_s, stations)


def shortest_piece_s(problem: Problem) -> float:
    """Least duration of a piece whose joints stay continuous to 1e-9 in spite of rounding.

    An acceleration is a second difference of coordinates over T^2, so their rounding, eps |P|, is felt as
    20 eps |P| / T^2; half of what the certificate allows is left to it.
    """
    size = max(
        1.0,
        float(np.abs(problem.start_m).max()),
        float(np.abs(problem.destination_m).max()),
        float(np.abs(problem.station_positions_m).max()),
    )
    return float(np.sqrt(60.0 * np.finfo(float).eps * size / (1e-9 * problem.limits.max_accel_m_s2)))
