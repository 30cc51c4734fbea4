"""ArduCopter's state, modes and arming: what its commands, failsafes and flight act upon."""

from __future__ import annotations

from sitl_fixtures.ardupilot import setpoints
from sitl_fixtures.ardupilot.modes import (
    ALT_HOLD,
    AUTO,
    BRAKE,
    GUIDED,
    LAND,
    MODE_NAMES,
    RTL,
    SMART_RTL,
    STABILIZE,
)
from sitl_fixtures.autopilot.model import WARNING, AutopilotModel, ModelledVehicle
from sitl_fixtures.dynamics.controller import Tracker
from sitl_fixtures.dynamics.guidance import Guidance, Limits, Vector


class CopterCore(AutopilotModel):
    """The state of ArduCopter, and how modes and arming change it.

    Attributes:
        mode: as HEARTBEAT shows it.
        guided: the target of GUIDED.
        taking_off, takeoff_alt_m: whether NAV_TAKEOFF climbs, and to which height above home.
        stage_s: when the stage, the leg or the take-off in hand began.
        idle_s: how long it has stood armed on the ground.
        landing_text_due: whether touching the ground is still to be told.
    """

    def __init__(self, vehicle: ModelledVehicle) -> None:
        super().__init__(vehicle)
        self.guidance = Guidance(Tracker((1.0, 1.0), (2.0, 4.0), (0.7, 1.0)), Limits())
        self.mode = int(self.params["INITIAL_MODE"])
        self.guided = setpoints.GuidedTarget()
        self.taking_off = False
        self.takeoff_alt_m = 0.0
        self.stage_s = 0.0
        self.idle_s = 0.0
        self.landing_text_due = False

    @property
    def mode_name(self) -> str:
        """The mode in words."""
        return MODE_NAMES.get(self.mode, str(self.mode))

    # -- modes --------------------------------------------------------------------------------------------------------

    def unavailable(self, mode: int) -> str | None:
        """Why a mode cannot be entered now; None when it can."""
        if mode not in MODE_NAMES:
            return f"No such mode {mode}"
        if self.armed and not self.vehicle.ready and mode not in (STABILIZE, ALT_HOLD, LAND):
            return f"Mode change to {MODE_NAMES[mode]} failed: requires position"
        return None

    def change_mode(self, mode: int) -> bool:
        """Changes the mode; False when there is no such mode or it cannot be entered."""
        refusal = self.unavailable(mode)
        if refusal is not None:
            self.text(refusal, WARNING)
            return False
        if mode == self.mode:
            return True
        self.mode = mode
        self._enter()
        self.vehicle.defer(lambda: self.vehicle.send(self.heartbeat()))
        return True

    def begin_takeoff(self, height_m: float) -> None:
        """NAV_TAKEOFF: climbs to a height above home, on the spot."""
        self.taking_off = True
        self.takeoff_alt_m = height_m
        self.stage_s = self.vehicle.time_s
        self.hold_at = self.position
        self.guided.take_off()

    def _enter(self) -> None:
        self.taking_off = False
        self.stage, self.stage_s = "", 0.0
        self.guidance.update(self.position, self.velocity)
        self.guidance.reset()
        self.hold_at = self.stopping_point()
        if self.mode == GUIDED:
            self.guided.stop(self.vehicle.time_s)

    def stopping_point(self) -> Vector:
        """Where the vehicle comes to rest when it brakes now."""
        north, east = self.guidance.stopping_place(0.1)
        return north, east, self.guidance.d

    # -- arming and landing -------------------------------------------------------------------------------------------

    def arm(self) -> None:
        """Arms: home is set where the vehicle stands."""
        super().arm()
        self.landing_text_due = False

    def disarm(self) -> None:
        """Disarms, in the air too."""
        self.armed = self.failsafe_active = False
        self.taking_off = False
        self.landed_for_s = self.idle_s = 0.0
        self.text("Disarming motors")

    def arming_refusals(self) -> list[str]:
        """Reasons not to arm."""
        reasons = []
        if self.vehicle.estimator.origin is None:
            reasons += ["Accels inconsistent", "AHRS: waiting for home"]
        elif not self.vehicle.ready:
            reasons.append("Need Position Estimate")
        elif not self.vehicle.estimator.healthy:
            reasons.append("EKF attitude is bad")
        if not self.vehicle.gps_ok:
            reasons.append("GPS 1: Bad fix")
        reasons += self.vehicle.injected_arming_refusals()
        if self.mode in (RTL, LAND, AUTO, SMART_RTL, BRAKE) and not (self.mode == AUTO and self.vehicle.missions.total):
            reasons.append(f"{MODE_NAMES[self.mode]} mode not armable")
        return reasons

    # -- who may speak ------------------------------------------------------------------------------------------------

    def is_owner(self, system_id: int) -> bool:
        """Whether a system id is in the range of ground stations."""
        if "SYSID_MYGCS" in self.params:
            return system_id == int(self.params["SYSID_MYGCS"])
        low, high = int(self.params["MAV_GCS_SYSID"]), int(self.params["MAV_GCS_SYSID_HI"])
        return low <= system_id <= max(low, high)
