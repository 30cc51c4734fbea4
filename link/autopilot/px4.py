"""What PX4 is sent and how it is read."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from link.autopilot import local_frame, px4_failsafes
from link.autopilot.failsafe_rule import FailsafeRule, UnsafeTogether
from link.autopilot.local_frame import EkfOrigin
from link.autopilot.parameter_catalogue import PX4_PARAMETERS, Values
from link.autopilot.profile import (
    FENCE_CIRCLE,
    FENCE_HEIGHT,
    FENCE_POLYGONS,
    ROTORCRAFT,
    VTOL,
    AutopilotProfile,
)
from link.dialect import mavlink
from link.microservices.mission_download import MissionTraits
from link.microservices.mission_item import AMSL
from link.setpoints.setpoint import Setpoint


def _px4_mode(main: int, sub: int = 0) -> int:
    return main << 16 | sub << 24


class Px4Profile(AutopilotProfile):
    """PX4 1.15 and later, multicopter or VTOL in hover."""

    name = "px4"
    title = "PX4"
    autopilot_id = mavlink.MAV_AUTOPILOT_PX4
    setpoint_message_id = mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT
    coordinate_frame = mavlink.MAV_FRAME_GLOBAL_INT
    needs_origin = False
    offboard_mode, hold_mode, return_mode, land_mode = "OFFBOARD", "HOLD", "RTL", "LAND"
    modes = MappingProxyType(
        {
            "MANUAL": _px4_mode(1),
            "ALTCTL": _px4_mode(2),
            "POSCTL": _px4_mode(3),
            "READY": _px4_mode(4, 1),
            "TAKEOFF": _px4_mode(4, 2),
            "HOLD": _px4_mode(4, 3),
            "MISSION": _px4_mode(4, 4),
            "RTL": _px4_mode(4, 5),
            "LAND": _px4_mode(4, 6),
            "FOLLOW": _px4_mode(4, 8),
            "PRECLAND": _px4_mode(4, 9),
            "ACRO": _px4_mode(5),
            "OFFBOARD": _px4_mode(6),
            "STABILIZED": _px4_mode(7),
        }
    )
    stream_before_offboard_s = 1.0
    parameter_encoding = "bytewise"
    parameters = PX4_PARAMETERS
    mission = MissionTraits(
        keeps_old_after_failure=True,
        first_item_is_home=False,
        keeps_parameters=True,
    )
    oldest_firmware = (1, 12)
    airframes = ROTORCRAFT | VTOL
    binding_speeds = True
    climbs_by_command = False
    resumes_offboard_unasked = True
    target_runs_on = False
    filters_station_ids = False
    estimator_message_id = mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS
    rally_frame = AMSL
    fence_actions = MappingProxyType({0: "nothing", 1: "a text", 2: "hold", 3: "return", 4: "terminate", 5: "land"})
    harmless_fence_actions = frozenset({0, 1})
    fence_switches: Mapping[str, int] = MappingProxyType({})

    def failsafe_rules(self, least_s: float) -> tuple[FailsafeRule, ...]:
        """See `link.autopilot.px4_failsafes`."""
        return px4_failsafes.rules(least_s)

    def unsafe_together(self, values: Values) -> list[UnsafeTogether]:
        """See `link.autopilot.px4_failsafes`."""
        return px4_failsafes.unsafe_together(values)

    def fence_kinds(self, values: Values) -> int | None:
        """All: its polygons are always in force, its distances when not 0."""
        return FENCE_HEIGHT | FENCE_CIRCLE | FENCE_POLYGONS

    def _message(self, setpoint: Setpoint, head: tuple[int, int, int], yaw_rad: float, origin: EkfOrigin | None) -> Any:
        return mavlink.MAVLink_set_position_target_global_int_message(
            *head,
            self.coordinate_frame,
            self.type_mask,
            round(setpoint.lat_deg * 1e7),
            round(setpoint.lon_deg * 1e7),
            setpoint.alt_amsl_m,
            *setpoint.velocity_ned_m_s,
            *setpoint.acceleration_ned_m_s2,
            yaw_rad,
            0.0,
        )

    _project = staticmethod(local_frame.px4_north_east_m)
    _unproject = staticmethod(local_frame.px4_lat_lon_deg)

    def _mode_words(self, custom_mode: int) -> tuple[float, float]:
        return float(custom_mode >> 16 & 255), float(custom_mode >> 24 & 255)

    def _mode_number(self, custom_mode: int) -> int:
        # The sub-mode means something in AUTO alone.
        main, sub = custom_mode >> 16 & 255, custom_mode >> 24 & 255
        return _px4_mode(main, sub if main == 4 else 0)
