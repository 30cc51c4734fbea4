"""How ArduCopter flies its modes: take-off, GUIDED, return, landing, missions, and the modes that need a pilot."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sitl_fixtures.ardupilot import setpoints as setpoints
from sitl_fixtures.ardupilot.modes import AUTO, BRAKE, GUIDED, LAND, RTL, SMART_RTL
from sitl_fixtures.autopilot import IN_AIR, LANDING, ON_GROUND, TAKING_OFF
from sitl_fixtures.dynamics.guidance import ZERO

if TYPE_CHECKING:
    from sitl_fixtures.ardupilot.autopilot import ArduCopter

SPOOL_UP_S = 2.6
LANDED_FOR_S = 2.1


class CopterFlight:
    """One step of whatever mode is on; leaves the acceleration asked for in the personality's ``command``."""

    def __init__(self, personality: ArduCopter) -> None:
        self._p = personality
        self.takeoff_alt_m = 0.0
        self.taking_off = False
        self.stage = ""
        self.stage_s = 0.0
        self.landed_for_s = 0.0
        self.idle_s = 0.0
        self.landing_text_due = False

    def tick(self, dt: float) -> None:
        """One step."""
        now = self._p.vehicle.time_s
        guidance = self._p.guidance
        if not self._p.armed:
            self._p.command, self._p.rotors = ZERO, False
            self._p.landed_state = ON_GROUND if self._p.vehicle.body.on_ground else IN_AIR
            return
        self._p.rotors = now - self._p.armed_at_s > 0.5
        grounded = self._p.vehicle.body.on_ground
        if self._auto_disarm(grounded, dt):
            return
        if grounded and not self.taking_off and not self._mission_climbs():
            guidance.reset()
            guidance.tracker.reset()
            self._p.command = ZERO
            self._p.landed_state = ON_GROUND
            if self._p.mode == GUIDED:
                self._p.guided.run(now, dt, self._p.params["GUID_TIMEOUT"])
            return
        self._p.landed_state = IN_AIR
        if self._p.mode == GUIDED:
            self._guided(now, dt)
        elif self._p.mode in (RTL, SMART_RTL):
            self._return(dt)
        elif self._p.mode == LAND:
            self._land(dt)
        elif self._p.mode == AUTO:
            self._auto(dt)
        elif self._p.mode == BRAKE:
            self._p.command = guidance.fly(ZERO, ZERO, dt)
        else:
            # No RC pilot: the throttle stick reads low and the vehicle sinks.
            self._p.command = guidance.descend(self._p.hold_at[0], self._p.hold_at[1], self._pilot_sink_m_s(), dt)
        self._p.turn_yaw(dt, 1.0)

    def _pilot_sink_m_s(self) -> float:
        down, up = self._p.params["PILOT_SPEED_DN"], self._p.params["PILOT_SPEED_UP"]
        return (down or up) / 100.0

    def _guided(self, now: float, dt: float) -> None:
        guidance, guided = self._p.guidance, self._p.guided
        if self.taking_off:
            self._climb(now, dt)
            return
        guided.run(now, dt, self._p.params["GUID_TIMEOUT"])
        if guided.spoilt:
            # A NaN has got into the controller: the vehicle stays where it is, whatever it is told.
            self._p.command = guidance.fly(ZERO, ZERO, dt)
        elif guided.kind == setpoints.POSITION:
            self._p.command = guidance.go_to(guided.position, dt)
        elif guided.kind == setpoints.POSITION_VELOCITY:
            self._p.command = guidance.follow(guided.position, guided.velocity, guided.accel, dt)
        elif guided.kind == setpoints.ACCELERATION:
            s = guidance.shaper
            self._p.command = guidance.fly(
                (s.vn + guided.accel[0] * dt, s.ve + guided.accel[1] * dt, 0.0), guided.accel, dt
            )
        else:
            self._p.command = guidance.fly(guided.velocity, guided.accel, dt)
        if guided.yaw_rad is not None:
            self._p.yaw_target_rad = guided.yaw_rad
        else:
            self._p.yaw_target_rad = None if self._p.params["WP_YAW_BEHAVIOR"] else self._p.yaw_rad

    def _climb(self, now: float, dt: float) -> None:
        guidance = self._p.guidance
        if self._p.vehicle.body.on_ground and now - self.stage_s < SPOOL_UP_S:
            guidance.reset()
            guidance.tracker.reset()
            self._p.command = ZERO
            self._p.landed_state = ON_GROUND
            return
        self._p.landed_state = TAKING_OFF
        home_d = self._p.home_local()[2]
        target_d = home_d - self.takeoff_alt_m
        self._p.command = guidance.go_to((self._p.hold_at[0], self._p.hold_at[1], target_d), dt)
        if abs(guidance.d - target_d) < 0.1 and abs(guidance.vd) < 0.2:
            self.taking_off = False
            self._p.landed_state = IN_AIR
            self._p.guided.hold_position((self._p.hold_at[0], self._p.hold_at[1], target_d), now)

    def _return(self, dt: float) -> None:
        guidance = self._p.guidance
        place = self._p.vehicle.route.return_place() or self._p.home_local()
        home_d = self._p.home_local()[2]
        if not self.stage:
            self.stage = "climb"
            self._p.hold_at = (
                *self._p.stopping_point()[:2],
                min(guidance.d, home_d - self._p.params["RTL_ALT"] / 100.0),
            )
        if self.stage == "climb":
            self._p.command = guidance.go_to(self._p.hold_at, dt)
            if guidance.d < self._p.hold_at[2] + 0.5 and self._p.vehicle.body.speed_m_s < 3.0:
                self.stage, self.stage_s = "return", self._p.vehicle.time_s
                self._p.hold_at = (place[0], place[1], self._p.hold_at[2])
        elif self.stage == "return":
            speed = self._p.params["RTL_SPEED"] / 100.0 or guidance.limits.speed_m_s
            self._p.command = guidance.go_to(self._p.hold_at, dt, speed_m_s=min(speed, self._soft_start_m_s()))
            if guidance.off_m(self._p.hold_at) < 2.0 and self._p.vehicle.body.speed_m_s < 0.5:
                self.stage, self.stage_s = "loiter", self._p.vehicle.time_s
        elif self.stage == "loiter":
            self._p.command = guidance.go_to(self._p.hold_at, dt)
            if self._p.vehicle.time_s - self.stage_s >= self._p.params["RTL_LOIT_TIME"] / 1000.0:
                self.stage = "land"
        else:
            self._land(dt)

    def _mission_climbs(self) -> bool:
        if self._p.mode != AUTO or self._p.vehicle.time_s - self._p.armed_at_s < SPOOL_UP_S:
            return False
        leg = self._p.vehicle.route.leg()
        return leg is not None and leg.kind == "climb"

    def _soft_start_m_s(self) -> float:
        """Speed a leg allows since its start: WPNAV_JERK is gentle, and the first second goes by."""
        since = max(0.0, self._p.vehicle.time_s - self.stage_s - 1.0)
        jerk, accel = max(0.2, self._p.params["WPNAV_JERK"]), 0.8 * self._p.guidance.limits.accel_m_s2
        turning = accel / jerk
        return 0.5 * jerk * since * since if since < turning else accel * (since - 0.5 * turning)

    def _land(self, dt: float) -> None:
        guidance = self._p.guidance
        self._p.landed_state = LANDING
        above = self._p.vehicle.body.height_m - self._p.vehicle.body.ground_m
        slow = self._p.params["LAND_SPEED"] / 100.0
        fast = max(slow, (self._p.params["LAND_SPEED_HIGH"] or self._p.params["WPNAV_SPEED_DN"]) / 100.0)
        low = self._p.params["LAND_ALT_LOW"] / 100.0
        rate = slow if above <= low else fast
        self._p.command = guidance.descend(self._p.hold_at[0], self._p.hold_at[1], rate, dt)

    def _auto(self, dt: float) -> None:
        guidance = self._p.guidance
        leg = self._p.vehicle.route.leg()
        if leg is None:
            self._p.command = guidance.go_to(self._p.hold_at, dt)
        elif leg.kind == "return":
            self._return(dt)
        elif leg.kind == "land":
            self._p.hold_at = leg.position
            self._land(dt)
        else:
            if self._p.hold_at != leg.position:
                self._p.hold_at, self.stage_s = leg.position, self._p.vehicle.time_s
            start = self._soft_start_m_s() + self._p.vehicle.body.speed_m_s
            self._p.command = guidance.go_to(leg.position, dt, speed_m_s=min(guidance.limits.speed_m_s, start))

    def _auto_disarm(self, grounded: bool, dt: float) -> bool:
        """Disarms after a landing, or when nothing came of arming; whether it did."""
        if not grounded:
            self.landed_for_s = self.idle_s = 0.0
            self.landing_text_due = True
            return False
        if self.landing_text_due:
            self._p.text(f"SIM Hit ground at {self._p.vehicle.body.impact_m_s:f} m/s")
            self.landing_text_due = False
        landing = self._p.mode == LAND or (
            self._p.mode in (RTL, AUTO) and self.stage in ("land", "loiter", "return", "climb")
        )
        if landing and not self.taking_off:
            self.landed_for_s += dt
            if self.landed_for_s >= LANDED_FOR_S:
                self._p.disarm()
                return True
            return False
        self.idle_s = 0.0 if self.taking_off else self.idle_s + dt
        delay = self._p.params["DISARM_DELAY"]
        if delay > 0 and self.idle_s >= delay:
            self._p.disarm()
            return True
        return False
