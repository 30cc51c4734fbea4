"""The reference trajectory, which is what is streamed.

A curve flown at a rate that may change, stop and turn back, but never leaves the curve.

Holding, resuming, going slower when the vehicle falls behind, waiting for the next station and returning are one
mechanism: the *rate*, seconds of plan per second of clock, between -1 and 1. Positions stay on the planned path,
which is covered; velocity and acceleration follow by the chain rule, so the vehicle always gets a consistent reference.

Where the flight may not go yet (a station not confirmed, a time not authorised) stands a *limit* on the curve,
approached as a train approaches a red signal: the speed is never more than lets it stop there,

    v^2 <= 2 a_b d,    a_b = `BRAKING_SHARE` of the plan's acceleration limit, d = way left along the path.

A limit already passed is returned to.
"""

from __future__ import annotations

import copy
import math
from typing import Protocol

import numpy as np

from link.setpoints.sampler import SetpointSampler
from link.setpoints.setpoint import Setpoint
from planner.arrays import Array

BRAKING_SHARE = 0.35
"""Of the acceleration limit, for the braking curve: the rest is left to the curve's own bends."""
CHANGE_SHARE = 0.55
"""Of the acceleration limit, along the path, for following it and for every other change of the rate."""
APPROACH_S = 1.0
"""Close to a limit the remaining way is flown in no less than this, so that the rate settles instead of chattering."""
STILL_M_S = 0.05
_TABLE_STEP_S = 0.1


class Curve(Protocol):
    """Something to fly along: `SetpointSampler`, or `StraightLine`."""

    duration_s: float

    def at(self, time_s: float) -> Setpoint:
        """The setpoint at a time of the curve, flown at rate 1."""
        ...


class ReferenceTrajectory:
    """Where on a curve the flight is, and how fast it goes along it.

    ``accel_m_s2`` is the plan's acceleration limit. ``time_s`` is the place on the curve, ``rate`` and
    ``rate_change_per_s`` how it moves.
    """

    def __init__(self, curve: Curve, *, accel_m_s2: float, time_s: float = 0.0, rate: float = 0.0) -> None:
        self.curve = curve
        self.time_s = time_s
        self.rate = rate
        self.rate_change_per_s = 0.0
        self._braking = BRAKING_SHARE * accel_m_s2
        self._change = CHANGE_SHARE * accel_m_s2
        self._accel = accel_m_s2
        times, speeds = _speeds(curve)
        self._times = times
        self._speeds = speeds
        self._slopes = np.gradient(speeds, times)
        self._way_m = np.concatenate([[0.0], np.cumsum(0.5 * (speeds[1:] + speeds[:-1]) * np.diff(times))])

    def placed(self, time_s: float, rate: float = 0.0) -> ReferenceTrajectory:
        """Another reference on the same curve, at another place and rate; shares this one's tables."""
        other = copy.copy(self)
        other.time_s, other.rate, other.rate_change_per_s = time_s, rate, 0.0
        return other

    def speed_m_s(self, time_s: float) -> float:
        """Speed of the curve itself at a time of it."""
        return float(np.interp(time_s, self._times, self._speeds))

    def way_m(self, from_s: float, to_s: float) -> float:
        """Way along the path between two times of the curve, signed."""
        ends = np.interp([from_s, to_s], self._times, self._way_m)
        return float(ends[1] - ends[0])

    def time_at_way(self, from_s: float, way_m: float) -> float:
        """The time of the curve a signed way along the path from ``from_s``, clamped to the curve."""
        start = float(np.interp(from_s, self._times, self._way_m))
        # Strictly increasing for the inverse: a hover has no length.
        return float(np.interp(start + way_m, self._way_m + 1e-9 * self._times, self._times))

    @property
    def stands(self) -> bool:
        """Whether the reference is at rest."""
        return abs(self.rate) * self.speed_m_s(self.time_s) <= STILL_M_S

    @property
    def finished(self) -> bool:
        """Whether the end of the curve is reached."""
        return self.time_s >= self.curve.duration_s - 1e-9

    def stopping_s(self) -> float:
        """About how far along the curve (s of it, signed) a stop begun now would end."""
        speed = abs(self.rate) * self.speed_m_s(self.time_s)
        way = math.copysign(speed**2 / (2.0 * self._braking), self.rate)
        return self.time_at_way(self.time_s, way) - self.time_s

    def step(self, dt_s: float, wanted: float, *, low_s: float = -math.inf, high_s: float = math.inf) -> None:
        """Move on by ``dt_s`` towards rate ``wanted``, kept between the limits ``low_s`` and ``high_s``."""
        speed = self.speed_m_s(self.time_s)
        target = max(-1.0, min(1.0, wanted))
        if high_s < self.curve.duration_s:
            target = min(target, self._allowed(self.way_m(self.time_s, high_s), speed))
        if low_s > 0.0:
            target = max(target, -self._allowed(self.way_m(low_s, self.time_s), speed))
        before = self.rate
        way_m = math.inf
        if before > 0.0 and high_s < self.curve.duration_s:
            way_m = self.way_m(self.time_s, high_s)
        elif before < 0.0 and low_s > 0.0:
            way_m = self.way_m(low_s, self.time_s)
        least, most = self._changes(before, speed, dt_s, self._brake(before, speed, way_m))
        self.rate = before + max(least, min(most, target - before))
        moved = dt_s if self.rate == 1.0 == before else 0.5 * (before + self.rate) * dt_s
        self.rate_change_per_s = (self.rate - before) / dt_s if dt_s > 0.0 and math.isfinite(most) else 0.0
        self.time_s = max(0.0, min(self.curve.duration_s, self.time_s + moved))

    def _brake(self, rate: float, speed_m_s: float, way_m: float) -> float:
        """How hard to brake with so much way left to a limit: harder than usual where that would not do.

        A station that dies just before its turn shuts the way at full speed. All that the curve's own bend leaves of
        the acceleration limit is used then.
        """
        needed = (rate * speed_m_s) ** 2 / (2.0 * max(way_m, 1e-3)) if math.isfinite(way_m) else 0.0
        if needed <= self._change:
            return self._change
        setpoint = self.curve.at(self.time_s)
        acceleration = np.array(setpoint.acceleration_enu_m_s2)
        along = np.array(setpoint.velocity_enu_m_s) / max(speed_m_s, 1e-6)
        across = rate * rate * float(np.linalg.norm(acceleration - (acceleration @ along) * along))
        spare = math.sqrt(max(0.0, self._accel**2 - across**2))
        return max(self._change, min(1.05 * needed, spare))

    def _changes(self, rate: float, speed_m_s: float, dt_s: float, brake_m_s2: float) -> tuple[float, float]:
        """Least and greatest change of the rate in ``dt_s``.

        The acceleration along the path is r' v + r^2 v'. It is kept within the share meant for changes, or left at
        the curve's own where that is more: braking may undo the curve's speeding up, but not add to its slowing down.
        """
        if speed_m_s <= 1e-6:
            return -math.inf, math.inf
        own = rate * rate * float(np.interp(self.time_s, self._times, self._slopes))
        down, up = (brake_m_s2, self._change) if rate >= 0.0 else (self._change, brake_m_s2)
        least, most = min(0.0, -down - own), max(0.0, up - own)
        return least / speed_m_s * dt_s, most / speed_m_s * dt_s

    def _allowed(self, way_m: float, speed_m_s: float) -> float:
        """Largest rate with ``way_m`` left to a limit; negative behind it."""
        room = abs(way_m)
        allowed = min(math.sqrt(2.0 * self._braking * room), room / APPROACH_S)
        rate = min(1.0, allowed / speed_m_s) if speed_m_s > 1e-6 else 1.0
        if room < 1e-3:
            return 0.0
        return math.copysign(rate, way_m)

    def setpoint(self, lead_s: float = 0.0) -> Setpoint:
        """The setpoint at this place and rate, or where the reference will be in ``lead_s`` if the rate stays.

        A lead under `APPROACH_S` does not reach past a limit that is being approached.
        """
        setpoint = self.curve.at(self.time_s + lead_s * self.rate)
        if self.rate == 1.0 and self.rate_change_per_s == 0.0:
            return setpoint
        # What is looked up moves on by this rate while the reference's own changes.
        rate = max(-1.0, min(1.0, self.rate + lead_s * self.rate_change_per_s))
        return setpoint.retimed(rate, self.rate_change_per_s)


def _speeds(curve: Curve) -> tuple[Array, Array]:
    """Times ``(N,)`` and the curve's speeds at them."""
    count = max(2, math.ceil(curve.duration_s / _TABLE_STEP_S) + 1)
    times = np.linspace(0.0, max(curve.duration_s, 1e-6), count)
    if isinstance(curve, SetpointSampler):
        return times, np.linalg.norm(curve.plan.trajectory.evaluate(times, 1), axis=-1)
    return times, np.array([math.hypot(*curve.at(float(t)).velocity_enu_m_s) for t in times])
