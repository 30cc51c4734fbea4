"""PX4's failsafes: a stream that stops, a ground station gone, a battery, an estimate that fails.

While one is active the mode shown is the failsafe's; what was commanded last is kept, and taken up again the moment
the cause is gone.
"""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl_fixtures.autopilot.model import CRITICAL, INFO
from sitl_fixtures.mavlink.wire import Message
from sitl_fixtures.px4.core import Px4Core
from sitl_fixtures.px4.modes import LAND, NAV_DLL_ACTION, OFFBOARD, OFFBOARD_LOSS_ACTION, RTL, Mode

HOME_MOVES_EVERY_S = 2.0


class Px4Failsafe:
    """Watches, and changes the mode."""

    def __init__(self, autopilot: Px4Core) -> None:
        self._autopilot = autopilot
        self.gcs_heard_s: float | None = None
        self.gcs_lost = False
        self.gcs_timeout_s = 10.0
        self.home_moves_s = 0.0
        self.battery_warned = False
        self.battery_mode: Mode | None = None
        self.acting_mode: Mode | None = None

    def heard(self, link: int, message: Message) -> None:
        """Any ground station's heartbeat counts."""
        autopilot = self._autopilot
        if message.type != mavlink.MAV_TYPE_GCS:
            return
        if self.gcs_lost:
            self.gcs_lost = False
            autopilot.text("Connection to ground station lost", INFO)
            autopilot.text("GCS connection regained", INFO)
        self.gcs_heard_s = autopilot.vehicle.time_s

    def check(self, now: float) -> None:
        """Looks at every cause; changes the mode when one appears, and back when it goes."""
        autopilot = self._autopilot
        if self.gcs_heard_s is not None and now - self.gcs_heard_s > self.gcs_timeout_s:
            self.gcs_lost = True
        if not autopilot.armed:
            return
        wanted = self._failsafe_mode()
        if wanted is not None:
            if not autopilot.failsafe_active or wanted != self.acting_mode:
                autopilot.failsafe_active = True
                self.acting_mode = wanted
                autopilot.text("Failsafe activated", CRITICAL)
                autopilot.vehicle.after(0.05, lambda: self._act(wanted))
        elif autopilot.failsafe_active:
            autopilot.failsafe_active = False
            # Back to what was commanded last: OFFBOARD resumes unasked when its stream does.
            autopilot.go(autopilot.intended)

    def _act(self, mode: Mode) -> None:
        """Takes the failsafe's mode, unless it has cleared meanwhile."""
        if self._autopilot.failsafe_active:
            self._autopilot.go(mode)

    def _failsafe_mode(self) -> Mode | None:
        autopilot = self._autopilot
        if not autopilot.vehicle.estimator.healthy:
            return LAND
        if self.battery_mode is not None:
            return self.battery_mode
        if autopilot.intended == OFFBOARD and not autopilot.stream_fresh and not autopilot.vehicle.body.on_ground:
            return OFFBOARD_LOSS_ACTION.get(int(autopilot.params["COM_OBL_RC_ACT"]), RTL)
        if self.gcs_lost and not autopilot.vehicle.body.on_ground:
            return NAV_DLL_ACTION.get(int(autopilot.params["NAV_DLL_ACT"]))
        return None

    def _battery_failsafe_mode(self) -> Mode | None:
        """COM_LOW_BAT_ACT: 0 warns, 2 lands when critical, 3 returns when critical and lands in an emergency."""
        autopilot = self._autopilot
        action, left = int(autopilot.params["COM_LOW_BAT_ACT"]), autopilot.vehicle.battery.remaining
        if left < autopilot.params["BAT_LOW_THR"] and not self.battery_warned:
            self.battery_warned = True
            autopilot.text("Low battery level! Return advised", CRITICAL)
        if action == 3:
            if left < autopilot.params["BAT_EMERGEN_THR"]:
                return LAND
            return RTL if left < autopilot.params["BAT_CRIT_THR"] else None
        return LAND if action == 2 and left < autopilot.params["BAT_CRIT_THR"] else None

    def _move_home(self, now: float) -> None:
        """The home altitude is corrected every now and then in flight, by up to about a metre."""
        autopilot = self._autopilot
        if autopilot.home is None or not autopilot.armed or autopilot.vehicle.body.on_ground or now < self.home_moves_s:
            return
        self.home_moves_s = now + HOME_MOVES_EVERY_S
        drift = max(-1.5, min(1.5, autopilot.vehicle.random.gauss(0.0, 0.6)))
        autopilot.home = (autopilot.home[0], autopilot.home[1], autopilot.vehicle.body.ground_m + drift)

    def slow_check(self, dt: float) -> None:
        """The battery's failsafe, and the home altitude."""
        self.battery_mode = self._battery_failsafe_mode()
        self._move_home(self._autopilot.vehicle.time_s)
