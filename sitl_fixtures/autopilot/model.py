"""What the two autopilot models have in common: state, addressing, the shape of an answer.

A model is told of every message and of every step; it decides what is obeyed, what is answered, in which order. What
differs between autopilots lives in ``ardupilot`` and ``px4``.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import ClassVar, Protocol

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl_fixtures.autopilot.command import Command
from sitl_fixtures.autopilot.mission_flight import MissionFlight
from sitl_fixtures.dynamics.estimator import OffsetProjection, SphereProjection
from sitl_fixtures.dynamics.guidance import ZERO, Guidance, Vector
from sitl_fixtures.mavlink.mission_protocol import Missions, TransferRules
from sitl_fixtures.mavlink.parameters import Parameter, ParameterSet, Row
from sitl_fixtures.mavlink.signing import Signing
from sitl_fixtures.mavlink.telemetry import Telemetry
from sitl_fixtures.mavlink.wire import Message
from sitl_fixtures.vehicle_protocol import VehicleProtocol

INFO, WARNING, CRITICAL = mavlink.MAV_SEVERITY_INFO, mavlink.MAV_SEVERITY_WARNING, mavlink.MAV_SEVERITY_CRITICAL
ON_GROUND, IN_AIR, TAKING_OFF, LANDING = 1, 2, 3, 4
"""MAV_LANDED_STATE."""


class ModelledVehicle(VehicleProtocol, Protocol):
    """The vehicle as its autopilot model sees it."""

    parameters: ParameterSet
    missions: Missions
    telemetry: Telemetry
    signing: Signing

    def send_parameter(self, parameter: Parameter, link: int | None, index: int | None = None) -> None:
        """PARAM_VALUE on one link or all; ``index`` as the autopilot reports it."""

    def set_aircraft(self, *, tilt_deg: float, drag_linear_1_s: float | None = None) -> None:
        """Lean and drag of the aircraft, from parameters and options."""

    def note_setpoint(self, link: int, system_id: int, message: str, target: dict[str, object]) -> None:
        """Logs a set-point that was obeyed."""

    def injected_arming_refusals(self) -> list[str]:
        """Reasons not to arm that injected faults give."""

    def reboot(self) -> None:
        """Starts the autopilot anew."""


class AutopilotModel(ABC):
    """State and behaviour of an autopilot. See ``ardupilot.autopilot.ArduCopter`` and ``px4.autopilot.Px4``.

    Attributes:
        armed, armed_at_s: whether the motors are armed, and since when.
        yaw_rad, yaw_target_rad: heading, and the one wanted; None: along the course.
        landed_state: MAV_LANDED_STATE.
        home: latitude and longitude, degrees, and altitude AMSL, m.
        command, rotors: what is asked of the aircraft in this step: acceleration (NED, m/s^2) and thrust at all.
        hold_at: the place the mode in hand holds or goes to, local NED, m.
        stage: how far a return has come; empty when it has not begun.
        landed_for_s: how long it has stood on the ground after a landing, s.
        failsafe_active: whether a failsafe chose the mode.
    """

    mav_autopilot: ClassVar[int]
    PROJECTION: ClassVar[type[SphereProjection] | type[OffsetProjection]]
    PARAMETERS: ClassVar[list[Row]]
    BITWISE_PARAMETERS: ClassVar[bool]
    MISSIONS: ClassVar[TransferRules]
    ORIGIN_AT: ClassVar[float]
    """Share of the start-up after which the EKF origin is laid."""
    guidance: Guidance

    def __init__(self, vehicle: ModelledVehicle) -> None:
        self.vehicle = vehicle
        self.params = vehicle.parameters
        self.mission_flight = MissionFlight(vehicle, vehicle.missions, vehicle.parameters)
        self.armed = False
        self.yaw_rad = 0.0
        self.yaw_target_rad: float | None = None
        self.landed_state = ON_GROUND
        self.home: tuple[float, float, float] | None = None
        self.command: Vector = ZERO
        self.hold_at: Vector = ZERO
        self.stage = ""
        self.landed_for_s = 0.0
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

    @abstractmethod
    def arming_refusals(self) -> list[str]:
        """Reasons not to arm."""

    # -- shared -------------------------------------------------------------------------------------------------------

    def arm(self) -> None:
        """Arms: home is set where the vehicle stands."""
        self.armed = True
        self.armed_at_s = self.vehicle.time_s
        self.set_home_here()

    def set_home_here(self) -> None:
        """Home is where the vehicle stands."""
        self.home = self.vehicle.telemetry.believed_place()

    def lean_deg(self, by_parameter_deg: float) -> float:
        """Largest lean of the aircraft, degrees: the option's when there is one, else the parameter's."""
        tilt_deg = self.vehicle.config.tilt_deg
        return max(10.0, min(80.0, by_parameter_deg if tilt_deg is None else tilt_deg))

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
    def home_alt_amsl_m(self) -> float:
        """Altitude of home AMSL, m; of the ground when there is no home."""
        return self.home[2] if self.home is not None else self.vehicle.body.ground_m

    @property
    def height_above_home_m(self) -> float:
        """Height above the home altitude by the estimate, m."""
        estimate = self.vehicle.estimator
        here = estimate.origin[2] - estimate.d if estimate.origin is not None else self.vehicle.body.height_m
        return here - self.home_alt_amsl_m

    def home_local(self) -> Vector:
        """Home in the local frame, m; the origin when there is no home."""
        estimate = self.vehicle.estimator
        if self.home is None or estimate.projection is None or estimate.origin is None:
            return ZERO
        north, east = estimate.projection.to_local(math.radians(self.home[0]), math.radians(self.home[1]))
        return north, east, estimate.origin[2] - self.home[2]

    def return_place(self) -> Vector:
        """Where a return goes to from here, local NED, m: a rally point or home."""
        return self.mission_flight.rally_place() or self.home_local()

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
