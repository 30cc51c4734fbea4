"""The manoeuvres both autopilots are made of: follow, go to a place, stop, climb, descend.

A ``Guidance`` owns the desired state (``Shaper``) and the loops (``Tracker``). Every manoeuvre is one call a step and
gives the acceleration to ask of the aircraft (north, east, down; m/s^2). Positions are local NED, m.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from sitl_fixtures.dynamics.controller import Shaper, Tracker, constrain_sum

Vector = tuple[float, float, float]
ZERO: Vector = (0.0, 0.0, 0.0)


@dataclass(slots=True)
class Limits:
    """What the autopilot's parameters allow a manoeuvre: m/s, m/s^2, m/s^3; ``brake`` is how late it slows down."""

    speed_m_s: float = 10.0
    up_m_s: float = 2.5
    down_m_s: float = 1.5
    accel_m_s2: float = 5.0
    jerk_m_s3: float = 20.0
    accel_z_m_s2: float = 2.5
    jerk_z_m_s3: float = 5.0
    brake_m_s2: float = 2.75
    brake_z_m_s2: float = 2.5


class Guidance:
    """Manoeuvres over one aircraft's state. ``update`` is to be called with the estimate before each manoeuvre."""

    def __init__(self, tracker: Tracker, limits: Limits) -> None:
        self.tracker = tracker
        self.limits = limits
        self.shaper = Shaper()
        self.n = self.e = self.d = 0.0
        self.vn = self.ve = self.vd = 0.0
        self.wanted_velocity: Vector = ZERO

    def update(self, position: Vector, velocity: Vector) -> None:
        """Takes the estimate of this step."""
        self.n, self.e, self.d = position
        self.vn, self.ve, self.vd = velocity

    def reset(self) -> None:
        """Starts the desired state anew from where the aircraft is."""
        self.shaper.reset((self.n, self.e, self.d), (self.vn, self.ve, self.vd))

    def follow(self, position: Vector, velocity: Vector, accel: Vector, dt: float) -> Vector:
        """Follows a moving target: its velocity and acceleration are fed forward, corrections are bounded."""
        self._horizontal((position[0], position[1], velocity[0], velocity[1], accel[0], accel[1]), True, dt)
        self._vertical(position[2], velocity[2], accel[2], True, dt)
        return self.track(dt)

    def fly(self, velocity: Vector, accel: Vector, dt: float) -> Vector:
        """Flies a velocity."""
        self._horizontal((0.0, 0.0, velocity[0], velocity[1], accel[0], accel[1]), False, dt)
        self._vertical(0.0, velocity[2], accel[2], False, dt)
        return self.track(dt)

    def go_to(self, position: Vector, dt: float, *, speed_m_s: float | None = None) -> Vector:
        """Flies to a place and stays there."""
        self._horizontal((position[0], position[1], 0.0, 0.0, 0.0, 0.0), True, dt, speed_m_s)
        self._vertical(position[2], 0.0, 0.0, True, dt)
        return self.track(dt)

    def descend(self, north_m: float, east_m: float, rate_m_s: float, dt: float) -> Vector:
        """Holds a place and sinks (negative: climbs) at a rate."""
        self._horizontal((north_m, east_m, 0.0, 0.0, 0.0, 0.0), True, dt)
        self._vertical(0.0, rate_m_s, 0.0, False, dt)
        return self.track(dt)

    def _horizontal(
        self,
        target: tuple[float, float, float, float, float, float],
        use_position: bool,
        dt: float,
        speed_m_s: float | None = None,
    ) -> None:
        limits = self.limits
        self.shaper.horizontal(
            target,
            use_position=use_position,
            max_correction_m_s=limits.speed_m_s if speed_m_s is None else speed_m_s,
            accel_m_s2=limits.accel_m_s2,
            jerk_m_s3=limits.jerk_m_s3,
            brake_m_s2=limits.brake_m_s2,
            dt=dt,
        )

    def _vertical(self, down_m: float, rate: float, accel: float, use_position: bool, dt: float) -> None:
        limits = self.limits
        self.shaper.vertical(
            (down_m, rate, accel),
            use_position=use_position,
            up_m_s=limits.up_m_s,
            down_m_s=limits.down_m_s,
            accel_m_s2=limits.accel_z_m_s2,
            jerk_m_s3=limits.jerk_z_m_s3,
            brake_m_s2=limits.brake_z_m_s2,
            dt=dt,
        )

    def track(self, dt: float) -> Vector:
        """The loops on the desired state as it stands."""
        shaper, tracker = self.shaper, self.tracker
        gain, gain_z = tracker.position_gain
        north, east = tracker.horizontal(
            (shaper.vn + gain * (shaper.pn - self.n), shaper.ve + gain * (shaper.pe - self.e)),
            (shaper.an, shaper.ae),
            (self.vn, self.ve),
            dt,
        )
        return north, east, tracker.vertical(shaper.vd + gain_z * (shaper.pd - self.d), shaper.ad, self.vd, dt)

    def direct(
        self, position: Vector | None, velocity: Vector | None, accel: Vector | None, max_speed_m_s: float, dt: float
    ) -> Vector:
        """Set-points straight into the loops, nothing shaped (PX4 OFFBOARD). An absent part is left out."""
        tracker, limits = self.tracker, self.limits
        gain, gain_z = tracker.position_gain
        feed = accel or ZERO
        if position is None and velocity is None:
            return feed
        wanted = velocity or ZERO
        if position is None:
            correction = ZERO
        else:
            correction = (
                gain * (position[0] - self.n),
                gain * (position[1] - self.e),
                gain_z * (position[2] - self.d),
            )
        vn, ve = constrain_sum((correction[0], correction[1]), (wanted[0], wanted[1]), max_speed_m_s)
        vd = max(-limits.up_m_s, min(limits.down_m_s, correction[2] + wanted[2]))
        self.wanted_velocity = (vn, ve, vd)
        north, east = tracker.horizontal((vn, ve), (feed[0], feed[1]), (self.vn, self.ve), dt)
        return north, east, tracker.vertical(vd, feed[2], self.vd, dt)

    def off_m(self, position: Vector) -> float:
        """Horizontal distance from a place, m."""
        return math.hypot(position[0] - self.n, position[1] - self.e)

    def stopping_place(self, reaction_s: float) -> tuple[float, float]:
        """Where (north, east; m) the aircraft comes to rest when it brakes now, ``reaction_s`` later.

        Slower than ``reaction_s`` read as m/s it counts as standing.
        """
        speed = math.hypot(self.vn, self.ve)
        reach_s = speed / (2.0 * self.limits.accel_m_s2) + reaction_s if speed > reaction_s else 0.0
        return self.n + self.vn * reach_s, self.e + self.ve * reach_s
