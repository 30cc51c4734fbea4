"""Whom an ArduPilot listens to: set before the flight, moved in flight where asked for, given back after it.

MAV_GCS_SYSID .. MAV_GCS_SYSID_HI is the range of ground stations whose heartbeats count for the failsafe, and, with bit
0 of MAV_OPTIONS, the only ones that are heard at all; a foreign station is dropped in silence. Two ways of using it:

range (the default)
    the plan's stations have system ids in one small range, so the vehicle is told that range once, and in flight
    nothing has to change.
parameter
    it hears one station alone, and is told of each handover (`GcsIdManager`). The only way for several stations before
    4.7, which has SYSID_MYGCS and SYSID_ENFORCE and no range.

Order matters, because every write must leave the writer inside: HI first, then SYSID (the other way locks everybody out
when the range grows downwards), enforcement last; back in the opposite order. A sender with the vehicle's own id is
always heard: it gets us out of a lock-out, and of not knowing whom the vehicle hears.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from gcs.flight import EventKind
from link.errors import GateClosed
from link.microservices.parameter import ParameterClient, same_value
from link.microservices.parameter_value import Parameter, write_parameter
from link.session.context import FlightContext
from link.session.procedure import Steps, wait_until
from link.transport.gate import ControlGrant, Sender

ENFORCE = 1
KEYS = ("gcs_system_id", "gcs_system_id_high", "enforce_gcs")
FIELDS = dict(zip(KEYS, ("low", "high", "options"), strict=True))
RETRY_S = 0.15
"""Between writes in flight: an answer takes one round trip."""
OWN_TRIES = 2
"""Writes under a station's own id that may stay unanswered before the vehicle's id is used."""


@dataclass(frozen=True)
class GcsIds:
    """The three values: lowest and highest station heard, and the option bits. ``high`` None: there is no range."""

    low: int
    high: int | None
    options: int

    def hears(self, system_id: int) -> bool:
        """Whether a station is obeyed (always, unless enforced)."""
        return not self.options & ENFORCE or self.low <= system_id <= max(self.low, self.high or 0)

    def alone(self, system_id: int) -> GcsIds:
        """One station heard and no other."""
        return GcsIds(system_id, None if self.high is None else system_id, self.options | ENFORCE)

    def both(self, first: int, second: int) -> GcsIds:
        """Two stations heard (and those between). Without a range that cannot be: the second."""
        if self.high is None:
            return self.alone(second)
        return GcsIds(min(first, second), max(first, second), self.options | ENFORCE)


def present(values: Mapping[str, Parameter | None]) -> GcsIds | None:
    """What was read; None when the vehicle lacks a name it must have."""
    low, high, options = (values.get(key) for key in KEYS)
    if low is None or options is None:
        return None
    return GcsIds(int(low.value), None if high is None else int(high.value), int(options.value))


def named(ids: GcsIds, values: Mapping[str, Parameter | None]) -> dict[str, int]:
    """GCS ids by the names this vehicle has for them."""
    return {p.name: int(getattr(ids, FIELDS[key])) for key in KEYS if (p := values.get(key)) is not None}


def wanted(system_ids: Mapping[str, int], before: GcsIds) -> GcsIds:
    """The range of the plan's stations, enforced. Without a range, that of one station."""
    ids = sorted(system_ids.values())
    high = None if before.high is None else ids[-1] if len(ids) > 1 else 0
    return GcsIds(ids[0], high, before.options | ENFORCE)


def writes(before: GcsIds, after: GcsIds) -> list[tuple[str, int]]:
    """The writes ``(key, value)`` that lead from one to the other.

    Enforcement goes off before anything else changes, and on after everything has. HI goes before SYSID, but after it
    where one id alone is to be left: HI at or below SYSID means SYSID alone, which then is still the old one. A writer
    inside both ranges, or without enforcement, is heard throughout.
    """
    alone = after.high is not None and after.high <= after.low
    ids = ("gcs_system_id", "gcs_system_id_high") if alone else ("gcs_system_id_high", "gcs_system_id")
    order = (*ids, "enforce_gcs") if after.options & ENFORCE else ("enforce_gcs", *ids)
    changes = [(key, getattr(after, FIELDS[key])) for key in order]
    return [(key, value) for key, value in changes if value is not None and value != getattr(before, FIELDS[key])]


def apply(
    flight: FlightContext,
    parameters: ParameterClient,
    values: Mapping[str, Parameter | None],
    before: GcsIds,
    after: GcsIds,
) -> Steps[bool]:
    """Write and read back, on the ground; whether all was taken.

    Where the station in control is not heard (any more), its link is used with the vehicle's own id.
    """
    station = flight.control.in_force.station_id
    done = True
    for key, value in writes(before, after):
        parameter = values[key]
        assert parameter is not None
        old = parameters.known[parameter.name].value
        taken = yield from _write(flight, parameters, parameter.name, value, flight.control.in_force)
        if not taken:
            # The answer may have been lost on a link that is shut to us now.
            flight.control.grant(station, "not heard under its own id", as_vehicle=True)
            taken = yield from _write(flight, parameters, parameter.name, value, flight.control.in_force)
        if taken:
            flight.timeline.emit(EventKind.PARAMETER, name=parameter.name, before=old, after=value)
        done = done and taken
    flight.control.grant(station, "parameters written")
    return done


def _write(
    flight: FlightContext, parameters: ParameterClient, name: str, value: int, grant: ControlGrant
) -> Steps[bool]:
    setting = parameters.set(name, value, grant, attempts=6)
    while not setting.finished:
        yield
    return setting.confirmed


def reread(
    flight: FlightContext, parameters: ParameterClient, values: Mapping[str, Parameter | None]
) -> Steps[GcsIds | None]:
    """What the vehicle says now, asked under the station's own id and then under the vehicle's; None: no answer."""
    station = flight.control.in_force.station_id
    names = {key: parameter.name for key in KEYS if (parameter := values.get(key)) is not None}
    for as_vehicle in (False, True):
        flight.control.grant(station, "whom does the vehicle hear", as_vehicle=as_vehicle)
        asked = parameters.read(names.values(), flight.control.in_force)
        yield from wait_until(flight.timeline, lambda a=asked: all(one.finished for one in a), 30.0)  # type: ignore[misc]
        answers = {one.name: one.answer for one in asked}
        if all(answer is not None for answer in answers.values()):
            flight.control.grant(station, "answered")
            return present({key: answers[name] for key, name in names.items()})
    flight.control.grant(station, "no answer")
    return None


class GcsIdManager:
    """In flight, by parameter: the vehicle hears the station in control, and in a handover both.

    Every unanswered write leaves two states the vehicle may be in, so a set of them is kept; any PARAM_VALUE of the
    vehicle, over whichever link, narrows it down. A station writes under its own id while all of them hear it; else,
    and where that stays unanswered, the write goes over its link under the vehicle's own id, which is always heard. So
    nobody stays locked out whose link works.

    `step` once a tick, `on_value` for every PARAM_VALUE.
    """

    def __init__(self, flight: FlightContext, values: Mapping[str, Parameter | None], now: GcsIds) -> None:
        self._timeline = flight.timeline
        self._vehicle = flight.vehicle
        self._control = flight.control
        self._parameters = {key: parameter for key in KEYS if (parameter := values.get(key)) is not None}
        self._keys = {parameter.name: key for key, parameter in self._parameters.items()}
        self.states: frozenset[GcsIds] = frozenset({now})
        """What the vehicle may be set to."""
        self.claimed: str | None = None
        """The station that is to be heard alone before control moves, where the vehicle has no range."""
        self._tries = 0
        self._write: tuple[str, int] | None = None
        self._next_s = 0.0
        self._rescued = False

    @property
    def ranged(self) -> bool:
        """Whether two stations can be heard at once."""
        return "gcs_system_id_high" in self._parameters

    def hears(self, station: str) -> bool:
        """Whether the vehicle surely obeys a station."""
        return all(state.hears(self._control.system_ids[station]) for state in self.states)

    def wanted(self) -> GcsIds | None:
        """What it is to be set to now; None while nobody is in control."""
        control = self._control
        gate, any_state = control.gate, next(iter(self.states))
        holder = gate.holder
        if holder is None:
            return None
        own = control.system_ids[holder]
        if self.claimed is not None:
            return any_state.alone(control.system_ids[self.claimed])
        if gate.incoming is not None and self.ranged:
            return any_state.both(own, control.system_ids[gate.incoming])
        return any_state.alone(own)

    def step(self, now_s: float) -> None:
        """Write what is due."""
        goal = self.wanted()
        due = None if goal is None else self._due(goal)
        if due != self._write:
            self._write, self._tries, self._next_s = due, 0, now_s
        if due is None:
            self._rescued = False
            return
        if now_s < self._next_s - 1e-9:
            return
        self._next_s = now_s + RETRY_S
        self._tries += 1
        self._put(*due)

    def _due(self, goal: GcsIds) -> tuple[str, int] | None:
        """The next write: the first, in the order that locks nobody out, that any possible state still needs."""
        ahead = [writes(state, goal) for state in self.states]
        for key in ("gcs_system_id_high", "gcs_system_id", "enforce_gcs"):
            for steps in ahead:
                for step in steps:
                    if step[0] == key:
                        return step
        return None

    def _put(self, key: str, value: int) -> None:
        control = self._control
        parameter = self._parameters[key]
        grant = control.in_force
        station = grant.station_id
        rescue = not self.hears(station) or self._tries > OWN_TRIES
        message = write_parameter(
            parameter.name, value, parameter.kind, "c_cast", target_system=self._vehicle.system_id
        )
        if rescue and not self._rescued:
            self._rescued = True
            self._timeline.alarm(
                "ownership by the vehicle's own id", station=station, parameter=parameter.name, value=value
            )
        try:
            control.gate.send(grant, message, sender=Sender(station, as_vehicle=True) if rescue else None)
        except GateClosed:
            return
        self.states = self.states | {replace(state, **{FIELDS[key]: value}) for state in self.states}

    def on_value(self, name: str, value: float) -> None:
        """Take a value the vehicle told."""
        key = self._keys.get(name)
        if key is None:
            return
        field = FIELDS[key]
        before = {getattr(state, field) for state in self.states}
        fitting = frozenset(state for state in self.states if same_value(value, getattr(state, field)))
        self.states = fitting or frozenset(replace(state, **{field: int(value)}) for state in self.states)
        if len(before) > 1 or not fitting:
            old = sorted(one for one in before if one != value)
            self._timeline.emit(EventKind.PARAMETER, name=name, before=old[0] if old else None, after=int(value))
