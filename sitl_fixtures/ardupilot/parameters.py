"""The parameters each simulated autopilot knows: ``(name, value, MAV_PARAM_TYPE)``.

Names, types and stock values are those of ArduCopter 4.7 and PX4 1.17, a selection: what a ground station reads before
a flight, and what the simulation obeys. Where the value differs from the stock one, so that the default vehicle can fly
fast missions, a comment says so.
"""

from __future__ import annotations

from sitl_fixtures.mavlink.parameters import INT8, INT16, INT32, REAL32, Row

ARDUPILOT: list[Row] = [
    ("ACRO_YAW_RATE", 202.5, REAL32),
    ("ANGLE_MAX", 4500, INT16),  # stock 3000: 30 degrees top out far below mission speed
    ("ARMING_CHECK", 1, INT32),
    ("ARMING_REQUIRE", 1, INT8),
    ("ATC_ACCEL_Y_MAX", 27000, REAL32),
    ("ATC_SLEW_YAW", 6000, REAL32),
    ("AUTO_OPTIONS", 0, INT32),
    ("BATT_ARM_VOLT", 0, REAL32),
    ("BATT_CAPACITY", 100000, INT32),
    ("BATT_CRT_MAH", 0, REAL32),
    ("BATT_CRT_VOLT", 0, REAL32),
    ("BATT_FS_CRT_ACT", 0, INT8),
    ("BATT_FS_LOW_ACT", 0, INT8),
    ("BATT_LOW_MAH", 0, REAL32),
    ("BATT_LOW_TIMER", 10, INT8),
    ("BATT_LOW_VOLT", 10.5, REAL32),
    ("BATT_MONITOR", 4, INT8),
    ("BRD_OPTIONS", 1, INT32),
    ("DISARM_DELAY", 10, INT8),
    ("EK3_ENABLE", 1, INT8),
    ("EK3_SRC1_POSXY", 3, INT8),
    ("FENCE_ACTION", 1, INT8),
    ("FENCE_ALT_MAX", 100, REAL32),
    ("FENCE_ENABLE", 0, INT8),
    ("FENCE_RADIUS", 300, REAL32),
    ("FENCE_TYPE", 7, INT8),
    ("FRAME_CLASS", 1, INT8),
    ("FRAME_TYPE", 0, INT8),
    ("FS_CRASH_CHECK", 1, INT8),
    ("FS_EKF_ACTION", 1, INT8),
    ("FS_EKF_THRESH", 0.8, REAL32),
    ("FS_GCS_ENABLE", 0, INT8),
    ("FS_GCS_TIMEOUT", 5, REAL32),
    ("FS_OPTIONS", 16, INT32),
    ("FS_THR_ENABLE", 1, INT8),
    ("FS_VIBE_ENABLE", 1, INT8),
    ("GPS1_TYPE", 1, INT8),
    ("GUID_OPTIONS", 0, INT32),
    ("GUID_TIMEOUT", 3, REAL32),
    ("INITIAL_MODE", 0, INT8),
    ("INS_GYR_ID", 2752772, INT32),
    ("LAND_ALT_LOW", 1000, INT16),
    ("LAND_SPEED", 50, INT16),
    ("LAND_SPEED_HIGH", 0, INT16),
    ("LOG_BACKEND_TYPE", 1, INT8),
    ("LOG_BITMASK", 176126, INT32),
    ("LOIT_SPEED", 1250, REAL32),
    ("MAV_GCS_SYSID", 255, INT16),
    ("MAV_GCS_SYSID_HI", 0, INT16),
    ("MAV_OPTIONS", 0, INT16),
    ("MAV_SYSID", 1, INT16),
    ("MAV_TELEM_DELAY", 0, INT8),
    ("MIS_OPTIONS", 0, INT16),
    ("MIS_RESTART", 0, INT8),
    ("MIS_TOTAL", 0, INT16),
    ("MOT_THST_HOVER", 0.39, REAL32),
    ("PHLD_BRAKE_RATE", 8, INT16),
    ("PILOT_SPEED_DN", 0, INT16),
    ("PILOT_SPEED_UP", 250, INT16),
    ("PILOT_TKOFF_ALT", 0, REAL32),
    ("PSC_ACCZ_P", 0.3, REAL32),
    ("PSC_ANGLE_MAX", 0, REAL32),
    ("PSC_JERK_XY", 20, REAL32),  # stock 5
    ("PSC_JERK_Z", 5, REAL32),
    ("PSC_POSXY_P", 1, REAL32),
    ("PSC_POSZ_P", 1, REAL32),
    ("PSC_VELXY_D", 0.5, REAL32),
    ("PSC_VELXY_I", 1, REAL32),
    ("PSC_VELXY_P", 2, REAL32),
    ("PSC_VELZ_P", 5, REAL32),
    ("RALLY_INCL_HOME", 1, INT8),
    ("RALLY_LIMIT_KM", 0.3, REAL32),
    ("RALLY_TOTAL", 0, INT8),
    ("RC_OPTIONS", 32, INT32),
    ("RNGFND1_TYPE", 0, INT8),
    ("RTL_ALT", 1500, INT32),
    ("RTL_ALT_FINAL", 0, INT16),
    ("RTL_ALT_TYPE", 0, INT8),
    ("RTL_CLIMB_MIN", 0, INT16),
    ("RTL_CONE_SLOPE", 3, REAL32),
    ("RTL_LOIT_TIME", 5000, INT32),
    ("RTL_OPTIONS", 0, INT32),
    ("RTL_SPEED", 0, INT16),
    ("SCHED_LOOP_RATE", 400, INT16),
    ("SERIAL0_PROTOCOL", 2, INT8),
    ("SERIAL1_PROTOCOL", 2, INT8),
    ("SIM_RATE_HZ", 1200, INT16),
    ("SIM_SPEEDUP", 1, REAL32),
    ("SIM_WIND_DIR", 180, REAL32),
    ("SIM_WIND_SPD", 0, REAL32),
    ("STAT_FLTCNT", 0, INT32),
    ("STAT_FLTTIME", 0, INT32),
    ("STAT_RUNTIME", 0, INT32),
    ("TERRAIN_ENABLE", 1, INT8),
    ("THROW_MOT_START", 0, INT8),
    ("WPNAV_ACCEL", 500, REAL32),  # stock 250
    ("WPNAV_ACCEL_C", 0, REAL32),
    ("WPNAV_ACCEL_Z", 100, REAL32),
    ("WPNAV_JERK", 1, REAL32),
    ("WPNAV_RADIUS", 200, REAL32),
    ("WPNAV_SPEED", 2000, REAL32),  # stock 1000
    ("WPNAV_SPEED_DN", 150, REAL32),
    ("WPNAV_SPEED_UP", 500, REAL32),  # stock 250
    ("WP_YAW_BEHAVIOR", 2, INT8),
]

# ArduCopter 4.6 and older: one ground station's id and no range, under other names.
_OLD_NAMES = {"MAV_GCS_SYSID": "SYSID_MYGCS", "MAV_OPTIONS": "SYSID_ENFORCE", "MAV_SYSID": "SYSID_THISMAV"}
ARDUPILOT_4_6: list[Row] = [
    (_OLD_NAMES.get(name, name), value, kind) for name, value, kind in ARDUPILOT if name != "MAV_GCS_SYSID_HI"
]
