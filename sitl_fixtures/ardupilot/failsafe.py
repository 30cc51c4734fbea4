"""ArduCopter's failsafes: the owner's heartbeats, the battery, the estimate.

None of them goes back to the mode before by itself.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from sitl_fixtures.ardupilot.modes import BRAKE, LAND, RTL
from sitl_fixtures.autopilot import CRITICAL, WARNING
from sitl_fixtures.mavlink.wire import Message

if TYPE_CHECKING:
    from sitl_fixtures.ardupilot.autopilot import ArduCopter

GCS_CHECK_EVERY_S = 1.0 / 3.0


class CopterFailsafe:
    """Watches, and changes the mode."""

    def __init__(self, personality: ArduCopter) -> None:
        self._p = personality
        self.owner_heard_s: float | None = None
        self.next_gcs_check_s = 0.0
        self.low_battery_s = 0.0
        self.battery_failsafe = ""
        self.estimate_lost_s = 0.0

    def check(self, now: float, dt: float) -> None:
        """Looks at the owner's heartbeats and at the estimate."""
        if now >= self.next_gcs_check_s:
            self.next_gcs_check_s = now + GCS_CHECK_EVERY_S
            self._gcs_failsafe(now)
        if not self._p.vehicle.estimator.healthy and self._p.armed:
            self.estimate_lost_s += dt
            if self.estimate_lost_s >= 1.0 and self._p.params["FS_EKF_ACTION"] and self._p.mode != LAND:
                self._p.text("EKF variance", CRITICAL)
                self._p.text("EKF Failsafe: changed to LAND Mode", CRITICAL)
                self._p.failsafe_active = True
                self._p.change_mode(LAND)
        else:
            self.estimate_lost_s = 0.0

    def _gcs_failsafe(self, now: float) -> None:
        action = int(self._p.params["FS_GCS_ENABLE"])
        if not action or self.owner_heard_s is None:
            return
        lost = now - self.owner_heard_s > self._p.params["FS_GCS_TIMEOUT"]
        if lost and self._p.armed and not self._p.failsafe_active:
            self._p.failsafe_active = True
            self._p.text("GCS Failsafe", WARNING)
            if self._p.vehicle.body.on_ground:
                self._p.disarm()
            else:
                self._p.change_mode({5: LAND, 7: BRAKE}.get(action, RTL))
        elif not lost and self._p.failsafe_active and not self.battery_failsafe and self._p.vehicle.estimator.healthy:
            self._p.failsafe_active = False
            self._p.text("GCS Failsafe Cleared", WARNING)

    def _battery(self, dt: float) -> None:
        battery, p = self._p.vehicle.battery, self._p.params
        for level in ("CRT", "LOW"):
            volt, mah = p[f"BATT_{level}_VOLT"], p[f"BATT_{level}_MAH"]
            left = p["BATT_CAPACITY"] - battery.used_mah
            if (volt and battery.voltage_v < volt) or (mah and left < mah):
                self.low_battery_s += dt
                if (
                    self.low_battery_s < p["BATT_LOW_TIMER"]
                    or not self._p.armed
                    or self.battery_failsafe in ("CRT", level)
                ):
                    return
                self.battery_failsafe = level
                word = "critical" if level == "CRT" else "low"
                self._p.text(f"Battery 1 is {word} {battery.voltage_v:.2f}V used {battery.used_mah:.0f} mAh", WARNING)
                action = int(p[f"BATT_FS_{level}_ACT"])
                if action:
                    self._p.failsafe_active = True
                    self._p.change_mode({1: LAND, 2: RTL}.get(action, RTL))
                return
        self.low_battery_s = 0.0

    def slow_check(self, dt: float) -> None:
        """The battery failsafe."""
        self._battery(dt)

    def heard(self, link: int, message: Message) -> None:
        """Counts towards the GCS failsafe when an owner sent it."""
        if self._p.is_owner(message.get_srcSystem()):
            self.owner_heard_s = self._p.vehicle.time_s
