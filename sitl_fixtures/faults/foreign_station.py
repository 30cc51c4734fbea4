"""A foreign ground station (system id 99), one nobody knows of, speaking on the first link."""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl_fixtures.faults.fault import Acting
from sitl_fixtures.faults.faulty_vehicle import FaultyVehicle
from sitl_fixtures.mavlink.wire import Message

FOREIGN_SYSTEM_ID = 99


def inject(vehicle: FaultyVehicle, message: Message, system_id: int = FOREIGN_SYSTEM_ID) -> None:
    """A message from a foreign station, on the first link."""
    frame = message.pack(mavlink.MAVLink(None, system_id, 190))
    vehicle.handle(0, mavlink.MAVLink(None, 0, 0).parse_buffer(frame)[0])


def foreign_station_streams(acting: Acting, dt: float) -> None:
    """It streams set-points, 10 Hz, to a place the argument's metres north of where the vehicle was."""
    vehicle = acting.vehicle
    start = acting.memory.setdefault("from", vehicle.autopilot.position)
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


def foreign_station_beats(acting: Acting, dt: float) -> None:
    """Its heartbeats come in once a second."""
    if acting.vehicle.time_s >= acting.memory.get("next", 0.0):
        acting.memory["next"] = acting.vehicle.time_s + 1.0
        inject(acting.vehicle, mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))


def foreign_station_commands_return(acting: Acting) -> None:
    """It commands a return."""
    inject(
        acting.vehicle,
        mavlink.MAVLink_command_long_message(acting.vehicle.config.system_id, 1, 20, 0, 0, 0, 0, 0, 0, 0, 0),
    )


def foreign_station_sets_parameter(acting: Acting) -> None:
    """It sets a parameter: ``NAME=VALUE``."""
    name, _, value = acting.text.partition("=")
    parameter = acting.vehicle.parameters.find(name, -1)
    if parameter is None:
        return
    wire = acting.vehicle.parameters.wire_of(parameter, float(value))
    system_id = acting.vehicle.config.system_id
    message = mavlink.MAVLink_param_set_message(system_id, 1, name.encode(), wire, parameter.kind)
    inject(acting.vehicle, message)
