"""PX4's answers to commands."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl_fixtures.autopilot import (
    ACCEPTED,
    CRITICAL,
    DENIED,
    FAILED,
    FORCE_DISARM,
    TEMPORARILY_REJECTED,
    UNSUPPORTED,
    Command,
)
from sitl_fixtures.px4.modes import HOLD, LAND, MISSION, MODE_NAMES, RTL, TAKEOFF, Mode

if TYPE_CHECKING:
    from sitl_fixtures.px4.autopilot import Px4

PROTOCOL_VERSION = 300


class Px4Commands:
    """The commands PX4 knows, by number."""

    def __init__(self, personality: Px4) -> None:
        self._p = personality
        self.commands: dict[int, Callable[[Command], None]] = {
            mavlink.MAV_CMD_DO_SET_MODE: self._do_set_mode,
            mavlink.MAV_CMD_COMPONENT_ARM_DISARM: self._arm_disarm,
            mavlink.MAV_CMD_NAV_TAKEOFF: self._takeoff,
            mavlink.MAV_CMD_NAV_LAND: lambda c: self._mode_command(c, LAND),
            mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: lambda c: self._mode_command(c, RTL),
            mavlink.MAV_CMD_NAV_LOITER_UNLIM: lambda c: self._mode_command(c, HOLD),
            mavlink.MAV_CMD_MISSION_START: lambda c: self._mode_command(c, MISSION),
            mavlink.MAV_CMD_SET_MESSAGE_INTERVAL: self._set_interval,
            mavlink.MAV_CMD_GET_MESSAGE_INTERVAL: self._get_interval,
            mavlink.MAV_CMD_REQUEST_MESSAGE: self._request_message,
            mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: self._capabilities,
            mavlink.MAV_CMD_REQUEST_PROTOCOL_VERSION: lambda c: self._p.ack(c, ACCEPTED),
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

    def _mode_command(self, command: Command, mode: Mode) -> None:
        self._p.ack(command, ACCEPTED)
        self._p.intend(mode)

    def _do_set_mode(self, command: Command) -> None:
        """Acknowledged twice: first always with 0, then with 1 where the mode is known and cannot be entered."""
        self._p.ack(command, ACCEPTED)
        mode = (int(command.params[1]), int(command.params[2]))
        custom = int(command.params[0]) & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        refusal = self._p.unavailable(mode) if custom and mode in MODE_NAMES else None
        if refusal is not None:
            self._p.ack(command, TEMPORARILY_REJECTED)
            self._p.text(refusal, CRITICAL)
            return
        self._p.ack(command, ACCEPTED)
        if custom and mode in MODE_NAMES:
            self._p.intend(mode)

    def _arm_disarm(self, command: Command) -> None:
        forced = command.params[1] == FORCE_DISARM
        if command.params[0] == 0.0:
            if self._p.armed and not self._p.vehicle.body.on_ground and not forced:
                self._p.ack(command, TEMPORARILY_REJECTED)
                self._p.text("Disarming denied: not landed", CRITICAL)
                return
            self._p.ack(command, ACCEPTED)
            if self._p.armed:
                self._p.disarm("Disarmed by external command")
            return
        if command.params[0] != 1.0:
            self._p.ack(command, UNSUPPORTED)
            return
        if self._p.armed:
            self._p.ack(command, ACCEPTED)
            return
        faults = [] if forced else self._p.arming_faults()
        if faults:
            self._p.ack(command, TEMPORARILY_REJECTED)
            self._p.text(f"Arming denied: {faults[0]}", CRITICAL)
            return
        self._p.arm()
        self._p.ack(command, ACCEPTED)
        self._p.text("Armed by external command")

    def _takeoff(self, command: Command) -> None:
        """NAV_TAKEOFF: altitude AMSL, taken in flight too; arming comes after it."""
        alt = command.params[6]
        if not math.isfinite(alt) or alt <= -500.0:
            alt = self._p.vehicle.telemetry.believed_place()[2] + self._p.params["MIS_TAKEOFF_ALT"]
        self._p.takeoff_alt_amsl_m = alt
        self._p.ack(command, ACCEPTED)
        self._p.mode = HOLD if self._p.mode == TAKEOFF else self._p.mode
        self._p.intended = TAKEOFF
        self._p.go(TAKEOFF)

    def _set_interval(self, command: Command) -> None:
        number, interval_us = int(command.params[0]), command.params[1]
        known = self._p.vehicle.set_interval(command.link, number, interval_us)
        self._p.ack(command, ACCEPTED if known else FAILED)

    def _get_interval(self, command: Command) -> None:
        number = int(command.params[0])
        interval = self._p.vehicle.telemetry.interval_s(command.link, number)
        interval_us = -1 if interval is None else round(interval * 1e6)
        self._p.vehicle.send(mavlink.MAVLink_message_interval_message(number, interval_us), command.link)
        self._p.ack(command, ACCEPTED)

    def _request_message(self, command: Command) -> None:
        """The message comes before its acknowledgement; PROTOCOL_VERSION is acknowledged and never sent."""
        number = int(command.params[0])
        builder = self._p.vehicle.telemetry.builders.get(number)
        message = builder() if builder else None
        if message is not None:
            self._p.vehicle.send(message, command.link)
        known = message is not None or number == PROTOCOL_VERSION
        self._p.ack(command, ACCEPTED if known else DENIED)

    def _capabilities(self, command: Command) -> None:
        self._p.vehicle.send(self._p.version(), command.link)
        self._p.ack(command, ACCEPTED)

    def _reposition(self, command: Command) -> None:
        estimate = self._p.vehicle.estimator
        lat, lon, alt = command.params[4:7]
        if estimate.projection is None or estimate.origin is None or abs(lat) > 90.0 or abs(lon) > 180.0:
            self._p.ack(command, DENIED)
            return
        self._p.ack(command, ACCEPTED)
        if int(command.params[1]) & 1 and self._p.mode != HOLD:
            self._p.intend(HOLD)
        if self._p.mode == HOLD:
            north, east = estimate.projection.to_local(math.radians(lat), math.radians(lon))
            down = estimate.origin[2] - alt if math.isfinite(alt) else self._p.guidance.d
            self._p.hold_at = (north, east, down)

    def _set_home(self, command: Command) -> None:
        if command.params[0] == 1.0:
            self._p.home = self._p.vehicle.telemetry.believed_place()
        else:
            self._p.home = (command.params[4], command.params[5], command.params[6])
        self._p.ack(command, ACCEPTED)

    def _reboot(self, command: Command) -> None:
        if self._p.armed:
            self._p.ack(command, DENIED)
            return
        self._p.ack(command, ACCEPTED)
        self._p.vehicle.after(0.2, self._p.vehicle.reboot)

    def _terminate(self, command: Command) -> None:
        self._p.ack(command, ACCEPTED)
        if command.params[0] > 1.5:
            self._p.disarm("Flight termination")
