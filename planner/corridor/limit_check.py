"""Constraints (17), (19) and (21) of given control points, for all pieces of a corridor at once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planner.airspeed import air_of
from planner.arrays import Array, Flags
from planner.corridor.corridor import Corridor
from planner.coverage.elevation_mask import ElevationMask
from planner.problem import Limits, Problem
from planner.trajectory import DEGREE

# Kept free of rounding when a trajectory is moved from one computation to the next.
GUARD_M = 1e-8


class CorridorCheck:
    """Measures control points ``(S, n + 1, 3)`` against the balls, the band and the vehicle's limits."""

    def __init__(self, problem: Problem, corridor: Corridor) -> None:
        # Where the wind is a field it is measured by itself.
        self._problem = problem
        self.limits = problem.limits
        if problem.wind is not None:
            self.limits = replace(problem.limits, max_airspeed_m_s=None)
        width = max(len(piece.balls) for piece in corridor.pieces)
        # Every piece gets the same number of balls, its first one repeated, so that arrays stay rectangular.
        balls = np.array([piece.balls + piece.balls[:1] * (width - len(piece.balls)) for piece in corridor.pieces])
        self._centres = problem.station_positions_m[balls]
        self._ranges = problem.ranges_m[balls]
        mask = ElevationMask.of(problem)
        self._mask = None if mask is None else mask.at(balls[..., None])
        # The ends are given: they and what rest fixes beside them may lie on the very edge of range or band.
        self._guard_m = np.full((len(corridor), DEGREE + 1), GUARD_M)
        if self.limits.max_alt_m - self.limits.min_alt_m < 4.0 * GUARD_M:
            self._guard_m[:] = 0.0
        self._guard_m[0, :3] = self._guard_m[-1, 3:] = 0.0

    def place_excess_m(self, points_m: Array) -> Array:
        """``(S, n + 1)``: how far each control point is outside its balls, the band or an elevation cone."""
        offset = points_m[:, None] - self._centres[:, :, None]
        worst = (np.linalg.norm(offset, axis=-1) - self._ranges[..., None]).max(axis=1)
        altitude = points_m[..., 2]
        worst = np.maximum(worst, np.maximum(self.limits.min_alt_m - altitude, altitude - self.limits.max_alt_m))
        if self._mask is not None:
            worst = np.maximum(worst, self._mask.below_m(offset).max(axis=1))
        return np.asarray(worst)

    def ratios(self, points_m: Array, durations_s: Array) -> Array:
        """``(3, S)``: largest speed, acceleration and jerk of each piece over its limit (formulas A and B of (37)).

        Vertical and wind-relative speeds count as speeds: every ratio of the first row divides by s when the
        piece is flown s times slower, the second by s^2, the third by s^3.
        """
        degree = points_m.shape[1] - 1
        first = degree * np.diff(points_m, axis=1)
        second = (degree - 1) * np.diff(first, axis=1)
        ratios = np.zeros((3, len(points_m)))
        velocity = first / durations_s[:, None, None]
        ratios[0] = speed_ratio(self.limits, velocity).max(axis=1)
        if self._problem.wind is not None and self._problem.limits.max_airspeed_m_s is not None:
            ratios[0] = np.maximum(ratios[0], airspeed_ratio(*air_of(self._problem, points_m, velocity)).max(axis=1))
        ratios[1] = np.linalg.norm(second, axis=-1).max(axis=1) / (durations_s**2 * self.limits.max_accel_m_s2)
        if self.limits.max_jerk_m_s3 is not None:
            third = (degree - 2) * np.diff(second, axis=1)
            ratios[2] = np.linalg.norm(third, axis=-1).max(axis=1) / (durations_s**3 * self.limits.max_jerk_m_s3)
        return ratios

    def slowdown(self, points_m: Array, durations_s: Array) -> Array:
        """``(S,)``: how many times slower each piece must be flown to keep the limits; below 1 could be faster."""
        ratios = self.ratios(points_m, durations_s)
        return np.asarray(np.maximum(np.maximum(ratios[0], np.sqrt(ratios[1])), np.cbrt(ratios[2])))

    def holds(self, points_m: Array, durations_s: Array) -> Flags:
        """``(S,)``: which pieces keep every constraint, a guard against rounding included."""
        inside = (self.place_excess_m(points_m) <= -self._guard_m).all(axis=1)
        return np.asarray(inside & (self.ratios(points_m, durations_s) <= 1.0).all(axis=0))


def speed_ratio(limits: Limits, velocity_m_s: Array) -> Array:
    """Velocities ``(..., 3)`` as multiples of what the limits allow in their direction, ``(...)``.

    Airspeed: the least J with |V - J w| <= J v_air. Unlike |V - w| / v_air it divides by s when V does, is 0 for a
    hovering vehicle and at most 1 exactly when the limit holds.
    """
    ratio = np.linalg.norm(velocity_m_s, axis=-1) / limits.max_speed_m_s
    if limits.max_climb_m_s is not None:
        ratio = np.maximum(ratio, velocity_m_s[..., 2] / limits.max_climb_m_s)
    if limits.max_descent_m_s is not None:
        ratio = np.maximum(ratio, -velocity_m_s[..., 2] / limits.max_descent_m_s)
    if limits.max_airspeed_m_s is not None:
        wind = np.array([*limits.wind_m_s, 0.0])
        ratio = np.maximum(ratio, airspeed_ratio(velocity_m_s, wind, np.array(limits.max_airspeed_m_s)))
    return np.asarray(ratio)


def airspeed_ratio(velocity_m_s: Array, wind_m_s: Array, airspeed_m_s: Array) -> Array:
    """`speed_ratio` of an airspeed ``(...)`` alone, in winds that broadcast against the velocities ``(..., 3)``."""
    room = airspeed_m_s**2 - np.einsum("...i,...i->...", wind_m_s, wind_m_s)
    along = np.einsum("...i,...i->...", velocity_m_s, wind_m_s)
    squared = np.einsum("...i,...i->...", velocity_m_s, velocity_m_s)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = (np.sqrt(along**2 + squared * room) - along) / room
    return np.asarray(np.where((room > 0.0) & (airspeed_m_s > 0.0), ratio, np.inf))
