"""What ArduPilot is sent and how it is read."""

from __future__ import annotations

from types import MappingProxyType
from typing import Any

from link.autopilot import ardupilot_failsafes, local_frame
from link.autopilot.failsafe_rule import FailsafeRule, UnsafeTogether
from link.autopilot.local_frame import EkfOrigin
from link.autopilot.parameter_catalogue import ARDUPILOT_PARAMETERS, Values
from link.autopilot.profile import (
    FENCE_POLYGONS,
    MAX_LOCAL_LATITUDE_DEG,
    MAX_LOCAL_OFFSET_M,
    ROTORCRAFT,
    AutopilotProfile,
    check_range,
)
from link.dialect import mavlink
from link.errors import MissingOrigin, UnsafeSetpoint
from link.microservices.mission_download import MissionTraits
from link.microservices.mission_item import RELATIVE
from link.setpoints.setpoint import Setpoint


class ArduPilotProfile(AutopilotProfile):
    """ArduCopter 4.3 and later (older names of parameters included)."""

    name = "ardupilot"
    title = "ArduPilot"
    autopilot_id = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
    setpoint_message_id = mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED
    coordinate_frame = mavlink.MAV_FRAME_LOCAL_NED
    needs_origin = True
    # BRAKE, not LOITER: without a pilot's radio LOITER sank 14 m in 6 s.
    offboard_mode, hold_mode, return_mode, land_mode = "GUIDED", "BRAKE", "RTL", "LAND"
    modes = MappingProxyType(
        {
            "STABILIZE": 0,
            "ACRO": 1,
            "ALT_HOLD": 2,
            "AUTO": 3,
            "GUIDED": 4,
            "LOITER": 5,
            "RTL": 6,
            "CIRCLE": 7,
            "LAND": 9,
            "DRIFT": 11,
            "SPORT": 13,
            "FLIP": 14,
            "AUTOTUNE": 15,
            "POSHOLD": 16,
            "BRAKE": 17,
            "THROW": 18,
            "AVOID_ADSB": 19,
            "GUIDED_NOGPS": 20,
            "SMART_RTL": 21,
            "FLOWHOLD": 22,
            "FOLLOW": 23,
            "ZIGZAG": 24,
            "SYSTEMID": 25,
            "AUTOROTATE": 26,
            "AUTO_RTL": 27,
        }
    )
    stream_before_offboard_s = 0.0
    parameter_encoding = "c_cast"
    parameters = ARDUPILOT_PARAMETERS
    mission = MissionTraits(
        keeps_old_after_failure=False,
        first_item_is_home=True,
        keeps_parameters=False,
    )
    oldest_firmware = (4, 3)
    airframes = ROTORCRAFT
    # Its own navigation's speeds do not bound position targets; its lean does.
    binding_speeds = False
    climbs_by_command = True
    resumes_offboard_unasked = False
    target_runs_on = True
    filters_station_ids = True
    estimator_message_id = mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT
    rally_frame = RELATIVE
    fence_actions = MappingProxyType(
        {
            0: "a text",
            1: "return, or land",
            2: "land",
            3: "smart return, return or land",
            4: "brake, or land",
            5: "smart return, or land",
        }
    )
    harmless_fence_actions = frozenset({0})
    # The kind before the switch, so that nothing but the polygon comes into force.
    fence_switches = MappingProxyType({"fence_type": FENCE_POLYGONS, "fence_enabled": 1})

    def failsafe_rules(self, least_s: float) -> tuple[FailsafeRule, ...]:
        """See `link.autopilot.ardupilot_failsafes`."""
        return ardupilot_failsafes.rules(least_s)

    def unsafe_together(self, values: Values) -> list[UnsafeTogether]:
        """See `link.autopilot.ardupilot_failsafes`."""
        return ardupilot_failsafes.unsafe_together(values)

    def fence_kinds(self, values: Values) -> int | None:
        """Those of FENCE_TYPE where FENCE_ENABLE is set."""
        if not self.measure(values, "fence_enabled"):
            return 0
        kinds = self.measure(values, "fence_type")
        return None if kinds is None else int(kinds)

    def _message(self, setpoint: Setpoint, head: tuple[int, int, int], yaw_rad: float, origin: EkfOrigin | None) -> Any:
        if origin is None:
            raise MissingOrigin(
                "ArduPilot takes local coordinates: wait for GPS_GLOBAL_ORIGIN (request message 49) and pass it"
            )
        latitudes = f"-{MAX_LOCAL_LATITUDE_DEG:g} to {MAX_LOCAL_LATITUDE_DEG:g} in ArduPilot's local frame"
        if not abs(setpoint.lat_deg) <= MAX_LOCAL_LATITUDE_DEG:
            raise UnsafeSetpoint("lat_deg", setpoint.lat_deg, latitudes)
        if not abs(origin.lat_deg) <= MAX_LOCAL_LATITUDE_DEG:
            raise UnsafeSetpoint("origin.lat_deg", origin.lat_deg, latitudes)
        north, east = local_frame.ardupilot_north_east_m(origin, setpoint.lat_deg, setpoint.lon_deg)
        check_range("north_m of the EKF origin", north, -MAX_LOCAL_OFFSET_M, MAX_LOCAL_OFFSET_M)
        check_range("east_m of the EKF origin", east, -MAX_LOCAL_OFFSET_M, MAX_LOCAL_OFFSET_M)
        return mavlink.MAVLink_set_position_target_local_ned_message(
            *head,
            self.coordinate_frame,
            self.type_mask,
            north,
            east,
            origin.alt_amsl_m - setpoint.alt_amsl_m,
            *setpoint.velocity_ned_m_s,
            *setpoint.acceleration_ned_m_s2,
            yaw_rad,
            0.0,
        )

    _project = staticmethod(local_frame.ardupilot_north_east_m)
    _unproject = staticmethod(local_frame.ardupilot_lat_lon_deg)

    def _mode_words(self, custom_mode: int) -> tuple[float, float]:
        return float(custom_mode), 0.0
