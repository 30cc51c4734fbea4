"""What differs between autopilots, as data and one method: modes, parameters, and how a setpoint is written.

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

from link.autopilot.local_frame import EkfOrigin
from link.autopilot.parameter_names import ParameterName
from link.dialect import mavlink
from link.errors import UnsafeSetpoint
from link.microservices.mission_download import MissionTraits
from link.microservices.parameter_value import Parameter
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
    min_stream_hz: float
    """A slower stream counts as lost."""
    parameter_encoding: Literal["bytewise", "c_cast"]
    parameters: tuple[ParameterName, ...]
    mission: MissionTraits

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
            _check("time_s", setpoint.time_s, 0.0, _UINT32 / 1000.0)
            time_boot_ms = int(setpoint.time_s * 1000.0)
        _check("time_boot_ms", time_boot_ms, 0, _UINT32)
        _check("target_system", target_system, 1, 255)
        _check("target_component", target_component, 0, 255)
        _check("lat_deg", setpoint.lat_deg, -90.0, 90.0)
        _check("lon_deg", setpoint.lon_deg, -180.0, 180.0)
        _check("alt_amsl_m", setpoint.alt_amsl_m, *ALTITUDE_BAND_AMSL_M)
        _check("yaw_deg", setpoint.yaw_deg, -360.0, 360.0)
        for axis, speed in zip("ned", setpoint.velocity_ned_m_s, strict=True):
            _check(f"v{axis}_m_s", speed, -MAX_SPEED_M_S, MAX_SPEED_M_S)
        for axis, acceleration in zip("ned", setpoint.acceleration_ned_m_s2, strict=True):
            _check(f"a{axis}_m_s2", acceleration, -MAX_ACCELERATION_M_S2, MAX_ACCELERATION_M_S2)
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

    def is_autopilot(self, heartbeat: Any) -> bool:
        """Whether a HEARTBEAT is the flight controller's own: gimbals and modems of the vehicle send them too."""
        return bool(
            heartbeat.get_type() == "HEARTBEAT"
            and heartbeat.get_srcComponent() == AUTOPILOT_COMPONENT
            and heartbeat.autopilot == self.autopilot_id
            and heartbeat.type != mavlink.MAV_TYPE_GCS
        )

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

    def is_armed(self, heartbeat: Any) -> bool:
        """Whether the motors are armed, from a HEARTBEAT."""
        return bool(heartbeat.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)

    def _mode_number(self, custom_mode: int) -> int:
        return custom_mode

    def parameter(self, key: str) -> ParameterName:
        """The parameter known here as ``key``; `KeyError` for any other."""
        for parameter in self.parameters:
            if parameter.key == key:
                return parameter
        raise KeyError(key)

    def measure(self, values: Mapping[str, Parameter | None], key: str) -> float | None:
        """What was read of a parameter, in the unit of its `ParameterName`; None where nothing was."""
        parameter = values.get(key)
        return None if parameter is None else self.parameter(key).measure(parameter)


def _check(field: str, value: float, low: float, high: float) -> None:
    # Written so that NaN fails it.
    if not low <= value <= high:
        raise UnsafeSetpoint(field, value, f"{low:g} to {high:g}")
