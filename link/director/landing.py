"""The landing: the autopilot's own, asked for until it shows it, waited for until the vehicle is down and disarmed.

Where the flight streams, it goes on until the vehicle shows LAND, so that it does not miss us meanwhile. Out of a climb
that the autopilot flies, and after the C2 link was lost, nothing is streamed: a setpoint would take the vehicle
elsewhere, and no judgement of the stream applies.
"""

from __future__ import annotations

import math

from gcs.flight import FlightState
from gcs.operator_commands import LANDING_LIMIT_S
from link.director.guidance import Guidance
from link.director.link_loss import LostC2Link
from link.director.operation.grounded import GroundedArmed
from link.handover.handover_chain import HandoverChain
from link.session.context import FlightContext

REASK_S = 1.5
LEFT_S = 3.0
"""For so long another mode must show before a pilot, or a failsafe, has taken the landing over."""


class Landing:
    """`begin`, then `tick`."""

    def __init__(self, flight: FlightContext, chain: HandoverChain, guidance: Guidance, lost_link: LostC2Link) -> None:
        self._chain = chain
        self._guidance = guidance
        self._lost_link = lost_link
        self._request = flight.request
        self._timeline = flight.timeline
        self._vehicle = flight.vehicle
        self._control = flight.control
        self.outcome = FlightState.COMPLETED
        """How the flight ends with it."""
        self.reason = ""
        """Why it lands, where an operator said so."""
        self.streams = True
        """Whether the flight streams until the landing is seen."""
        self.seen = False
        """Whether the vehicle has shown that it lands."""
        self._since_s = 0.0
        self._asked_s = -math.inf
        self._lands_s = 0.0
        self._ground = GroundedArmed(flight)

    def begin(self, outcome: FlightState, *, streams: bool = True, reason: str = "") -> None:
        """Land from now on, and end so."""
        self.outcome, self.streams, self.reason, self.seen = outcome, streams, reason, False
        self._since_s, self._asked_s = self._timeline.now_s, -math.inf
        self._ground.begin()

    def tick(self, dt_s: float) -> tuple[FlightState, str] | None:
        """One tick; the state that follows and why, where one does. `FlightState.LAPSED`: somebody else has it."""
        if self._chain.moving:
            # Until it is settled whom the vehicle obeys, it may not hear this.
            self._chain.step(self._guidance.reference.time_s, backwards=False)
        if self.down:
            return self.outcome, f"landed and disarmed, {self.reason}" if self.reason else "landed and disarmed"
        if not self.streams:
            self._lost_link.use_best_link()
        self.ask()
        if not self.alone:
            # Until it shows LAND the vehicle must not miss us.
            self._guidance.along_line(dt_s, 0.0)
        if self.taken_over:
            return FlightState.LAPSED, self.taken_over
        return (FlightState.LOST, self.ended) if self.ended else None

    @property
    def alone(self) -> bool:
        """Whether the vehicle needs no stream of ours: it lands by itself, or none was running."""
        return self.seen or not self.streams

    @property
    def down(self) -> bool:
        """Whether the vehicle has disarmed since, by two witnesses."""
        return bool(self._vehicle.down_since(self._since_s))

    def ask(self) -> None:
        """Ask for the mode, now and then, while the vehicle does not show it; to disarm, when it is down and does not.

        A landing that was seen and left is not asked for again: a pilot has the vehicle.
        """
        timeline, vehicle = self._timeline, self._vehicle
        lands = vehicle.mode == vehicle.profile.land_mode
        if lands:
            self.seen, self._lands_s = True, timeline.now_s
        if not self.seen and timeline.now_s - self._asked_s >= REASK_S:
            self._asked_s = timeline.now_s
            self._control.start_mode(vehicle.profile.land_mode)
        self._ground.update(ask=self.seen and lands)

    @property
    def taken_over(self) -> str:
        """Why the landing is no longer ours; empty while it is."""
        vehicle = self._vehicle
        away_s = self._timeline.now_s - self._lands_s
        if not self.seen or away_s < LEFT_S or not vehicle.armed or vehicle.on_ground:
            return ""
        return f"the vehicle left {vehicle.profile.land_mode} for {vehicle.mode}"

    @property
    def ended(self) -> str:
        """Why the landing is given up; empty while it goes on."""
        timeline = self._timeline
        silent_s = timeline.now_s - self._vehicle.monitor.last_heard_s()
        if silent_s > self._request.lost_after_s:
            return f"nothing heard for {silent_s:.0f} s, no landing was seen"
        if self._ground.ended:
            return self._ground.ended
        if timeline.now_s - self._since_s > LANDING_LIMIT_S:
            return f"no landing was seen in {LANDING_LIMIT_S:g} s"
        return ""
