"""PX4's state, modes and arming: what its commands, failsafes and flight act upon."""

from __future__ import annotations

import math

from sitl_fixtures.autopilot.model import CRITICAL, AutopilotModel, ModelledVehicle
from sitl_fixtures.dynamics.controller import Tracker
from sitl_fixtures.dynamics.guidance import Guidance, Limits, Vector
from sitl_fixtures.px4 import setpoints
from sitl_fixtures.px4.modes import HOLD, MISSION, MODE_NAMES, OFFBOARD, Mode

IDLE: tuple[Vector, Vector, Vector] = (setpoints.NAN, setpoints.NAN, (0.0, 0.0, 100.0))


class Px4Core(AutopilotModel):
    """The state of PX4, and how modes and arming change it.

    Attributes:
        mode: as HEARTBEAT shows it.
        intended: the mode last commanded; a failsafe that ends goes back to it.
        mode_after_disarm: the mode last commanded while disarmed.
        target, stream_s: the last set-point taken, and when.
        echoed: position, velocity and acceleration of POSITION_TARGET_LOCAL_NED.
        flown: whether it has left the ground since it was armed.
    """

    def __init__(self, vehicle: ModelledVehicle) -> None:
        super().__init__(vehicle)
        self.guidance = Guidance(Tracker((0.95, 1.0), (1.8, 4.0), (0.4, 2.0)), Limits())
        self.intended: Mode = HOLD
        self.mode: Mode = HOLD
        self.mode_after_disarm: Mode = HOLD
        self.target: setpoints.Target | None = None
        self.stream_s = -math.inf
        self.takeoff_alt_amsl_m = 0.0
        self.echoed: tuple[Vector, Vector, Vector] = IDLE
        self.stream_timeout_s = 1.03
        self.flown = False

    @property
    def mode_name(self) -> str:
        """The mode in words."""
        return MODE_NAMES.get(self.mode, str(self.mode))

    # -- modes --------------------------------------------------------------------------------------------------------

    @property
    def stream_fresh(self) -> bool:
        """Whether accepted set-points keep coming."""
        return self.vehicle.time_s - self.stream_s <= self.stream_timeout_s

    def unavailable(self, mode: Mode) -> str | None:
        """Why a mode cannot be entered now; None when it can."""
        if mode == OFFBOARD and self.armed and not self.vehicle.body.on_ground and not self.stream_fresh:
            return "Switching to Offboard is currently not available"
        if mode == MISSION and not self.vehicle.missions.total:
            return "Switching to Mission is currently not available"
        return None

    def intend(self, mode: Mode) -> bool:
        """A mode commanded by a person; False when it cannot be entered and is not."""
        refusal = self.unavailable(mode)
        if refusal is not None:
            self.text(refusal, CRITICAL)
            return False
        self.intended = mode
        if not self.armed:
            self.mode_after_disarm = mode
        self.failsafe_active = False
        self.go(mode)
        return True

    def go(self, mode: Mode) -> None:
        """Takes a mode up."""
        if mode == self.mode:
            return
        self.mode = mode
        self.stage = ""
        guidance = self.guidance
        guidance.update(self.position, self.velocity)
        guidance.reset()
        north, east = guidance.stopping_place(0.3)
        self.hold_at = (north, east, guidance.d + 0.2 * guidance.vd)

    # -- arming -------------------------------------------------------------------------------------------------------

    def arm(self) -> None:
        """Arms: home is set where the vehicle stands."""
        super().arm()
        self.flown = False
        self.landed_for_s = 0.0

    def arming_refusals(self) -> list[str]:
        """Reasons not to arm."""
        reasons = []
        if not self.vehicle.ready or not self.vehicle.estimator.healthy or not self.vehicle.gps_ok:
            reasons.append("Resolve system health failures first")
        if self.mode == OFFBOARD and not self.stream_fresh:
            reasons.append("Resolve system health failures first")
        return reasons + self.vehicle.injected_arming_refusals()

    def disarm(self, text: str) -> None:
        """Disarms, in the air too; the mode is then the one last commanded while disarmed."""
        self.armed = self.failsafe_active = False
        self.flown = False
        self.landed_for_s = 0.0
        self.text(text)
        self.params.put("COM_FLIGHT_UUID", self.params["COM_FLIGHT_UUID"] + 1)
        self.vehicle.broadcast_parameter("COM_FLIGHT_UUID")
        self.intended = self.mode_after_disarm
        self.go(self.intended)
