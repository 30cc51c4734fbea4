"""A flight and its handovers as data: states, what may follow what, operator commands, events, the journal.

Pure: no clock, no wire. `link.director.core` drives these on the wire, the store keeps their events.

::

    connecting -> identifying -> preflight -> ready -> arming -> takeoff -> transit -> cruise -> arrived -> landing
                                                                               ^         |  ^
                                                                               |       hold resume
                                                                             resume      v  |
                                                       lapsed (silent) <-------------  holding -> returning -> landing
    every state -> one of the ends: completed, landed, refused, contingency, lost

A handover, seen from the receiving station::

    planned <-> ready -> requested -> confirmed -> released
       |          ^         |
       v          |         v
     late ------>-+<---- failed | timed_out | refused     (a person or a later proof may bring each back to ready)

Exactly one station is in control at every instant; the new link is proved before the old one is let go; request,
grant and confirmation are explicit and logged (the rule shared by STANAG 4586, ASTM F3411 practice and MAVLink's
operator-control protocol).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from types import MappingProxyType
from typing import Any, Protocol


class TransitionError(Exception):
    """A step no flight or handover may take; says from where, to where, and what is allowed."""


class FlightState(StrEnum):
    """Where a flight stands."""

    CONNECTING = "connecting"
    """Links are opened; the vehicle's autopilot (component 1) is waited for on each."""
    IDENTIFYING = "identifying"
    """Who it is: autopilot, version, simulator or not."""
    PREFLIGHT = "preflight"
    """Parameters, EKF origin, position and plan are judged. Nothing is armed."""
    READY = "ready"
    """Preflight passed; an operator command, or the command line, launches."""
    ARMING = "arming"
    TAKEOFF = "takeoff"
    TRANSIT = "transit"
    """From where the vehicle is to a point of the plan, inside one station's range."""
    CRUISE = "cruise"
    """The plan is streamed; T+ runs."""
    HOLDING = "holding"
    """Stopped on the path: the stream goes on with zero velocity."""
    RETURNING = "returning"
    """Back along the path flown, which is covered."""
    LAPSED = "lapsed"
    """Lost C2 link: we are silent and the autopilot is on its own; only an operator command brings us back."""
    ARRIVED = "arrived"
    LANDING = "landing"
    COMPLETED = "completed"
    """An end: the mission was flown as planned."""
    LANDED = "landed"
    """An end: landed where it was, because an operator commanded `land`."""
    REFUSED = "refused"
    """An end: never armed."""
    CONTINGENCY = "contingency"
    """An end: on the ground, or safe in the autopilot's own hold, other than planned."""
    LOST = "lost"
    """An end: we no longer command or no longer hear the vehicle; its own failsafe has it."""

    @property
    def ended(self) -> bool:
        """Whether nothing follows."""
        return not FLIGHT_TRANSITIONS[self]

    @property
    def airborne(self) -> bool:
        """Whether the vehicle may be in the air in this state."""
        return self in _AIRBORNE

    @property
    def exit_code(self) -> int:
        """What ``skyrelay fly`` ends with: 0 completed, or landed as commanded; 4 any other end.

        Raises `TransitionError` before the end.
        """
        if not self.ended:
            raise TransitionError(f"a flight that is {self} has no result yet")
        return 0 if self in (FlightState.COMPLETED, FlightState.LANDED) else 4


_S = FlightState
_ENDS = frozenset({_S.COMPLETED, _S.LANDED, _S.REFUSED, _S.CONTINGENCY, _S.LOST})
_AIRBORNE = frozenset({_S.TAKEOFF, _S.TRANSIT, _S.CRUISE, _S.HOLDING, _S.RETURNING, _S.LAPSED, _S.ARRIVED, _S.LANDING})
_BAD_ENDS_IN_FLIGHT = frozenset({_S.CONTINGENCY, _S.LOST})

FLIGHT_TRANSITIONS: Mapping[FlightState, frozenset[FlightState]] = MappingProxyType(
    {
        _S.CONNECTING: frozenset({_S.IDENTIFYING, _S.REFUSED}),
        _S.IDENTIFYING: frozenset({_S.PREFLIGHT, _S.REFUSED}),
        _S.PREFLIGHT: frozenset({_S.READY, _S.REFUSED}),
        _S.READY: frozenset({_S.ARMING, _S.PREFLIGHT, _S.REFUSED}),
        _S.ARMING: frozenset({_S.TAKEOFF, _S.REFUSED, _S.LAPSED}) | _BAD_ENDS_IN_FLIGHT,
        _S.TAKEOFF: frozenset({_S.TRANSIT, _S.LANDING, _S.LAPSED}) | _BAD_ENDS_IN_FLIGHT,
        _S.TRANSIT: frozenset({_S.CRUISE, _S.HOLDING, _S.RETURNING, _S.LANDING, _S.LAPSED}) | _BAD_ENDS_IN_FLIGHT,
        _S.CRUISE: frozenset({_S.HOLDING, _S.RETURNING, _S.ARRIVED, _S.LANDING, _S.LAPSED}) | _BAD_ENDS_IN_FLIGHT,
        _S.HOLDING: frozenset({_S.CRUISE, _S.TRANSIT, _S.RETURNING, _S.LANDING, _S.LAPSED}) | _BAD_ENDS_IN_FLIGHT,
        _S.RETURNING: frozenset({_S.HOLDING, _S.LANDING, _S.LAPSED}) | _BAD_ENDS_IN_FLIGHT,
        _S.LAPSED: frozenset({_S.TRANSIT, _S.LANDING}) | _BAD_ENDS_IN_FLIGHT,
        _S.ARRIVED: frozenset({_S.LANDING, _S.COMPLETED, _S.LAPSED}) | _BAD_ENDS_IN_FLIGHT,
        _S.LANDING: frozenset({_S.COMPLETED, _S.LANDED, _S.LAPSED}) | _BAD_ENDS_IN_FLIGHT,
        **{end: frozenset() for end in _ENDS},
    }
)


def advance(state: FlightState, to: FlightState) -> FlightState:
    """``to``, if a flight may go there from ``state``. Raises `TransitionError` otherwise."""
    if to not in FLIGHT_TRANSITIONS[state]:
        allowed = ", ".join(sorted(FLIGHT_TRANSITIONS[state])) or "nothing, it has ended"
        raise TransitionError(f"a flight that is {state} cannot become {to}; allowed is: {allowed}")
    return to


class HandoverState(StrEnum):
    """Where one handover stands."""

    PLANNED = "planned"
    READY = "ready"
    """The receiving station's C2 link is proved, and origin and plan agree on both sides."""
    LATE = "late"
    """The planned time has come and the receiving station is not ready; the transferring one stays in control."""
    REQUESTED = "requested"
    """Control is being moved; still one station at a time."""
    CONFIRMED = "confirmed"
    """The vehicle gave evidence that it obeys the receiving station."""
    RELEASED = "released"
    """The transferring station is silent. Done."""
    REFUSED = "refused"
    """An operator said no."""
    FAILED = "failed"
    """The vehicle said no."""
    TIMED_OUT = "timed_out"
    """No evidence in time; control is back with the transferring station."""


class HandoverEvent(StrEnum):
    """What can happen to a handover."""

    PROVED = "proved"
    UNPROVED = "unproved"
    DUE = "due"
    """The planned time has come."""
    REQUEST = "request"
    EVIDENCE = "evidence"
    NAK = "nak"
    TIMEOUT = "timeout"
    RELEASE = "release"
    REFUSE = "refuse"
    ACCEPT = "accept"


_H, _E = HandoverState, HandoverEvent
HANDOVER_TRANSITIONS: Mapping[tuple[HandoverState, HandoverEvent], HandoverState] = MappingProxyType(
    {
        (_H.PLANNED, _E.PROVED): _H.READY,
        (_H.PLANNED, _E.DUE): _H.LATE,
        (_H.LATE, _E.PROVED): _H.READY,
        (_H.READY, _E.UNPROVED): _H.PLANNED,
        (_H.READY, _E.REQUEST): _H.REQUESTED,
        (_H.REQUESTED, _E.EVIDENCE): _H.CONFIRMED,
        (_H.REQUESTED, _E.NAK): _H.FAILED,
        (_H.REQUESTED, _E.TIMEOUT): _H.TIMED_OUT,
        (_H.CONFIRMED, _E.RELEASE): _H.RELEASED,
        (_H.FAILED, _E.PROVED): _H.READY,
        (_H.TIMED_OUT, _E.PROVED): _H.READY,
        (_H.PLANNED, _E.REFUSE): _H.REFUSED,
        (_H.READY, _E.REFUSE): _H.REFUSED,
        (_H.LATE, _E.REFUSE): _H.REFUSED,
        (_H.FAILED, _E.REFUSE): _H.REFUSED,
        (_H.TIMED_OUT, _E.REFUSE): _H.REFUSED,
        (_H.REFUSED, _E.ACCEPT): _H.PLANNED,
    }
)


def handover_step(state: HandoverState, event: HandoverEvent) -> HandoverState:
    """The state after ``event``. Raises `TransitionError` when it cannot happen in ``state``."""
    try:
        return HANDOVER_TRANSITIONS[state, event]
    except KeyError:
        allowed = ", ".join(sorted(e for s, e in HANDOVER_TRANSITIONS if s is state)) or "nothing, it is done"
        raise TransitionError(f"{event} cannot happen to a handover that is {state}; allowed is: {allowed}") from None


class OperatorCommand(StrEnum):
    """What a remote pilot station may command a flight to do."""

    LAUNCH = "launch"
    """Arm and go (after a passed preflight)."""
    PREFLIGHT = "preflight"
    """Make the preflight again, before the launch command."""
    HOLD = "hold"
    RESUME = "resume"
    ABORT = "abort"
    """Fly the contingency in force."""
    LAND = "land"
    """Land where the vehicle is."""
    READY = "ready"
    """The receiving station stands by (where the flight asks for that)."""
    ACCEPT = "accept"
    """As `READY`, and takes back a refusal."""
    REFUSE = "refuse"
    REPLAN = "replan"
    """Fly another plan from now on, made for this flight from a moment ahead (`gcs.planning.replanning`)."""
    AUTHORISE = "authorise"
    """The flight may go on up to a given T+ of the plan, parent or no parent."""


class EventKind(StrEnum):
    """What a `FlightEvent` tells."""

    STATE = "state"
    """The flight's state changed: ``data`` has from, to, reason."""
    IDENTITY = "identity"
    """Which vehicle this is, by its own word, and that this flight alone has it: identity, unique_id, system_id."""
    CHECK = "check"
    """One finding of the preflight: name, level, message, value, required, fix."""
    COMMAND = "command"
    """A command to the vehicle was answered or given up: name, station, result, attempts."""
    TEXT = "text"
    """The vehicle's own words: severity, text."""
    GATE = "gate"
    """Control moved: fence, station, reason."""
    HANDOVER = "handover"
    """A handover changed: index, from, to, state, event, reason, t_plus_s."""
    RETIMED = "retimed"
    """The schedule moved: shift_s, and the handovers still to come with their new T+."""
    REPLANNED = "replanned"
    """Another plan is flown from now on: plan_sha256, before, plan_s, mission_time_s, handovers_done."""
    LINK = "link"
    """Another of a station's ways to the vehicle sends: station, url, before."""
    OPERATOR_COMMAND = "word"
    """An operator command was given: word, by, handover."""
    ALARM = "alarm"
    """Something a person must know at once: what, and the values."""
    PARAMETER = "parameter"
    """A parameter of the vehicle was changed by us: name, before, after."""
    PROGRESS = "progress"
    """About once a second in flight: where, how fast, tracking error, margins, lateness. Kept or not, as you like."""
    RESULT = "result"
    """The last event: outcome, exit_code, summary figures."""


@dataclass(frozen=True)
class FlightEvent:
    """One line of a flight's history.

    ``sequence`` counts from 1 without gaps. ``time_s`` is the flight's own clock (seconds since it was set up, does
    not jump), ``t_plus_s`` seconds since T+0 or None before it, ``utc`` an RFC 3339 time for people.
    """

    sequence: int
    kind: EventKind
    time_s: float
    t_plus_s: float | None
    utc: str
    state: FlightState
    data: Mapping[str, Any] = field(default_factory=dict)

    def to_document(self) -> dict[str, Any]:
        """As a JSON object."""
        return {
            "sequence": self.sequence,
            "kind": self.kind.value,
            "time_s": self.time_s,
            "t_plus_s": self.t_plus_s,
            "utc": self.utc,
            "state": self.state.value,
            "data": dict(self.data),
        }

    @classmethod
    def from_document(cls, document: Mapping[str, Any]) -> FlightEvent:
        """From `to_document`. Raises `ValueError` (or `KeyError`) for anything else."""
        return cls(
            sequence=int(document["sequence"]),
            kind=EventKind(document["kind"]),
            time_s=float(document["time_s"]),
            t_plus_s=None if document["t_plus_s"] is None else float(document["t_plus_s"]),
            utc=str(document["utc"]),
            state=FlightState(document["state"]),
            data=dict(document["data"]),
        )


class Journal(Protocol):
    """Where a flight's history is written; the store implements it and passes it in."""

    def append(self, event: FlightEvent) -> None:
        """Keep ``event``. Called in order, once each; must not raise for want of space or time."""
        ...
