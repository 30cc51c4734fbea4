"""ArduCopter as recorded from 4.7.

What a ground station is most likely to trip over:

- Nobody owns the vehicle unless MAV_OPTIONS bit 0 is set; then whatever comes from outside
  MAV_GCS_SYSID..MAV_GCS_SYSID_HI is dropped in silence, reads included. The vehicle's own id is always let in.
- A bad set-point is not refused: it stops the vehicle. Only the echo (POSITION_TARGET_LOCAL_NED) tells.
- Between set-points the target runs on with its velocity; GUID_TIMEOUT after the last one it stands still where it is
  then, and the vehicle brakes, overshoots and flies back to it. The mode stays GUIDED and nothing is said.
- A set-point during the climb of NAV_TAKEOFF ends the climb; set-points do not take off.
- The GCS failsafe looks at the owner's heartbeats alone, and leaves RTL to be left by command.
"""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl_fixtures.ardupilot import setpoints
from sitl_fixtures.ardupilot.commands import CopterCommands
from sitl_fixtures.ardupilot.core import CopterCore
from sitl_fixtures.ardupilot.failsafe import CopterFailsafe
from sitl_fixtures.ardupilot.flight import CopterFlight
from sitl_fixtures.ardupilot.modes import AUTO, BRAKE, GUIDED, LAND, LOITER, POSHOLD, RTL
from sitl_fixtures.ardupilot.parameters import ARDUPILOT
from sitl_fixtures.autopilot.command import Command
from sitl_fixtures.autopilot.model import CRITICAL, INFO, WARNING, ModelledVehicle
from sitl_fixtures.dynamics.estimator import OffsetProjection
from sitl_fixtures.mavlink import mission_protocol
from sitl_fixtures.mavlink.parameters import Parameter
from sitl_fixtures.mavlink.wire import Message

STATISTICS_EVERY_S = 31.0


class ArduCopter(CopterCore):
    """ArduCopter 4.7."""

    mav_autopilot = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
    PROJECTION = OffsetProjection
    PARAMETERS = ARDUPILOT
    ORIGIN_AT = 0.48
    MISSIONS = mission_protocol.ARDUPILOT
    BITWISE_PARAMETERS = False

    def __init__(self, vehicle: ModelledVehicle) -> None:
        super().__init__(vehicle)
        self.runtime_s = 0.0
        self.statistics_due_s = STATISTICS_EVERY_S
        self._text_id = 0
        self.flight = CopterFlight(self)
        self.failsafe = CopterFailsafe(self)
        self.commands = CopterCommands(self)

    # -- parameters ---------------------------------------------------------------------------------------------------

    def refresh(self) -> None:
        """Takes over limits and gains from the parameters."""
        p, limits = self.params, self.guidance.limits
        limits.speed_m_s = max(0.2, p["WPNAV_SPEED"] / 100.0)
        limits.up_m_s = max(0.1, p["WPNAV_SPEED_UP"] / 100.0)
        limits.down_m_s = max(0.1, p["WPNAV_SPEED_DN"] / 100.0)
        limits.accel_m_s2 = max(0.5, p["WPNAV_ACCEL"] / 100.0)
        limits.jerk_m_s3 = max(1.0, p["PSC_JERK_XY"])
        limits.accel_z_m_s2 = max(0.2, p["WPNAV_ACCEL_Z"] / 100.0)
        limits.jerk_z_m_s3 = max(1.0, p["PSC_JERK_Z"])
        limits.brake_m_s2 = 0.6 * limits.accel_m_s2
        limits.brake_z_m_s2 = 0.55 * limits.accel_z_m_s2
        tracker = self.guidance.tracker
        tracker.position_gain = (p["PSC_POSXY_P"], p["PSC_POSZ_P"])
        tracker.velocity_gain = (p["PSC_VELXY_P"], p["PSC_VELZ_P"])
        self.vehicle.set_aircraft(tilt_deg=self.lean_deg(p["ANGLE_MAX"] / 100.0))
        if p["SIM_WIND_SPD"] > 0.0:
            # SIM_WIND_DIR is where the wind comes from.
            towards = math.radians(p["SIM_WIND_DIR"] + 180.0)
            self.vehicle.body.wind_n_m_s = p["SIM_WIND_SPD"] * math.cos(towards)
            self.vehicle.body.wind_e_m_s = p["SIM_WIND_SPD"] * math.sin(towards)

    def named_index(self, parameter: Parameter) -> int:
        """A parameter read or set by name is reported with index 65535."""
        return 65535

    def on_parameter_set(self, link: int, parameter: Parameter) -> None:
        """One PARAM_VALUE to every link, and the new value holds from then on."""
        self.vehicle.send_parameter(parameter, None, self.named_index(parameter))

    def tick(self, dt: float) -> None:
        """Failsafes, then flight."""
        self.failsafe.check(self.vehicle.time_s, dt)
        self.guidance.update(self.position, self.velocity)
        self.flight.tick(dt)

    def slow_tick(self, dt: float) -> None:
        """The battery, and the statistics ArduPilot keeps in parameters and broadcasts unasked."""
        self.failsafe.slow_check(dt)
        self.runtime_s += dt
        if self.runtime_s < self.statistics_due_s:
            return
        self.statistics_due_s += STATISTICS_EVERY_S
        if self.armed:
            self.params.put("STAT_FLTTIME", self.params["STAT_FLTTIME"] + STATISTICS_EVERY_S)
            self.vehicle.broadcast_parameter("STAT_FLTTIME")
        self.params.put("STAT_RUNTIME", self.params["STAT_RUNTIME"] + STATISTICS_EVERY_S)
        self.vehicle.broadcast_parameter("STAT_RUNTIME")

    def on_command(self, command: Command) -> None:
        """See ``commands.py``."""
        self.commands.handle(command)

    def on_heartbeat(self, link: int, message: Message) -> None:
        """An owner's heartbeat counts."""
        self.failsafe.heard(link, message)

    # -- who may speak ------------------------------------------------------------------------------------------------

    def heard_from(self, link: int, message: Message) -> bool:
        """With MAV_OPTIONS bit 0 (SYSID_ENFORCE), owners and the vehicle's own id only."""
        enforced = self.params["SYSID_ENFORCE" if "SYSID_ENFORCE" in self.params else "MAV_OPTIONS"]
        if not int(enforced) & 1:
            return True
        system_id = message.get_srcSystem()
        return system_id == self.vehicle.config.system_id or self.is_owner(system_id)

    def addressed(self, message: Message) -> bool:
        """System 0 and any component are taken."""
        return message.target_system in (0, self.vehicle.config.system_id)

    def parameters_for(self, message: Message) -> bool:
        """System 0 and any component are taken."""
        return self.addressed(message)

    # -- what it says -------------------------------------------------------------------------------------------------

    def text(self, text: str, severity: int = INFO, link: int | None = None) -> None:
        """STATUSTEXT, in pieces of 50 characters where it is longer."""
        pieces = [text[i : i + 50] for i in range(0, len(text), 50)] or [""]
        number = 0
        if len(pieces) > 1:
            number = self._text_id = self._text_id % 0xFFFF + 1
        for chunk, piece in enumerate(pieces):
            self.vehicle.send(mavlink.MAVLink_statustext_message(severity, piece.encode(), number, chunk), link)

    def heartbeat(self) -> Message:
        """HEARTBEAT: custom_mode is the mode number."""
        base = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        base |= mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED | mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
        if self.mode in (GUIDED, AUTO, LOITER, RTL, POSHOLD, BRAKE, LAND):
            base |= mavlink.MAV_MODE_FLAG_GUIDED_ENABLED
        if self.mode == RTL and not self.armed:
            base &= ~mavlink.MAV_MODE_FLAG_GUIDED_ENABLED
        if self.armed:
            base |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED
        if self.failsafe_active:
            status = mavlink.MAV_STATE_CRITICAL
        elif self.armed and not self.vehicle.body.on_ground:
            status = mavlink.MAV_STATE_ACTIVE
        elif self.vehicle.time_s < 0.5:
            status = mavlink.MAV_STATE_BOOT
        else:
            status = mavlink.MAV_STATE_STANDBY
        return mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_QUADROTOR, self.mav_autopilot, base, self.mode, status, 3
        )

    def position_target(self) -> Message | None:
        """The echo: only in GUIDED, so it goes stale when the mode is left."""
        if self.mode != GUIDED:
            return None
        mask, position, velocity, accel = self.guided.echo()
        return mavlink.MAVLink_position_target_local_ned_message(
            int(self.vehicle.time_s * 1000), 1, mask, *position, *velocity, *accel, 0.0, 0.0
        )

    def version(self) -> Message:
        """AUTOPILOT_VERSION of ArduCopter 4.7.0-dev, or 4.6.3 where that was asked for."""
        number = 0x040603FF if self.vehicle.config.firmware else 67567616
        return mavlink.MAVLink_autopilot_version_message(
            64495, number, 0, 0, 0, list(b"simulatd"), [0] * 8, [0] * 8, 0, 0, 0, list(self.vehicle.uid)
        )

    @property
    def acceptance_radius_m(self) -> float:
        """How near a waypoint counts as reached, m."""
        return self.params["WPNAV_RADIUS"] / 100.0

    def on_ready(self) -> None:
        """The position is good enough to arm."""
        self.text("EKF3 IMU0 is using GPS")

    def on_origin(self) -> None:
        """The origin is told, home is set."""
        vehicle = self.vehicle
        self.set_home_here()
        vehicle.send(vehicle.telemetry.global_origin())
        vehicle.send(vehicle.telemetry.home_position())
        self.text("EKF3 IMU0 origin set")
        self.vehicle.missions.home_was_set()

    # -- failsafes ----------------------------------------------------------------------------------------------------

    def force_mode(self, kind: str) -> None:
        """Changes the mode without a command."""
        self.change_mode({"hold": BRAKE, "return": RTL, "land": LAND, "pilot": LOITER}[kind])

    # -- set-points ---------------------------------------------------------------------------------------------------

    def on_setpoint_local(self, link: int, message: Message) -> None:
        """84: obeyed in GUIDED, whatever the target component."""
        if message.target_system in (0, self.vehicle.config.system_id) and self.mode == GUIDED:
            self._obey(link, message, setpoints.local(message, self.position, self.yaw_rad))

    def on_setpoint_global(self, link: int, message: Message) -> None:
        """86: obeyed in GUIDED, the acceleration dropped."""
        if message.target_system not in (0, self.vehicle.config.system_id) or self.mode != GUIDED:
            return
        if message.coordinate_frame not in setpoints.GLOBAL_FRAMES:
            self.text(f"Unknown mavlink coordinate frame {message.coordinate_frame}")
        self._obey(link, message, setpoints.global_int(message, self.vehicle.estimator, self.home_alt_amsl_m))

    def _obey(self, link: int, message: Message, order: setpoints.Order) -> None:
        was_spoilt = self.guided.spoilt
        self.taking_off = False
        self.guided.take(order, self.vehicle.time_s)
        if self.guided.spoilt and not was_spoilt:
            self.text("Internal Errors 0x400", CRITICAL)
        self.accepted(link, message.get_srcSystem(), message.get_type(), self.guided.describe())

    # -- commands -----------------------------------------------------------------------------------------------------

    def set_mode(self, link: int, message: Message) -> None:
        """The old SET_MODE; there is no acknowledgement."""
        if message.target_system != self.vehicle.config.system_id:
            return
        self.change_mode(message.custom_mode)

    def on_setup_signing(self, link: int, message: Message) -> None:
        """SETUP_SIGNING: only while disarmed."""
        if self.armed:
            error = mavlink.MAVLink_statustext_message(WARNING, b"ERROR: Won't setup signing when armed", 0, 0)
            self.vehicle.send(error, link)
            return
        self.vehicle.signing.set_up(bytes(message.secret_key), message.initial_timestamp)
