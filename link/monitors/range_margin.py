"""Range left of the station in control."""

from __future__ import annotations

import math

import numpy as np

from link.session.context import FlightContext

AGAIN_S = 60.0
"""A vehicle that stays out of range is told again so often."""


class RangeWatch:
    """How much of the range of the station in control is left, by where the vehicle says it is, not by the plan."""

    def __init__(self, flight: FlightContext) -> None:
        self._flight = flight
        self._timeline = flight.timeline
        self._vehicle = flight.vehicle
        self._control = flight.control
        self._seen: tuple[float, str] | None = None
        self._told_s = -math.inf
        self.margin_m: float | None = None
        """Range left, metres; negative outside. None while nothing is known."""
        self.left = False
        """Whether the vehicle is outside."""

    def update(self) -> None:
        """Measure the newest position; once a tick."""
        vehicle = self._vehicle
        position, station = vehicle.position, self._control.gate.holder
        here = vehicle.position_enu_m()
        if position is None or station is None or here is None:
            self.margin_m = None
            return
        if self._seen == (position.boot_s, station):
            return
        self._seen = (position.boot_s, station)
        index = np.array([self._flight.plan.mission.station_index(station)])
        self.margin_m = -float(self._flight.plan.geometry.outside_m(index, np.array([here]))[0])
        # A metre of doubt, so that it is told once.
        was, self.left = self.left, self.margin_m < (0.0 if not self.left else 1.0)
        if self.left and (not was or self._timeline.now_s - self._told_s >= AGAIN_S):
            self._told_s = self._timeline.now_s
            self._timeline.alarm("the vehicle is out of range", station=station, outside_m=round(-self.margin_m, 1))
