"""Latency compensation: how far ahead of the schedule setpoints are sent."""

from __future__ import annotations

import math

from link.session.context import FlightContext

LEAD_STEP_S, LEAD_SETTLED_S = 0.015, 0.002
"""The lead follows the latency once they are so far apart, until so near: noise of the measurement moves nothing."""
LEAD_SLEW = 0.05
"""How fast the lead changes, seconds a second."""


class Lead:
    """How far ahead of the reference the setpoints are asked for, so that they are in time when they arrive.

    A setpoint that takes L seconds to the vehicle is v L behind when it gets there. So the reference is looked up that
    much ahead: by the latency of the station in control, half its round trip, at most ``lead_limit_s`` of the request.
    At a handover it changes at once with the link, for then every setpoint is right at its arrival.
    """

    def __init__(self, context: FlightContext) -> None:
        self._c = context
        self.seconds = 0.0
        self._station = ""
        self._moving = False

    def update(self, dt_s: float) -> None:
        """Follow the latency; once a tick."""
        station = self._c.in_force.station_id
        latency_s = self._c.monitor.links[station].latency_s
        if latency_s is None:
            return
        wanted = min(latency_s, self._c.request.lead_limit_s)
        if station != self._station:
            self._station, self.seconds, self._moving = station, wanted, False
            return
        off = wanted - self.seconds
        self._moving = abs(off) > (LEAD_SETTLED_S if self._moving else LEAD_STEP_S)
        if self._moving:
            self.seconds += math.copysign(min(abs(off), LEAD_SLEW * dt_s), off)

    @property
    def missing_s(self) -> float:
        """Latency that is not led."""
        latency_s = self._c.monitor.links[self._c.in_force.station_id].latency_s
        return 0.0 if latency_s is None else max(0.0, latency_s - self.seconds)
