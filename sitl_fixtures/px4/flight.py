"""How PX4 flies its modes: take-off, OFFBOARD, return, landing, missions."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from sitl_fixtures.autopilot import IN_AIR, LANDING, ON_GROUND, TAKING_OFF
from sitl_fixtures.dynamics.guidance import ZERO, Vector
from sitl_fixtures.px4 import setpoints as setpoints
from sitl_fixtures.px4.modes import HOLD, LAND, MISSION, OFFBOARD, RTL, TAKEOFF

if TYPE_CHECKING:
    from sitl_fixtures.px4.autopilot import Px4

SPOOL_UP_S = 1.0
# After spooling up, the climb is let in over three seconds, from pressing down to the full rate.
TAKEOFF_RAMP_S, TAKEOFF_RAMP_FROM_M_S = 3.0, 2.4
TAKEOFF_DETECTED_S = 2.0
LANDING_DETECTED_S = 2.5
IDLE: tuple[Vector, Vector, Vector] = (setpoints.NAN, setpoints.NAN, (0.0, 0.0, 100.0))


class Px4Flight:
    """One step of whatever mode is on; leaves the acceleration asked for in the personality's ``command``."""

    def __init__(self, personality: Px4) -> None:
        self._p = personality
        self.stage = ""
        self.landed_for_s = 0.0
        self.flown = False
        self.climb_m_s = 3.0
        self.max_speed_m_s = 12.0
        self.yaw_rate_rad_s = 1.0

    def tick(self, dt: float) -> None:
        """One step."""
        vehicle, guidance = self._p.vehicle, self._p.guidance
        now = vehicle.time_s
        if not self._p.armed:
            self._p.command, self._p.rotors = ZERO, False
            self._p.landed_state = ON_GROUND if vehicle.body.on_ground else IN_AIR
            return
        self._p.rotors = now - self._p.armed_at_s > 0.3
        grounded = vehicle.body.on_ground
        if self._landing(grounded, dt):
            return
        climb = self._climb_allowed_m_s(now)
        self._p.guidance.limits.up_m_s = max(0.0, climb)
        if grounded and not self.flown and now - self._p.armed_at_s >= TAKEOFF_DETECTED_S and self._wants_up():
            self.flown = True
            self._p.text("Takeoff detected")
        if grounded and (climb <= 0.05 or not self._wants_up()):
            guidance.reset()
            guidance.tracker.reset()
            self._p.command = ZERO
            self._p.landed_state = ON_GROUND
            self._p.echoed = IDLE
            return
        self._p.landed_state = IN_AIR
        if self._p.mode == OFFBOARD:
            self._offboard(now, dt)
        elif self._p.mode == RTL:
            self._return(dt)
        elif self._p.mode == LAND:
            self._land(dt)
        elif self._p.mode == TAKEOFF:
            self._climb(dt)
        elif self._p.mode == MISSION:
            self._mission(dt)
        else:
            self._p.command = guidance.go_to(self._p.hold_at, dt)
        if self._p.mode != OFFBOARD:
            s = guidance.shaper
            self._p.echoed = ((s.pn, s.pe, s.pd), (s.vn, s.ve, s.vd), (s.an, s.ae, s.ad))
            self._p.yaw_target_rad = None if self._p.mode in (RTL, MISSION) else self._p.yaw_target_rad
        self._p.turn_yaw(dt, self.yaw_rate_rad_s)

    def _climb_allowed_m_s(self, now: float) -> float:
        most = self.climb_m_s
        since = now - self._p.armed_at_s - SPOOL_UP_S
        if since >= TAKEOFF_RAMP_S or (not self._p.vehicle.body.on_ground and self._p.guidance.d < -5.0):
            return most
        return (most + TAKEOFF_RAMP_FROM_M_S) * since / TAKEOFF_RAMP_S - TAKEOFF_RAMP_FROM_M_S

    def _wants_up(self) -> bool:
        if self._p.mode == OFFBOARD and self._p.target is not None:
            target = self._p.target
            up = target.position[2] < self._p.guidance.d - 0.3
            return up or target.velocity[2] < -0.1 or target.accel[2] < -0.5
        if self._p.mode == MISSION:
            leg = self._p.vehicle.route.leg()
            return leg is not None and leg.kind in ("climb", "fly") and leg.position[2] < self._p.guidance.d - 0.3
        return self._p.mode == TAKEOFF

    def _offboard(self, now: float, dt: float) -> None:
        guidance, target = self._p.guidance, self._p.target
        if target is None:
            self._p.command = guidance.go_to(self._p.hold_at, dt)
            return
        if not target.flyable:
            self._p.command = guidance.direct(None, ZERO, None, self.max_speed_m_s, dt)
            self._p.echoed = (setpoints.NAN, ZERO, self._p.command)
            return
        position, velocity, accel = target.parts
        if not target.complete:
            position, velocity, accel = (
                self._filled(position, self._p.position),
                self._filled(velocity),
                self._filled(accel),
            )
        self._p.command = guidance.direct(position, velocity, accel, self.max_speed_m_s, dt)
        wanted = setpoints.NAN if position is None and velocity is None else guidance.wanted_velocity
        self._p.echoed = (target.position, wanted, self._p.command)
        self._p.yaw_target_rad = target.yaw_rad if target.yaw_rad is not None else self._p.yaw_rad

    @staticmethod
    def _filled(part: Vector | None, neutral: Vector = ZERO) -> Vector | None:
        """A part with its absent axes made neutral."""
        if part is None:
            return None
        return (
            neutral[0] if math.isnan(part[0]) else part[0],
            neutral[1] if math.isnan(part[1]) else part[1],
            neutral[2] if math.isnan(part[2]) else part[2],
        )

    def _climb(self, dt: float) -> None:
        self._p.landed_state = TAKING_OFF
        origin = self._p.vehicle.estimator.origin
        down = (origin[2] if origin else 0.0) - self._p.takeoff_alt_amsl_m
        self._p.command = self._p.guidance.go_to((self._p.hold_at[0], self._p.hold_at[1], down), dt)
        if abs(self._p.guidance.d - down) < 0.3:
            self._p.hold_at = (self._p.hold_at[0], self._p.hold_at[1], down)
            self._p.intended = HOLD
            self._p.mode = HOLD

    def _return(self, dt: float) -> None:
        guidance = self._p.guidance
        place = self._p.vehicle.route.return_place() or self._p.home_local()
        home_d = self._p.home_local()[2]
        if not self.stage:
            self.stage = "climb"
            near = math.hypot(guidance.n - place[0], guidance.e - place[1]) < self._p.params["RTL_MIN_DIST"]
            height = 0.0 if near else self._p.params["RTL_RETURN_ALT"]
            self._p.hold_at = (self._p.hold_at[0], self._p.hold_at[1], min(guidance.d, home_d - height))
            origin = self._p.vehicle.estimator.origin
            above = home_d - self._p.hold_at[2]
            amsl = (origin[2] if origin else 0.0) - self._p.hold_at[2]
            self._p.text(f"RTL: start return at {amsl:.0f} m ({above:.0f} m above destination)")
            if near:
                self._start_landing()
        if self.stage == "climb":
            self._p.command = guidance.go_to(self._p.hold_at, dt)
            if guidance.d < self._p.hold_at[2] + 0.8 and self._p.vehicle.body.speed_m_s < 1.0:
                self.stage = "return"
                self._p.hold_at = (place[0], place[1], self._p.hold_at[2])
        elif self.stage == "return":
            self._p.command = guidance.go_to(self._p.hold_at, dt)
            if guidance.off_m(self._p.hold_at) < 2.0 and self._p.vehicle.body.speed_m_s < 0.5:
                self._start_landing()
        else:
            self._land(dt)

    def _start_landing(self) -> None:
        self.stage = "land"
        self._p.vehicle.after(0.06, self._tell_landing)

    def _tell_landing(self) -> None:
        if self._p.mode == RTL:
            self._p.text("RTL: land at destination")

    def _land(self, dt: float) -> None:
        self._p.landed_state = LANDING
        p = self._p.params
        above = self._p.vehicle.body.height_m - self._p.vehicle.body.ground_m
        high, low = p["MPC_LAND_ALT1"], p["MPC_LAND_ALT2"]
        fast, slow = p["MPC_Z_VEL_MAX_DN"], p["MPC_LAND_SPEED"]
        # In two steps, as recorded: half way to slow between 1.8 and 1.4 times the higher altitude, then at the lower.
        upper = max(0.0, min(1.0, (above / max(0.1, high) - 1.4) / 0.4))
        lower = max(0.0, min(1.0, (above - low) / max(0.1, high - low)))
        rate = slow + (fast - slow) * (0.5 * upper + 0.5 * lower)
        self._p.command = self._p.guidance.descend(self._p.hold_at[0], self._p.hold_at[1], rate, dt)

    def _mission(self, dt: float) -> None:
        leg = self._p.vehicle.route.leg()
        if leg is None:
            self._p.command = self._p.guidance.go_to(self._p.hold_at, dt)
        elif leg.kind == "return":
            self._return(dt)
        elif leg.kind == "land":
            self._p.hold_at = leg.position
            self._land(dt)
        else:
            self._p.hold_at = leg.position
            self._p.command = self._p.guidance.go_to(leg.position, dt)

    def _landing(self, grounded: bool, dt: float) -> bool:
        """Disarms after a landing, or when nothing came of arming; whether it did."""
        now = self._p.vehicle.time_s
        if not grounded:
            self.landed_for_s = 0.0
            return False
        if self.flown and (self.landed_for_s > 0.0 or not self._wants_up()):
            before = self.landed_for_s
            self.landed_for_s += dt
            if before < LANDING_DETECTED_S <= self.landed_for_s:
                self._p.text("Landing detected")
            delay = self._p.params["COM_DISARM_LAND"]
            if delay > 0.0 and self.landed_for_s >= LANDING_DETECTED_S + delay:
                self._p.disarm("Disarmed by landing")
                return True
        elif (
            not self.flown
            and self._p.params["COM_DISARM_PRFLT"] > 0.0
            and now - self._p.armed_at_s >= self._p.params["COM_DISARM_PRFLT"]
        ):
            self._p.disarm("Disarmed by auto preflight disarming")
            return True
        return False
