"""PX4 as recorded from 1.17.

What a ground station is most likely to trip over:

- Nobody owns the vehicle: the last set-point wins, whoever sent it.
- DO_SET_MODE is acknowledged twice, and the acknowledgement says nothing: in flight, OFFBOARD without a stream is
  "accepted" and does not happen. Only HEARTBEAT tells, once a second.
- When the stream stops, the vehicle is pulled back to the last position at once; COM_OF_LOSS_T later the failsafe of
  COM_OBL_RC_ACT acts. When the stream comes back it enters OFFBOARD again, unasked, unless another mode was commanded.
- Set-points that are refused do not hold OFFBOARD.
- The home altitude wanders by a metre in flight, and relative set-points with it.
"""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl_fixtures.autopilot.command import Command
from sitl_fixtures.autopilot.model import CRITICAL, INFO, ModelledVehicle
from sitl_fixtures.dynamics.estimator import SphereProjection
from sitl_fixtures.mavlink import mission_protocol
from sitl_fixtures.mavlink.parameters import Parameter
from sitl_fixtures.mavlink.wire import Message
from sitl_fixtures.px4 import setpoints
from sitl_fixtures.px4.commands import Px4Commands
from sitl_fixtures.px4.core import Px4Core
from sitl_fixtures.px4.failsafe import Px4Failsafe
from sitl_fixtures.px4.flight import Px4Flight
from sitl_fixtures.px4.modes import HOLD, LAND, MODE_NAMES, OFFBOARD, POSCTL, RTL
from sitl_fixtures.px4.parameters import PX4


class Px4(Px4Core):
    """PX4 1.17 multicopter."""

    mav_autopilot = mavlink.MAV_AUTOPILOT_PX4
    PROJECTION = SphereProjection
    PARAMETERS = PX4
    ORIGIN_AT = 0.2
    MISSIONS = mission_protocol.PX4
    BITWISE_PARAMETERS = True

    def __init__(self, vehicle: ModelledVehicle) -> None:
        super().__init__(vehicle)
        self.texts = 0
        self.flight = Px4Flight(self)
        self.failsafe = Px4Failsafe(self)
        self.commands = Px4Commands(self)

    # -- parameters ---------------------------------------------------------------------------------------------------

    def refresh(self) -> None:
        """Takes over limits and gains from the parameters."""
        p, limits = self.params, self.guidance.limits
        limits.speed_m_s = p["MPC_XY_CRUISE"]
        limits.up_m_s, limits.down_m_s = p["MPC_Z_VEL_MAX_UP"], p["MPC_Z_VEL_MAX_DN"]
        limits.accel_m_s2 = max(0.5, p["MPC_ACC_HOR"])
        limits.jerk_m_s3 = max(1.0, p["MPC_JERK_AUTO"])
        limits.accel_z_m_s2 = max(0.5, p["MPC_ACC_DOWN_MAX"])
        limits.jerk_z_m_s3 = max(1.0, p["MPC_JERK_AUTO"])
        limits.brake_m_s2 = 0.6 * limits.accel_m_s2
        limits.brake_z_m_s2 = 0.5 * limits.accel_z_m_s2
        self.flight.max_speed_m_s = p["MPC_XY_VEL_MAX"]
        self.stream_timeout_s = p["COM_OF_LOSS_T"] + 0.03
        self.failsafe.gcs_timeout_s = p["COM_DL_LOSS_T"]
        self.flight.climb_m_s = p["MPC_Z_VEL_MAX_UP"]
        self.flight.yaw_rate_rad_s = math.radians(p["MPC_YAWRAUTO_MAX"])
        tracker = self.guidance.tracker
        tracker.position_gain = (p["MPC_XY_P"], p["MPC_Z_P"])
        tracker.velocity_gain = (p["MPC_XY_VEL_P_ACC"], p["MPC_Z_VEL_P_ACC"])
        tracker.integral_gain = (p["MPC_XY_VEL_I_ACC"], p["MPC_Z_VEL_I_ACC"])
        self.vehicle.set_aircraft(
            tilt_deg=self.lean_deg(p["MPC_TILTMAX_AIR"]), drag_linear_1_s=p["SIH_KDV"] / max(0.1, p["SIH_MASS"])
        )

    def named_index(self, parameter: Parameter) -> int:
        """A parameter always carries its place in the list."""
        return parameter.index

    def on_parameter_set(self, link: int, parameter: Parameter) -> None:
        """PARAM_VALUE to the station that set it, and a little later again to every link, unasked."""
        self.vehicle.send_parameter(parameter, link)
        self.vehicle.after(0.015, lambda: self.vehicle.send_parameter(parameter, None, parameter.index))

    def tick(self, dt: float) -> None:
        """Failsafes, then flight."""
        self.guidance.update(self.position, self.velocity)
        self.failsafe.check(self.vehicle.time_s)
        self.flight.tick(dt)

    def slow_tick(self, dt: float) -> None:
        """The battery, and the home altitude."""
        self.failsafe.slow_check(dt)

    def on_command(self, command: Command) -> None:
        """See ``commands.py``."""
        self.commands.handle(command)

    def on_heartbeat(self, link: int, message: Message) -> None:
        """Any ground station's heartbeat counts."""
        self.failsafe.heard(link, message)

    # -- who may speak ------------------------------------------------------------------------------------------------

    def heard_from(self, link: int, message: Message) -> bool:
        """Everyone."""
        return True

    def addressed(self, message: Message) -> bool:
        """The vehicle's own system id alone, component 1 or 0."""
        return message.target_system == self.vehicle.config.system_id and message.target_component in (0, 1)

    def parameters_for(self, message: Message) -> bool:
        """Component 1 or 0."""
        return message.target_system in (0, self.vehicle.config.system_id) and message.target_component in (0, 1)

    # -- what it says -------------------------------------------------------------------------------------------------

    def text(self, text: str, severity: int = INFO, link: int | None = None) -> None:
        """STATUSTEXT ending in a tab, in pieces of 50 characters, each text with a number of its own."""
        whole = text + "\t"
        for chunk, start in enumerate(range(0, len(whole), 50)):
            piece = whole[start : start + 50].encode()
            self.vehicle.send(mavlink.MAVLink_statustext_message(severity, piece, self.texts & 0xFFFF, chunk), link)
        self.texts += 1

    def heartbeat(self) -> Message:
        """HEARTBEAT: main mode in bits 16-23 of custom_mode, sub mode in bits 24-31."""
        main, sub = self.mode
        base = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        if self.mode == OFFBOARD:
            if self.stream_fresh or self.armed:
                base |= mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
        elif main == 4:
            base |= 28
        else:
            base |= mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED | mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
        if self.armed:
            base |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED
        if self.failsafe_active:
            status = mavlink.MAV_STATE_CRITICAL
        elif self.armed:
            status = mavlink.MAV_STATE_ACTIVE
        elif self.arming_refusals():
            status = mavlink.MAV_STATE_UNINIT
        else:
            status = mavlink.MAV_STATE_STANDBY
        return mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_QUADROTOR, self.mav_autopilot, base, main << 16 | sub << 24, status, 3
        )

    def position_target(self) -> Message | None:
        """The echo: what the controller holds; while disarmed there is none."""
        if not self.armed:
            return None
        mask = 0
        flat: list[float] = []
        for part in self.echoed:
            for value in part:
                if math.isnan(value):
                    mask |= 1 << len(flat)
                flat.append(value)
        return mavlink.MAVLink_position_target_local_ned_message(
            int(self.vehicle.time_s * 1000), 1, mask, *flat, self.yaw_rad, 0.0
        )

    def version(self) -> Message:
        """AUTOPILOT_VERSION of PX4 1.17.0."""
        return mavlink.MAVLink_autopilot_version_message(
            59647,
            17891583,
            17891583,
            101854463,
            1,
            list(b"simulatd"),
            [0] * 8,
            [0] * 8,
            0,
            0,
            1,
            list(self.vehicle.uid),
        )

    @property
    def acceptance_radius_m(self) -> float:
        """How near a waypoint counts as reached, m."""
        return self.params["NAV_ACC_RAD"]

    def on_ready(self) -> None:
        """Health checks pass from now on."""

    def on_origin(self) -> None:
        """Home is set, the origin told."""
        vehicle = self.vehicle
        self.set_home_here()
        vehicle.send(vehicle.telemetry.global_origin())
        vehicle.send(vehicle.telemetry.home_position())
        vehicle.telemetry.set_default_interval(mavlink.MAVLINK_MSG_ID_HOME_POSITION, 2.0)

    # -- failsafes ----------------------------------------------------------------------------------------------------

    def force_mode(self, kind: str) -> None:
        """Changes the mode without a command."""
        self.intend({"hold": HOLD, "return": RTL, "land": LAND, "pilot": POSCTL}[kind])

    # -- set-points ---------------------------------------------------------------------------------------------------

    def _for_setpoint(self, message: Message) -> bool:
        return message.target_system in (0, self.vehicle.config.system_id) and message.target_component in (0, 1)

    def on_setpoint_local(self, link: int, message: Message) -> None:
        """84: frames 1 and 8."""
        if self._for_setpoint(message):
            try:
                self._take(link, message, setpoints.local(message, self.yaw_rad))
            except setpoints.RefusedError as refusal:
                self.text(str(refusal), CRITICAL)

    def on_setpoint_global(self, link: int, message: Message) -> None:
        """86: frames 5, 6 and 11."""
        if self._for_setpoint(message):
            try:
                self._take(link, message, setpoints.global_int(message, self.vehicle.estimator, self.home_alt_amsl_m))
            except setpoints.RefusedError as refusal:
                self.text(str(refusal), CRITICAL)

    def _take(self, link: int, message: Message, target: setpoints.Target | None) -> None:
        if target is None:
            return
        self.stream_s = self.vehicle.time_s
        self.target = target
        if self.mode == OFFBOARD:
            self.accepted(link, message.get_srcSystem(), message.get_type(), target.describe())

    # -- commands -----------------------------------------------------------------------------------------------------

    def set_mode(self, link: int, message: Message) -> None:
        """The old SET_MODE."""
        mode = (message.custom_mode >> 16 & 255, message.custom_mode >> 24 & 255)
        if message.target_system == self.vehicle.config.system_id and mode in MODE_NAMES:
            self.intend(mode)

    def on_setup_signing(self, link: int, message: Message) -> None:
        """PX4 1.17 does not sign: SETUP_SIGNING is ignored."""
