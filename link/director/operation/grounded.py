"""A vehicle on the ground whose motors stay armed."""

from __future__ import annotations

import math

from gcs.operator_commands import DISARM_ASKED_AFTER_S, GROUND_ARMED_LIMIT_S
from link.dialect import mavlink
from link.microservices.command import Ticket
from link.session.context import FlightContext

REASK_S = 5.0
STILL_M_S = 0.5
FRESH_S = 1.5


class GroundedArmed:
    """A vehicle that says it is on the ground and stays armed: asked to disarm, then given up with the reason.

    The autopilot itself refuses to disarm while it thinks that it flies; nothing is forced.
    """

    def __init__(self, flight: FlightContext) -> None:
        self._timeline = flight.timeline
        self._vehicle = flight.vehicle
        self._control = flight.control
        self.begin()

    def begin(self) -> None:
        """Count from now on."""
        self._since_s: float | None = None
        self._asked_s = -math.inf
        self._ticket: Ticket | None = None
        self._asked = 0

    def update(self, *, ask: bool) -> None:
        """Look, once a tick; ``ask``: the vehicle lands by our command, so it may be asked to disarm."""
        timeline, vehicle = self._timeline, self._vehicle
        position = vehicle.monitor.position
        still = position is None or position.speed_m_s <= STILL_M_S
        if not (vehicle.on_ground and vehicle.armed and still):
            self.begin()
            return
        if self._since_s is None:
            self._since_s = timeline.now_s
        known = position is not None and timeline.now_s - position.heard_s <= FRESH_S
        if not ask or not known or timeline.now_s - self._since_s < DISARM_ASKED_AFTER_S:
            return
        if timeline.now_s - self._asked_s >= REASK_S:
            if self._asked == 0:
                timeline.alarm("on the ground, still armed", asked="disarm")
            self._asked, self._asked_s = self._asked + 1, timeline.now_s
            self._ticket = self._control.start_command("disarm", mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (0.0,))

    @property
    def ended(self) -> str:
        """Why it is given up; empty while it is not."""
        if self._since_s is None or self._timeline.now_s - self._since_s < GROUND_ARMED_LIMIT_S:
            return ""
        told = "not asked" if self._ticket is None else f"asked {self._asked} times, {self._ticket.outcome}"
        return f"on the ground, armed, does not disarm: {told}; keep away from it"
