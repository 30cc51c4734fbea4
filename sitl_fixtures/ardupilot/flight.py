"""How ArduCopter flies its modes: take-off, GUIDED, return, landing, missions, and the modes that need a pilot."""

from __future__ import annotations

from sitl_fixtures.ardupilot import setpoints
from sitl_fixtures.ardupilot.core import CopterCore
from sitl_fixtures.ardupilot.modes import AUTO, BRAKE, GUIDED, LAND, RTL, SMART_RTL
from sitl_fixtures.autopilot.mode_flight import ModeFlight
from sitl_fixtures.autopilot.model import IN_AIR, LANDING, TAKING_OFF
from sitl_fixtures.dynamics.guidance import ZERO, Vector

SPOOL_UP_S = 2.6
LANDED_FOR_S = 2.1


class CopterFlight(ModeFlight[CopterCore]):
    """ArduCopter's modes."""

    def tick(self, dt: float) -> None:
        """One step."""
        autopilot = self._autopilot
        now = autopilot.vehicle.time_s
        guidance = autopilot.guidance
        if not autopilot.armed:
            self._stand_disarmed()
            return
        autopilot.rotors = now - autopilot.armed_at_s > 0.5
        grounded = autopilot.vehicle.body.on_ground
        if self._auto_disarm(grounded, dt):
            return
        if grounded and not autopilot.taking_off and not self._mission_climbs():
            self._rest()
            if autopilot.mode == GUIDED:
                autopilot.guided.run(now, dt, autopilot.params["GUID_TIMEOUT"])
            return
        autopilot.landed_state = IN_AIR
        if autopilot.mode == GUIDED:
            self._guided(now, dt)
        elif autopilot.mode in (RTL, SMART_RTL):
            self._return(dt)
        elif autopilot.mode == LAND:
            self._land(dt)
        elif autopilot.mode == AUTO:
            self._mission(dt)
        elif autopilot.mode == BRAKE:
            autopilot.command = guidance.fly(ZERO, ZERO, dt)
        else:
            # No RC pilot: the throttle stick reads low and the vehicle sinks.
            autopilot.command = guidance.descend(autopilot.hold_at[0], autopilot.hold_at[1], self._pilot_sink_m_s(), dt)
        autopilot.turn_yaw(dt, 1.0)

    def _pilot_sink_m_s(self) -> float:
        down, up = self._autopilot.params["PILOT_SPEED_DN"], self._autopilot.params["PILOT_SPEED_UP"]
        return (down or up) / 100.0

    def _guided(self, now: float, dt: float) -> None:
        autopilot = self._autopilot
        guidance, guided = autopilot.guidance, autopilot.guided
        if autopilot.taking_off:
            self._climb(now, dt)
            return
        guided.run(now, dt, autopilot.params["GUID_TIMEOUT"])
        if guided.spoilt:
            # A NaN has got into the controller: the vehicle stays where it is, whatever it is told.
            autopilot.command = guidance.fly(ZERO, ZERO, dt)
        elif guided.kind == setpoints.POSITION:
            autopilot.command = guidance.go_to(guided.position, dt)
        elif guided.kind == setpoints.POSITION_VELOCITY:
            autopilot.command = guidance.follow(guided.position, guided.velocity, guided.accel, dt)
        elif guided.kind == setpoints.ACCELERATION:
            s = guidance.shaper
            autopilot.command = guidance.fly(
                (s.vn + guided.accel[0] * dt, s.ve + guided.accel[1] * dt, 0.0), guided.accel, dt
            )
        else:
            autopilot.command = guidance.fly(guided.velocity, guided.accel, dt)
        if guided.yaw_rad is not None:
            autopilot.yaw_target_rad = guided.yaw_rad
        else:
            autopilot.yaw_target_rad = None if autopilot.params["WP_YAW_BEHAVIOR"] else autopilot.yaw_rad

    def _climb(self, now: float, dt: float) -> None:
        autopilot = self._autopilot
        guidance = autopilot.guidance
        if autopilot.vehicle.body.on_ground and now - autopilot.stage_s < SPOOL_UP_S:
            self._rest()
            return
        autopilot.landed_state = TAKING_OFF
        home_d = autopilot.home_local()[2]
        target_d = home_d - autopilot.takeoff_alt_m
        autopilot.command = guidance.go_to((autopilot.hold_at[0], autopilot.hold_at[1], target_d), dt)
        if abs(guidance.d - target_d) < 0.1 and abs(guidance.vd) < 0.2:
            autopilot.taking_off = False
            autopilot.landed_state = IN_AIR
            autopilot.guided.hold_position((autopilot.hold_at[0], autopilot.hold_at[1], target_d), now)

    def _return(self, dt: float) -> None:
        autopilot = self._autopilot
        guidance = autopilot.guidance
        place = autopilot.return_place()
        home_d = autopilot.home_local()[2]
        if not autopilot.stage:
            autopilot.stage = "climb"
            autopilot.hold_at = (
                *autopilot.stopping_point()[:2],
                min(guidance.d, home_d - autopilot.params["RTL_ALT"] / 100.0),
            )
        if autopilot.stage == "climb":
            autopilot.command = guidance.go_to(autopilot.hold_at, dt)
            if guidance.d < autopilot.hold_at[2] + 0.5 and autopilot.vehicle.body.speed_m_s < 3.0:
                autopilot.stage, autopilot.stage_s = "return", autopilot.vehicle.time_s
                autopilot.hold_at = (place[0], place[1], autopilot.hold_at[2])
        elif autopilot.stage == "return":
            speed = autopilot.params["RTL_SPEED"] / 100.0 or guidance.limits.speed_m_s
            autopilot.command = guidance.go_to(autopilot.hold_at, dt, speed_m_s=min(speed, self._soft_start_m_s()))
            if self._still_over(autopilot.hold_at):
                autopilot.stage, autopilot.stage_s = "loiter", autopilot.vehicle.time_s
        elif autopilot.stage == "loiter":
            autopilot.command = guidance.go_to(autopilot.hold_at, dt)
            if autopilot.vehicle.time_s - autopilot.stage_s >= autopilot.params["RTL_LOIT_TIME"] / 1000.0:
                autopilot.stage = "land"
        else:
            self._land(dt)

    def _mission_climbs(self) -> bool:
        autopilot = self._autopilot
        if autopilot.mode != AUTO or autopilot.vehicle.time_s - autopilot.armed_at_s < SPOOL_UP_S:
            return False
        leg = autopilot.mission_flight.leg()
        return leg is not None and leg.kind == "climb"

    def _soft_start_m_s(self) -> float:
        """Speed a leg allows since its start: WPNAV_JERK is gentle, and the first second goes by."""
        autopilot = self._autopilot
        since = max(0.0, autopilot.vehicle.time_s - autopilot.stage_s - 1.0)
        jerk, accel = max(0.2, autopilot.params["WPNAV_JERK"]), 0.8 * autopilot.guidance.limits.accel_m_s2
        turning = accel / jerk
        return 0.5 * jerk * since * since if since < turning else accel * (since - 0.5 * turning)

    def _land(self, dt: float) -> None:
        autopilot = self._autopilot
        guidance = autopilot.guidance
        autopilot.landed_state = LANDING
        above = autopilot.vehicle.body.above_ground_m
        slow = autopilot.params["LAND_SPEED"] / 100.0
        fast = max(slow, (autopilot.params["LAND_SPEED_HIGH"] or autopilot.params["WPNAV_SPEED_DN"]) / 100.0)
        low = autopilot.params["LAND_ALT_LOW"] / 100.0
        rate = slow if above <= low else fast
        autopilot.command = guidance.descend(autopilot.hold_at[0], autopilot.hold_at[1], rate, dt)

    def _fly_leg(self, place: Vector, dt: float) -> None:
        autopilot = self._autopilot
        guidance = autopilot.guidance
        if autopilot.hold_at != place:
            autopilot.hold_at, autopilot.stage_s = place, autopilot.vehicle.time_s
        start = self._soft_start_m_s() + autopilot.vehicle.body.speed_m_s
        autopilot.command = guidance.go_to(place, dt, speed_m_s=min(guidance.limits.speed_m_s, start))

    def _auto_disarm(self, grounded: bool, dt: float) -> bool:
        """Disarms after a landing, or when nothing came of arming; whether it did."""
        autopilot = self._autopilot
        if not grounded:
            autopilot.landed_for_s = autopilot.idle_s = 0.0
            autopilot.landing_text_due = True
            return False
        if autopilot.landing_text_due:
            autopilot.text(f"SIM Hit ground at {autopilot.vehicle.body.impact_m_s:f} m/s")
            autopilot.landing_text_due = False
        landing = autopilot.mode == LAND or (
            autopilot.mode in (RTL, AUTO) and autopilot.stage in ("land", "loiter", "return", "climb")
        )
        if landing and not autopilot.taking_off:
            autopilot.landed_for_s += dt
            if autopilot.landed_for_s >= LANDED_FOR_S:
                autopilot.disarm()
                return True
            return False
        autopilot.idle_s = 0.0 if autopilot.taking_off else autopilot.idle_s + dt
        delay = autopilot.params["DISARM_DELAY"]
        if delay > 0 and autopilot.idle_s >= delay:
            autopilot.disarm()
            return True
        return False
