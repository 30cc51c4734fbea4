"""The vehicle as a fault sees it: all the autopilot model may touch, and what only a fault does."""

from __future__ import annotations

from typing import Protocol

from sitl_fixtures.autopilot.model import AutopilotModel, ModelledVehicle
from sitl_fixtures.mavlink.wire import Message, Port


class FaultyVehicle(ModelledVehicle, Protocol):
    """A vehicle whose parts can be made to fail.

    Attributes:
        ports: the links' ends.
        hung: whether it takes no step and gives no answer.
        rotors_stopped: whether the rotors give nothing, whatever the autopilot asks.
        clock_rate: vehicle seconds a second of the caller's clock.
    """

    ports: list[Port]
    hung: bool
    rotors_stopped: bool
    clock_rate: float

    @property
    def autopilot(self) -> AutopilotModel:
        """The model of the autopilot on board."""

    def handle(self, link: int, message: Message) -> None:
        """One message that came in on a link."""
