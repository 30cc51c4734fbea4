"""The catalogue of the vehicle's parameters a flight asks for: names old and new, units, what each is for.

A name asked for may be unknown (the answer is silence), so every name of a parameter is asked for and the newest that
answers counts. ArduCopter 4.7 began to give its parameters new names in metres and degrees; `ParameterName.measure`
turns whichever answered into one unit.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from link.microservices.parameter_value import Parameter

Values = Mapping[str, Parameter | None]
"""What was read of a vehicle's parameters, by `ParameterName.key`; None where it told none of the names."""


@dataclass(frozen=True)
class ParameterName:
    """A parameter a preflight check reads: ``names`` newest first, as the vehicle may know any one of them.

    ``unit`` is the unit of `measure`; ``factors``, one a name, lead to it from the vehicle's own (none: all 1).
    ``newer`` says that some firmware still flown has it under none of the names.
    """

    key: str
    names: tuple[str, ...]
    integer: bool
    unit: str
    purpose: str
    factors: tuple[float, ...] = ()
    newer: bool = False

    def measure(self, parameter: Parameter) -> float:
        """The value in ``unit``. Raises `ValueError` for a parameter of another name."""
        at = self.names.index(parameter.name)
        return float(parameter.value) * (self.factors[at] if self.factors else 1.0)


def one(key: str, name: str, unit: str, purpose: str, *, integer: bool = False, newer: bool = False) -> ParameterName:
    """A parameter that has always had one name."""
    return ParameterName(key, (name,), integer, unit, purpose, (), newer)


PX4_PARAMETERS = (
    one("offboard_loss_timeout", "COM_OF_LOSS_T", "s", "silence until the stream counts as lost"),
    one("offboard_loss_action", "COM_OBL_RC_ACT", "", "what it does then", integer=True),
    one(
        "offboard_loss_action_no_rc",
        "COM_OBL_ACT",
        "",
        "what it does then without a pilot's radio (up to 1.13)",
        integer=True,
        newer=True,
    ),
    one("data_link_loss_action", "NAV_DLL_ACT", "", "what it does without any station's heartbeat", integer=True),
    one("data_link_loss_timeout", "COM_DL_LOSS_T", "s", "silence until that", integer=True),
    one(
        "rc_loss_exceptions",
        "COM_RCL_EXCEPT",
        "bits",
        "modes in which a missing pilot's radio is fine",
        integer=True,
    ),
    one("rc_loss_action", "NAV_RCL_ACT", "", "what it does without a pilot's radio", integer=True),
    one("rc_input_mode", "COM_RC_IN_MODE", "", "where pilot's input comes from", integer=True),
    one("battery_action", "COM_LOW_BAT_ACT", "", "what it does when the battery is critical", integer=True),
    one("battery_critical", "BAT_CRIT_THR", "share", "charge at which it does so"),
    one("battery_emergency", "BAT_EMERGEN_THR", "share", "charge at which it lands where it is"),
    one(
        "position_loss_action",
        "COM_POSCTL_NAVL",
        "",
        "what it does without a position estimate",
        integer=True,
        newer=True,
    ),
    one("position_error_limit", "COM_POS_FS_EPH", "m", "error from which its position counts as lost", newer=True),
    one("return_type", "RTL_TYPE", "", "where a return goes", integer=True),
    one("return_altitude", "RTL_RETURN_ALT", "m", "height of the return above home"),
    one("return_speed", "MPC_XY_CRUISE", "m/s", "speed of a return"),
    one("fence_action", "GF_ACTION", "", "what it does beyond its fence", integer=True),
    one("fence_radius", "GF_MAX_HOR_DIST", "m", "distance from home it may go, 0: any"),
    one("fence_height", "GF_MAX_VER_DIST", "m", "height above home it may go, 0: any"),
    one("max_speed", "MPC_XY_VEL_MAX", "m/s", "horizontal speed limit"),
    one("max_climb", "MPC_Z_VEL_MAX_UP", "m/s", "climb limit"),
    one("max_descent", "MPC_Z_VEL_MAX_DN", "m/s", "descent limit"),
    one("max_acceleration", "MPC_ACC_HOR", "m/s^2", "horizontal acceleration limit"),
    one("max_tilt", "MPC_TILTMAX_AIR", "deg", "lean limit"),
    one("system_id", "MAV_SYS_ID", "", "the vehicle's own MAVLink id", integer=True),
)

ARDUPILOT_PARAMETERS = (
    one("offboard_loss_timeout", "GUID_TIMEOUT", "s", "silence until it brakes and flies back"),
    one("guided_options", "GUID_OPTIONS", "bits", "what GUIDED allows", integer=True),
    one("gcs_failsafe", "FS_GCS_ENABLE", "", "what it does without the owner's heartbeat", integer=True),
    one("gcs_failsafe_timeout", "FS_GCS_TIMEOUT", "s", "silence until that"),
    one("failsafe_options", "FS_OPTIONS", "bits", "exceptions from failsafes", integer=True),
    one("ekf_failsafe", "FS_EKF_ACTION", "", "what it does without a position estimate", integer=True),
    one("ekf_threshold", "FS_EKF_THRESH", "", "variance from which its estimate counts as lost"),
    one("battery_action", "BATT_FS_LOW_ACT", "", "what it does when the battery is low", integer=True),
    one("battery_critical_action", "BATT_FS_CRT_ACT", "", "what it does when the battery is critical", integer=True),
    one("battery_low_voltage", "BATT_LOW_VOLT", "V", "voltage that is low, 0: none"),
    one("battery_low_charge", "BATT_LOW_MAH", "mAh", "charge left that is low, 0: none"),
    ParameterName(
        "gcs_system_id", ("MAV_GCS_SYSID", "SYSID_MYGCS"), True, "", "station in control, or the lowest of a range"
    ),
    one("gcs_system_id_high", "MAV_GCS_SYSID_HI", "", "highest station of the range", integer=True, newer=True),
    ParameterName("enforce_gcs", ("MAV_OPTIONS", "SYSID_ENFORCE"), True, "bits", "bit 0: other stations are not heard"),
    ParameterName("system_id", ("MAV_SYSID", "SYSID_THISMAV"), True, "", "the vehicle's own MAVLink id"),
    ParameterName(
        "return_altitude", ("RTL_ALT_M", "RTL_ALT"), False, "m", "height of the return above home", (1.0, 0.01)
    ),
    ParameterName(
        "return_speed",
        ("RTL_SPEED_MS", "RTL_SPEED"),
        False,
        "m/s",
        "speed of a return, 0: its own navigation's",
        (1.0, 0.01),
    ),
    one("rally_limit", "RALLY_LIMIT_KM", "km", "distance from which rally points do not count, 0: any"),
    one("rally_home", "RALLY_INCL_HOME", "", "whether home counts as a rally point", integer=True),
    one("fence_enabled", "FENCE_ENABLE", "", "whether its fence acts", integer=True),
    one("fence_type", "FENCE_TYPE", "bits", "1 height, 2 circle about home, 4 polygons, 8 lowest height", integer=True),
    one("fence_action", "FENCE_ACTION", "", "what it does beyond its fence", integer=True),
    one("fence_height", "FENCE_ALT_MAX", "m", "height above home it may go"),
    one("fence_radius", "FENCE_RADIUS", "m", "distance from home it may go"),
    ParameterName(
        "max_speed", ("WP_SPD", "WPNAV_SPEED"), False, "m/s", "horizontal speed of its own navigation", (1.0, 0.01)
    ),
    ParameterName("max_climb", ("WP_SPD_UP", "WPNAV_SPEED_UP"), False, "m/s", "climb of its own", (1.0, 0.01)),
    ParameterName("max_descent", ("WP_SPD_DN", "WPNAV_SPEED_DN"), False, "m/s", "descent of its own", (1.0, 0.01)),
    ParameterName(
        "max_acceleration", ("WP_ACC", "WPNAV_ACCEL"), False, "m/s^2", "acceleration of its own navigation", (1.0, 0.01)
    ),
    ParameterName("max_tilt", ("ATC_ANGLE_MAX", "ANGLE_MAX"), False, "deg", "lean limit", (1.0, 0.01)),
)
