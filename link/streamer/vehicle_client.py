"""A vehicle asked, and given back what flights left changed on it, over one link and outside any flight.

No heartbeat is sent: a ground station's heartbeat would tell the vehicle's failsafe that somebody flies it. TIMESYNC,
which commands nothing, says where to answer. Nothing is written but by `restore`.
"""

from __future__ import annotations

import contextlib
import select
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from gcs.geodesy import Plane
from link.autopilot.registry import PROFILES
from link.clock import UtcScale
from link.dialect import mavlink
from link.errors import VehicleError
from link.handover.gcs_ids import ENFORCE
from link.handover.restoration import Microservices, is_option, read_heard, restore_changes, write_heard
from link.microservices.command import Commander
from link.microservices.mission_client import MissionClient
from link.microservices.parameter import ParameterClient
from link.microservices.parameter_value import encoding_of
from link.preflight.identity import Identity
from link.session.changes import ChangeJournal, VehicleChanges, unique_id
from link.session.control import Control
from link.session.procedure import Steps, T, answered, wait_until
from link.session.timeline import Timeline
from link.session.vehicle import Vehicle
from link.telemetry.setpoint_echo import EchoTracker
from link.telemetry.vehicle_monitor import VehicleMonitor
from link.transport.gate import TransmitterGate
from link.transport.opening import open_endpoint
from link.transport.port_lock import LinkLocks
from link.transport.url import parse_url
from link.wire.codec import StationCodec
from link.wire.signing import Signing, SigningKey
from link.wire.signing_timestamps import SigningStore

OWN_ID = 254
"""No station of a plan; an ArduPilot that is deaf to it is asked under the vehicle's own id."""
STEP_S = 0.02
PROBE_S = 0.5
LIMIT_S = 300.0
_LINK = "link"


class VehicleClient:
    """A vehicle heard over one link. Made by `open_vehicle_client`."""

    def __init__(self, url: str, codec: StationCodec, endpoint: Any) -> None:
        self.url = url
        self._endpoint, self._codec = endpoint, codec
        self._decoder = StationCodec(OWN_ID, signing=codec.signing, stream=parse_url(url).is_stream)
        self._probe_s = 0.0
        self.signed: bool | None = None
        """Whether its heartbeats are signed; None before one was heard."""
        self.services: Microservices

    # -- hearing ------------------------------------------------------------------------------------------------------

    def find(self, system_id: int | None, timeout_s: float) -> None:
        """Wait for an autopilot's heartbeat. Raises `VehicleError` where none comes, saying what did."""
        heard: set[int] = set()
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline:
            self._probe()
            for message in self._take():
                known = [p for p in PROFILES.values() if _is_autopilot(message, p.autopilot_id)]
                if not known:
                    continue
                heard.add(message.get_srcSystem())
                if system_id in (None, message.get_srcSystem()):
                    self._begin(known[0].name, message.get_srcSystem())
                    self.services.vehicle.monitor.receive(self.services.timeline.now_s, _LINK, message, self.url)
                    return
        refused = ", ".join(f"{count} {why}" for why, count in self._decoder.stats.refused.items())
        if refused:
            raise VehicleError(f"{self.url}: frames came, and none could be believed ({refused}): is the key right?")
        if heard:
            raise VehicleError(f"{self.url}: no system {system_id}; heard were {', '.join(map(str, sorted(heard)))}")
        raise VehicleError(f"{self.url}: no autopilot was heard in {timeout_s:g} s; is it powered, the link right?")

    def _begin(self, autopilot: str, system_id: int) -> None:
        profile, ids = PROFILES[autopilot], {_LINK: OWN_ID}
        timeline = Timeline(UtcScale(time.time()), time.monotonic())
        monitor = VehicleMonitor((_LINK,), system_id, frozenset((OWN_ID, system_id)), {_LINK: (self.url,)})
        vehicle = Vehicle(profile, monitor, Plane(0.0, 0.0, 0.0))
        as_vehicle = StationCodec(system_id, 190, signing=self._codec.signing)
        gate = TransmitterGate({_LINK: self._codec.encode}, {_LINK: as_vehicle.encode})
        echoes = EchoTracker(runs_on=profile.target_runs_on)
        control = Control(timeline, vehicle, gate, Commander(gate.send, ids), echoes, ids)
        control.grant(_LINK, "asked")
        parameters = ParameterClient(gate.send, system_id, profile.parameter_encoding)
        self.services = Microservices(timeline, vehicle, control, parameters, MissionClient(gate.send))

    def _probe(self) -> None:
        if time.monotonic() >= self._probe_s:
            self._probe_s = time.monotonic() + PROBE_S
            self._endpoint.send(self._codec.encode(mavlink.MAVLink_timesync_message(0, 1)))

    def _take(self) -> Iterator[Any]:
        descriptor = self._endpoint.fileno()
        with contextlib.suppress(OSError, ValueError):
            select.select([descriptor] if descriptor >= 0 else [], [], [], STEP_S)
        for data in self._endpoint.receive():
            for message in self._decoder.decode(data):
                if message.get_type() == "HEARTBEAT" and message.type != mavlink.MAV_TYPE_GCS:
                    frame = bytes(message.get_msgbuf())
                    self.signed = frame[:1] == b"\xfd" and bool(frame[2] & mavlink.MAVLINK_IFLAG_SIGNED)
                yield message

    # -- doing --------------------------------------------------------------------------------------------------------

    def run(self, steps: Steps[T]) -> T:
        """A procedure, on the wall clock. Raises `VehicleError` when it takes too long."""
        services, deadline = self.services, time.monotonic() + LIMIT_S
        while time.monotonic() < deadline:
            services.timeline.now_s = time.monotonic()
            self._probe()
            for message in self._take():
                if services.vehicle.monitor.receive(time.monotonic(), _LINK, message, self.url):
                    self._pass_on(message)
            try:
                next(steps)
            except StopIteration as end:
                result: T = end.value
                return result
            for part in (services.control.commander, services.parameters, services.missions):
                part.step(services.timeline.now_s)
            for _, frame in services.control.gate.take_outgoing():
                self._endpoint.send(frame)
        raise VehicleError(f"{self.url}: the vehicle did not answer to the end in {LIMIT_S:g} s; try again")

    def _pass_on(self, message: Any) -> None:
        services, kind = self.services, message.get_type()
        if kind == "COMMAND_ACK":
            services.control.commander.on_ack(services.timeline.now_s, message)
        elif kind == "PARAM_VALUE":
            services.parameters.on_value(message)
        elif kind == "PARAM_ERROR":
            services.parameters.on_error(message)
        elif kind.startswith("MISSION_"):
            services.missions.on_message(services.timeline.now_s, message)

    def identify(self, journal: ChangeJournal) -> dict[str, Any]:
        """Who it is, what it does, whom it hears, how it signs, and what flights left changed on it, as JSON."""
        return self.run(self._identify(journal))

    def restore(self, journal: ChangeJournal, *, unlock: bool = False, ids_while_armed: bool = False) -> dict[str, Any]:
        """Give back what the journal's notes of this vehicle say; what was done, as JSON.

        ``unlock``: where no note says what was there before, end the enforcement of station ids all the same.
        ``ids_while_armed``: give GCS ids back to an armed vehicle, and nothing else.

        Raises `VehicleError`: it is armed, or a flight that still runs has it.
        """
        return self.run(self._restore(journal, unlock=unlock, ids_while_armed=ids_while_armed))

    # -- procedures ---------------------------------------------------------------------------------------------------

    def _who(self) -> Steps[bool]:
        """Ask for AUTOPILOT_VERSION; whether it answers us under an id that is not its own."""
        services, answers = self.services, False
        for as_vehicle in (False, True) if services.vehicle.profile.filters_station_ids else (False,):
            services.control.grant(_LINK, "who is it", as_vehicle=as_vehicle)
            ticket = services.control.start_command("version", mavlink.MAV_CMD_REQUEST_MESSAGE, (148.0,), attempts=4)
            yield from answered(ticket)
            answers = answers or (ticket.result is not None and not as_vehicle)
            if ticket.result is not None:
                yield from wait_until(services.timeline, lambda: services.vehicle.monitor.version is not None, 2.0)
                break
        version = services.vehicle.monitor.version
        if version is not None:
            default = services.vehicle.profile.parameter_encoding
            services.parameters.encoding = encoding_of(int(version.capabilities), default)
        return answers

    def _ids(self) -> Steps[dict[str, int]]:
        """The GCS id parameters it has, by name."""
        found: dict[str, int] = {}
        if not self.services.vehicle.profile.filters_station_ids:
            return found
        for names in (("MAV_GCS_SYSID", "SYSID_MYGCS"), ("MAV_GCS_SYSID_HI",), ("MAV_OPTIONS", "SYSID_ENFORCE")):
            for name in names:
                value = yield from read_heard(self.services, name)
                if value is not None:
                    found[name] = int(value)
                    break
        return found

    def _identify(self, journal: ChangeJournal) -> Steps[dict[str, Any]]:
        answers = yield from self._who()
        ids = yield from self._ids()
        vehicle = self.services.vehicle
        version = vehicle.monitor.version
        identity = None if version is None else Identity.from_message(version)
        enforced = any(is_option(name) and value & ENFORCE for name, value in ids.items())
        return {
            "url": self.url,
            "system_id": vehicle.system_id,
            "autopilot": vehicle.profile.name,
            "version": None if identity is None else identity.text,
            "uid": unique_id(version),
            "armed": vehicle.armed,
            "mode": vehicle.mode,
            "signed": self.signed,
            "answers": answers,
            "gcs_ids": ids,
            "locked": enforced,
            "left_by": [_told(note, journal) for note in self._notes(journal)],
        }

    def _notes(self, journal: ChangeJournal) -> list[VehicleChanges]:
        vehicle = self.services.vehicle
        uid = unique_id(vehicle.monitor.version)
        return [one for one in journal.pending() if one.is_of(vehicle.system_id, uid)]

    def _restore(self, journal: ChangeJournal, *, unlock: bool, ids_while_armed: bool) -> Steps[dict[str, Any]]:
        yield from self._who()
        services, notes = self.services, self._notes(journal)
        for note in notes:
            if journal.in_use(note) and self.url in note.urls:
                raise VehicleError(f"flight {note.flight_id} (process {note.pid}) has this vehicle: end that first")
        armed = services.vehicle.armed
        if armed and not ids_while_armed:
            raise VehicleError(
                f"the vehicle is armed, in {services.vehicle.mode}: land and disarm it; its GCS ids alone can be given "
                "back now (--ids-while-armed)"
            )
        parts = {"given_back": [], "as_before": [], "foreign": [], "failed": []}  # type: dict[str, list[str]]
        for note in notes:
            if journal.in_use(note):
                continue
            sure = self.url in note.urls
            done = yield from restore_changes(services, journal, note, sure=sure, ids_alone=armed)
            for name, found in parts.items():
                found += getattr(done, name)
        ids = yield from self._ids()
        if unlock:
            for name, value in ids.items():
                if is_option(name) and value & ENFORCE:
                    taken = yield from write_heard(services, name, value & ~ENFORCE)
                    parts["given_back" if taken else "failed"].append(name)
                    ids[name] = value & ~ENFORCE if taken else value
        locked = any(is_option(name) and value & ENFORCE for name, value in ids.items())
        return {
            "url": self.url,
            "system_id": services.vehicle.system_id,
            "notes": len(notes),
            **parts,
            "locked": locked,
        }


@contextlib.contextmanager
def open_vehicle_client(
    url: str,
    *,
    system_id: int | None = None,
    signing_key: str | None = None,
    signing_state: str | None = None,
    timeout_s: float = 15.0,
) -> Iterator[VehicleClient]:
    """A vehicle behind a link URL, which no flight of this machine may use meanwhile; let go of with the block.

    ``signing_key``: ``file:PATH`` or ``env:NAME``; ``signing_state``: the folder its stamps are kept in.

    Raises `EndpointError`, `SigningError`, and `VehicleError` where no vehicle answers.
    """
    locks = LinkLocks([url])
    with contextlib.ExitStack() as stack:
        stack.callback(locks.release)
        endpoint = stack.enter_context(open_endpoint(url))
        signing = None
        if signing_key is not None:
            kind, name = signing_key.split(":", 1)
            key = SigningKey.from_file(name) if kind == "file" else SigningKey.from_environment(name)
            folder = signing_state or stack.enter_context(tempfile.TemporaryDirectory(prefix="skyrelay-stamps-"))
            store = SigningStore.open(Path(folder) / f"station-{OWN_ID}.stamps")
            stack.callback(store.close)
            signing = Signing(key, OWN_ID, store, allow_unsigned=(109,))
        client = VehicleClient(url, StationCodec(OWN_ID, signing=signing), endpoint)
        client.find(system_id, timeout_s)
        yield client


def _is_autopilot(message: Any, autopilot_id: int) -> bool:
    return bool(
        message.get_type() == "HEARTBEAT"
        and message.get_srcComponent() == 1
        and message.type != mavlink.MAV_TYPE_GCS
        and message.autopilot == autopilot_id
    )


def _told(note: VehicleChanges, journal: ChangeJournal) -> dict[str, Any]:
    return {"flight": note.flight_id, "utc": note.utc, "changed": note.texts, "flies": journal.in_use(note)}
