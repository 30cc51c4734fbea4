"""The flight director's core: bytes in, bytes out, one clock passed in; no socket, no file, no thread.

`FlightCore` owns a flight's stations (a codec each), the transmitter gate, the heartbeats and probes, the commands, the
handovers and the director that takes the flight from open links to a disarmed vehicle. The streamer process feeds it
real time and sockets, a test virtual time and a simulator.

Everything happens on one grid of ticks, ``rate_hz`` of them a second. A tick that is missed is skipped, never caught
up: no setpoint is sent later than one tick after its time. When something in here fails, nothing is sent any more,
heartbeats included: silence is what the autopilot's failsafe understands.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from gcs.flight import EventKind, FlightEvent, FlightState, TransitionError, Word, check_word
from link.autopilot.registry import PROFILES
from link.clock import Lateness, TickGrid, UtcScale
from link.dialect import mavlink
from link.director.airborne import Airborne
from link.director.launch import Launch
from link.director.plan_exchange import NextPlan, make_ready
from link.director.progress import Announcer
from link.microservices.command import Commander
from link.microservices.mission_client import MissionDesk
from link.microservices.parameter import ParameterClient
from link.session.context import FlightContext, plain
from link.session.procedure import Refused, Steps
from link.session.request import FlightRequest
from link.setpoints.local_projection import LocalMap
from link.telemetry.link_path import FAILOVER_S, IDLE_FAILOVER_S, Carrier
from link.telemetry.setpoint_echo import EchoTracker
from link.telemetry.vehicle_monitor import VehicleMonitor
from link.transport.gate import TransmitterGate
from link.transport.url import STREAM_SCHEMES, parse_url
from link.wire.codec import StationCodec

__all__ = ["FlightCore", "FlightRequest"]

HEARTBEAT_S = 0.5
"""Twice as often as is usual: ArduPilot returns after 5 s without one, which at 10 % loss would come once in 30 hours
with one a second (of 5 in a row each lost), and at 30 % once in 10 minutes."""
PROBE_S = 1.0
GROUND_PROBE_S = 0.25
FAST_PROBE_S = 0.1
"""Every link is probed once a second; that of the station in control, and of the next one when near, this often."""

ECHO_MEMORY_S = 5.0

OnFrame = Callable[[float, bytes], None]


class FlightCore:
    """One flight.

    ``codecs`` gives each station its codec (default: unsigned, the plan's system ids). ``now_s`` is the flight's clock
    at the start, ``epoch_unix_s`` what it is in UTC at 0. ``on_frame(now_s, frame)`` is told every frame sent and every
    message heard, in order. A core is used by one thread.
    """

    def __init__(
        self,
        request: FlightRequest,
        *,
        codecs: Mapping[str, StationCodec] | None = None,
        now_s: float = 0.0,
        epoch_unix_s: float = 0.0,
        on_frame: OnFrame | None = None,
    ) -> None:
        plan = request.flown_plan
        profile = PROFILES[request.autopilot]
        self.stations = request.stations
        system_ids = {
            s: int(plan.mission.stations[plan.mission.station_index(s)].system_id or 0) for s in self.stations
        }
        self.codecs = dict(codecs) if codecs is not None else {s: StationCodec(i) for s, i in system_ids.items()}
        vehicle = plan.mission.options.vehicle_system_id
        gate = TransmitterGate(
            {station: codec.encode for station, codec in self.codecs.items()},
            {s: StationCodec(vehicle, 190, signing=codec.signing).encode for s, codec in self.codecs.items()},
        )
        # Stations that share a link hear the same bytes; each link has a decoder of its own.
        urls = request.urls
        self._sharing = {
            url: tuple(t for t in self.stations if url in urls[t]) for s in self.stations for url in urls[s]
        }
        self._decoders = {}
        for url, sharing in self._sharing.items():
            codec = self.codecs[sharing[0]]
            stream = parse_url(url).scheme in STREAM_SCHEMES
            self._decoders[url] = StationCodec(codec.system_id, signing=codec.signing, stream=stream)
        monitor = VehicleMonitor(self.stations, vehicle, frozenset(system_ids.values()) | {vehicle}, urls)
        self.context = FlightContext(
            request=request,
            plan=plan,
            profile=profile,
            gate=gate,
            monitor=monitor,
            commander=Commander(gate.send, system_ids),
            echoes=EchoTracker(runs_on=profile.name == "ardupilot", memory=math.ceil(ECHO_MEMORY_S * request.rate_hz)),
            utc=UtcScale(epoch_unix_s),
            system_ids=system_ids,
            local=LocalMap(plan.plane),
            now_s=now_s,
        )
        self.parameters = ParameterClient(gate.send, vehicle, profile.parameter_encoding)
        self.missions = MissionDesk(gate.send)
        self.launch = Launch(self.context, self.parameters, self.missions)
        self.airborne = Airborne(self.context, self.launch)
        self.announcer = Announcer(self.context, self.airborne)
        self.lateness = Lateness()
        self.finished = False
        self._on_frame = on_frame
        self._grid = TickGrid(request.rate_hz, now_s)
        self._procedure: Steps[None] | None = self.launch.run()
        self._restoring: Steps[None] | None = None
        self._streams: Steps[None] | None = None
        self._streamed: tuple[int, Carrier] | None = None
        self._beat: dict[str, float] = {}
        self._probed: dict[str, float] = {}
        self._near: set[str | None] = set()

    @property
    def state(self) -> FlightState:
        """Where the flight stands."""
        return self.context.state

    def start(self, now_s: float) -> None:
        """Lay the grid of ticks from now on (where setting up took time that must not count as late)."""
        self.context.now_s = now_s
        self._grid = TickGrid(self.context.request.rate_hz, now_s)

    # -- bytes --------------------------------------------------------------------------------------------------------

    def receive(self, station_id: str, data: bytes, now_s: float, url: str | None = None) -> None:
        """Take what came in over a station's link, or the one of its links named. Never raises for what is in it."""
        c = self.context
        c.now_s = max(c.now_s, now_s)
        url = url or c.monitor.links[station_id].carriers[0].url
        for message in self._decoders[url].decode(data):
            if self._on_frame is not None:
                self._on_frame(c.now_s, bytes(message.get_msgbuf()))
            heard = [c.monitor.receive(c.now_s, station, message, url) for station in self._sharing[url]]
            if not any(heard):
                continue
            kind = message.get_type()
            if kind == "COMMAND_ACK":
                c.commander.on_ack(c.now_s, message)
            elif kind == "PARAM_VALUE":
                parameter = self.parameters.on_value(message)
                if c.keeper is not None and parameter is not None:
                    c.keeper.on_value(parameter.name, parameter.value)
            elif kind == "PARAM_ERROR":
                self.parameters.on_error(message)
            elif kind.startswith("MISSION_"):
                self.missions.on_message(c.now_s, message)

    def step(self, now_s: float) -> float:
        """Serve the tick that is due, if one is; the next deadline."""
        tick = self._grid.due(now_s)
        if tick is None:
            return self._grid.deadline_s
        c = self.context
        c.now_s = max(c.now_s, now_s)
        self.lateness.add(tick.lateness_s / c.request.speedup, tick.skipped)
        if not self.finished:
            self._choose_links()
            self._direct((1 + tick.skipped) / c.request.rate_hz)
            c.commander.step(c.now_s)
            self.parameters.step(c.now_s)
            self.missions.step(c.now_s)
            if c.keeper is not None and c.state.airborne:
                c.keeper.step(c.now_s)
            self._heartbeats()
            self._probes()
        return self._grid.deadline_s

    def tell(self) -> None:
        """What can wait until the tick's frames are out: texts, progress, the schedule. After every `step`."""
        c = self.context
        for severity, text in c.monitor.take_texts():
            c.emit(EventKind.TEXT, severity=severity, text=text)
        if not self.finished:
            self.announcer.update()

    def routes(self, station_id: str, frame: bytes) -> tuple[str, ...]:
        """The URLs a frame of a station goes out over: a probe over all its links, all else over the one that sends."""
        link = self.context.monitor.links[station_id]
        if int.from_bytes(frame[7:10], "little") == mavlink.MAVLINK_MSG_ID_TIMESYNC:
            return tuple(carrier.url for carrier in link.carriers)
        return (link.active.url,)

    def take_outgoing(self) -> list[tuple[str, bytes]]:
        """Frames to send now, in order, each with its station."""
        outgoing = [(sender.station_id, frame) for sender, frame in self.context.gate.take_outgoing()]
        if self._on_frame is not None:
            for _, frame in outgoing:
                self._on_frame(self.context.now_s, frame)
        return outgoing

    def take_events(self) -> list[FlightEvent]:
        """Events since the last call."""
        events, self.context.events = self.context.events, []
        return events

    # -- the director -------------------------------------------------------------------------------------------------

    def _direct(self, dt_s: float) -> None:
        c = self.context
        if self._procedure is not None:
            self._advance_launch()
        elif c.state.ended:
            self._finish()
        else:
            self.airborne.tick(dt_s)
            self._ask_for_telemetry()

    def _advance_launch(self) -> None:
        assert self._procedure is not None
        try:
            next(self._procedure)
        except StopIteration:
            self._procedure = None
            self.airborne.begin()
        except Refused as refusal:
            self._procedure = None
            self._refuse(str(refusal))

    def _refuse(self, reason: str) -> None:
        c = self.context
        c.become(FlightState.CONTINGENCY if c.state is FlightState.TAKEOFF else FlightState.REFUSED, reason)

    def _finish(self) -> None:
        """Give back what was taken from the vehicle, then say how it ended."""
        c = self.context
        if self._restoring is None:
            c.gate.accompany(None)
            if c.state is FlightState.LOST or c.armed:
                self.launch.loan.forget()
            self._restoring = self.launch.restore()
        try:
            next(self._restoring)
        except StopIteration:
            self.finished = True
            c.emit(EventKind.RESULT, **self.summary())

    def summary(self) -> dict[str, Any]:
        """How the flight went, in figures."""
        c, air = self.context, self.airborne
        return {
            "outcome": c.state.value,
            "exit_code": c.state.exit_code if c.state.ended else None,
            "plan_sha256": c.plan.plan_sha256,
            "flown_s": None if c.launched_s is None else round(c.now_s - c.launched_s, 3),
            "setpoints": c.setpoints_sent,
            "handovers": air.relay.leg,
            "tracking_rms_m": round(air.lag.rms_m, 3),
            "tracking_worst_m": round(air.lag.worst_m, 3),
            "lateness": self.lateness.to_document(),
            "links": {link.station_id: link.to_document(c.now_s) for link in c.monitor.links.values()},
        }

    def _ask_for_telemetry(self) -> None:
        """The station in control asks for what the flight is watched by, on every link that has come to send."""
        relay = self.airborne.relay
        sends = self.context.monitor.links[self.context.plan.station_ids[relay.leg]].active
        if (relay.leg, sends) != self._streamed and not relay.moving:
            if self._streamed is not None:
                self._streams = self.launch.request_streams()
            self._streamed = (relay.leg, sends)
        if self._streams is not None and not relay.moving:
            try:
                next(self._streams)
            except StopIteration:
                self._streams = None

    # -- heartbeats and probes ----------------------------------------------------------------------------------------

    @property
    def _own_voice(self) -> str | None:
        """The station in control where it speaks under its own id; None while nobody does."""
        grant = self.context.gate.in_force
        return None if grant is None or grant.sender.as_vehicle else grant.station_id

    def _heartbeats(self) -> None:
        c = self.context
        for station in (self._own_voice, c.gate.incoming):
            if station is None:
                continue
            if c.now_s - self._beat.get(station, -math.inf) >= HEARTBEAT_S - 1e-6:
                self._beat[station] = c.now_s
                c.gate.heartbeat(station, _heartbeat())

    def _choose_links(self) -> None:
        """Let another of a station's links send where it is proved and the present one is not."""
        c = self.context
        for link in c.monitor.links.values():
            if len(link.carriers) == 1:
                continue
            near = link.station_id in self._near or not c.state.airborne
            before = link.choose(FAILOVER_S if near else IDLE_FAILOVER_S)
            if before and near:
                c.emit(EventKind.LINK, station=link.station_id, url=link.active.url, before=before)

    def _probes(self) -> None:
        c = self.context
        near = self._near = {self._own_voice}
        every_s = PROBE_S
        if not c.state.airborne:
            # On the ground every link is to be judged within seconds, losses or not.
            every_s = GROUND_PROBE_S
        if c.state.airborne and not self.airborne.line:
            relay, time_s = self.airborne.relay, self.airborne.reference.time_s
            for border in (relay.ahead(backwards=False), relay.ahead(backwards=True)):
                if border is not None and border.near(time_s):
                    near.add(border.to_station)
        for station in self.stations:
            due_s = FAST_PROBE_S if station in near else every_s
            if c.now_s - self._probed.get(station, -math.inf) >= due_s - 1e-6:
                self._probed[station] = c.now_s
                # A station the vehicle does not hear proves its link with the id that is always heard.
                deaf = c.keeper is not None and station != self._own_voice and not c.keeper.hears(station)
                c.gate.probe(station, c.monitor.probe(c.now_s, station), as_vehicle=deaf)

    # -- words --------------------------------------------------------------------------------------------------------

    def command(
        self,
        word: Word | str,
        *,
        by: str = "",
        handover: int | None = None,
        until_s: float | None = None,
        reason: str = "",
        plan_sha256: str | None = None,
        upcoming: NextPlan | None = None,
        join_s: float | None = None,
        leave_s: float | None = None,
    ) -> None:
        """A person's word.

        ``handover`` is the index that `Word.READY`, `Word.ACCEPT` and `Word.REFUSE` are about; ``until_s`` the time of
        the plan for `Word.AUTHORISE`. ``plan_sha256``, where given, must be that of the plan being flown. ``upcoming``
        (from `make_ready`), ``join_s`` and ``leave_s`` are for `Word.REPLAN`: see
        `link.director.airborne.Airborne.adopt`.

        Raises `gcs.flight.TransitionError` (also for an unknown word) and changes nothing then.
        """
        c = self.context
        try:
            word = Word(word)
        except ValueError:
            raise TransitionError(f"unknown word {word!r}; allowed is {', '.join(sorted(Word))}") from None
        if plan_sha256 is not None and plan_sha256 != c.plan.plan_sha256:
            raise TransitionError(f"'{word}' is for another plan ({plan_sha256[:12]}...) than the one being flown")
        check_word(word, c.state)
        if word in (Word.READY, Word.ACCEPT, Word.REFUSE) and handover is None:
            raise TransitionError(f"'{word}' needs the index of a handover")
        if word is Word.AUTHORISE and (until_s is None or not until_s >= 0.0):
            raise TransitionError("'authorise' needs until_s, a time of the plan, 0 or more")
        if word is Word.REPLAN:
            if upcoming is None:
                raise TransitionError("'replan' needs a plan made ready for this flight")
            self.airborne.adopt(upcoming, join_s, leave_s)
        else:
            self._obey(word, handover or 0, until_s or 0.0, reason or by or "word")
        c.emit(EventKind.WORD, word=word.value, by=by, handover=handover, until_s=until_s, reason=reason)

    def make_ready(self, document: Mapping[str, Any]) -> NextPlan:
        """A plan document judged and prepared for `Word.REPLAN`; slow, and safe in a thread beside the flight.

        Raises `TransitionError` with the reasons why this flight cannot fly it.
        """
        return make_ready(document, self.context, self.launch.values)

    def _obey(self, word: Word, handover: int, until_s: float, reason: str) -> None:
        air = self.airborne
        if word is Word.LAUNCH:
            self.launch.launch_word = True
        elif word is Word.HOLD:
            air.hold()
        elif word is Word.RESUME:
            air.resume()
        elif word is Word.ABORT:
            self._abort(reason)
        elif word is Word.LAND:
            self._land()
        elif word is Word.AUTHORISE:
            air.authorise(until_s)
        elif word is Word.REFUSE:
            air.relay.refuse(handover, reason)
        else:
            air.relay.accept(handover)

    def _abort(self, reason: str) -> None:
        c = self.context
        if self._procedure is None:
            self.airborne.contingency(f"abort: {reason}")
        elif c.state is FlightState.TAKEOFF:
            self._land()
        else:
            # On the ground: motors off, parameters back, done.
            self._procedure = self._stop_on_ground(f"aborted: {reason}")

    def _land(self) -> None:
        if self._procedure is not None:
            self._procedure = None
            self.airborne.uplink.restart()
        self.airborne.land()

    def _stop_on_ground(self, reason: str) -> Steps[None]:
        c = self.context
        if c.gate.in_force is not None and c.armed:
            ticket = c.start_command("disarm", mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (0.0,))
            while not ticket.finished:
                yield
        yield from self.launch.restore()
        raise Refused(reason)

    # -- for people ---------------------------------------------------------------------------------------------------

    def parent_gone(self) -> None:
        """Nobody can speak to the flight any more: it goes on as far as authorised, and a hold ends by itself."""
        self.airborne.attended = False
        self.context.alarm("nobody attends the flight")

    def parent_back(self) -> None:
        """Somebody can speak again."""
        self.airborne.attended = True

    def status(self) -> dict[str, Any]:
        """The flight now, as JSON."""
        c, judged_s = self.context, self.launch.preflight_s
        document = {
            "flight_id": c.request.flight_id,
            "state": c.state.value,
            "time_s": round(c.now_s, 3),
            "utc": c.utc.text(c.now_s),
            "t_plus_s": None if c.launched_s is None else round(c.now_s - c.launched_s, 3),
            "plan_sha256": c.plan.plan_sha256,
            "preflight_id": self.launch.preflight_id,
            "preflight_age_s": None if math.isinf(judged_s) else round(c.now_s - judged_s, 1),
            "fence": None if c.gate.in_force is None else c.gate.in_force.number,
            "loss_timeout_s": self.launch.loss_timeout_s,
            **self.announcer.where(),
            "lateness": self.lateness.to_document(),
        }
        clean: dict[str, Any] = plain(document)
        return clean


def _heartbeat() -> Any:
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE, 3
    )
