"""What a part of the simulated vehicle may ask of the vehicle it belongs to.

The vehicle makes its parts (telemetry, transfers, the autopilot model, faults) and they speak back to it. Here stands
what all of them know of it, so that no part imports the vehicle. Rooms above ``mavlink``, which know its stores as
well, ask for more in a Protocol of their own: ``ModelledVehicle`` in ``autopilot``, ``FaultyVehicle`` in ``faults``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from random import Random
from typing import Any, Protocol

from sitl_fixtures.dynamics.battery import Battery
from sitl_fixtures.dynamics.estimator import Estimator
from sitl_fixtures.dynamics.guidance import Vector
from sitl_fixtures.dynamics.point_mass import PointMass


class ConfigProtocol(Protocol):
    """What the vehicle was made from; see `sitl_fixtures.vehicle.config.SimulatorConfig`."""

    @property
    def system_id(self) -> int:
        """The vehicle's own."""

    @property
    def speedup(self) -> float:
        """Vehicle seconds a wall second."""

    @property
    def tilt_deg(self) -> float | None:
        """Largest lean, degrees; None: by the parameters."""

    @property
    def firmware(self) -> str:
        """``4.6``, or empty for the newest."""


class AutopilotProtocol(Protocol):
    """What a service asks the autopilot model; see `sitl_fixtures.autopilot.model.AutopilotModel`."""

    armed: bool
    yaw_rad: float
    landed_state: int
    rotors: bool
    home: tuple[float, float, float] | None
    """Latitude and longitude, degrees, and altitude AMSL, m."""

    @property
    def mav_autopilot(self) -> int:
        """MAV_AUTOPILOT of its heartbeats."""

    @property
    def position(self) -> Vector:
        """The estimate, local NED, m."""

    @property
    def height_above_home_m(self) -> float:
        """Height above the home altitude by the estimate, m."""

    @property
    def acceptance_radius_m(self) -> float:
        """How near a waypoint counts as reached, m."""

    def home_local(self) -> Vector:
        """Home in the local frame, m."""

    def addressed(self, message: Any) -> bool:
        """Whether a command is for this vehicle."""

    def text(self, text: str, severity: int = ..., link: int | None = None) -> None:
        """Sends a STATUSTEXT on one link or all."""

    def heartbeat(self) -> Any:
        """HEARTBEAT as of now."""

    def position_target(self) -> Any | None:
        """POSITION_TARGET_LOCAL_NED as of now, None when none is sent."""

    def version(self) -> Any:
        """AUTOPILOT_VERSION."""


class VehicleProtocol(Protocol):
    """The vehicle as its parts see it. Times are seconds of the vehicle's clock since boot."""

    body: PointMass
    estimator: Estimator
    battery: Battery
    random: Random
    uid: bytes
    """The board's unique id, 18 bytes; zeros: it tells none."""
    time_s: float
    ready: bool
    gps_ok: bool

    @property
    def config(self) -> ConfigProtocol:
        """What it was made from."""

    @property
    def autopilot(self) -> AutopilotProtocol:
        """The model of the autopilot on board."""

    def send(self, message: Any, link: int | None = None) -> None:
        """Sends on one link, or on all."""

    def send_to(self, message: Any, links: Iterable[int]) -> None:
        """Sends on some links."""

    def send_raw(self, message_id: int, payload: bytes, crc_extra: int) -> None:
        """Sends a message the stock dialect does not know, on all links."""

    def broadcast_parameter(self, name: str) -> None:
        """Tells every link a parameter the autopilot changed by itself."""

    def after(self, delay_s: float, action: Callable[[], None]) -> None:
        """Does something later."""

    def defer(self, action: Callable[[], None]) -> None:
        """Does something when the message or step in hand is done with."""
