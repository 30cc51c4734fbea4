"""Latency compensation: how far ahead of the schedule setpoints are sent."""

from __future__ import annotations

import math

from link.session.control import Control
from link.telemetry.vehicle_monitor import VehicleMonitor

STEP_S, SETTLED_S = 0.015, 0.002
"""The compensation follows the latency once they are so far apart, until so near: noise of the measurement moves
nothing."""
SLEW = 0.05
"""How fast the compensation changes, seconds a second."""


class LatencyCompensation:
    """How far ahead of the reference the setpoints are asked for, so that they are in time when they arrive.

    A setpoint that takes L seconds to the vehicle is v L behind when it gets there. So the reference is looked up that
    much ahead: by the latency of the station in control, half its round trip, at most ``limit_s``. At a handover it
    changes at once with the link, for then every setpoint is right at its arrival.
    """

    def __init__(self, control: Control, monitor: VehicleMonitor, *, limit_s: float) -> None:
        self._control = control
        self._monitor = monitor
        self._limit_s = limit_s
        self.ahead_s = 0.0
        self._station = ""
        self._moving = False

    def update(self, dt_s: float) -> None:
        """Follow the latency; once a tick."""
        station, latency_s = self._control.in_force.station_id, self._latency_s
        if latency_s is None:
            return
        wanted = min(latency_s, self._limit_s)
        if station != self._station:
            self._station, self.ahead_s, self._moving = station, wanted, False
            return
        off = wanted - self.ahead_s
        self._moving = abs(off) > (SETTLED_S if self._moving else STEP_S)
        if self._moving:
            self.ahead_s += math.copysign(min(abs(off), SLEW * dt_s), off)

    @property
    def missing_s(self) -> float:
        """Latency that is not compensated."""
        latency_s = self._latency_s
        return 0.0 if latency_s is None else max(0.0, latency_s - self.ahead_s)

    @property
    def _latency_s(self) -> float | None:
        return self._monitor.links[self._control.in_force.station_id].latency_s
