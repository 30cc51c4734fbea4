"""What PX4 is sent and how it is read."""

from __future__ import annotations

from types import MappingProxyType
from typing import Any

from link.autopilot import local_frame
from link.autopilot.local_frame import EkfOrigin
from link.autopilot.parameter_names import PX4_PARAMETERS
from link.autopilot.profile import AutopilotProfile
from link.dialect import mavlink
from link.microservices.mission_download import MissionTraits
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
    min_stream_hz = 2.0
    parameter_encoding = "bytewise"
    parameters = PX4_PARAMETERS
    mission = MissionTraits(
        keeps_old_after_failure=True,
        honours_cancel=True,
        upload_timeout_s=5.0,
        first_item_is_home=False,
        keeps_parameters=True,
    )

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
