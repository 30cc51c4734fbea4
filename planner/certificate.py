"""Proof that a trajectory keeps every limit: signed excesses from the control points, at zero tolerance.

The convex hull property (paper section 2.1.2) carries a bound on the control points to the whole curve, so
no sampling is involved. Every figure is an excess in the unit named: at most zero where the limit holds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.airspeed import air_of
from planner.arrays import Indices
from planner.coverage.elevation_mask import ElevationMask
from planner.coverage.window import Stations, held_s, leaves_s
from planner.errors import ProblemError
from planner.problem import Problem
from planner.trajectory import Trajectory

CONTINUITY_TOLERANCE = 1e-9


@dataclass(frozen=True)
class Certificate:
    """Worst signed excess of each constraint; ``worst`` in the units the names carry.

    ``continuity`` is the largest relative residual of position, velocity and acceleration at a joint and of the
    given ends, allowed up to `CONTINUITY_TOLERANCE`.
    """

    worst: dict[str, float]

    @property
    def broken(self) -> dict[str, float]:
        """The excesses above what is allowed: zero, and `CONTINUITY_TOLERANCE` for ``continuity``; NaN is one."""
        return {
            name: value
            for name, value in self.worst.items()
            if not value <= (CONTINUITY_TOLERANCE if name == "continuity" else 0.0)
        }

    @property
    def feasible(self) -> bool:
        """True when every excess is at most zero and the joints are continuous."""
        return not self.broken


def certify(problem: Problem, trajectory: Trajectory) -> Certificate:
    """Measure ``trajectory`` against every constraint of ``problem``.

    Optional limits appear in ``worst`` when the problem has them. Raises `ProblemError` when the trajectory flies by
    stations the problem does not have.
    """
    if trajectory.station_index.min() < 0 or trajectory.station_index.max() >= problem.station_count:
        raise ProblemError(
            f"the trajectory flies by stations {trajectory.sequence}, the problem has 0 to {problem.station_count - 1}"
        )
    limits = problem.limits
    points = trajectory.control_points_m
    velocity = trajectory.derivative_control_points(1)
    accel = trajectory.derivative_control_points(2)
    stations = trajectory.station_index
    distance = np.linalg.norm(points - problem.station_positions_m[stations][:, None, :], axis=-1)
    altitude = points[..., 2]
    worst = {
        "range_m": float((distance - problem.ranges_m[stations][:, None]).max()),
        "altitude_m": float(max(limits.min_alt_m - altitude.min(), altitude.max() - limits.max_alt_m)),
        "speed_m_s": float(np.linalg.norm(velocity, axis=-1).max() - limits.max_speed_m_s),
        "accel_m_s2": float(np.linalg.norm(accel, axis=-1).max() - limits.max_accel_m_s2),
        "overlap_s": _overlap_excess_s(problem, trajectory),
        "tenure_s": _tenure_excess_s(problem, trajectory),
        "continuity": continuity_residual(problem, trajectory),
    }
    if limits.max_jerk_m_s3 is not None:
        jerk = trajectory.derivative_control_points(3)
        worst["jerk_m_s3"] = float(np.linalg.norm(jerk, axis=-1).max() - limits.max_jerk_m_s3)
    if limits.max_climb_m_s is not None:
        worst["climb_m_s"] = float(velocity[..., 2].max() - limits.max_climb_m_s)
    if limits.max_descent_m_s is not None:
        worst["descent_m_s"] = float(-velocity[..., 2].min() - limits.max_descent_m_s)
    if limits.max_airspeed_m_s is not None:
        flown, wind, allowed = air_of(problem, points, velocity)
        worst["airspeed_m_s"] = float((np.linalg.norm(flown - wind, axis=-1) - allowed).max())
    if limits.max_duration_s is not None:
        worst["duration_s"] = trajectory.duration_s - limits.max_duration_s
    if problem.max_handovers is not None:
        worst["handovers"] = float(len(trajectory.sequence) - 1 - problem.max_handovers)
    mask = ElevationMask.of(problem)
    if mask is not None:
        # How far a control point lies below its station's elevation cone, measured vertically.
        offset = points - problem.station_positions_m[stations][:, None, :]
        worst["elevation_m"] = float(mask.at(stations[:, None]).below_m(offset).max())
    return Certificate(worst)


def continuity_residual(problem: Problem, trajectory: Trajectory) -> float:
    """Largest jump at a joint or a given end, relative to the size of what is compared.

    Positions are compared on the scale of the larger coordinate of the trajectory, velocities and accelerations
    on that of their limits.
    """
    ends = {
        0: (problem.start_m, problem.destination_m),
        1: (problem.start_velocity_m_s, np.zeros(3)),
        2: (problem.start_acceleration_m_s2, np.zeros(3)),
    }
    scales = {
        0: max(1.0, float(np.abs(trajectory.control_points_m).max())),
        1: problem.limits.max_speed_m_s,
        2: problem.limits.max_accel_m_s2,
    }
    residual = 0.0
    for order, (first, last) in ends.items():
        points = trajectory.derivative_control_points(order)
        left = np.concatenate([[first], points[:, -1]])
        right = np.concatenate([points[:, 0], [last]])
        residual = max(residual, float(np.abs(left - right).max()) / scales[order])
    return residual


def _overlap_excess_s(problem: Problem, trajectory: Trajectory) -> float:
    """How much of half the asked overlap is missing, at the worst handover and side; in the ranges planned with.

    Proved by whole segments next to the handover whose control points all lie in the other station's range (exact,
    and how overlaps are planned). Only where that is not enough, by the roots of the distance, which see further.
    """
    joints = np.flatnonzero(np.diff(trajectory.station_index)) + 1
    if not len(joints):
        return 0.0
    half_s = 0.5 * problem.min_overlap_s
    sequence, times = np.array(trajectory.sequence), trajectory.knots_s[joints]
    missing_s = -np.inf
    for side, first, ahead in ((sequence[1:], joints - 1, False), (sequence[:-1], joints, True)):
        held = held_s(trajectory, _stations(problem, side), first, ahead=ahead)
        short = np.flatnonzero(held < half_s)
        if len(short):
            at = times[short]
            left = leaves_s(trajectory, _stations(problem, side[short]), at, ahead=ahead, slack_m=0.0)
            # A vehicle outside at the handover itself has seen nothing of the other range (NaN).
            held[short] = np.fmax(np.abs(left - at), held[short])
        missing_s = max(missing_s, half_s - float(held.min()))
    return missing_s


def _stations(problem: Problem, which: Indices) -> Stations:
    mask = ElevationMask.of(problem)
    return Stations(
        problem.station_positions_m[which], problem.ranges_m[which], None if mask is None else mask.at(which)
    )


def _tenure_excess_s(problem: Problem, trajectory: Trajectory) -> float:
    legs = np.bincount(trajectory.leg_index, weights=trajectory.durations_s)
    return float(problem.min_tenure_s - legs.min()) if len(legs) > 1 else 0.0
