"""PX4's answers to commands."""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl_fixtures.autopilot.command import ACCEPTED, DENIED, FAILED, TEMPORARILY_REJECTED, Command
from sitl_fixtures.autopilot.command_table import CommandTable
from sitl_fixtures.autopilot.model import CRITICAL
from sitl_fixtures.mavlink.wire import Message
from sitl_fixtures.px4.core import Px4Core
from sitl_fixtures.px4.modes import HOLD, LAND, MISSION, MODE_NAMES, RTL, TAKEOFF, Mode

PROTOCOL_VERSION = 300
MODE_COMMANDS: dict[int, Mode] = {
    mavlink.MAV_CMD_NAV_LAND: LAND,
    mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: RTL,
    mavlink.MAV_CMD_NAV_LOITER_UNLIM: HOLD,
    mavlink.MAV_CMD_MISSION_START: MISSION,
}


class Px4Commands(CommandTable[Px4Core, Mode]):
    """The commands PX4 knows, by number: a message asked for comes before its acknowledgement."""

    ACK_FIRST = False
    UNKNOWN_MESSAGE = FAILED
    REBOOT_REFUSED = DENIED

    def __init__(self, autopilot: Px4Core) -> None:
        super().__init__(autopilot, MODE_COMMANDS)
        self.commands[mavlink.MAV_CMD_REQUEST_PROTOCOL_VERSION] = self._accept

    def _mode_command(self, mode: Mode, command: Command) -> None:
        self._autopilot.ack(command, ACCEPTED)
        self._autopilot.intend(mode)

    def _do_set_mode(self, command: Command) -> None:
        """Acknowledged twice: first always with 0, then with 1 where the mode is known and cannot be entered."""
        autopilot = self._autopilot
        autopilot.ack(command, ACCEPTED)
        mode = (int(command.params[1]), int(command.params[2]))
        custom = int(command.params[0]) & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        refusal = autopilot.unavailable(mode) if custom and mode in MODE_NAMES else None
        if refusal is not None:
            autopilot.ack(command, TEMPORARILY_REJECTED)
            autopilot.text(refusal, CRITICAL)
            return
        autopilot.ack(command, ACCEPTED)
        if custom and mode in MODE_NAMES:
            autopilot.intend(mode)

    def _disarm(self, command: Command) -> None:
        autopilot = self._autopilot
        autopilot.ack(command, ACCEPTED)
        if autopilot.armed:
            autopilot.disarm("Disarmed by external command")

    def _refuse_disarming(self, command: Command) -> None:
        self._autopilot.ack(command, TEMPORARILY_REJECTED)
        self._autopilot.text("Disarming denied: not landed", CRITICAL)

    def _refuse_arming(self, command: Command, reasons: list[str]) -> None:
        self._autopilot.ack(command, TEMPORARILY_REJECTED)
        self._autopilot.text(f"Arming denied: {reasons[0]}", CRITICAL)

    def _tell_armed(self) -> None:
        self._autopilot.text("Armed by external command")

    def _takeoff(self, command: Command) -> None:
        """NAV_TAKEOFF: altitude AMSL, taken in flight too; arming comes after it."""
        autopilot = self._autopilot
        alt = command.params[6]
        if not math.isfinite(alt) or alt <= -500.0:
            alt = autopilot.vehicle.telemetry.believed_place()[2] + autopilot.params["MIS_TAKEOFF_ALT"]
        autopilot.takeoff_alt_amsl_m = alt
        autopilot.ack(command, ACCEPTED)
        autopilot.mode = HOLD if autopilot.mode == TAKEOFF else autopilot.mode
        autopilot.intended = TAKEOFF
        autopilot.go(TAKEOFF)

    def _request_result(self, number: int, message: Message | None) -> int:
        """PROTOCOL_VERSION is acknowledged and never sent."""
        return ACCEPTED if message is not None or number == PROTOCOL_VERSION else DENIED

    def _reposition(self, command: Command) -> None:
        autopilot = self._autopilot
        estimate = autopilot.vehicle.estimator
        lat, lon, alt = command.params[4:7]
        if estimate.projection is None or estimate.origin is None or abs(lat) > 90.0 or abs(lon) > 180.0:
            autopilot.ack(command, DENIED)
            return
        autopilot.ack(command, ACCEPTED)
        if int(command.params[1]) & 1 and autopilot.mode != HOLD:
            autopilot.intend(HOLD)
        if autopilot.mode == HOLD:
            north, east = estimate.projection.to_local(math.radians(lat), math.radians(lon))
            down = estimate.origin[2] - alt if math.isfinite(alt) else autopilot.guidance.d
            autopilot.hold_at = (north, east, down)

    def _refuses_reboot(self, command: Command) -> bool:
        return self._autopilot.armed

    def _terminate(self, command: Command) -> None:
        self._autopilot.ack(command, ACCEPTED)
        if command.params[0] > 1.5:
            self._autopilot.disarm("Flight termination")
