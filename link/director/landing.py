"""The landing: the autopilot's own, asked for until it shows it, waited for until the vehicle is down and disarmed."""

from __future__ import annotations

import math

from gcs.flight import FlightState
from link.session.context import FlightContext

REASK_S = 1.5
LANDED_WAIT_S = 1800.0


class Landing:
    """`begin`, then every tick: `down`?, `ask`, `overdue`?"""

    def __init__(self, flight: FlightContext) -> None:
        self._request = flight.request
        self._timeline = flight.timeline
        self._vehicle = flight.vehicle
        self._control = flight.control
        self.outcome = FlightState.COMPLETED
        """How the flight ends with it."""
        self.seen = False
        """Whether the vehicle has shown that it lands."""
        self._since_s = 0.0
        self._asked_s = -math.inf

    def begin(self, outcome: FlightState) -> None:
        """Land from now on, and end so."""
        self.outcome, self.seen = outcome, False
        self._since_s, self._asked_s = self._timeline.now_s, -math.inf

    @property
    def down(self) -> bool:
        """Whether the vehicle has disarmed since, by two witnesses."""
        return bool(self._vehicle.down_since(self._since_s))

    def ask(self) -> None:
        """Ask for the mode, now and then, while the vehicle does not show it."""
        timeline, vehicle = self._timeline, self._vehicle
        lands = vehicle.mode == vehicle.profile.land_mode
        self.seen = self.seen or lands
        if not lands and timeline.now_s - self._asked_s >= REASK_S:
            self._asked_s = timeline.now_s
            self._control.start_mode(vehicle.profile.land_mode)

    @property
    def overdue(self) -> bool:
        """Whether nothing has been heard of the vehicle, or no landing seen, for too long."""
        timeline = self._timeline
        silent_s = timeline.now_s - self._vehicle.monitor.last_heard_s()
        return silent_s > self._request.lost_after_s or timeline.now_s - self._since_s > LANDED_WAIT_S
