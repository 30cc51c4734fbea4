"""The flight director's core: bytes in, bytes out, one clock passed in; no socket, no file, no thread.

`FlightCore` owns a flight's stations (a codec each), the transmitter gate, the heartbeats and probes, the commands, the
handovers and the director that takes the flight from open links to a disarmed vehicle. The streamer process feeds it
real time and sockets, a test virtual time and a simulator.

Everything happens on one grid of ticks, ``rate_hz`` of them a second. A tick that is missed is skipped, never caught
up: no setpoint is sent later than one tick after its time. When something in here fails, the tick holds and an alarm
says so (`link.session.containment`); three ticks in a row and nothing is sent any more, heartbeats included: silence is
what the autopilot's failsafe understands.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from gcs.flight import EventKind, FlightEvent, FlightState, OperatorCommand, TransitionError
from gcs.operator_commands import Effect, check_operator_command
from link.clock import TickGrid, TickLateness
from link.dialect import mavlink
from link.director.airborne import Airborne
from link.director.launch import Launch
from link.director.link_upkeep import LinkUpkeep
from link.director.operation.ground_stop import stop_on_ground
from link.director.operation.summary import summary
from link.director.plan_exchange import NextPlan, make_ready
from link.director.progress import Announcer
from link.microservices.mission_client import MissionClient
from link.microservices.parameter import ParameterClient
from link.monitors.evidence import EvidenceWatch
from link.monitors.motion import STREAMED
from link.monitors.one_vehicle import Claim, OneVehicle
from link.monitors.telemetry_upkeep import TelemetryUpkeep
from link.session.changes import ChangeJournal
from link.session.containment import Containment
from link.session.context import FlightContext
from link.session.decoders import decoders_of, sharing_of
from link.session.procedure import Refused, Steps
from link.session.request import FlightRequest
from link.session.timeline import plain
from link.telemetry.link_path import LinkPath
from link.wire.codec import StationCodec

OnFrame = Callable[[float, bytes, str], None]


class FlightCore:
    """One flight.

    ``codecs`` gives each station its codec (default: unsigned, the plan's system ids). ``now_s`` is the flight's clock
    at the start, ``epoch_unix_s`` what it is in UTC at 0. ``on_frame(now_s, frame, url)`` is told every frame sent and
    every message heard, in order, and its link; ``journal`` keeps what is changed on the vehicle, ``claim`` holds it
    against other programs. A core is used by one thread.
    """

    def __init__(
        self,
        request: FlightRequest,
        *,
        codecs: Mapping[str, StationCodec] | None = None,
        now_s: float = 0.0,
        epoch_unix_s: float = 0.0,
        on_frame: OnFrame | None = None,
        journal: ChangeJournal | None = None,
        claim: Claim | None = None,
    ) -> None:
        own = {station: StationCodec(system_id) for station, system_id in request.system_ids.items()}
        self.codecs = own if codecs is None else dict(codecs)
        self.context = flight = FlightContext.begin(request, self.codecs, now_s=now_s, epoch_unix_s=epoch_unix_s)
        self._timeline, self._vehicle, self._control = flight.timeline, flight.vehicle, flight.control
        self._sharing = sharing_of(request)
        self._decoders = decoders_of(self._sharing, self.codecs)
        send, encoding = flight.control.gate.send, flight.vehicle.profile.parameter_encoding
        self.parameters = ParameterClient(send, flight.vehicle.system_id, encoding)
        self.missions = MissionClient(send)
        self.one_vehicle = OneVehicle(flight, self.parameters, claim)
        self.launch = Launch(flight, self.parameters, self.missions, self.one_vehicle, journal)
        self.airborne = Airborne(flight)
        self.links, self.announcer = LinkUpkeep(flight, self.airborne), Announcer(flight, self.airborne)
        self.evidence, self.upkeep = EvidenceWatch(flight), TelemetryUpkeep(flight, self.airborne.lag)
        self.containment = Containment(flight.timeline)
        self.lateness = TickLateness()
        self.finished, self._on_frame = False, on_frame
        self._grid = TickGrid(request.rate_hz, now_s)
        self._procedure: Steps[None] | None = self.launch.run()
        self._stopping = False
        """Whether the flight is being ended on the ground."""
        self._restoring: Steps[None] | None = None
        self._streams: Steps[None] | None = None
        self._streamed: tuple[int, LinkPath] | None = None

    @property
    def state(self) -> FlightState:
        """Where the flight stands."""
        return self._timeline.state

    def start(self, now_s: float) -> None:
        """Lay the grid of ticks from now on (where setting up took time that must not count as late)."""
        self._timeline.now_s = now_s
        self._grid = TickGrid(self.context.request.rate_hz, now_s)

    # -- bytes --------------------------------------------------------------------------------------------------------

    def receive(self, station_id: str, data: bytes, now_s: float, url: str | None = None) -> None:
        """Take what came in over a station's link, or the one of its links named. Never raises for what is in it."""
        timeline, monitor = self._timeline, self._vehicle.monitor
        timeline.now_s = self._vehicle.now_s = max(timeline.now_s, now_s)
        url = url or monitor.links[station_id].paths[0].url
        decoder = self._decoders[url]
        for message in decoder.decode(data):
            if self._on_frame is not None:
                self._on_frame(timeline.now_s, bytes(message.get_msgbuf()), url)
            with self.containment.of(f"taking a {message.get_type()}"):
                self.one_vehicle.heard(message.get_srcSystem(), message.get_srcComponent(), message.get_msgbuf())
                heard = [monitor.receive(timeline.now_s, station, message, url) for station in self._sharing[url]]
                if any(heard):
                    self._pass_on(message)
        self.one_vehicle.reflected(decoder)

    def _pass_on(self, message: Any) -> None:
        """An answer of the vehicle, to whoever asked."""
        kind, now_s, manager = message.get_type(), self._timeline.now_s, self._control.id_manager
        if kind == "COMMAND_ACK":
            self.one_vehicle.on_ack(message)
            self._control.commander.on_ack(now_s, message)
        elif kind == "PARAM_VALUE":
            parameter = self.parameters.on_value(message)
            if manager is not None and parameter is not None:
                manager.on_value(parameter.name, parameter.value)
        elif kind == "PARAM_ERROR":
            self.parameters.on_error(message)
        elif kind.startswith("MISSION_"):
            self.missions.on_message(now_s, message)

    def step(self, now_s: float) -> float:
        """Serve the tick that is due, if one is; the next deadline."""
        tick = self._grid.due(now_s)
        if tick is None:
            return self._grid.deadline_s
        request = self.context.request
        self._timeline.now_s = self._vehicle.now_s = max(self._timeline.now_s, now_s)
        self.lateness.add(tick.lateness_s / request.speedup, tick.skipped)
        if not self.finished:
            with self.containment.tick():
                self._serve((1 + tick.skipped) / request.rate_hz)
            if self.containment.held:
                self._hold_tick()
        return self._grid.deadline_s

    def _serve(self, dt_s: float) -> None:
        """One tick's work."""
        timeline, control = self._timeline, self._control
        self.links.choose()
        self.evidence.update()
        self._direct(dt_s)
        control.commander.step(timeline.now_s)
        self.parameters.step(timeline.now_s)
        self.missions.step(timeline.now_s)
        if control.id_manager is not None and timeline.state.airborne:
            control.id_manager.step(timeline.now_s)
        self.links.heartbeats()
        self.links.probes()

    def _hold_tick(self) -> None:
        """A tick with a fault of ours: the reference stands, heartbeats go on."""
        with self.containment.of("holding the tick"):
            if self._timeline.state in STREAMED and self._control.last_setpoint_s < self._timeline.now_s:
                self.airborne.guidance.stay()
        with self.containment.of("heartbeats"):
            self.links.heartbeats()

    def tell(self) -> None:
        """What can wait until the tick's frames are out: texts, progress, the schedule. After every `step`."""
        for severity, text in self._vehicle.monitor.take_texts(self._timeline.now_s):
            self._timeline.emit(EventKind.TEXT, severity=severity, text=text)
        if not self.finished:
            with self.containment.of("telling"):
                self.one_vehicle.update()
                self.announcer.update()

    def routes(self, station_id: str, frame: bytes) -> tuple[str, ...]:
        """The URLs a frame of a station goes out over: a probe over all its links, all else over the one that sends."""
        link = self._vehicle.monitor.links[station_id]
        if int.from_bytes(frame[7:10], "little") == mavlink.MAVLINK_MSG_ID_TIMESYNC:
            return tuple(path.url for path in link.paths)
        return (link.active.url,)

    def take_outgoing(self) -> list[tuple[str, bytes]]:
        """Frames to send now, in order, each with its station."""
        outgoing = [(sender.station_id, frame) for sender, frame in self._control.gate.take_outgoing()]
        for station, frame in outgoing:
            self.one_vehicle.sent(frame)
            if self._on_frame is not None:
                self._on_frame(self._timeline.now_s, frame, self._vehicle.monitor.links[station].active.url)
        return outgoing

    def take_events(self) -> list[FlightEvent]:
        """Events since the last call."""
        return self._timeline.take_events()

    # -- the director -------------------------------------------------------------------------------------------------

    def _direct(self, dt_s: float) -> None:
        if self._procedure is not None:
            self._advance_launch()
        elif self._timeline.state.ended:
            self._finish()
        else:
            self.airborne.tick(dt_s)
            self._ask_for_telemetry()
        # Not after a lapse: somebody else may have the vehicle.
        watched = self._timeline.state in (*STREAMED, FlightState.READY, FlightState.TAKEOFF, FlightState.LANDING)
        if watched and self._streams is None and not self.airborne.chain.moving:
            self.upkeep.step()

    def _advance_launch(self) -> None:
        assert self._procedure is not None
        try:
            next(self._procedure)
        except StopIteration:
            self._procedure = None
            if self._timeline.state.ended:
                return
            if self.launch.stuck:
                self._land("take-off stuck", FlightState.CONTINGENCY)
            else:
                self.airborne.begin()
        except Refused as refusal:
            self._procedure = None
            self._refuse(str(refusal))
        except Exception as fault:
            # The procedure is over with it: on the ground that is the end, in the climb the vehicle lands.
            climbing = self._timeline.state is FlightState.TAKEOFF
            self._procedure = None if climbing else self._stop_on_ground(f"a fault of ours: {fault!r}")
            if climbing:
                self._land("a fault of ours", FlightState.CONTINGENCY)
            raise

    def _refuse(self, reason: str) -> None:
        climbing = self._timeline.state is FlightState.TAKEOFF
        self._timeline.become(FlightState.CONTINGENCY if climbing else FlightState.REFUSED, reason)

    def _finish(self) -> None:
        """Give back what was taken from the vehicle, say how it ended, and let nobody send any more."""
        gate = self._control.gate
        if self._restoring is None:
            gate.accompany(None)
            if self._timeline.state is FlightState.LOST or self._vehicle.armed:
                self.launch.borrowed.forget()
            self._restoring = self.launch.restore()
        try:
            next(self._restoring)
        except StopIteration:
            self.finished = True
            self._timeline.emit(EventKind.RESULT, **self.summary())
            gate.revoke()

    def summary(self) -> dict[str, Any]:
        """How the flight went, in figures."""
        return summary(self.context, self.airborne, self.lateness, late_s=self.announcer.late_s)

    def _ask_for_telemetry(self) -> None:
        """The station in control asks for what the flight is watched by, on every link that has come to send."""
        chain = self.airborne.chain
        sends = self._vehicle.monitor.links[self.context.plan.station_ids[chain.leg]].active
        if (chain.leg, sends) != self._streamed and not chain.moving:
            if self._streamed is not None:
                self._streams = self.launch.request_streams()
            self._streamed = (chain.leg, sends)
        if self._streams is not None and not chain.moving and next(self._streams, self) is self:
            self._streams = None

    # -- operator commands --------------------------------------------------------------------------------------------

    def command(
        self,
        command: OperatorCommand | str,
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
        """An operator's command.

        ``handover`` is the index that READY, ACCEPT and REFUSE are about; ``until_s`` the plan's time for AUTHORISE.
        ``plan_sha256``, where given, must be that of the plan being flown. ``upcoming`` (from `make_ready`), ``join_s``
        and ``leave_s`` are for REPLAN: see `link.director.airborne.Airborne.adopt`.

        Raises `gcs.flight.TransitionError` (also for an unknown command) and changes nothing then.
        """
        try:
            command = OperatorCommand(command)
        except ValueError:
            allowed = ", ".join(sorted(OperatorCommand))
            raise TransitionError(f"unknown word {command!r}; allowed is {allowed}") from None
        if plan_sha256 is not None and plan_sha256 != self.context.plan.plan_sha256:
            raise TransitionError(f"'{command}' is for another plan ({plan_sha256[:12]}...) than the one being flown")
        effect = check_operator_command(command, self._timeline.state)
        if self._stopping and effect not in (Effect.STOP_ON_GROUND, Effect.NOTE):
            raise TransitionError(f"'{command}' comes too late: the flight is being ended on the ground")
        if command is OperatorCommand.LAUNCH and (unfit := self.launch.evidence.unfit()):
            raise TransitionError(f"launch refused: {unfit}")
        if command in (OperatorCommand.READY, OperatorCommand.ACCEPT, OperatorCommand.REFUSE) and handover is None:
            raise TransitionError(f"'{command}' needs the index of a handover")
        if command is OperatorCommand.AUTHORISE and (until_s is None or not until_s >= 0.0):
            raise TransitionError("'authorise' needs until_s, a time of the plan, 0 or more")
        if command is OperatorCommand.REPLAN:
            if upcoming is None:
                raise TransitionError("'replan' needs a plan made ready for this flight")
            self.airborne.adopt(upcoming, join_s, leave_s)
        else:
            self._obey(command, effect, handover or 0, until_s or 0.0, reason or by or "word")
        self._timeline.emit(
            EventKind.OPERATOR_COMMAND, word=command.value, by=by, handover=handover, until_s=until_s, reason=reason
        )

    def make_ready(self, document: Mapping[str, Any]) -> NextPlan:
        """A plan document judged and prepared for REPLAN; slow, and safe in a thread beside the flight.

        Raises `TransitionError` with the reasons why this flight cannot fly it.
        """
        return make_ready(document, self.context, self.launch.values)

    def _obey(self, command: OperatorCommand, effect: Effect, handover: int, until_s: float, reason: str) -> None:
        air = self.airborne
        if effect in (Effect.LAUNCH, Effect.PREFLIGHT):
            self.launch.ask(again=effect is Effect.PREFLIGHT)
        elif effect is Effect.STOP_ON_GROUND:
            if not self._stopping:
                # On the ground: motors off, parameters back, done.
                self._stopping = True
                self._procedure = self._stop_on_ground(f"aborted: {reason}")
        elif effect in (Effect.HOLD, Effect.KEEP_HOLDING):
            air.hold()
        elif effect in (Effect.GO_ON, Effect.RE_ENTER):
            air.resume()
        elif command is OperatorCommand.LAND:
            self._land(reason)
        elif command is OperatorCommand.ABORT:
            if effect is Effect.STOP_CLIMB:
                self._land(f"abort: {reason}", FlightState.CONTINGENCY)
            else:
                air.contingency(f"abort: {reason}")
        elif command is OperatorCommand.AUTHORISE:
            air.authorise(until_s)
        elif command is OperatorCommand.REFUSE:
            air.chain.refuse(handover, reason)
        else:
            air.chain.accept(handover)

    def _land(self, reason: str, outcome: FlightState | None = None) -> None:
        """Land at once, wherever the vehicle is; out of the climb too, whose commands are taken back."""
        if self._procedure is not None:
            self._procedure = None
            self._control.commander.cancel_all()
        self.airborne.land(reason, outcome)

    def _stop_on_ground(self, reason: str) -> Steps[None]:
        yield from stop_on_ground(self.context, self.launch.restore, reason)

    # -- for people ---------------------------------------------------------------------------------------------------

    def parent_gone(self) -> None:
        """Nobody can speak to the flight any more: it goes on as far as authorised, and a hold ends by itself."""
        self.airborne.attended = False
        self._timeline.alarm("nobody attends the flight")

    def parent_back(self) -> None:
        """Somebody can speak again."""
        self.airborne.attended = True

    def status(self) -> dict[str, Any]:
        """The flight now, as JSON."""
        timeline, grant, age_s = self._timeline, self._control.gate.in_force, self.launch.preflight_age_s
        document = {
            "flight_id": self.context.request.flight_id,
            "state": timeline.state.value,
            "time_s": round(timeline.now_s, 3),
            "utc": timeline.utc.text(timeline.now_s),
            "t_plus_s": None if timeline.t_plus_s is None else round(timeline.t_plus_s, 3),
            "plan_sha256": self.context.plan.plan_sha256,
            "vehicle_identity": self.one_vehicle.identity,
            "preflight_id": self.launch.preflight_id,
            "preflight_age_s": None if age_s is None else round(age_s, 1),
            "fence": None if grant is None else grant.number,
            "loss_timeout_s": self._vehicle.loss_timeout_s,
            **self.announcer.where(),
            "lateness": self.lateness.to_document(),
        }
        clean: dict[str, Any] = plain(document)
        return clean
