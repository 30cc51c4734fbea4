"""What differs between autopilots: modes, parameters and what they must be, habits, and how a setpoint is written.

Nobody else asks for an autopilot's name: a difference that matters somewhere is an attribute here.

Both stream position, velocity and acceleration under one mask (0x0C00: yaw and yaw rate ignored) for the whole
flight: ArduCopter starts its controller anew whenever the set of fields changes, and with yaw left to it the vehicle
follows the course within 4.3 degrees, so giving yaw buys nothing and spends control authority. The yaw field is filled
all the same, for readers of logs.

======== ===================================== ======================================================
PX4      SET_POSITION_TARGET_GLOBAL_INT (86)   frame 5, latitude, longitude, AMSL: PX4 projects by itself, and frames 6
                                               and 11 hang on a home altitude that it moves in flight
ArduPilot SET_POSITION_TARGET_LOCAL_NED (84)   frame 1 from its EKF origin by its own formula: message 86 silently
                                               drops the acceleration
======== ===================================== ======================================================

Velocity and acceleration go along true north and east at the vehicle, in true metres: an estimator's velocity is that
of its GNSS receiver, whatever its position projection does to lengths.
"""

from __future__ import annotations

import abc
import math
from collections.abc import Mapping
from typing import Any, Literal

from link.autopilot.failsafe_rule import FailsafeRule, UnsafeTogether
from link.autopilot.local_frame import EkfOrigin
from link.autopilot.parameter_catalogue import ParameterName, Values
from link.dialect import mavlink
from link.errors import UnsafeSetpoint
from link.microservices.mission_download import MissionTraits
from link.setpoints.setpoint import Setpoint

POSITION_VELOCITY_ACCELERATION = 0x0C00
AUTOPILOT_COMPONENT = 1

MAX_SPEED_M_S = 340.0
MAX_ACCELERATION_M_S2 = 200.0
ALTITUDE_BAND_AMSL_M = (-1_000.0, 20_000.0)
MAX_LOCAL_OFFSET_M = 1_000_000.0
"""float32 metres step by 6 cm there."""
MAX_LOCAL_LATITUDE_DEG = 85.0
"""ArduPilot's longitude scaling is meaningless near the poles."""
_UINT32 = 0xFFFFFFFF

ROTORCRAFT = frozenset({2, 3, 4, 13, 14, 15, 29, 35})
"""MAV_TYPE of what hovers on rotors alone."""
VTOL = frozenset(range(19, 26))
FENCE_HEIGHT, FENCE_CIRCLE, FENCE_POLYGONS = 1, 2, 4
"""Kinds of a vehicle's fence, as the bits of ArduPilot's FENCE_TYPE."""
_UNKNOWN_ACTION = "an action nobody knows"


class AutopilotProfile(abc.ABC):
    """One kind of autopilot. Instances are stateless; use `PROFILES`."""

    name: Literal["px4", "ardupilot"]
    title: str
    autopilot_id: int
    """MAV_AUTOPILOT in its HEARTBEAT."""
    setpoint_message_id: int
    coordinate_frame: int
    type_mask = POSITION_VELOCITY_ACCELERATION
    needs_origin: bool
    """Whether `encode` needs the vehicle's EKF origin."""
    offboard_mode: str
    hold_mode: str
    """A mode that keeps its place without a pilot's radio."""
    return_mode: str
    land_mode: str
    modes: Mapping[str, int]
    """Mode names to custom_mode numbers."""
    stream_before_offboard_s: float
    """How long setpoints must have been arriving before the mode is asked for."""
    parameter_encoding: Literal["bytewise", "c_cast"]
    parameters: tuple[ParameterName, ...]
    mission: MissionTraits
    oldest_firmware: tuple[int, int]
    """What this profile was made for."""
    airframes: frozenset[int]
    """MAV_TYPEs that hover and take position setpoints under this firmware."""
    binding_speeds: bool
    """Whether `parameters` ``max_speed``, ``max_climb`` and ``max_descent`` bound position setpoints too."""
    climbs_by_command: bool
    """Takes off by MAV_CMD_NAV_TAKEOFF, which a setpoint would abort; otherwise a stream of setpoints lifts it."""
    resumes_offboard_unasked: bool
    """Takes a stream that comes back for leave to go on with it: it must be put on hold first."""
    target_runs_on: bool
    """Moves its target on along the setpoint's velocity until the next one comes."""
    filters_station_ids: bool
    """Can be told by parameters which ground stations' system ids it hears, as a range or one alone."""
    estimator_message_id: int
    """The message that tells how well its estimator knows its place."""
    rally_frame: int
    """MAV_FRAME in which its rally points are written."""
    fence_actions: Mapping[int, str]
    """What it does beyond its fence, in words, by the value of its parameter ``fence_action``."""
    harmless_fence_actions: frozenset[int]
    """Those of `fence_actions` that leave the flight alone."""
    fence_switches: Mapping[str, int]
    """Bits to set, parameter by parameter and in this order, for a polygon laid to come into force."""

    @abc.abstractmethod
    def failsafe_rules(self, least_s: float) -> tuple[FailsafeRule, ...]:
        """What its failsafe parameters must be, for a stream whose silence of up to ``least_s`` must be borne."""

    @abc.abstractmethod
    def unsafe_together(self, values: Values) -> list[UnsafeTogether]:
        """Parameters each fine by itself and unsafe beside another."""

    @abc.abstractmethod
    def fence_kinds(self, values: Values) -> int | None:
        """The kinds of fence in force, bits of `FENCE_HEIGHT` and its like; None where it does not tell which."""

    def encode(
        self,
        setpoint: Setpoint,
        *,
        target_system: int,
        target_component: int = AUTOPILOT_COMPONENT,
        time_boot_ms: int | None = None,
        origin: EkfOrigin | None = None,
    ) -> Any:
        """The setpoint as this autopilot's message. ``time_boot_ms`` defaults to T+ (no autopilot reads it).

        Raises `UnsafeSetpoint` for anything not finite or out of range, `MissingOrigin` where ``origin`` is needed.
        """
        if time_boot_ms is None:
            check_range("time_s", setpoint.time_s, 0.0, _UINT32 / 1000.0)
            time_boot_ms = int(setpoint.time_s * 1000.0)
        check_range("time_boot_ms", time_boot_ms, 0, _UINT32)
        check_range("target_system", target_system, 1, 255)
        check_range("target_component", target_component, 0, 255)
        check_range("lat_deg", setpoint.lat_deg, -90.0, 90.0)
        check_range("lon_deg", setpoint.lon_deg, -180.0, 180.0)
        check_range("alt_amsl_m", setpoint.alt_amsl_m, *ALTITUDE_BAND_AMSL_M)
        check_range("yaw_deg", setpoint.yaw_deg, -360.0, 360.0)
        for axis, speed in zip("ned", setpoint.velocity_ned_m_s, strict=True):
            check_range(f"v{axis}_m_s", speed, -MAX_SPEED_M_S, MAX_SPEED_M_S)
        for axis, acceleration in zip("ned", setpoint.acceleration_ned_m_s2, strict=True):
            check_range(f"a{axis}_m_s2", acceleration, -MAX_ACCELERATION_M_S2, MAX_ACCELERATION_M_S2)
        return self._message(
            setpoint,
            (int(time_boot_ms), int(target_system), int(target_component)),
            math.remainder(math.radians(setpoint.yaw_deg), math.tau),
            origin,
        )

    @abc.abstractmethod
    def _message(self, setpoint: Setpoint, head: tuple[int, int, int], yaw_rad: float, origin: EkfOrigin | None) -> Any:
        """The message of a checked setpoint."""

    @staticmethod
    @abc.abstractmethod
    def _project(origin: EkfOrigin, lat_deg: float, lon_deg: float) -> tuple[float, float]: ...

    @staticmethod
    @abc.abstractmethod
    def _unproject(origin: EkfOrigin, north_m: float, east_m: float) -> tuple[float, float]: ...

    @abc.abstractmethod
    def _mode_words(self, custom_mode: int) -> tuple[float, float]: ...

    def north_east_m(self, origin: EkfOrigin, lat_deg: float, lon_deg: float) -> tuple[float, float]:
        """Where the vehicle's own projection puts a place, from its EKF origin."""
        return self._project(origin, lat_deg, lon_deg)

    def lat_lon_deg(self, origin: EkfOrigin, north_m: float, east_m: float) -> tuple[float, float]:
        """Inverse of `north_east_m`: the place behind a LOCAL_POSITION_NED."""
        return self._unproject(origin, north_m, east_m)

    def set_mode_parameters(self, mode: str) -> tuple[float, float, float, float, float, float, float]:
        """The seven parameters of MAV_CMD_DO_SET_MODE for a mode of `modes`; `KeyError` for any other."""
        flag = float(mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED)
        return (flag, *self._mode_words(self.modes[mode]), 0.0, 0.0, 0.0, 0.0)

    def mode_of(self, heartbeat: Any) -> str:
        """Mode name from a HEARTBEAT, ``"mode N"`` where the number is not known."""
        number = self._mode_number(heartbeat.custom_mode)
        for name, known in self.modes.items():
            if known == number:
                return name
        return f"mode {heartbeat.custom_mode}"

    def is_offboard(self, heartbeat: Any) -> bool:
        """Whether the vehicle follows setpoints. Believe this alone: PX4 acknowledges the mode without taking it."""
        return self.mode_of(heartbeat) == self.offboard_mode

    def _mode_number(self, custom_mode: int) -> int:
        return custom_mode

    def fence_action(self, values: Values) -> tuple[str, bool]:
        """What it does beyond its fence, in words, and whether that leaves the flight alone."""
        action = self.measure(values, "fence_action")
        if action is None:
            return _UNKNOWN_ACTION, False
        return self.fence_actions.get(int(action), _UNKNOWN_ACTION), int(action) in self.harmless_fence_actions

    def parameter(self, key: str) -> ParameterName:
        """The parameter known here as ``key``; `KeyError` for any other."""
        for parameter in self.parameters:
            if parameter.key == key:
                return parameter
        raise KeyError(key)

    def measure(self, values: Values, key: str) -> float | None:
        """What was read of a parameter, in the unit of its `ParameterName`; None where nothing was."""
        parameter = values.get(key)
        return None if parameter is None else self.parameter(key).measure(parameter)


def check_range(field: str, value: float, low: float, high: float) -> None:
    """Raise `UnsafeSetpoint` for a value outside ``low`` to ``high``; NaN is outside."""
    if not low <= value <= high:
        raise UnsafeSetpoint(field, value, f"{low:g} to {high:g}")
