"""The simulated autopilot without any input or output of its own: bytes and a clock in, bytes out.

``SimulatedAutopilot`` is what ``python -m sitl_fixtures`` runs, and what a test can run in virtual time. Time is the
vehicle's: seconds on whatever clock the caller passes; the first call boots the vehicle.
"""

from __future__ import annotations

import math
import random
import secrets
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl_fixtures.ardupilot.parameters import ARDUPILOT_4_6
from sitl_fixtures.autopilot.command import Command
from sitl_fixtures.autopilot.model import AutopilotModel
from sitl_fixtures.dynamics.battery import Battery
from sitl_fixtures.dynamics.estimator import Estimator
from sitl_fixtures.dynamics.point_mass import GRAVITY_M_S2, PointMass
from sitl_fixtures.faults.injection import FaultSet
from sitl_fixtures.mavlink.mission_protocol import Missions
from sitl_fixtures.mavlink.operator_control import OperatorControl
from sitl_fixtures.mavlink.parameters import Parameter, ParameterSet
from sitl_fixtures.mavlink.signing import Signing
from sitl_fixtures.mavlink.telemetry import Telemetry
from sitl_fixtures.mavlink.wire import Message, Packer, Port
from sitl_fixtures.vehicle.config import AUTOPILOT_MODELS, DEFAULT_HOMES, SimulatorConfig

SLOW_EVERY_S = 0.1
REBOOT_SILENCE_S = 1.0


class SimulatedAutopilot:
    """An autopilot, its aircraft and its links.

    Attributes for tests:
        body: the true state (``lat_deg``, ``lon_deg``, ``height_m``, ``vn``, ...).
        autopilot: mode and arming (``mode_name``, ``armed``).
        accepted_setpoints: the last set-points obeyed, as ``(now_s, link, system_id, message name, target)``; all of
            them go to ``on_setpoint`` as well.
    """

    def __init__(
        self,
        config: SimulatorConfig,
        on_setpoint: Callable[[float, int, int, str, dict[str, object]], None] | None = None,
    ) -> None:
        self.config = config
        self.on_setpoint = on_setpoint
        self.accepted_setpoints: list[tuple[float, int, int, str, dict[str, object]]] = []
        self.random = random.Random(config.seed)
        self.uid = _unique_id(config.uid)
        self.hung = False
        self.rotors_stopped = False
        self.clock_rate = 1.0
        self._last_call_s: float | None = None
        self._epoch: float | None = None
        self._outgoing: list[tuple[int, bytes]] = []
        self.ports = [Port(index) for index in range(config.links)]
        self._packer = Packer(config.system_id, mavlink.MAV_COMP_ID_AUTOPILOT1)
        self.home_place = config.home or DEFAULT_HOMES[config.autopilot]
        kind = AUTOPILOT_MODELS[config.autopilot]
        table = ARDUPILOT_4_6 if config.firmware else kind.PARAMETERS
        self.parameters = ParameterSet(table, bitwise=kind.BITWISE_PARAMETERS)
        self.parameters.put("SIM_SPEEDUP", config.speedup)
        for text in config.parameters:
            self.parameters.override(text)
        self.parameters.remember()
        self.body = PointMass(*self.home_place)
        self.body.wind_n_m_s, self.body.wind_e_m_s = config.wind_n_m_s, config.wind_e_m_s
        self.battery = Battery()
        self.faults = FaultSet(config.faults, self)
        self._boot(kind)

    def _boot(self, kind: type[AutopilotModel]) -> None:
        self.time_s = 0.0
        self.ready = False
        self.gps_ok = True
        self.estimator = Estimator(kind.PROJECTION)
        self.signing = Signing()
        self.missions = Missions(self, kind.MISSIONS, self.parameters)
        self.operator_control = OperatorControl(self) if self.config.speaks_operator_control else None
        self.autopilot = kind(self)
        self.telemetry = Telemetry(self, self.missions, self.config.links)
        self.autopilot.refresh()
        self._timers: list[tuple[float, int, Callable[[], None]]] = []
        self._timer_count = 0
        self._slow_s = 0.0
        self._silent_until_s = 0.0
        self._deferred: list[Callable[[], None]] = []
        self._handlers: dict[str, Callable[[int, Message], None]] = {
            "HEARTBEAT": lambda link, m: self.autopilot.on_heartbeat(link, m),
            "COMMAND_LONG": self._on_command,
            "COMMAND_INT": self._on_command,
            "SET_MODE": lambda link, m: self.autopilot.set_mode(link, m),
            "SET_POSITION_TARGET_LOCAL_NED": lambda link, m: self.autopilot.on_setpoint_local(link, m),
            "SET_POSITION_TARGET_GLOBAL_INT": lambda link, m: self.autopilot.on_setpoint_global(link, m),
            "PARAM_REQUEST_READ": self._on_param_read,
            "PARAM_REQUEST_LIST": self._on_param_list,
            "PARAM_SET": self._on_param_set,
            "REQUEST_DATA_STREAM": self._on_data_stream,
            "TIMESYNC": self._on_timesync,
            "PING": self._on_ping,
            "SETUP_SIGNING": self._on_setup_signing,
        }
        for name, handler in self.missions.handlers.items():
            self._handlers[name] = handler

    def reboot(self) -> None:
        """Starts the autopilot anew, silent for a second; the aircraft keeps its motion, parameters stay."""
        self.faults.rebooted()
        if self._epoch is not None:
            self._epoch += self.time_s
        self._boot(AUTOPILOT_MODELS[self.config.autopilot])
        self._silent_until_s = REBOOT_SILENCE_S

    # -- the four calls -----------------------------------------------------------------------------------------------

    def receive(self, link: int, data: bytes, now_s: float) -> None:
        """Takes what came in on a link at ``now_s``; the simulation is brought up to then first."""
        self.step(now_s)
        for message in self.ports[link].parse(data):
            for admitted in self.faults.incoming(link, message):
                self.handle(link, admitted)

    def step(self, now_s: float) -> None:
        """Moves the vehicle on to ``now_s``, in fixed steps; what is less than a step is left for the next call."""
        if self._epoch is None:
            self._epoch = now_s
        if self.clock_rate != 1.0 and self._last_call_s is not None:
            self._epoch += (now_s - self._last_call_s) * (1.0 - self.clock_rate)
        self._last_call_s = now_s
        tick = self.config.tick_s
        end = now_s - self._epoch + 1e-9
        while self.time_s + tick <= end:
            self._tick(tick)
            end = now_s - self._epoch + 1e-9

    def take_outgoing(self) -> list[tuple[int, bytes]]:
        """What is to be sent since the last call: (link, frame), in order."""
        outgoing, self._outgoing = self._outgoing, []
        return outgoing

    def next_event_s(self) -> float:
        """When ``step`` should be called next at the latest, on the caller's clock."""
        if self._epoch is None:
            return 0.0
        soonest = min(self.telemetry.next_due_s, self.time_s + 0.1)
        if self._timers:
            soonest = min(soonest, self._timers[0][0])
        return self._epoch + max(soonest, self.time_s + self.config.tick_s)

    # -- one step -----------------------------------------------------------------------------------------------------

    def _tick(self, dt: float) -> None:
        self.time_s += dt
        now = self.time_s
        body, autopilot = self.body, self.autopilot
        self.faults.tick(now, dt)
        if self.hung or now < self._silent_until_s:
            body.step(body.an, body.ae, body.ad, dt, autopilot.rotors and not self.rotors_stopped)
            return
        if not self.ready and self.gps_ok:
            self._start_up(now)
        autopilot.tick(dt)
        north, east, down = autopilot.command
        body.step(north, east, down, dt, autopilot.rotors and not self.rotors_stopped)
        self.estimator.update(body.lat_rad, body.lon_rad, body.height_m)
        if now >= self._slow_s:
            self._slow_s = now + SLOW_EVERY_S
            thrust = math.sqrt(body.an * body.an + body.ae * body.ae + (GRAVITY_M_S2 - body.ad) ** 2)
            self.battery.step(SLOW_EVERY_S, autopilot.rotors, thrust, body.speed_m_s)
            autopilot.slow_tick(SLOW_EVERY_S)
            if self.operator_control is not None:
                self.operator_control.tick(now)
        while self._timers and self._timers[0][0] <= now:
            self._timers.pop(0)[2]()
        if self.missions.uploading:
            self.missions.tick(now)
        if self._deferred:
            self._run_deferred()
        if self.time_s != now:
            return  # it was rebooted, and begins at zero
        if now >= self.telemetry.next_due_s:
            self.telemetry.run(now)

    def defer(self, action: Callable[[], None]) -> None:
        """Does something when the message or step in hand is done with."""
        self._deferred.append(action)

    def _run_deferred(self) -> None:
        while self._deferred:
            self._deferred.pop(0)()

    def set_aircraft(self, *, tilt_deg: float, drag_linear_1_s: float | None = None) -> None:
        """Lean and drag of the aircraft, from parameters and options."""
        body, config = self.body, self.config
        body.tilt_rad = math.radians(tilt_deg)
        if config.max_speed_m_s is not None:
            body.cap_speed(config.max_speed_m_s)
        elif drag_linear_1_s is not None:
            body.drag_linear_1_s, body.drag_quadratic_1_m = drag_linear_1_s, 0.0

    def injected_arming_refusals(self) -> list[str]:
        """Reasons not to arm that injected faults give."""
        return self.faults.arming_refusals()

    def _start_up(self, now: float) -> None:
        """First the origin, later a position good enough to arm."""
        body, autopilot = self.body, self.autopilot
        after = self.config.ready_after_s
        if self.estimator.origin is None and now >= after * autopilot.ORIGIN_AT:
            self.estimator.set_origin(body.lat_rad, body.lon_rad, body.height_m)
            self.estimator.update(body.lat_rad, body.lon_rad, body.height_m)
            autopilot.on_origin()
        if now >= after and self.estimator.origin is not None:
            self.ready = True
            autopilot.on_ready()

    def after(self, delay_s: float, action: Callable[[], None]) -> None:
        """Does something later, in vehicle time."""
        self._timer_count += 1
        self._timers.append((self.time_s + delay_s, self._timer_count, action))
        self._timers.sort(key=lambda timer: timer[:2])

    # -- out ----------------------------------------------------------------------------------------------------------

    def send(self, message: Message, link: int | None = None) -> None:
        """Sends on one link, or on all."""
        self.send_to(message, range(len(self.ports)) if link is None else (link,))

    def send_to(self, message: Message, links: Any) -> None:
        """Sends on some links: packed once, framed for each."""
        for altered, delay_s in self.faults.outgoing(message):
            if delay_s > 0.0:
                chosen = tuple(links)
                self.after(delay_s, lambda m=altered, c=chosen: self._emit(m, c))  # type: ignore[misc]
            else:
                self._emit(altered, links)

    def send_raw(self, message_id: int, payload: bytes, crc_extra: int) -> None:
        """Sends a message the stock dialect does not know, on all links."""
        self._frame(self._packer.pack_raw(message_id, payload), crc_extra, range(len(self.ports)))

    def _emit(self, message: Message, links: Any) -> None:
        self._frame(self._packer.pack(message), message.crc_extra, links)

    def _frame(self, packed: bytes, extra: int, links: Any) -> None:
        signer = self.signing if self.signing.active else None
        for link in links:
            frame = self.ports[link].frame(packed, extra, signer)
            if self.faults.on_frames:
                self._outgoing.extend((link, changed) for changed in self.faults.frames(link, frame))
            else:
                self._outgoing.append((link, frame))

    def note_setpoint(self, link: int, system_id: int, message: str, target: dict[str, object]) -> None:
        """Logs a set-point that was obeyed."""
        self.faults.setpoint_obeyed(self.time_s)
        entry = ((self._epoch or 0.0) + self.time_s, link, system_id, message, target)
        if len(self.accepted_setpoints) >= self.config.setpoint_log:
            del self.accepted_setpoints[: self.config.setpoint_log // 2]
        self.accepted_setpoints.append(entry)
        if self.on_setpoint is not None:
            self.on_setpoint(*entry)

    # -- in -----------------------------------------------------------------------------------------------------------

    def handle(self, link: int, message: Message) -> None:
        """One message that came in on a link."""
        if self.hung or self.time_s < self._silent_until_s or not self.signing.admits(link, message):
            return
        if not self.autopilot.heard_from(link, message):
            return
        if self.operator_control is not None and not self.operator_control.admits(link, message):
            return
        handler = self._handlers.get(message.get_type())
        if handler is not None:
            handler(link, message)
            if self._deferred:
                self._run_deferred()

    def _for_us(self, message: Message) -> bool:
        return message.target_system in (0, self.config.system_id)

    def _on_command(self, link: int, message: Message) -> None:
        if self.autopilot.addressed(message):
            self.autopilot.on_command(Command.of(link, message))

    def send_parameter(self, parameter: Parameter, link: int | None, index: int | None = None) -> None:
        """PARAM_VALUE; ``index`` as the autopilot reports it."""
        self.send(
            mavlink.MAVLink_param_value_message(
                parameter.name.encode(),
                self.parameters.wire_value(parameter),
                parameter.kind,
                len(self.parameters),
                parameter.index if index is None else index,
            ),
            link,
        )

    def broadcast_parameter(self, name: str) -> None:
        """A parameter the autopilot changed by itself, told to every link."""
        parameter = self.parameters.find(name, -1)
        if parameter is not None:
            self.send_parameter(parameter, None, self.autopilot.named_index(parameter))

    def _on_param_read(self, link: int, message: Message) -> None:
        if not self.autopilot.parameters_for(message):
            return
        parameter = self.parameters.find(message.param_id, message.param_index)
        if parameter is not None:
            by_name = message.param_index < 0
            self.send_parameter(parameter, link, self.autopilot.named_index(parameter) if by_name else None)

    def _on_param_list(self, link: int, message: Message) -> None:
        if not self.autopilot.parameters_for(message):
            return
        # About 100 a second of vehicle time, as over a modest radio.
        for index in range(len(self.parameters)):
            self.after(0.01 * index, lambda i=index: self.send_parameter(self.parameters.at(i), link))  # type: ignore[misc]

    def _on_param_set(self, link: int, message: Message) -> None:
        if not self.autopilot.parameters_for(message):
            return
        parameter = self.parameters.set_from_wire(message.param_id, message.param_value, message.param_type)
        if parameter is not None:
            self.autopilot.refresh()
            self.autopilot.on_parameter_set(link, parameter)

    def _on_data_stream(self, link: int, message: Message) -> None:
        if self._for_us(message):
            rate = float(message.req_message_rate) if message.start_stop else 0.0
            self.telemetry.request_stream(link, message.req_stream_id, rate)

    def _on_timesync(self, link: int, message: Message) -> None:
        if message.tc1 == 0:
            self.send(mavlink.MAVLink_timesync_message(int(self.time_s * 1e9) or 1, message.ts1), link)

    def _on_ping(self, link: int, message: Message) -> None:
        if message.target_system == 0:
            self.send(
                mavlink.MAVLink_ping_message(
                    message.time_usec, message.seq, message.get_srcSystem(), message.get_srcComponent()
                ),
                link,
            )

    def _on_setup_signing(self, link: int, message: Message) -> None:
        if self._for_us(message):
            self.autopilot.on_setup_signing(link, message)


def _unique_id(given: str) -> bytes:
    """The 18 bytes of uid2: as given; none; or drawn anew, as two boards of one make differ too."""
    if given == "none":
        return bytes(18)
    return (bytes.fromhex(given) if given else secrets.token_bytes(12)).ljust(18, b"\0")
