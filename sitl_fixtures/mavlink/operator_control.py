"""Operator control of the newer MAVLink development dialect: CONTROL_STATUS (512) and command 32100.

No stock autopilot has it, nor has pymavlink's stock dialect, so the message is packed by hand. It is on with
``--speaks-operator-control``.

=============================  ===================================  =====================================
state                          event                                result
=============================  ===================================  =====================================
nobody, or takeover allowed    B requests                           ACCEPTED, B is in control, status sent
A in control                   B requests                           FAILED to B, the request goes on to A
..                             A requests again, allowing takeover  the next to ask within 10 s gets it
..                             A releases                           nobody is in control
..                             a command from another               NOT_IN_CONTROL; its set-points are dropped
..                             no heartbeat of A for 5 s            nobody is in control
=============================  ===================================  =====================================
"""

from __future__ import annotations

import struct

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl_fixtures.mavlink.wire import Message
from sitl_fixtures.vehicle_protocol import VehicleProtocol

REQUEST_OPERATOR_CONTROL = 32100
CONTROL_STATUS_ID, CONTROL_STATUS_CRC_EXTRA = 512, 21
NOT_IN_CONTROL = 10
SYSTEM_MANAGER, TAKEOVER_ALLOWED = 1, 2
TAKEOVER_WINDOW_S = 10.0
OWNER_LOST_S = 5.0
STATUS_EVERY_S = 1.0
# Reading is open to everyone.
OPEN_COMMANDS = {
    mavlink.MAV_CMD_REQUEST_MESSAGE,
    mavlink.MAV_CMD_SET_MESSAGE_INTERVAL,
    mavlink.MAV_CMD_GET_MESSAGE_INTERVAL,
    mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES,
}
GUARDED = {
    "SET_POSITION_TARGET_LOCAL_NED",
    "SET_POSITION_TARGET_GLOBAL_INT",
    "SET_MODE",
    "PARAM_SET",
    "MISSION_COUNT",
    "MISSION_CLEAR_ALL",
}


class OperatorControl:
    """Who is in control, as the vehicle keeps it. System id 0 is nobody."""

    def __init__(self, vehicle: VehicleProtocol) -> None:
        self._vehicle = vehicle
        self.owner = 0
        self.takeover_until_s = 0.0
        self._owner_heard_s = 0.0
        self._owner_link = 0
        self._next_status_s = 0.0
        self._was_allowed = False

    @property
    def takeover_allowed(self) -> bool:
        """Whether another station may simply take over now."""
        return self._vehicle.time_s < self.takeover_until_s

    def tick(self, now_s: float) -> None:
        """Status once a second and on change; an owner who has fallen silent loses control."""
        if self.owner and now_s - self._owner_heard_s > OWNER_LOST_S:
            self._give_to(0)
        if now_s >= self._next_status_s or self._was_allowed != self.takeover_allowed:
            self._send_status()

    def _send_status(self) -> None:
        self._was_allowed = self.takeover_allowed
        self._next_status_s = self._vehicle.time_s + STATUS_EVERY_S
        flags = SYSTEM_MANAGER | (TAKEOVER_ALLOWED if self._was_allowed else 0)
        payload = struct.pack("<BB10s", flags, self.owner, b"")
        self._vehicle.send_raw(CONTROL_STATUS_ID, payload, CONTROL_STATUS_CRC_EXTRA)

    def _give_to(self, system_id: int) -> None:
        self.owner = system_id
        self.takeover_until_s = 0.0
        self._owner_heard_s = self._vehicle.time_s
        self._send_status()

    def _ack(self, link: int, message: Message, result: int) -> None:
        ack = mavlink.MAVLink_command_ack_message(
            message.command, result, 0, 0, message.get_srcSystem(), message.get_srcComponent()
        )
        self._vehicle.send(ack, link)

    def admits(self, link: int, message: Message) -> bool:
        """Whether a message may go on to the autopilot; answers it when it may not."""
        name, sender = message.get_type(), message.get_srcSystem()
        if sender == self.owner:
            self._owner_link = link
            if name == "HEARTBEAT":
                self._owner_heard_s = self._vehicle.time_s
        if name in ("COMMAND_LONG", "COMMAND_INT"):
            if not self._vehicle.autopilot.addressed(message):
                return True
            if message.command == REQUEST_OPERATOR_CONTROL:
                self._request(link, message)
                return False
            if self.owner and sender != self.owner and message.command not in OPEN_COMMANDS:
                self._ack(link, message, NOT_IN_CONTROL)
                return False
            return True
        return not (self.owner and sender != self.owner and name in GUARDED)

    def _request(self, link: int, message: Message) -> None:
        sender = message.get_srcSystem()
        if message.param1 == 0.0:
            if sender == self.owner:
                self._ack(link, message, mavlink.MAV_RESULT_ACCEPTED)
                self._give_to(0)
            else:
                self._ack(link, message, mavlink.MAV_RESULT_FAILED)
            return
        if sender == self.owner:
            self.takeover_until_s = self._vehicle.time_s + TAKEOVER_WINDOW_S if message.param2 else 0.0
            self._ack(link, message, mavlink.MAV_RESULT_ACCEPTED)
            self._send_status()
        elif self.owner == 0 or self.takeover_allowed:
            self._ack(link, message, mavlink.MAV_RESULT_ACCEPTED)
            self._owner_link = link
            self._give_to(sender)
            if message.param2:
                self.takeover_until_s = self._vehicle.time_s + TAKEOVER_WINDOW_S
        else:
            self._ack(link, message, mavlink.MAV_RESULT_FAILED)
            forward = mavlink.MAVLink_command_long_message(
                self.owner, 0, REQUEST_OPERATOR_CONTROL, 0, 1.0, message.param2, message.param3, float(sender), 0, 0, 0
            )
            self._vehicle.send(forward, self._owner_link)
