"""ArduCopter's answers to commands: the acknowledgement first, then what it brings about."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl_fixtures.ardupilot import setpoints as setpoints
from sitl_fixtures.ardupilot.modes import AUTO, GUIDED, LAND, LOITER, RTL
from sitl_fixtures.autopilot import ACCEPTED, CRITICAL, DENIED, FAILED, FORCE_DISARM, UNSUPPORTED, WARNING, Command

if TYPE_CHECKING:
    from sitl_fixtures.ardupilot.autopilot import ArduCopter


class CopterCommands:
    """The commands ArduCopter knows, by number."""

    def __init__(self, personality: ArduCopter) -> None:
        self._p = personality
        self.commands: dict[int, Callable[[Command], None]] = {
            mavlink.MAV_CMD_DO_SET_MODE: self._do_set_mode,
            mavlink.MAV_CMD_COMPONENT_ARM_DISARM: self._arm_disarm,
            mavlink.MAV_CMD_NAV_TAKEOFF: self._takeoff,
            mavlink.MAV_CMD_NAV_LAND: lambda c: self._mode_command(c, LAND),
            mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: lambda c: self._mode_command(c, RTL),
            mavlink.MAV_CMD_NAV_LOITER_UNLIM: lambda c: self._mode_command(c, LOITER),
            mavlink.MAV_CMD_MISSION_START: lambda c: self._mode_command(c, AUTO),
            mavlink.MAV_CMD_SET_MESSAGE_INTERVAL: self._set_interval,
            mavlink.MAV_CMD_GET_MESSAGE_INTERVAL: self._get_interval,
            mavlink.MAV_CMD_REQUEST_MESSAGE: self._request_message,
            mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: self._capabilities,
            mavlink.MAV_CMD_DO_REPOSITION: self._reposition,
            mavlink.MAV_CMD_DO_CHANGE_SPEED: lambda c: self._p.ack(c, ACCEPTED),
            mavlink.MAV_CMD_DO_SET_HOME: self._set_home,
            mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: self._reboot,
            mavlink.MAV_CMD_DO_FLIGHTTERMINATION: self._terminate,
        }

    def handle(self, command: Command) -> None:
        """Answers every command addressed to it; unknown ones are unsupported."""
        handler = self.commands.get(command.number)
        if handler is None:
            self._p.ack(command, UNSUPPORTED)
        else:
            handler(command)

    def _mode_command(self, command: Command, mode: int) -> None:
        # The acknowledgement comes before the extra heartbeat and any text.
        refusal = self._p.unavailable(mode)
        if refusal is not None:
            self._p.ack(command, FAILED)
            self._p.text(refusal, WARNING)
            return
        self._p.ack(command, ACCEPTED)
        self._p.change_mode(mode)

    def _do_set_mode(self, command: Command) -> None:
        if int(command.params[0]) & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
            self._mode_command(command, int(command.params[1]))
        else:
            self._p.ack(command, FAILED)

    def _arm_disarm(self, command: Command) -> None:
        forced = command.params[1] == FORCE_DISARM
        if command.params[0] == 0.0:
            if not self._p.armed or self._p.vehicle.body.on_ground or forced:
                if self._p.armed:
                    self._p.disarm()
                self._p.ack(command, ACCEPTED)
            else:
                self._p.ack(command, FAILED)
            return
        if command.params[0] != 1.0:
            self._p.ack(command, UNSUPPORTED)
            return
        if self._p.armed:
            self._p.ack(command, ACCEPTED)
            return
        faults = [] if forced else self._p.arming_faults()
        if faults:
            self._p.ack(command, FAILED)
            for fault in faults:
                self._p.text(f"Arm: {fault}", CRITICAL)
            return
        self._p.arm()
        self._p.ack(command, ACCEPTED)
        self._p.vehicle.send(self._p.vehicle.telemetry.global_origin())
        self._p.vehicle.send(self._p.vehicle.telemetry.home_position())
        self._p.text("Arming motors")

    def _takeoff(self, command: Command) -> None:
        if (
            self._p.mode != GUIDED
            or not self._p.armed
            or not self._p.vehicle.body.on_ground
            or command.params[6] <= 0.0
        ):
            self._p.ack(command, FAILED)
            return
        self._p.flight.taking_off = True
        self._p.flight.takeoff_alt_m = command.params[6]
        self._p.flight.stage_s = self._p.vehicle.time_s
        self._p.hold_at = self._p.position
        self._p.guided.take_off()
        self._p.ack(command, ACCEPTED)

    def _set_interval(self, command: Command) -> None:
        number, interval_us = int(command.params[0]), command.params[1]
        known = self._p.vehicle.set_interval(command.link, number, interval_us)
        self._p.ack(command, ACCEPTED if known else DENIED)
        if not known:
            self._p.text(f"No ap_message for mavlink id ({number})")

    def _get_interval(self, command: Command) -> None:
        number = int(command.params[0])
        interval = self._p.vehicle.telemetry.interval_s(command.link, number)
        self._p.ack(command, ACCEPTED)
        interval_us = -1 if interval is None else round(interval * 1e6)
        self._p.vehicle.send(mavlink.MAVLink_message_interval_message(number, interval_us), command.link)

    def _request_message(self, command: Command) -> None:
        builder = self._p.vehicle.telemetry.builders.get(int(command.params[0]))
        self._p.ack(command, ACCEPTED if builder else FAILED)
        message = builder() if builder else None
        if message is not None:
            self._p.vehicle.send(message, command.link)

    def _capabilities(self, command: Command) -> None:
        self._p.ack(command, ACCEPTED)
        self._p.vehicle.send(self._p.version(), command.link)

    def _reposition(self, command: Command) -> None:
        if self._p.mode != GUIDED and not int(command.params[1]) & 1:
            self._p.ack(command, DENIED)
            return
        place = setpoints.geodetic(
            command.params[4],
            command.params[5],
            command.params[6],
            command.frame,
            self._p.vehicle.estimator,
            self._p.home,
        )
        if place is None or not self._p.change_mode(GUIDED):
            self._p.ack(command, DENIED)
            return
        self._p.flight.taking_off = False
        self._p.guided.hold_position(place, self._p.vehicle.time_s)
        self._p.ack(command, ACCEPTED)

    def _set_home(self, command: Command) -> None:
        if command.params[0] == 1.0:
            self._p.set_home_here()
        else:
            self._p.home = (command.params[4], command.params[5], command.params[6])
        self._p.ack(command, ACCEPTED)
        self._p.vehicle.send(self._p.vehicle.telemetry.home_position())

    def _reboot(self, command: Command) -> None:
        if self._p.armed and command.params[0] in (1.0, 3.0) and not self._p.vehicle.body.on_ground:
            self._p.ack(command, FAILED)
            return
        self._p.ack(command, ACCEPTED)
        self._p.vehicle.after(0.2, self._p.vehicle.reboot)

    def _terminate(self, command: Command) -> None:
        self._p.ack(command, ACCEPTED)
        if command.params[0] == 1.0:
            self._p.disarm()
