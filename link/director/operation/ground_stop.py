"""A flight ended on the ground: motors off, what was changed on the vehicle given back."""

from __future__ import annotations

from collections.abc import Callable

from gcs.flight import FlightState
from gcs.operator_commands import STOP_LIMIT_S
from link.dialect import mavlink
from link.session.context import FlightContext
from link.session.procedure import Refused, Steps

REASK_S = 1.5
"""More than a beat of a 1 Hz HEARTBEAT."""


def stop_on_ground(flight: FlightContext, restore: Callable[[], Steps[None]], reason: str) -> Steps[None]:
    """Disarm as often as it takes, restore, and end the flight. Raises `Refused` where the vehicle never armed.

    While arming, a HEARTBEAT that shows motors off proves nothing yet: an arm command may be under way, and is taken
    back.
    """
    timeline, vehicle, control = flight.timeline, flight.vehicle, flight.control
    control.commander.cancel_all()
    since_s, armed = timeline.now_s, False
    arming = timeline.state is FlightState.ARMING
    while control.gate.in_force is not None and (arming or vehicle.armed):
        if timeline.now_s - since_s >= STOP_LIMIT_S:
            timeline.alarm("the vehicle does not disarm")
            timeline.become(FlightState.LOST, f"{reason}; on the ground, armed, does not disarm")
            return
        ticket = control.start_command("disarm", mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (0.0,))
        asked_s = timeline.now_s
        while timeline.now_s - asked_s < REASK_S:
            armed = armed or vehicle.armed
            yield
        control.commander.cancel(ticket)
        arming = arming and not vehicle.disarmed_since(since_s + REASK_S)
    yield from restore()
    if armed:
        timeline.become(FlightState.CONTINGENCY, f"{reason}; disarmed again on the ground")
        return
    raise Refused(reason)
