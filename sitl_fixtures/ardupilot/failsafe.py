"""ArduCopter's failsafes: the owner's heartbeats, the battery, the estimate.

None of them goes back to the mode before by itself.
"""

from __future__ import annotations

from sitl_fixtures.ardupilot.core import CopterCore
from sitl_fixtures.ardupilot.modes import BRAKE, LAND, RTL
from sitl_fixtures.autopilot.model import CRITICAL, WARNING
from sitl_fixtures.mavlink.wire import Message

GCS_CHECK_EVERY_S = 1.0 / 3.0


class CopterFailsafe:
    """Watches, and changes the mode."""

    def __init__(self, autopilot: CopterCore) -> None:
        self._autopilot = autopilot
        self.owner_heard_s: float | None = None
        self.next_gcs_check_s = 0.0
        self.low_battery_s = 0.0
        self.battery_failsafe = ""
        self.estimate_lost_s = 0.0

    def check(self, now: float, dt: float) -> None:
        """Looks at the owner's heartbeats and at the estimate."""
        autopilot = self._autopilot
        if now >= self.next_gcs_check_s:
            self.next_gcs_check_s = now + GCS_CHECK_EVERY_S
            self._gcs_failsafe(now)
        if not autopilot.vehicle.estimator.healthy and autopilot.armed:
            self.estimate_lost_s += dt
            if self.estimate_lost_s >= 1.0 and autopilot.params["FS_EKF_ACTION"] and autopilot.mode != LAND:
                autopilot.text("EKF variance", CRITICAL)
                autopilot.text("EKF Failsafe: changed to LAND Mode", CRITICAL)
                autopilot.failsafe_active = True
                autopilot.change_mode(LAND)
        else:
            self.estimate_lost_s = 0.0

    def _gcs_failsafe(self, now: float) -> None:
        autopilot = self._autopilot
        action = int(autopilot.params["FS_GCS_ENABLE"])
        if not action or self.owner_heard_s is None:
            return
        lost = now - self.owner_heard_s > autopilot.params["FS_GCS_TIMEOUT"]
        if lost and autopilot.armed and not autopilot.failsafe_active:
            autopilot.failsafe_active = True
            autopilot.text("GCS Failsafe", WARNING)
            if autopilot.vehicle.body.on_ground:
                autopilot.disarm()
            else:
                autopilot.change_mode({5: LAND, 7: BRAKE}.get(action, RTL))
        elif (
            not lost and autopilot.failsafe_active and not self.battery_failsafe and autopilot.vehicle.estimator.healthy
        ):
            autopilot.failsafe_active = False
            autopilot.text("GCS Failsafe Cleared", WARNING)

    def _battery(self, dt: float) -> None:
        autopilot = self._autopilot
        battery, p = autopilot.vehicle.battery, autopilot.params
        for level in ("CRT", "LOW"):
            volt, mah = p[f"BATT_{level}_VOLT"], p[f"BATT_{level}_MAH"]
            left = p["BATT_CAPACITY"] - battery.used_mah
            if (volt and battery.voltage_v < volt) or (mah and left < mah):
                self.low_battery_s += dt
                if (
                    self.low_battery_s < p["BATT_LOW_TIMER"]
                    or not autopilot.armed
                    or self.battery_failsafe in ("CRT", level)
                ):
                    return
                self.battery_failsafe = level
                word = "critical" if level == "CRT" else "low"
                autopilot.text(f"Battery 1 is {word} {battery.voltage_v:.2f}V used {battery.used_mah:.0f} mAh", WARNING)
                action = int(p[f"BATT_FS_{level}_ACT"])
                if action:
                    autopilot.failsafe_active = True
                    autopilot.change_mode({1: LAND, 2: RTL}.get(action, RTL))
                return
        self.low_battery_s = 0.0

    def slow_check(self, dt: float) -> None:
        """The battery failsafe."""
        self._battery(dt)

    def heard(self, link: int, message: Message) -> None:
        """Counts towards the GCS failsafe when an owner sent it."""
        if self._autopilot.is_owner(message.get_srcSystem()):
            self.owner_heard_s = self._autopilot.vehicle.time_s
