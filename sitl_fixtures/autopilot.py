"""What the two autopilots have in common: state, addressing, the shape of a command and of an answer.

A personality is told of every message and of every step; it decides what is obeyed, what is answered, in which order.
What differs between autopilots lives in ``ardupilot.py`` and ``px4.py``.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl_fixtures.dynamics.guidance import ZERO, Guidance, Vector
from sitl_fixtures.mavlink.mission_protocol import Manners
from sitl_fixtures.mavlink.parameters import Parameter, Row
from sitl_fixtures.mavlink.wire import Message

if TYPE_CHECKING:
    from sitl_fixtures.dynamics.estimator import OffsetProjection, SphereProjection
    from sitl_fixtures.vehicle.vehicle import SimulatedAutopilot

ACCEPTED = mavlink.MAV_RESULT_ACCEPTED
TEMPORARILY_REJECTED = mavlink.MAV_RESULT_TEMPORARILY_REJECTED
DENIED = mavlink.MAV_RESULT_DENIED
UNSUPPORTED = mavlink.MAV_RESULT_UNSUPPORTED
FAILED = mavlink.MAV_RESULT_FAILED

REQUEST_OPERATOR_CONTROL = 32100
FORCE_DISARM = 21196.0
INFO, WARNING, CRITICAL = mavlink.MAV_SEVERITY_INFO, mavlink.MAV_SEVERITY_WARNING, mavlink.MAV_SEVERITY_CRITICAL

LANDED_UNDEFINED, ON_GROUND, IN_AIR, TAKING_OFF, LANDING = 0, 1, 2, 3, 4


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


class Personality(ABC):
    """State and manners of an autopilot. See ``ardupilot.ArduCopter`` and ``px4.Px4``."""

    NAME: ClassVar[str]
    AUTOPILOT: ClassVar[int]
    PROJECTION: ClassVar[type[SphereProjection] | type[OffsetProjection]]
    PARAMETERS: ClassVar[list[Row]]
    BITWISE_PARAMETERS: ClassVar[bool]
    MISSIONS: ClassVar[Manners]
    ORIGIN_AT: ClassVar[float]
    """Share of the start-up after which the EKF origin is laid."""
    guidance: Guidance

    def __init__(self, vehicle: SimulatedAutopilot) -> None:
        self.vehicle = vehicle
        self.params = vehicle.parameters
        self.armed = False
        self.yaw_rad = 0.0
        self.yaw_target_rad: float | None = None
        self.landed_state = ON_GROUND
        self.home: tuple[float, float, float] | None = None
        self.command: Vector = ZERO
        self.rotors = False
        self.failsafe_active = False
        self.armed_at_s = 0.0

    # -- to be told ---------------------------------------------------------------------------------------------------

    @abstractmethod
    def refresh(self) -> None:
        """Parameters changed: takes over what is derived from them."""

    @abstractmethod
    def tick(self, dt: float) -> None:
        """One step of the mode logic; leaves ``command`` and ``rotors`` for the aircraft."""

    @abstractmethod
    def force_mode(self, kind: str) -> None:
        """Changes the mode without a command: ``hold``, ``return``, ``land`` or ``pilot`` (a manual mode)."""

    @abstractmethod
    def slow_tick(self, dt: float) -> None:
        """What need not be looked at in every step."""

    @abstractmethod
    def heard_from(self, link: int, message: Message) -> bool:
        """Whether a message is let in at all (ownership)."""

    @abstractmethod
    def on_heartbeat(self, link: int, message: Message) -> None:
        """A ground station's heartbeat."""

    @abstractmethod
    def on_setpoint_local(self, link: int, message: Message) -> None:
        """SET_POSITION_TARGET_LOCAL_NED (84)."""

    @abstractmethod
    def on_setpoint_global(self, link: int, message: Message) -> None:
        """SET_POSITION_TARGET_GLOBAL_INT (86)."""

    @abstractmethod
    def addressed(self, message: Message) -> bool:
        """Whether a command is for this vehicle."""

    @abstractmethod
    def parameters_for(self, message: Message) -> bool:
        """Whether a parameter message is for this vehicle."""

    @abstractmethod
    def set_mode(self, link: int, message: Message) -> None:
        """The old SET_MODE (11)."""

    @abstractmethod
    def text(self, text: str, severity: int = INFO, link: int | None = None) -> None:
        """Sends a STATUSTEXT, cut up the autopilot's way, on one link or all."""

    @abstractmethod
    def on_origin(self) -> None:
        """The EKF origin has been laid."""

    @abstractmethod
    def on_ready(self) -> None:
        """The position estimate has come up."""

    @abstractmethod
    def named_index(self, parameter: Parameter) -> int:
        """The index reported for a parameter read or set by name."""

    @abstractmethod
    def on_parameter_set(self, link: int, parameter: Parameter) -> None:
        """A parameter was set on a link: tells of it."""

    @abstractmethod
    def on_setup_signing(self, link: int, message: Message) -> None:
        """SETUP_SIGNING (256)."""

    @abstractmethod
    def on_command(self, command: Command) -> None:
        """A command addressed to this vehicle."""

    # -- to be asked --------------------------------------------------------------------------------------------------

    @abstractmethod
    def heartbeat(self) -> Message:
        """HEARTBEAT as of now."""

    @abstractmethod
    def position_target(self) -> Message | None:
        """POSITION_TARGET_LOCAL_NED as of now, None when none is sent."""

    @abstractmethod
    def version(self) -> Message:
        """AUTOPILOT_VERSION."""

    @property
    @abstractmethod
    def mode_name(self) -> str:
        """The mode in words."""

    @property
    @abstractmethod
    def acceptance_radius_m(self) -> float:
        """How near a waypoint counts as reached, m."""

    # -- shared -------------------------------------------------------------------------------------------------------

    def ack(self, command: Command, result: int) -> None:
        """COMMAND_ACK on the link the command came from."""
        self.vehicle.send(
            mavlink.MAVLink_command_ack_message(command.number, result, 0, 0, command.system_id, command.component_id),
            command.link,
        )

    def accepted(self, link: int, system_id: int, message: str, target: dict[str, object]) -> None:
        """Notes a set-point that was obeyed."""
        self.vehicle.note_setpoint(link, system_id, message, target)

    @property
    def position(self) -> Vector:
        """The estimate, local NED, m."""
        estimate = self.vehicle.estimator
        return estimate.n, estimate.e, estimate.d

    @property
    def velocity(self) -> Vector:
        """Velocity along north, east, down, m/s."""
        body = self.vehicle.body
        return body.vn, body.ve, body.vd

    @property
    def height_above_home_m(self) -> float:
        """Height above the home altitude by the estimate, m."""
        origin = self.vehicle.estimator.origin
        base = self.home[2] if self.home is not None else self.vehicle.body.ground_m
        return (origin[2] - self.vehicle.estimator.d if origin is not None else self.vehicle.body.height_m) - base

    def home_local(self) -> Vector:
        """Home in the local frame, m; the origin when there is no home."""
        estimate = self.vehicle.estimator
        if self.home is None or estimate.projection is None or estimate.origin is None:
            return ZERO
        north, east = estimate.projection.to_local(math.radians(self.home[0]), math.radians(self.home[1]))
        return north, east, estimate.origin[2] - self.home[2]

    def turn_yaw(self, dt: float, rate_rad_s: float) -> None:
        """Turns towards the yaw wanted; without one, along the course."""
        body = self.vehicle.body
        target = self.yaw_target_rad
        if target is None:
            if body.vn * body.vn + body.ve * body.ve < 1.0:
                return
            target = math.atan2(body.ve, body.vn)
        error = math.remainder(target - self.yaw_rad, 2.0 * math.pi)
        if error == 0.0:
            return
        most = rate_rad_s * dt
        self.yaw_rad = math.remainder(self.yaw_rad + max(-most, min(most, error)), 2.0 * math.pi)
