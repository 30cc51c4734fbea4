"""A command as an autopilot sees it, and the results it may be answered with."""

from __future__ import annotations

from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl_fixtures.mavlink.wire import Message

ACCEPTED: int = mavlink.MAV_RESULT_ACCEPTED
TEMPORARILY_REJECTED: int = mavlink.MAV_RESULT_TEMPORARILY_REJECTED
DENIED: int = mavlink.MAV_RESULT_DENIED
UNSUPPORTED: int = mavlink.MAV_RESULT_UNSUPPORTED
FAILED: int = mavlink.MAV_RESULT_FAILED

FORCE_DISARM = 21196.0


@dataclass(slots=True)
class Command:
    """A command, whichever of COMMAND_LONG and COMMAND_INT it came in."""

    link: int
    system_id: int
    component_id: int
    number: int
    params: tuple[float, float, float, float, float, float, float]
    frame: int | None
    target_system: int
    target_component: int

    @classmethod
    def of(cls, link: int, message: Message) -> Command:
        """The command in a message."""
        if message.get_type() == "COMMAND_INT":
            tail = (message.x / 1e7, message.y / 1e7, message.z)
            frame: int | None = message.frame
        else:
            tail = (message.param5, message.param6, message.param7)
            frame = None
        head = (message.param1, message.param2, message.param3, message.param4)
        return cls(
            link,
            message.get_srcSystem(),
            message.get_srcComponent(),
            message.command,
            (*head, *tail),
            frame,
            message.target_system,
            message.target_component,
        )
