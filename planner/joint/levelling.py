"""Altitude left only where that gains time or a limit asks.

Climbing within the band costs a fast flight next to no time, so that an interior-point method drifts to the middle of
the band for nothing. Here the flight keeps its way seen from above and its times, and is brought to the straight line
from the start's altitude to the destination's, over the way flown: at every joint as far as its pieces' limits allow.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from planner.arrays import Array, Flags, Indices
from planner.bezier import bernstein, derivative
from planner.certificate import certify
from planner.coverage.elevation_mask import ElevationMask
from planner.problem import Limits, Problem
from planner.trajectory import Trajectory

DEGREE = 5
# A flight this little above and below its ends is level.
LEVEL_M = 0.5
# How far joints go to the straight line, tried in turn, next to where they may not go all the way.
PARTS = (1.0, 0.5, 0.2, 0.0)
# Gauss quadrature over a piece.
_NODES, _NODE_WEIGHTS = np.polynomial.legendre.leggauss(6)
_AT_NODES, _NODE_WEIGHTS = bernstein(DEGREE - 1, 0.5 * (1.0 + _NODES)), 0.5 * _NODE_WEIGHTS


def levelled(problem: Problem, trajectory: Trajectory) -> Trajectory:
    """The same flight seen from above, as level as its limits allow; the one given where it is, or cannot be."""
    altitude = trajectory.control_points_m[..., 2]
    ends = (float(problem.start_m[2]), float(problem.destination_m[2]))
    if trajectory.degree != DEGREE or (altitude.min() >= min(ends) - LEVEL_M and altitude.max() <= max(ends) + LEVEL_M):
        return trajectory
    own, straight = _states(trajectory), _straight_states(problem, trajectory)
    straight[:, 0], straight[:, -1] = own[:, 0], own[:, -1]
    bounds, durations = _Bounds.of(problem, trajectory), trajectory.durations_s

    def at(part: Array) -> Array:
        return _altitudes(own + part * (straight - own), durations)

    part = _allowed_parts(lambda part: bounds.broken(at(part), durations), len(own[0]))
    if not part.any():
        return trajectory
    points = trajectory.control_points_m.copy()
    points[..., 2] = at(part)
    changed = replace(trajectory, control_points_m=points)
    return changed if certify(problem, changed).feasible else trajectory


def _allowed_parts(broken: Callable[[Array], Flags], joints: int) -> Array:
    """How far every joint may go ``(joints,)``: less and less beside pieces that a limit stops."""
    tried = np.zeros(joints, dtype=np.int64)
    while True:
        part = np.array(PARTS)[tried]
        stopped = broken(part)
        if not stopped.any():
            return part
        beside = np.append(stopped, False) | np.append(False, stopped)
        if (tried[beside] == len(PARTS) - 1).all():
            return np.zeros(joints)
        tried[beside] = np.minimum(tried[beside] + 1, len(PARTS) - 1)


def _states(trajectory: Trajectory) -> Array:
    """Altitude and its two derivatives by time at every joint, both ends included: ``(3, K + 1)``."""
    altitude, durations = trajectory.control_points_m[..., 2:], trajectory.durations_s
    states = []
    for order in range(3):
        along = derivative(altitude, order)[..., 0] / durations[:, None] ** order
        states.append(np.append(along[:, 0], along[-1, -1]))
    return np.stack(states)


def _altitudes(states: Array, durations_s: Array) -> Array:
    """Control points ``(K, 6)`` of the quintics between the ``states`` ``(3, K + 1)``."""
    table = np.empty((len(durations_s), 6))
    for side, (z, climb, change), sign in ((0, states[:, :-1], 1), (5, states[:, 1:], -1)):
        step = sign * durations_s
        table[:, side] = z
        table[:, side + sign] = z + climb * step / 5.0
        table[:, side + 2 * sign] = z + 2.0 * climb * step / 5.0 + change * step**2 / 20.0
    return table


def _straight_states(problem: Problem, trajectory: Trajectory) -> Array:
    """The states ``(3, K + 1)`` of a flight that rises or falls evenly with its way seen from above."""
    durations = trajectory.durations_s
    flat = trajectory.control_points_m[..., :2]
    velocities = derivative(flat) / durations[:, None, None]
    velocity = np.concatenate([velocities[:, 0], velocities[-1:, -1]])
    accelerations = derivative(flat, 2)[:, [0, -1]] / durations[:, None, None] ** 2
    acceleration = np.concatenate([accelerations[:, 0], accelerations[-1:, -1]])
    speed = np.sqrt((velocity**2).sum(axis=1))
    change = (velocity * acceleration).sum(axis=1) / np.maximum(speed, 1e-9)
    speeds = np.sqrt(((_AT_NODES @ velocities) ** 2).sum(axis=-1))
    way = np.concatenate([[0.0], np.cumsum(durations * (speeds @ _NODE_WEIGHTS))])
    slope = float(problem.destination_m[2] - problem.start_m[2]) / max(float(way[-1]), 1e-9)
    return np.stack([problem.start_m[2] + slope * way, slope * speed, slope * change])


@dataclass(frozen=True)
class _Bounds:
    """What the way seen from above leaves: altitudes ``(K, 6)``, climb ``(K, 5)``, its change, and that one's."""

    low: Array
    high: Array
    down: Array
    up: Array
    change: Array
    jerk: Array | None

    @classmethod
    def of(cls, problem: Problem, trajectory: Trajectory) -> _Bounds:
        limits, points = problem.limits, trajectory.control_points_m
        low, high = np.full(points.shape[:2], limits.min_alt_m), np.full(points.shape[:2], limits.max_alt_m)
        mask = ElevationMask.of(problem)
        for pieces, stations in _held(problem, trajectory):
            centre = problem.station_positions_m[stations][:, None]
            away = np.linalg.norm(points[pieces, :, :2] - centre[..., :2], axis=-1)
            reach = np.sqrt(np.maximum(problem.ranges_m[stations][:, None] ** 2 - away**2, 0.0))
            low[pieces] = np.maximum(low[pieces], centre[..., 2] - reach)
            high[pieces] = np.minimum(high[pieces], centre[..., 2] + reach)
            if mask is not None:
                low[pieces] = np.maximum(low[pieces], mask.at(stations[:, None]).lowest_alt_m(centre[..., 2], away))
        durations = trajectory.durations_s[:, None, None]
        velocity, acceleration, jerk = (derivative(points[..., :2], n) / durations**n for n in (1, 2, 3))
        up, down = _climbs(limits, velocity)
        most = limits.max_jerk_m_s3
        return cls(
            low,
            high,
            down,
            up,
            _left(limits.max_accel_m_s2, acceleration),
            None if most is None else _left(most, jerk),
        )

    def broken(self, altitudes: Array, durations_s: Array) -> Flags:
        """``(K,)``: which pieces leave a bound."""
        durations = durations_s[:, None]
        climb = DEGREE * np.diff(altitudes, axis=1) / durations
        change = (DEGREE - 1) * np.diff(climb, axis=1) / durations
        outside = ((altitudes < self.low) | (altitudes > self.high)).any(axis=1)
        outside |= ((climb < -self.down) | (climb > self.up)).any(axis=1)
        outside |= (np.abs(change) > self.change).any(axis=1)
        if self.jerk is not None:
            outside |= (np.abs((DEGREE - 2) * np.diff(change, axis=1) / durations) > self.jerk).any(axis=1)
        return np.asarray(outside)


def _left(most: float, flat: Array) -> Array:
    """What vectors seen from above ``(..., 2)`` leave of a limit of their length for the third axis."""
    return np.asarray(np.sqrt(np.maximum(most**2 - (flat**2).sum(axis=-1), 0.0)))


def _climbs(limits: Limits, velocity: Array) -> tuple[Array, Array]:
    fast = _left(limits.max_speed_m_s, velocity)
    if limits.max_airspeed_m_s is not None:
        fast = np.minimum(fast, _left(limits.max_airspeed_m_s, velocity - np.array(limits.wind_m_s)))
    up = fast if limits.max_climb_m_s is None else np.minimum(fast, limits.max_climb_m_s)
    down = fast if limits.max_descent_m_s is None else np.minimum(fast, limits.max_descent_m_s)
    return up, down


def _held(problem: Problem, trajectory: Trajectory) -> list[tuple[Indices, Indices]]:
    """Pieces, and the stations that must cover them: those in control, and beside handovers the others.

    A piece comes once in each entry of the list.
    """
    station, durations = trajectory.station_index, trajectory.durations_s
    held = [(np.arange(len(station)), np.asarray(station))]
    half_s = 0.5 * problem.min_overlap_s
    for joint in (np.flatnonzero(np.diff(station)) + 1).tolist() if half_s > 0.0 else []:
        before, after = range(joint - 1, -1, -1), range(joint, len(station))
        for other, beside in ((station[joint], before), (station[joint - 1], after)):
            held_s, pieces = 0.0, []
            for piece in beside:
                offset = trajectory.control_points_m[piece] - problem.station_positions_m[other]
                if held_s >= half_s or np.linalg.norm(offset, axis=1).max() > problem.ranges_m[other]:
                    break
                pieces.append(piece)
                held_s += float(durations[piece])
            held.append((np.array(pieces, dtype=np.int64), np.full(len(pieces), other)))
    return held
