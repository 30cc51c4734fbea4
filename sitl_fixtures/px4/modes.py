"""PX4's modes as (main, sub) of HEARTBEAT's custom_mode, and the modes its failsafes lead to."""

from __future__ import annotations

Mode = tuple[int, int]

MANUAL, ALTCTL, POSCTL, STABILIZED = (1, 0), (2, 0), (3, 0), (7, 0)
TAKEOFF, HOLD, MISSION, RTL, LAND, OFFBOARD = (4, 2), (4, 3), (4, 4), (4, 5), (4, 6), (6, 0)
MODE_NAMES: dict[Mode, str] = {
    MANUAL: "MANUAL",
    ALTCTL: "ALTCTL",
    POSCTL: "POSCTL",
    STABILIZED: "STABILIZED",
    TAKEOFF: "TAKEOFF",
    HOLD: "HOLD",
    MISSION: "MISSION",
    RTL: "RTL",
    LAND: "LAND",
    OFFBOARD: "OFFBOARD",
}
# COM_OBL_RC_ACT: without an RC pilot the manual modes 0-2 fall back to Return.
OFFBOARD_LOSS_ACTION: dict[int, Mode] = {0: RTL, 1: RTL, 2: RTL, 3: RTL, 4: LAND, 5: HOLD}
NAV_DLL_ACTION: dict[int, Mode] = {1: HOLD, 2: RTL, 3: LAND}
