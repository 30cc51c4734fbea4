"""Giving back what an earlier flight left changed on a vehicle, from its note in the journal; on the ground, disarmed.

Only what is still as that flight made it is put back: a value that somebody else has set since stays, and is told.
Everything is read before and read back after, so that a restoration broken off at any moment is done again by whoever
comes next, to the same end.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from gcs.flight import EventKind
from link.errors import MissionItemError
from link.handover.gcs_ids import ENFORCE
from link.microservices.mission_client import MissionClient
from link.microservices.mission_download import MissionDownload, MissionTransfer
from link.microservices.mission_item import TYPE_NAMES, MissionItem
from link.microservices.mission_upload import MissionClear, MissionUpload, difference
from link.microservices.parameter import ParameterClient, same_value
from link.session.changes import ChangeJournal, VehicleChanges
from link.session.control import Control
from link.session.procedure import Steps, wait_until
from link.session.timeline import Timeline
from link.session.vehicle import Vehicle

ANSWER_S = 30.0


@dataclass(frozen=True)
class Microservices:
    """What a restoration works with: a station in control, the vehicle, and the two microservices."""

    timeline: Timeline
    vehicle: Vehicle
    control: Control
    parameters: ParameterClient
    missions: MissionClient


@dataclass
class Restored:
    """How it went: ``given_back``, ``as_before`` already, ``foreign`` (somebody else's since, and left), ``failed``."""

    given_back: list[str] = field(default_factory=list)
    as_before: list[str] = field(default_factory=list)
    foreign: list[str] = field(default_factory=list)
    failed: list[str] = field(default_factory=list)

    @property
    def complete(self) -> bool:
        """Whether nothing of the flight's is left on the vehicle."""
        return not self.failed


def restore_changes(
    services: Microservices, journal: ChangeJournal, changes: VehicleChanges, *, sure: bool, ids_alone: bool = False
) -> Steps[Restored]:
    """Give back what ``changes`` notes, and strike it from the journal; ``ids_alone``: of an armed vehicle no more.

    Not ``sure`` that it is the note's vehicle (simulators share a uid): the note stays where nothing was the flight's.
    """
    done, left = Restored(), changes
    if not ids_alone:
        for name, (before, after) in reversed(list(changes.settings.items())):
            if (yield from _give_back(services, name, before, (after,), done)):
                left = left.without(settings=(name,))
        for kind, (items, made) in changes.lists.items():
            if (yield from _list_back(services, kind, items, made, done)):
                left = left.without(lists=(kind,))
    # Last, and in the order that leaves the writer heard as long as can be.
    given = True
    for key, was, ours in _ids_in_order(changes):
        given = (yield from _give_back(services, key, was, ours, done)) and given
    if given:
        left = left.without(gcs_ids=True)
    if sure or done.given_back:
        _strike(services, journal, changes, left)
    return done


def _strike(services: Microservices, journal: ChangeJournal, before: VehicleChanges, left: VehicleChanges) -> None:
    if left.empty:
        journal.done(before.key)
    elif left != before:
        try:
            journal.keep(left)
        except OSError as error:  # the older note names more than is left, which does no harm
            services.timeline.alarm("the journal of changes cannot be written", reason=str(error))


def _ids_in_order(changes: VehicleChanges) -> list[tuple[str, int, tuple[int, ...]]]:
    """(name, before, what the flight may have made of it), in the order of writing."""
    ids: Mapping[str, int] = changes.gcs_ids

    def rank(name: str) -> int:
        return 0 if name.endswith("_HI") else 1

    numbers = sorted((name for name in ids if not is_option(name)), key=rank)
    steps: list[tuple[str, int, tuple[int, ...]]] = [(n, ids[n], (0, *changes.stations)) for n in numbers]
    options: list[tuple[str, int, tuple[int, ...]]] = [
        (n, ids[n], (ids[n] | ENFORCE, ids[n] & ~ENFORCE)) for n in ids if is_option(n)
    ]
    locks = any(value & ENFORCE for _, value, _ in options)
    return steps + options if locks else options + steps


def is_option(name: str) -> bool:
    """Whether a parameter is the one that makes an ArduPilot deaf to other stations."""
    return name in ("MAV_OPTIONS", "SYSID_ENFORCE")


def _give_back(
    services: Microservices, name: str, before: int | float, made: Iterable[int | float], done: Restored
) -> Steps[bool]:
    """One parameter; whether it needs no more care."""
    now = yield from read_heard(services, name)
    if now is None:
        done.failed.append(name)
        return False
    if same_value(now, before):
        done.as_before.append(name)
        return True
    if not any(same_value(now, value) for value in made):
        done.foreign.append(name)
        services.timeline.alarm("somebody else changed it since, so it stays", name=name, value=now, before=before)
        return True
    if not (yield from write_heard(services, name, before)):
        done.failed.append(name)
        services.timeline.alarm("parameter not put back", name=name, value=before)
        return False
    done.given_back.append(name)
    services.timeline.emit(EventKind.PARAMETER, name=name, before=now, after=before)
    return True


def _voices(services: Microservices) -> tuple[bool, ...]:
    """Under whose id to speak: our own, then, where an autopilot may be deaf to it, the vehicle's."""
    return (False, True) if services.vehicle.profile.filters_station_ids else (False,)


def read_heard(services: Microservices, name: str) -> Steps[int | float | None]:
    """A parameter's value, asked under our own id and then under the vehicle's; None: no answer."""
    station = services.control.in_force.station_id
    for as_vehicle in _voices(services):
        services.control.grant(station, "restoration", as_vehicle=as_vehicle)
        (asked,) = services.parameters.read([name], services.control.in_force)
        yield from wait_until(services.timeline, lambda a=asked: a.finished, ANSWER_S)  # type: ignore[misc]
        if asked.answer is not None:
            return asked.answer.value
        if asked.denied:
            return None
    return None


def write_heard(services: Microservices, name: str, value: int | float) -> Steps[bool]:
    """Set a parameter that was read, under whichever id is heard; whether it was read back."""
    station, first = services.control.in_force.station_id, services.control.in_force.sender.as_vehicle
    for as_vehicle in dict.fromkeys((first, *_voices(services))):
        services.control.grant(station, "restoration", as_vehicle=as_vehicle)
        setting = services.parameters.set(name, value, services.control.in_force)
        yield from wait_until(services.timeline, lambda s=setting: s.finished, ANSWER_S)  # type: ignore[misc]
        if setting.confirmed:
            return True
    return False


def _list_back(
    services: Microservices, kind: int, before: tuple[MissionItem, ...], made: tuple[MissionItem, ...], done: Restored
) -> Steps[bool]:
    """One list; whether it needs no more care."""
    name, traits = TYPE_NAMES[kind], services.vehicle.profile.mission
    held = yield from _held(services, kind)
    if held is None:
        done.failed.append(name)
        return False
    if not difference(before, held, traits, kind):
        done.as_before.append(name)
        return True
    # A list half written holds items of both; anything else is somebody's own.
    ours = [any(not difference([one], [item], traits, kind) for one in (*made, *before)) for item in held]
    if not all(ours):
        done.foreign.append(name)
        services.timeline.alarm("somebody else changed it since, so it stays", name=name, count=len(held))
        return True
    transfer = yield from (
        _run(services, MissionUpload(before, traits=traits, **_ends(services, kind)))
        if before
        else _run(services, MissionClear(traits=traits, **_ends(services, kind)))
    )
    if transfer.failure is not None:
        done.failed.append(name)
        services.timeline.alarm(f"{name} not put back", count=len(before), reason=transfer.failure.message)
        return False
    done.given_back.append(name)
    return True


def _held(services: Microservices, kind: int) -> Steps[tuple[MissionItem, ...] | None]:
    station = services.control.in_force.station_id
    for as_vehicle in _voices(services):
        services.control.grant(station, "restoration", as_vehicle=as_vehicle)
        transfer = yield from _run(services, MissionDownload(**_ends(services, kind)))
        if transfer.failure is None:
            assert isinstance(transfer, MissionDownload)
            try:
                return tuple(transfer.items)
            except MissionItemError:
                return None
    return None


def _ends(services: Microservices, kind: int) -> dict[str, object]:
    return {"target": (services.vehicle.system_id, 1), "station": (services.control.own_id, 190), "mission_type": kind}


def _run(services: Microservices, transfer: MissionTransfer) -> Steps[MissionTransfer]:
    services.missions.start(services.timeline.now_s, services.control.in_force, transfer)
    while transfer.running:
        yield
    return transfer
