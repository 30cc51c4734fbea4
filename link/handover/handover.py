"""Handing control from one station to the next, on the wire.

The next station's link is proved before the old one is let go; control moves at one tick, from one station's setpoint
to the other's, so the vehicle misses none; the handover is *confirmed* by evidence from the vehicle that it obeys the
new station, and until then the old one stands by to go on. What the vehicle must be told depends on it:

gate
    nothing (PX4 obeys whoever sends): the gate alone decides.
range
    nothing in flight: before the flight ArduPilot was told to listen to the plan's stations and to no other
    (MAV_GCS_SYSID .. MAV_GCS_SYSID_HI, MAV_OPTIONS bit 0).
operator_control
    the old station allows a takeover, the new one asks for control (command 32100); confirmed by its ack and, where
    the vehicle speaks it, CONTROL_STATUS (512).

parameter
    the vehicle hears one station alone: its range of ids is first widened to both by the old station, control moves,
    and the new station narrows the range to itself (`link.handover.gcs_ids.GcsIdManager`). Without a range (before
    ArduPilot 4.7) the old station names the new one, and control moves with the answer; unanswered, the new one is
    tried, and one of the two is obeyed. A neighbour that takes over from a dead link opens the vehicle with the
    vehicle's own id.

Evidence is one of: the vehicle repeats a setpoint that only the new station can have sent; it answers a command of the
new station, to that station. TIMESYNC answers prove links, never control.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from gcs.flight import EventKind, HandoverEvent, HandoverState, handover_step
from gcs.plan import Plan
from link.dialect import mavlink
from link.microservices.command import Ticket
from link.session.context import FlightContext
from link.session.request import HandoverWay

LINK_HEARD_S = 1.5
"""The vehicle must have been heard over the next station's link this lately."""
LINK_PROVEN_S = 1.0
"""A frame of the next station, no older than this, must have been answered over its link."""
LOOK_AHEAD_S = 60.0
"""From so long before the two coverages meet on the next station's readiness is watched and told."""
ORIGIN_TOLERANCE_M = 0.2
DUE_TOLERANCE_S = 1e-6
REASK_S = 0.5
REQUEST_OPERATOR_CONTROL = 32100
TELLING_MESSAGE = mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION


@dataclass(frozen=True)
class HandoverWindow:
    """Where control passes between two neighbouring legs of a plan, seen in the direction it is crossed.

    Times are on the plan. ``open_s`` is where the new station's coverage begins and ``limit_s`` where the old one's
    ends; when the flight returns (``forward`` false) both and their order are mirrored.
    """

    index: int
    from_leg: int
    to_leg: int
    from_station: str
    to_station: str
    time_s: float
    open_s: float
    limit_s: float
    forward: bool = True

    def due(self, time_s: float) -> bool:
        """Whether a place on the plan is at or past the planned one."""
        if self.forward:
            return time_s >= self.time_s - DUE_TOLERANCE_S
        return time_s <= self.time_s + DUE_TOLERANCE_S

    def covered_by_next(self, time_s: float) -> bool:
        """Whether the new station covers the vehicle at a place on the plan."""
        return time_s >= self.open_s if self.forward else time_s <= self.open_s

    def near(self, time_s: float) -> bool:
        """Whether it is time to watch the new station."""
        return self.covered_by_next(time_s + LOOK_AHEAD_S if self.forward else time_s - LOOK_AHEAD_S)

    def mirrored(self) -> HandoverWindow:
        """The same window crossed the other way."""
        return HandoverWindow(
            self.index,
            self.to_leg,
            self.from_leg,
            self.to_station,
            self.from_station,
            self.time_s,
            self.limit_s,
            self.open_s,
            not self.forward,
        )


def handover_windows(plan: Plan) -> list[HandoverWindow]:
    """The plan's handovers, forward: ``handover_windows(plan)[k]`` is between legs ``k`` and ``k + 1``."""
    return [
        HandoverWindow(h.index, k, k + 1, h.from_station, h.to_station, h.time_s, h.overlap_start_s, h.overlap_end_s)
        for k, h in enumerate(plan.handovers)
    ]


class Handover:
    """One handover under way. `step` once a tick, before that tick's setpoint.

    ``attempt_s`` is how long one attempt may take; ``proof_after_s`` the time the next station's link must have been
    proved after, where it has failed before.
    """

    def __init__(
        self,
        flight: FlightContext,
        window: HandoverWindow,
        way: HandoverWay,
        attempt_s: float,
        proof_after_s: float = -math.inf,
    ) -> None:
        self._request = flight.request
        self._timeline = flight.timeline
        self._vehicle = flight.vehicle
        self._control = flight.control
        self.window = window
        self.way = way
        self.attempt_s = attempt_s
        self._proof_after_s = proof_after_s
        self.state = HandoverState.PLANNED
        self.attempts = 0
        self.reason = ""
        self._accepted = not flight.request.operator_words
        self._requested_s = -math.inf
        self._moved_s = math.inf
        self._retry_s = -math.inf
        self._ticket: Ticket | None = None
        self._allow: Ticket | None = None

    # -- operator commands --------------------------------------------------------------------------------------------

    def accept(self) -> None:
        """The next station's operator stands by, or takes back a refusal."""
        self._accepted = True
        if self.state is HandoverState.REFUSED:
            self._event(HandoverEvent.ACCEPT, "operator's word")

    def refuse(self, reason: str) -> None:
        """An operator says no. Raises `gcs.flight.TransitionError` when it is under way or done."""
        self._accepted = not self._request.operator_words
        self._event(HandoverEvent.REFUSE, reason)

    # -- state --------------------------------------------------------------------------------------------------------

    @property
    def done(self) -> bool:
        """Whether the new station is confirmed and the old one silent."""
        return self.state is HandoverState.RELEASED

    @property
    def open(self) -> bool:
        """Whether the flight may go on towards the window at full speed.

        After an attempt that failed not before one succeeds: a station that is proved and never obeyed would else
        let the flight out of its coverage step by step.
        """
        if self.state in (HandoverState.CONFIRMED, HandoverState.RELEASED):
            return True
        if self.state is HandoverState.REQUESTED:
            return self.attempts == 1 and self._timeline.now_s - self._requested_s <= 0.5 * self.attempt_s
        return self.state is HandoverState.READY and self.attempts == 0

    def missing(self, *, hurried: bool = False) -> str:
        """What the next station still lacks; empty when its link is proved and both sides agree.

        Where the vehicle is must be known, and its estimate good, unless it is ``hurried``: the old link has failed.
        """
        now_s, vehicle, station = self._timeline.now_s, self._vehicle, self.window.to_station
        if not self._accepted:
            return "operator's word"
        if not hurried and (vehicle.doubt or vehicle.position is None):
            return vehicle.doubt or "a position of the vehicle"
        if not vehicle.monitor.heard_within(now_s, station, LINK_HEARD_S):
            return "telemetry over its link"
        proven = vehicle.monitor.proven_within(now_s, station, LINK_PROVEN_S)
        link = vehicle.monitor.links[station]
        if not proven or link.proven_s <= self._proof_after_s:
            return "an answer over its link"
        theirs, ours = link.origin, vehicle.origin
        if theirs is not None and ours is not None and link.origin_s > vehicle.origin_s:
            north, east = vehicle.profile.north_east_m(ours, theirs.lat_deg, theirs.lon_deg)
            if math.hypot(north, east, theirs.alt_amsl_m - ours.alt_amsl_m) > ORIGIN_TOLERANCE_M:
                return "the same EKF origin"
        return ""

    # -- a tick -------------------------------------------------------------------------------------------------------

    def step(self, time_s: float, *, at_once: str | None = None) -> None:
        """Move on, the flight being at ``time_s`` of the plan. ``at_once``: do not wait for the planned place (why)."""
        window, hurried = self.window, at_once is not None
        if self.done or not (window.near(time_s) or hurried):
            return
        if self.state in (HandoverState.PLANNED, HandoverState.LATE, HandoverState.FAILED, HandoverState.TIMED_OUT):
            if self._timeline.now_s >= self._retry_s and not self.missing(hurried=hurried):
                self._event(HandoverEvent.PROVED)
            elif self.state is HandoverState.PLANNED and window.due(time_s):
                self._event(HandoverEvent.DUE, f"{window.to_station} lacks {self.missing()}")
        elif self.state is HandoverState.READY and (missing := self.missing(hurried=hurried)):
            self._event(HandoverEvent.UNPROVED, f"{window.to_station} lacks {missing}")
        if self.state is HandoverState.READY and (window.due(time_s) or hurried) and window.covered_by_next(time_s):
            self._ask_for_control(at_once)
        if self.state is HandoverState.REQUESTED:
            self._follow_up()

    def _ask_for_control(self, at_once: str | None) -> None:
        control = self._control
        self.attempts += 1
        self._requested_s = self._timeline.now_s
        self._moved_s = math.inf
        control.gate.accompany(self.window.to_station)
        self._event(HandoverEvent.REQUEST, at_once or "")
        if self.way == HandoverWay.OPERATOR_CONTROL:
            self._allow = control.start_command(
                "allow takeover",
                REQUEST_OPERATOR_CONTROL,
                (1.0, 1.0, 10.0, float(control.system_ids[self.window.from_station])),
                retry_s=0.2,
            )
        elif control.id_manager is not None and at_once is None:
            # Heard first, then in control; `_follow_up` moves it.
            if not control.id_manager.ranged:
                control.id_manager.claimed = self.window.to_station
        else:
            self._move()

    def _move(self) -> None:
        """Control is the new station's from here on; it speaks first, then its setpoint of this tick follows."""
        control = self._control
        if control.id_manager is not None:
            control.id_manager.claimed = None
        control.grant(self.window.to_station, f"handover {self.window.index}")
        control.gate.accompany(self.window.from_station)
        self._moved_s = self._timeline.now_s
        if self.way == HandoverWay.OPERATOR_CONTROL:
            own = float(control.system_ids[self.window.to_station])
            self._ticket = control.start_command(
                "request control", REQUEST_OPERATOR_CONTROL, (1.0, 0.0, 10.0, own), retry_s=0.1, attempts=30
            )
        else:
            self._ticket = control.start_command(
                "request message", mavlink.MAV_CMD_REQUEST_MESSAGE, (float(TELLING_MESSAGE),), retry_s=0.2, attempts=30
            )

    def _follow_up(self) -> None:
        timeline, control = self._timeline, self._control
        if math.isinf(self._moved_s):
            if control.id_manager is not None:
                # An answer that was lost leaves two the vehicle may hear: the new one is tried for the other half.
                unsure = timeline.now_s - self._requested_s >= 0.5 * self.attempt_s and not control.id_manager.ranged
                if control.id_manager.hears(self.window.to_station) or unsure:
                    self._move()
            elif self._allow is not None and self._allow.accepted:
                self._move()
            elif self._allow is not None and self._allow.finished and self._allow.result is not None:
                self._fail(HandoverEvent.NAK, f"the vehicle answered {self._allow.outcome}")
                return
        else:
            evidence = self._evidence()
            if evidence:
                self._event(HandoverEvent.EVIDENCE, evidence)
                if self._ticket is not None:
                    control.commander.cancel(self._ticket)
                control.gate.accompany(None)
                self._event(HandoverEvent.RELEASE, f"{self.window.from_station} is silent")
                return
            if self._refused():
                self._fail(HandoverEvent.NAK, f"the vehicle answered {self._ticket.outcome if self._ticket else ''}")
                return
        if timeline.now_s - self._requested_s >= self.attempt_s:
            self._fail(HandoverEvent.TIMEOUT, "no evidence from the vehicle")

    def _evidence(self) -> str:
        """What shows that the vehicle obeys the new station; empty while nothing does."""
        monitor, control, ticket = self._vehicle.monitor, self._control, self._ticket
        answered = ticket is not None and ticket.finished and ticket.result is not None
        if self.way == HandoverWay.OPERATOR_CONTROL:
            if ticket is None or not ticket.accepted:
                return ""
            if monitor.control_s <= -math.inf or monitor.control_main == control.system_ids[self.window.to_station]:
                return "control granted to it"
            return ""
        if answered and ticket is not None and ticket.result not in _REFUSALS:
            return "a command of it was answered"
        if self.way == HandoverWay.PARAMETER:
            # A vehicle that drops the new station in silence runs on along the old one's last setpoint, which may look
            # like the new one's for seconds: only an answer shows whom it hears.
            return ""
        grant = control.gate.in_force
        if monitor.target is not None and monitor.target_s > self._moved_s and grant is not None:
            held = control.echoes.held(monitor.target)
            if held and all(sent.grant == grant.number for sent in held):
                return "its setpoint is held"
        return ""

    def _refused(self) -> bool:
        """Whether the vehicle said that it does not obey the new station."""
        ticket = self._ticket
        if ticket is None or not ticket.finished or ticket.result is None:
            return False
        if self.way == HandoverWay.OPERATOR_CONTROL:
            return not ticket.accepted
        # Any other answer addressed to the new station shows that it is heard and not turned away.
        return ticket.result in _REFUSALS

    def _fail(self, event: HandoverEvent, reason: str) -> None:
        """Control goes back to the old station, which goes on."""
        timeline, control = self._timeline, self._control
        for ticket in (self._ticket, self._allow):
            if ticket is not None:
                control.commander.cancel(ticket)
        control.gate.accompany(None)
        control.grant(self.window.from_station, f"handover {self.window.index} not confirmed")
        self._retry_s = timeline.now_s + REASK_S
        self._proof_after_s = timeline.now_s
        self._event(event, reason)

    def _event(self, event: HandoverEvent, reason: str = "") -> None:
        before, self.state = self.state, handover_step(self.state, event)
        self.reason = reason
        self._timeline.emit(
            EventKind.HANDOVER,
            index=self.window.index,
            **{"from": self.window.from_station, "to": self.window.to_station},
            before=before.value,
            state=self.state.value,
            event=event.value,
            reason=reason,
            attempt=self.attempts,
            way=self.way,
            forward=self.window.forward,
        )


_REFUSALS = frozenset({10})
"""MAV_RESULT_NOT_IN_CONTROL: the vehicle heard the new station and does not obey it."""
