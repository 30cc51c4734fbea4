"""How PX4 flies its modes: take-off, OFFBOARD, return, landing, missions."""

from __future__ import annotations

import math

from sitl_fixtures.autopilot.mode_flight import ModeFlight
from sitl_fixtures.autopilot.model import IN_AIR, LANDING, TAKING_OFF
from sitl_fixtures.dynamics.guidance import ZERO, Vector
from sitl_fixtures.px4 import setpoints
from sitl_fixtures.px4.core import IDLE, Px4Core
from sitl_fixtures.px4.modes import HOLD, LAND, MISSION, OFFBOARD, RTL, TAKEOFF

SPOOL_UP_S = 1.0
# After spooling up, the climb is let in over three seconds, from pressing down to the full rate.
TAKEOFF_RAMP_S, TAKEOFF_RAMP_FROM_M_S = 3.0, 2.4
TAKEOFF_DETECTED_S = 2.0
LANDING_DETECTED_S = 2.5


class Px4Flight(ModeFlight[Px4Core]):
    """PX4's modes."""

    def __init__(self, autopilot: Px4Core) -> None:
        super().__init__(autopilot)
        self.climb_m_s = 3.0
        self.max_speed_m_s = 12.0
        self.yaw_rate_rad_s = 1.0

    def tick(self, dt: float) -> None:
        """One step."""
        autopilot = self._autopilot
        vehicle, guidance = autopilot.vehicle, autopilot.guidance
        now = vehicle.time_s
        if not autopilot.armed:
            self._stand_disarmed()
            return
        autopilot.rotors = now - autopilot.armed_at_s > 0.3
        grounded = vehicle.body.on_ground
        if self._landing(grounded, dt):
            return
        climb = self._climb_allowed_m_s(now)
        guidance.limits.up_m_s = max(0.0, climb)
        if grounded and not autopilot.flown and now - autopilot.armed_at_s >= TAKEOFF_DETECTED_S and self._wants_up():
            autopilot.flown = True
            autopilot.text("Takeoff detected")
        if grounded and (climb <= 0.05 or not self._wants_up()):
            self._rest()
            autopilot.echoed = IDLE
            return
        autopilot.landed_state = IN_AIR
        if autopilot.mode == OFFBOARD:
            self._offboard(now, dt)
        elif autopilot.mode == RTL:
            self._return(dt)
        elif autopilot.mode == LAND:
            self._land(dt)
        elif autopilot.mode == TAKEOFF:
            self._climb(dt)
        elif autopilot.mode == MISSION:
            self._mission(dt)
        else:
            autopilot.command = guidance.go_to(autopilot.hold_at, dt)
        if autopilot.mode != OFFBOARD:
            s = guidance.shaper
            autopilot.echoed = ((s.pn, s.pe, s.pd), (s.vn, s.ve, s.vd), (s.an, s.ae, s.ad))
            autopilot.yaw_target_rad = None if autopilot.mode in (RTL, MISSION) else autopilot.yaw_target_rad
        autopilot.turn_yaw(dt, self.yaw_rate_rad_s)

    def _climb_allowed_m_s(self, now: float) -> float:
        autopilot = self._autopilot
        most = self.climb_m_s
        since = now - autopilot.armed_at_s - SPOOL_UP_S
        if since >= TAKEOFF_RAMP_S or (not autopilot.vehicle.body.on_ground and autopilot.guidance.d < -5.0):
            return most
        return (most + TAKEOFF_RAMP_FROM_M_S) * since / TAKEOFF_RAMP_S - TAKEOFF_RAMP_FROM_M_S

    def _wants_up(self) -> bool:
        autopilot = self._autopilot
        if autopilot.mode == OFFBOARD and autopilot.target is not None:
            target = autopilot.target
            up = target.position[2] < autopilot.guidance.d - 0.3
            return up or target.velocity[2] < -0.1 or target.accel[2] < -0.5
        if autopilot.mode == MISSION:
            leg = autopilot.mission_flight.leg()
            return leg is not None and leg.kind in ("climb", "fly") and leg.position[2] < autopilot.guidance.d - 0.3
        return autopilot.mode == TAKEOFF

    def _offboard(self, now: float, dt: float) -> None:
        autopilot = self._autopilot
        guidance, target = autopilot.guidance, autopilot.target
        if target is None:
            autopilot.command = guidance.go_to(autopilot.hold_at, dt)
            return
        if not target.flyable:
            autopilot.command = guidance.direct(None, ZERO, None, self.max_speed_m_s, dt)
            autopilot.echoed = (setpoints.NAN, ZERO, autopilot.command)
            return
        position, velocity, accel = target.parts
        if not target.complete:
            position, velocity, accel = (
                self._filled(position, autopilot.position),
                self._filled(velocity),
                self._filled(accel),
            )
        autopilot.command = guidance.direct(position, velocity, accel, self.max_speed_m_s, dt)
        wanted = setpoints.NAN if position is None and velocity is None else guidance.wanted_velocity
        autopilot.echoed = (target.position, wanted, autopilot.command)
        autopilot.yaw_target_rad = target.yaw_rad if target.yaw_rad is not None else autopilot.yaw_rad

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
        autopilot = self._autopilot
        autopilot.landed_state = TAKING_OFF
        origin = autopilot.vehicle.estimator.origin
        down = (origin[2] if origin else 0.0) - autopilot.takeoff_alt_amsl_m
        autopilot.command = autopilot.guidance.go_to((autopilot.hold_at[0], autopilot.hold_at[1], down), dt)
        if abs(autopilot.guidance.d - down) < 0.3:
            autopilot.hold_at = (autopilot.hold_at[0], autopilot.hold_at[1], down)
            autopilot.intended = HOLD
            autopilot.mode = HOLD

    def _return(self, dt: float) -> None:
        autopilot = self._autopilot
        guidance = autopilot.guidance
        place = autopilot.return_place()
        home_d = autopilot.home_local()[2]
        if not autopilot.stage:
            autopilot.stage = "climb"
            near = math.hypot(guidance.n - place[0], guidance.e - place[1]) < autopilot.params["RTL_MIN_DIST"]
            height = 0.0 if near else autopilot.params["RTL_RETURN_ALT"]
            autopilot.hold_at = (autopilot.hold_at[0], autopilot.hold_at[1], min(guidance.d, home_d - height))
            origin = autopilot.vehicle.estimator.origin
            above = home_d - autopilot.hold_at[2]
            amsl = (origin[2] if origin else 0.0) - autopilot.hold_at[2]
            autopilot.text(f"RTL: start return at {amsl:.0f} m ({above:.0f} m above destination)")
            if near:
                self._start_landing()
        if autopilot.stage == "climb":
            autopilot.command = guidance.go_to(autopilot.hold_at, dt)
            if guidance.d < autopilot.hold_at[2] + 0.8 and autopilot.vehicle.body.speed_m_s < 1.0:
                autopilot.stage = "return"
                autopilot.hold_at = (place[0], place[1], autopilot.hold_at[2])
        elif autopilot.stage == "return":
            autopilot.command = guidance.go_to(autopilot.hold_at, dt)
            if self._still_over(autopilot.hold_at):
                self._start_landing()
        else:
            self._land(dt)

    def _start_landing(self) -> None:
        self._autopilot.stage = "land"
        self._autopilot.vehicle.after(0.06, self._tell_landing)

    def _tell_landing(self) -> None:
        if self._autopilot.mode == RTL:
            self._autopilot.text("RTL: land at destination")

    def _land(self, dt: float) -> None:
        autopilot = self._autopilot
        autopilot.landed_state = LANDING
        p = autopilot.params
        above = autopilot.vehicle.body.above_ground_m
        high, low = p["MPC_LAND_ALT1"], p["MPC_LAND_ALT2"]
        fast, slow = p["MPC_Z_VEL_MAX_DN"], p["MPC_LAND_SPEED"]
        # In two steps, as recorded: half way to slow between 1.8 and 1.4 times the higher altitude, then at the lower.
        upper = max(0.0, min(1.0, (above / max(0.1, high) - 1.4) / 0.4))
        lower = max(0.0, min(1.0, (above - low) / max(0.1, high - low)))
        rate = slow + (fast - slow) * (0.5 * upper + 0.5 * lower)
        autopilot.command = autopilot.guidance.descend(autopilot.hold_at[0], autopilot.hold_at[1], rate, dt)

    def _fly_leg(self, place: Vector, dt: float) -> None:
        autopilot = self._autopilot
        autopilot.hold_at = place
        autopilot.command = autopilot.guidance.go_to(place, dt)

    def _landing(self, grounded: bool, dt: float) -> bool:
        """Disarms after a landing, or when nothing came of arming; whether it did."""
        autopilot = self._autopilot
        now = autopilot.vehicle.time_s
        if not grounded:
            autopilot.landed_for_s = 0.0
            return False
        if autopilot.flown and (autopilot.landed_for_s > 0.0 or not self._wants_up()):
            before = autopilot.landed_for_s
            autopilot.landed_for_s += dt
            if before < LANDING_DETECTED_S <= autopilot.landed_for_s:
                autopilot.text("Landing detected")
            delay = autopilot.params["COM_DISARM_LAND"]
            if delay > 0.0 and autopilot.landed_for_s >= LANDING_DETECTED_S + delay:
                autopilot.disarm("Disarmed by landing")
                return True
        elif (
            not autopilot.flown
            and autopilot.params["COM_DISARM_PRFLT"] > 0.0
            and now - autopilot.armed_at_s >= autopilot.params["COM_DISARM_PRFLT"]
        ):
            autopilot.disarm("Disarmed by auto preflight disarming")
            return True
        return False
