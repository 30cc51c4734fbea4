"""The parameters the simulated PX4 knows: ``(name, value, MAV_PARAM_TYPE)``.

Names, types and stock values are those of PX4 1.17, a selection: what a ground station reads before a flight, and what
the simulation obeys. Where the value differs from the stock one, so that the default vehicle can fly fast missions, a
comment says so.
"""

from __future__ import annotations

from sitl_fixtures.mavlink.parameters import INT32, REAL32, Row

PX4: list[Row] = [
    ("BAT1_CAPACITY", -1, REAL32),
    ("BAT1_N_CELLS", 4, INT32),
    ("BAT1_V_CHARGED", 4.05, REAL32),
    ("BAT1_V_EMPTY", 3.6, REAL32),
    ("BAT_CRIT_THR", 0.07, REAL32),
    ("BAT_EMERGEN_THR", 0.05, REAL32),
    ("BAT_LOW_THR", 0.15, REAL32),
    ("CAL_ACC0_ID", 1310988, INT32),
    ("CAL_GYRO0_ID", 1310988, INT32),
    ("CAL_MAG0_ID", 197388, INT32),
    ("CBRK_SUPPLY_CHK", 894281, INT32),
    ("COM_ARM_WO_GPS", 1, INT32),
    ("COM_DISARM_LAND", 2.0, REAL32),
    ("COM_DISARM_PRFLT", 10.0, REAL32),
    ("COM_DL_LOSS_T", 10, INT32),
    ("COM_FAIL_ACT_T", 5.0, REAL32),
    ("COM_FLIGHT_UUID", 0, INT32),
    ("COM_FLTMODE1", -1, INT32),
    ("COM_LOW_BAT_ACT", 0, INT32),
    ("COM_OBC_LOSS_T", 5.0, REAL32),
    ("COM_OBL_RC_ACT", 0, INT32),
    ("COM_OF_LOSS_T", 1.0, REAL32),
    ("COM_POS_FS_EPH", -1.0, REAL32),
    ("COM_RCL_EXCEPT", 0, INT32),
    ("COM_RC_IN_MODE", 1, INT32),
    ("COM_RC_LOSS_T", 0.5, REAL32),
    ("EKF2_EN", 1, INT32),
    ("EKF2_GPS_CTRL", 7, INT32),
    ("EKF2_HGT_REF", 1, INT32),
    ("EKF2_MAG_DECL", 0.0, REAL32),
    ("GF_ACTION", 2, INT32),
    ("GF_MAX_HOR_DIST", 0.0, REAL32),
    ("GF_MAX_VER_DIST", 0.0, REAL32),
    ("LNDMC_ALT_MAX", -1.0, REAL32),
    ("MAV_COMP_ID", 1, INT32),
    ("MAV_PROTO_VER", 2, INT32),
    ("MAV_SYS_ID", 1, INT32),
    ("MAV_TYPE", 2, INT32),
    ("MIS_DIST_1WP", 10000.0, REAL32),
    ("MIS_TAKEOFF_ALT", 2.5, REAL32),
    ("MPC_ACC_DOWN_MAX", 3.0, REAL32),
    ("MPC_ACC_HOR", 5.0, REAL32),  # stock 3
    ("MPC_ACC_HOR_MAX", 10.0, REAL32),  # stock 5
    ("MPC_ACC_UP_MAX", 4.0, REAL32),
    ("MPC_JERK_AUTO", 8.0, REAL32),  # stock 4
    ("MPC_JERK_MAX", 8.0, REAL32),
    ("MPC_LAND_ALT1", 10.0, REAL32),
    ("MPC_LAND_ALT2", 5.0, REAL32),
    ("MPC_LAND_SPEED", 0.7, REAL32),
    ("MPC_MAN_TILT_MAX", 35.0, REAL32),
    ("MPC_THR_HOVER", 0.5, REAL32),
    ("MPC_TILTMAX_AIR", 45.0, REAL32),
    ("MPC_TILTMAX_LND", 12.0, REAL32),
    ("MPC_TKO_SPEED", 1.5, REAL32),
    ("MPC_VEL_MANUAL", 10.0, REAL32),
    ("MPC_XY_CRUISE", 20.0, REAL32),  # stock 5
    ("MPC_XY_P", 0.95, REAL32),
    ("MPC_XY_VEL_D_ACC", 0.2, REAL32),
    ("MPC_XY_VEL_I_ACC", 0.4, REAL32),
    ("MPC_XY_VEL_MAX", 60.0, REAL32),  # stock 12: it bounds velocity set-points too
    ("MPC_XY_VEL_P_ACC", 1.8, REAL32),
    ("MPC_YAWRAUTO_MAX", 60.0, REAL32),
    ("MPC_Z_P", 1.0, REAL32),
    ("MPC_Z_VEL_I_ACC", 2.0, REAL32),
    ("MPC_Z_VEL_MAX_DN", 1.5, REAL32),
    ("MPC_Z_VEL_MAX_UP", 3.0, REAL32),
    ("MPC_Z_VEL_P_ACC", 4.0, REAL32),
    ("NAV_ACC_RAD", 10.0, REAL32),
    ("NAV_DLL_ACT", 0, INT32),
    ("NAV_RCL_ACT", 2, INT32),
    ("RTL_CONE_ANG", 45, INT32),
    ("RTL_DESCEND_ALT", 30.0, REAL32),
    ("RTL_LAND_DELAY", 0.0, REAL32),
    ("RTL_MIN_DIST", 10.0, REAL32),
    ("RTL_RETURN_ALT", 30.0, REAL32),
    ("RTL_TYPE", 0, INT32),
    ("SIH_KDV", 0.05, REAL32),  # stock 1.0: drag over mass, 1/s
    ("SIH_MASS", 1.0, REAL32),
    ("SIM_SPEEDUP", 1.0, REAL32),  # not a PX4 parameter: how a ground station knows this simulator's factor
    ("SYS_AUTOSTART", 10040, INT32),
    ("SYS_HAS_GPS", 1, INT32),
]
