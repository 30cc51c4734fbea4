"""ArduCopter's answers to commands: the acknowledgement first, then what it brings about."""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl_fixtures.ardupilot import setpoints
from sitl_fixtures.ardupilot.core import CopterCore
from sitl_fixtures.ardupilot.modes import AUTO, GUIDED, LAND, LOITER, RTL
from sitl_fixtures.autopilot.command import ACCEPTED, DENIED, FAILED, Command
from sitl_fixtures.autopilot.command_table import CommandTable
from sitl_fixtures.autopilot.model import CRITICAL, WARNING
from sitl_fixtures.mavlink.wire import Message

MODE_COMMANDS: dict[int, int] = {
    mavlink.MAV_CMD_NAV_LAND: LAND,
    mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: RTL,
    mavlink.MAV_CMD_NAV_LOITER_UNLIM: LOITER,
    mavlink.MAV_CMD_MISSION_START: AUTO,
}


class CopterCommands(CommandTable[CopterCore, int]):
    """The commands ArduCopter knows, by number."""

    ACK_FIRST = True
    UNKNOWN_MESSAGE = DENIED
    REBOOT_REFUSED = FAILED

    def __init__(self, autopilot: CopterCore) -> None:
        super().__init__(autopilot, MODE_COMMANDS)

    def _mode_command(self, mode: int, command: Command) -> None:
        # The acknowledgement comes before the extra heartbeat and any text.
        autopilot = self._autopilot
        refusal = autopilot.unavailable(mode)
        if refusal is not None:
            autopilot.ack(command, FAILED)
            autopilot.text(refusal, WARNING)
            return
        autopilot.ack(command, ACCEPTED)
        autopilot.change_mode(mode)

    def _do_set_mode(self, command: Command) -> None:
        if int(command.params[0]) & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
            self._mode_command(int(command.params[1]), command)
        else:
            self._autopilot.ack(command, FAILED)

    def _disarm(self, command: Command) -> None:
        autopilot = self._autopilot
        if autopilot.armed:
            autopilot.disarm()
        autopilot.ack(command, ACCEPTED)

    def _refuse_disarming(self, command: Command) -> None:
        self._autopilot.ack(command, FAILED)

    def _refuse_arming(self, command: Command, reasons: list[str]) -> None:
        self._autopilot.ack(command, FAILED)
        for reason in reasons:
            self._autopilot.text(f"Arm: {reason}", CRITICAL)

    def _tell_armed(self) -> None:
        vehicle = self._autopilot.vehicle
        vehicle.send(vehicle.telemetry.global_origin())
        vehicle.send(vehicle.telemetry.home_position())
        self._autopilot.text("Arming motors")

    def _takeoff(self, command: Command) -> None:
        autopilot, height_m = self._autopilot, command.params[6]
        if autopilot.mode != GUIDED or not autopilot.armed or not autopilot.vehicle.body.on_ground or height_m <= 0.0:
            autopilot.ack(command, FAILED)
            return
        autopilot.begin_takeoff(height_m)
        autopilot.ack(command, ACCEPTED)

    def _set_interval(self, command: Command) -> None:
        super()._set_interval(command)
        number = int(command.params[0])
        if number not in self._autopilot.vehicle.telemetry.builders:
            self._autopilot.text(f"No ap_message for mavlink id ({number})")

    def _request_result(self, number: int, message: Message | None) -> int:
        """Accepted for a message it knows, even when there is nothing to send."""
        return ACCEPTED if number in self._autopilot.vehicle.telemetry.builders else FAILED

    def _reposition(self, command: Command) -> None:
        autopilot = self._autopilot
        if autopilot.mode != GUIDED and not int(command.params[1]) & 1:
            autopilot.ack(command, DENIED)
            return
        place = setpoints.geodetic(
            command.params[4],
            command.params[5],
            command.params[6],
            command.frame,
            autopilot.vehicle.estimator,
            autopilot.home,
        )
        if place is None or not autopilot.change_mode(GUIDED):
            autopilot.ack(command, DENIED)
            return
        autopilot.taking_off = False
        autopilot.guided.hold_position(place, autopilot.vehicle.time_s)
        autopilot.ack(command, ACCEPTED)

    def _set_home(self, command: Command) -> None:
        super()._set_home(command)
        self._autopilot.vehicle.send(self._autopilot.vehicle.telemetry.home_position())

    def _refuses_reboot(self, command: Command) -> bool:
        autopilot = self._autopilot
        return autopilot.armed and command.params[0] in (1.0, 3.0) and not autopilot.vehicle.body.on_ground

    def _terminate(self, command: Command) -> None:
        self._autopilot.ack(command, ACCEPTED)
        if command.params[0] == 1.0:
            self._autopilot.disarm()
