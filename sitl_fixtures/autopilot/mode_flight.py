"""What flying a mode is in both autopilots: standing disarmed, resting on the ground, walking through a mission."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Generic, TypeVar

from sitl_fixtures.autopilot.model import IN_AIR, ON_GROUND, AutopilotModel
from sitl_fixtures.dynamics.guidance import ZERO, Vector

Model = TypeVar("Model", bound=AutopilotModel)


class ModeFlight(ABC, Generic[Model]):
    """One step of whatever mode is on; leaves the acceleration asked for in the autopilot's ``command``."""

    def __init__(self, autopilot: Model) -> None:
        self._autopilot = autopilot

    @abstractmethod
    def tick(self, dt: float) -> None:
        """One step."""

    @abstractmethod
    def _return(self, dt: float) -> None: ...

    @abstractmethod
    def _land(self, dt: float) -> None: ...

    @abstractmethod
    def _fly_leg(self, place: Vector, dt: float) -> None:
        """Flies on towards a place of the mission."""

    def _stand_disarmed(self) -> None:
        autopilot = self._autopilot
        autopilot.command, autopilot.rotors = ZERO, False
        autopilot.landed_state = ON_GROUND if autopilot.vehicle.body.on_ground else IN_AIR

    def _rest(self) -> None:
        """Stands on the ground, armed."""
        autopilot = self._autopilot
        autopilot.guidance.reset()
        autopilot.guidance.tracker.reset()
        autopilot.command = ZERO
        autopilot.landed_state = ON_GROUND

    def _still_over(self, place: Vector) -> bool:
        """Whether a return has come to rest over its place."""
        autopilot = self._autopilot
        return autopilot.guidance.off_m(place) < 2.0 and autopilot.vehicle.body.speed_m_s < 0.5

    def _mission(self, dt: float) -> None:
        autopilot = self._autopilot
        leg = autopilot.mission_flight.leg()
        if leg is None:
            autopilot.command = autopilot.guidance.go_to(autopilot.hold_at, dt)
        elif leg.kind == "return":
            self._return(dt)
        elif leg.kind == "land":
            autopilot.hold_at = leg.position
            self._land(dt)
        else:
            self._fly_leg(leg.position, dt)
