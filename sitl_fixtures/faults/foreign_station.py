"""A ground station nobody knows of (system id 99), speaking on the first link."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl_fixtures.faults.fault import Acting
from sitl_fixtures.mavlink.wire import Message

if TYPE_CHECKING:
    from sitl_fixtures.vehicle.vehicle import SimulatedAutopilot

STRANGER_SYSTEM_ID = 99


def inject(vehicle: SimulatedAutopilot, message: Message, system_id: int = STRANGER_SYSTEM_ID) -> None:
    """A message from a station nobody knows of, on the first link."""
    frame = message.pack(mavlink.MAVLink(None, system_id, 190))
    vehicle.handle(0, mavlink.MAVLink(None, 0, 0).parse_buffer(frame)[0])


def stranger_streams(acting: Acting, dt: float) -> None:
    """A stranger streams set-points, 10 Hz, to a place the argument's metres north of where the vehicle was."""
    vehicle = acting.vehicle
    start = acting.memory.setdefault("from", vehicle.personality.position)
    if vehicle.time_s < acting.memory.get("next", 0.0):
        return
    acting.memory["next"] = vehicle.time_s + 0.1
    inject(
        vehicle,
        mavlink.MAVLink_set_position_target_local_ned_message(
            0,
            vehicle.config.system_id,
            1,
            1,
            0xDF8,
            start[0] + acting.value,
            start[1],
            start[2],
            0,
            0,
            0,
            0,
            0,
            0,
            0,
            0,
        ),
    )


def stranger_beats(acting: Acting, dt: float) -> None:
    """A stranger's heartbeats come in once a second."""
    if acting.vehicle.time_s >= acting.memory.get("next", 0.0):
        acting.memory["next"] = acting.vehicle.time_s + 1.0
        inject(acting.vehicle, mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))


def stranger_commands_return(acting: Acting) -> None:
    """A stranger commands a return."""
    inject(
        acting.vehicle,
        mavlink.MAVLink_command_long_message(acting.vehicle.config.system_id, 1, 20, 0, 0, 0, 0, 0, 0, 0, 0),
    )


def stranger_sets_parameter(acting: Acting) -> None:
    """A stranger sets a parameter: ``NAME=VALUE``."""
    name, _, value = acting.text.partition("=")
    parameter = acting.vehicle.parameters.find(name, -1)
    if parameter is None:
        return
    wire = acting.vehicle.parameters.wire_of(parameter, float(value))
    system_id = acting.vehicle.config.system_id
    message = mavlink.MAVLink_param_set_message(system_id, 1, name.encode(), wire, parameter.kind)
    inject(acting.vehicle, message)
