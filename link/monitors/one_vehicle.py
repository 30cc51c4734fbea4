"""One aircraft, one flight: who the vehicle is, that it is one, that it is this flight's alone, who else speaks to it.

On the ground every link is asked, the vehicle is claimed against all other programs of the machine, and what speaks
against the launch is said (`judge`, `hindrance`). In flight the same is watched, and alarmed (`update`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from gcs.flight import EventKind, FlightState
from link.dialect import mavlink
from link.microservices.parameter import ParameterClient
from link.preflight.check import Check, Level
from link.session.context import FlightContext
from link.session.procedure import Refused, Steps, wait_until
from link.telemetry.board import SentFrames
from link.wire.codec import StationCodec

ASK_WAIT_S = 2.0
FIRST_ASK_S = 5.0
ASK_AGAIN_S = 10.0
"""In flight the unique id is asked for so often, and whenever another link carries the commands."""
TOLD_AGAIN_S = 30.0
HEARD_LATELY_S = 15.0
CONTROL_STATUS_S = 5.0
COMMAND_MEMORY_S = 60.0
GROUND_STATION_COMPONENT = 190

Claim = Callable[[int, str | None], str]
"""Holds the vehicle of a system id and unique id against other programs; who has it, or empty."""

_STREAMING = frozenset(
    {FlightState.TRANSIT, FlightState.CRUISE, FlightState.HOLDING, FlightState.RETURNING, FlightState.ARRIVED}
)


class OneVehicle:
    """The watch of one flight. ``claim`` defaults to nobody else being there."""

    def __init__(self, flight: FlightContext, parameters: ParameterClient, claim: Claim | None = None) -> None:
        self._timeline = flight.timeline
        self._vehicle = flight.vehicle
        self._control = flight.control
        self._parameters = parameters
        self._claim = claim or (lambda system_id, unique_id: "")
        self._own = frozenset(flight.request.system_ids.values())
        self._frames = SentFrames()
        self._told_s: dict[str, float] = {}
        self._own_id_misused: dict[int, float] = {}
        self._asked_s = -math.inf
        self._asked_over: Any = None
        self._mode: str | None = None
        self._heard_ids: dict[str, float] = {}
        self._verdicts: dict[str, int] = {}
        self.identity: str | None = None
        """What the vehicle was claimed as."""

    # -- asking, on the ground ----------------------------------------------------------------------------------------

    def identify(self, station: str) -> Steps[None]:
        """Ask the vehicle over a station's links who it is, each in turn. The station must be in control."""
        link = self._vehicle.monitor.links[station]
        sends, now = link.active, self._timeline
        wait_s = FIRST_ASK_S if self.identity is None else ASK_WAIT_S
        for path in link.paths:
            if path is sends or now.now_s - path.proven_s <= HEARD_LATELY_S:
                link.active = path
                yield from self._ask(path.url, wait_s)
        link.active = sends

    def _ask(self, url: str, wait_s: float) -> Steps[None]:
        board, asked_s = self._vehicle.monitor.board, self._timeline.now_s

        def answered() -> bool:
            return board.answered_s.get(url, -math.inf) >= asked_s

        while not answered() and self._timeline.now_s < asked_s + wait_s:
            ticket = self._control.start_command("version", mavlink.MAV_CMD_REQUEST_MESSAGE, (148.0,), attempts=2)
            yield from wait_until(self._timeline, lambda t=ticket: answered() or t.finished, 1.0)  # type: ignore[misc]
            yield from wait_until(self._timeline, answered, 0.5)
            self._control.commander.cancel(ticket)

    def claim(self) -> None:
        """Hold the vehicle for this flight. Raises `Refused` where another program of this machine flies it."""
        monitor = self._vehicle.monitor
        unique_id = monitor.board.unique_id
        taken_by = self._claim(monitor.vehicle_system_id, unique_id)
        shown = f"system {monitor.vehicle_system_id}" + ("" if unique_id is None else f", {unique_id}")
        if taken_by:
            raise Refused(
                f"the vehicle ({shown}) is on another flight of this machine: {taken_by}; command that flight or end it"
            )
        self.identity = shown
        self._timeline.emit(
            EventKind.IDENTITY, identity=shown, unique_id=unique_id, system_id=monitor.vehicle_system_id
        )

    def heard_instead(self) -> str:
        """What comes over the links where the vehicle is not heard, or answers nothing, and what to do; else empty."""
        monitor = self._vehicle.monitor
        told = []
        if monitor.other_vehicles:
            ids = ", ".join(map(str, sorted(monitor.other_vehicles)))
            told.append(f"system {ids} is heard: set vehicle_system_id, if that is the vehicle")
        wrong = self._verdicts.get("wrong signature", 0)
        if wrong:
            told.append(f"{wrong} frames come signed with another key: their signatures are refused")
        unsigned = self._verdicts.get("unsigned", 0) + self._verdicts.get("MAVLink 1", 0)
        if unsigned:
            told.append(f"{unsigned} frames come unsigned, and this link has a key: they are refused")
        if monitor.signed and not wrong:
            told.append("its frames are signed: it takes commands signed with its key alone")
        return "; ".join(told)

    # -- judging, on the ground ---------------------------------------------------------------------------------------

    def judge(self) -> list[Check]:
        """Findings of the preflight; the vehicle's mode and the ids it hears are remembered for the launch."""
        monitor = self._vehicle.monitor
        board, required = monitor.board, "one autopilot under the vehicle's id, the same over every link"
        over = len(board.answers)
        if board.two_boards:
            message = f"two autopilots speak as system {monitor.vehicle_system_id}: {board.two_boards}"
            fix = "switch the other vehicle off, or give one of them another system id, and begin anew"
            one = Check("one vehicle", Level.FAILURE, message, None, required, fix=fix)
        elif board.unique_id is None:
            message = "it tells no unique id: another one with its system id is known by its clock and frames alone"
            fix = "make sure that no other vehicle in reach has its system id"
            one = Check("one vehicle", Level.WARNING, message, None, required, fix=fix)
        else:
            message = f"{board.unique_id}, asked over {over} link{'s' if over != 1 else ''}"
            one = Check("one vehicle", Level.PASS, message, board.unique_id, required)
        return [one, self._judge_stations()]

    def _judge_stations(self) -> Check:
        required = "no other ground station in command of the vehicle"
        commands = self._who_commands()
        if commands:
            fix = "end the other station or flight, and begin anew"
            return Check("other stations", Level.FAILURE, commands, None, required, fix=fix)
        now_s = self._timeline.now_s
        heard = [n for n, s in self._vehicle.monitor.foreign_stations.items() if now_s - s <= HEARD_LATELY_S]
        if heard:
            shown = ", ".join(map(str, sorted(heard)))
            message = f"ground station {shown} is heard on the links: it may command the vehicle too"
            fix = "let it watch only, or close it"
            return Check("other stations", Level.WARNING, message, sorted(heard), required, fix=fix)
        return Check("other stations", Level.PASS, "none heard", [], required)

    def _who_commands(self) -> str:
        """Evidence that somebody else commands the vehicle now; empty where there is none."""
        monitor, now_s = self._vehicle.monitor, self._timeline.now_s
        for system_id, heard_s in self._own_id_misused.items():
            if now_s - heard_s <= HEARD_LATELY_S:
                return f"another program speaks as our own system {system_id}"
        main = monitor.control_main
        if main and main not in self._own and now_s - monitor.control_s <= CONTROL_STATUS_S:
            return f"the vehicle says that station {main} is in control of it"
        return ""

    def passed(self) -> None:
        """The preflight has passed: the vehicle must be found as it is now when it is launched."""
        self._mode = self._vehicle.mode
        self._heard_ids = self._ids_heard()

    def _ids_heard(self) -> dict[str, float]:
        """The parameters that say whom the vehicle hears, as last told."""
        if not self._vehicle.profile.filters_station_ids:
            return {}
        known = self._parameters.known
        keys = ("gcs_system_id", "gcs_system_id_high", "enforce_gcs")
        names = [name for key in keys for name in self._vehicle.profile.parameter(key).names]
        return {name: float(known[name].value) for name in names if name in known}

    def hindrance(self) -> str:
        """Why this vehicle must not be launched now, by what is known without asking; empty: nothing."""
        vehicle, monitor = self._vehicle, self._vehicle.monitor
        if monitor.board.two_boards:
            return f"two autopilots speak as system {monitor.vehicle_system_id}: {monitor.board.two_boards}"
        if commands := self._who_commands():
            return commands
        if vehicle.armed or vehicle.landed_state not in (0, mavlink.MAV_LANDED_STATE_ON_GROUND):
            return "the vehicle was armed or took off after the preflight, and not by this flight"
        return ""

    def look_again(self, restore: Callable[[], Steps[None]]) -> Steps[None]:
        """Look at the vehicle once more before it is armed. Raises `Refused` where it is not as it was judged."""
        if self._heard_ids:
            again = self._parameters.read(list(self._heard_ids), self._control.in_force)
            yield from wait_until(self._timeline, lambda: all(one.finished for one in again), 10.0)
        why = self.hindrance()
        if not why and self._vehicle.mode != self._mode:
            moved = f"the vehicle's mode went from {self._mode} to {self._vehicle.mode}"
            why = f"{moved} after the preflight, and not by this flight: somebody else commands it; begin anew"
        if not why and (changed := self._ids_changed()):
            why = f"another station changed whom the vehicle hears after the preflight: {changed}; begin anew"
        if why:
            yield from restore()
            raise Refused(why)

    def _ids_changed(self) -> str:
        now = self._ids_heard()
        return ", ".join(
            f"{name} {value:g} to {now[name]:g}" for name, value in self._heard_ids.items() if now.get(name) != value
        )

    # -- what is sent and heard ---------------------------------------------------------------------------------------

    def sent(self, frame: bytes) -> None:
        """A frame of ours leaves."""
        self._frames.sent(self._timeline.now_s, frame)

    def heard(self, system_id: int, component_id: int, frame: bytes | bytearray) -> None:
        """A frame of any sender came in."""
        ours = system_id in self._own or (
            system_id == self._vehicle.system_id and component_id == GROUND_STATION_COMPONENT
        )
        if ours and not self._frames.ours(bytes(frame)):
            self._own_id_misused[system_id] = self._timeline.now_s

    def reflected(self, decoder: StationCodec) -> None:
        """Frames that a decoder holds for its own station's."""
        self._verdicts.update(decoder.stats.refused)
        while decoder.returned:
            self.heard(decoder.system_id, decoder.component_id, decoder.returned.popleft())

    def on_ack(self, ack: Any) -> None:
        """A COMMAND_ACK of the vehicle: one to us that answers nothing of ours is an answer to somebody else."""
        if ack.target_system not in self._own:
            return
        sent_s = self._control.commander.sent_s(ack.command)
        if self._timeline.now_s - sent_s > COMMAND_MEMORY_S:
            self._alarm("the vehicle answers a command we never sent", str(ack.command), command=ack.command)

    # -- watching -----------------------------------------------------------------------------------------------------

    def update(self) -> None:
        """Alarms what is found; asks again in flight. Once a tick."""
        timeline, monitor = self._timeline, self._vehicle.monitor
        if timeline.state.ended:
            return
        if monitor.board.two_boards:
            self._alarm("two vehicles speak under one system id", reason=monitor.board.two_boards)
        for system_id, heard_s in self._own_id_misused.items():
            if timeline.now_s - heard_s <= 1.0:
                self._alarm("somebody else speaks under our system id", str(system_id), system_id=system_id)
        if timeline.state.airborne:
            if commands := self._who_commands():
                self._alarm("another station commands the vehicle", reason=commands)
            if self._control.id_manager is None and (changed := self._ids_changed()):
                self._alarm("another station changed whom the vehicle hears", reason=changed)
            self._ask_again()

    def _ask_again(self) -> None:
        timeline, control = self._timeline, self._control
        grant = control.gate.in_force
        if timeline.state not in _STREAMING or grant is None:
            return
        over = (grant.number, self._vehicle.monitor.links[grant.station_id].active.url)
        due = over != self._asked_over or timeline.now_s - self._asked_s >= ASK_AGAIN_S
        if due and not control.commander.waits_for(mavlink.MAV_CMD_REQUEST_MESSAGE):
            self._asked_over, self._asked_s = over, timeline.now_s
            control.start_command("version", mavlink.MAV_CMD_REQUEST_MESSAGE, (148.0,), attempts=2)

    def _alarm(self, what: str, which: str = "", **data: Any) -> None:
        key = f"{what} {which}"
        if self._timeline.now_s - self._told_s.get(key, -math.inf) > TOLD_AGAIN_S:
            self._told_s[key] = self._timeline.now_s
            self._timeline.alarm(what, **data)
