"""Whom an ArduPilot listens to: set before the flight, given back after it.

MAV_GCS_SYSID .. MAV_GCS_SYSID_HI is the range of ground stations whose heartbeats count for the failsafe, and, with bit
0 of MAV_OPTIONS, the only ones that are heard at all. The plan's stations have system ids in one small range, so the
vehicle is told that range once, and in flight nothing has to change. A foreign station is then dropped in silence.

Order matters, because every write must leave the writer inside: HI first, then SYSID (the other way locks everybody out
when the range grows downwards), enforcement last; back in the opposite order. A sender with the vehicle's own id is
always heard; it is the way out of a lock-out and is used on the ground only.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from gcs.flight import EventKind
from link.context import VEHICLE_STATION, FlightContext
from link.gate import Fence
from link.parameters import ParameterClient
from link.params import Parameter
from link.steps import Steps

ENFORCE = 1
KEYS = ("gcs_system_id", "gcs_system_id_high", "enforce_gcs")


@dataclass(frozen=True)
class Ownership:
    """The three values: lowest and highest station heard, and the option bits."""

    low: int
    high: int
    options: int

    def hears(self, system_id: int) -> bool:
        """Whether a station is obeyed (always, unless enforced)."""
        return not self.options & ENFORCE or self.low <= system_id <= max(self.low, self.high)


def present(values: Mapping[str, Parameter | None]) -> Ownership | None:
    """What was read; None when the vehicle lacks one of the names (before 4.7 there was no range)."""
    found = [values.get(key) for key in KEYS]
    if any(one is None for one in found):
        return None
    low, high, options = (int(one.value) for one in found if one is not None)
    return Ownership(low, high, options)


def wanted(system_ids: Mapping[str, int], before: Ownership) -> Ownership:
    """The range of the plan's stations, enforced."""
    ids = sorted(system_ids.values())
    return Ownership(ids[0], ids[-1] if len(ids) > 1 else 0, before.options | ENFORCE)


def writes(before: Ownership, after: Ownership) -> list[tuple[str, int]]:
    """The writes ``(key, value)`` that lead from one to the other.

    Enforcement goes off before anything else changes, and on after everything has; HI goes before SYSID. A writer
    inside both ranges, or without enforcement, is heard throughout.
    """
    names = dict(zip(KEYS, ("low", "high", "options"), strict=True))
    order = ("gcs_system_id_high", "gcs_system_id", "enforce_gcs")
    if not after.options & ENFORCE:
        order = ("enforce_gcs", "gcs_system_id_high", "gcs_system_id")
    return [
        (key, getattr(after, names[key])) for key in order if getattr(before, names[key]) != getattr(after, names[key])
    ]


def apply(
    context: FlightContext,
    parameters: ParameterClient,
    values: Mapping[str, Parameter | None],
    before: Ownership,
    after: Ownership,
) -> Steps[bool]:
    """Write and read back; whether all was taken.

    Where the station in control is not heard (any more), its link is used with the vehicle's own id.
    """
    station = context.fence.station_id.removesuffix(VEHICLE_STATION)
    done = True
    for key, value in writes(before, after):
        parameter = values[key]
        assert parameter is not None
        old = parameters.known[parameter.name].value
        taken = yield from _write(context, parameters, parameter.name, value, context.fence)
        if not taken:
            # The answer may have been lost on a link that is shut to us now.
            context.grant(station + VEHICLE_STATION, "not heard under its own id")
            taken = yield from _write(context, parameters, parameter.name, value, context.fence)
        if taken:
            context.emit(EventKind.PARAMETER, name=parameter.name, before=old, after=value)
        done = done and taken
    context.grant(station, "parameters written")
    return done


def _write(context: FlightContext, parameters: ParameterClient, name: str, value: int, fence: Fence) -> Steps[bool]:
    setting = parameters.set(name, value, fence, attempts=6)
    while not setting.finished:
        yield
    return setting.confirmed
