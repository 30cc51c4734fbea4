"""Messages the vehicle sends of itself, and when.

Rates are in vehicle time: at a speed-up of 75, a 4 Hz message leaves 300 times a second. They are therefore modest by
default, more so above a speed-up of 10, and can be changed link by link with SET_MESSAGE_INTERVAL or
REQUEST_DATA_STREAM. A message due on several links is packed once.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl_fixtures.mavlink.mission_protocol import Missions
from sitl_fixtures.mavlink.wire import Message
from sitl_fixtures.vehicle_protocol import VehicleProtocol

DEFAULT_RATES_HZ: dict[int, float] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1.0,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 5.0,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 4.0,
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: 5.0,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: 2.0,
    mavlink.MAVLINK_MSG_ID_VFR_HUD: 1.0,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 1.0,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: 1.0,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 1.0,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: 0.5,
    mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: 0.5,
}

# At a high speed-up these are slower unless asked for otherwise: everything else still goes out once a second.
FAST_RATES_HZ: dict[int, float] = {
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 4.0,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 2.0,
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: 2.0,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: 0.5,
    mavlink.MAVLINK_MSG_ID_VFR_HUD: 0.5,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: 0.2,
    mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: 0.2,
}
FAST_FROM_SPEEDUP = 10.0

# REQUEST_DATA_STREAM stream ids and what ArduPilot puts in them.
STREAMS: dict[int, tuple[int, ...]] = {
    mavlink.MAV_DATA_STREAM_EXTENDED_STATUS: (
        mavlink.MAVLINK_MSG_ID_SYS_STATUS,
        mavlink.MAVLINK_MSG_ID_GPS_RAW_INT,
        mavlink.MAVLINK_MSG_ID_MISSION_CURRENT,
        mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED,
    ),
    mavlink.MAV_DATA_STREAM_POSITION: (
        mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
        mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
    ),
    mavlink.MAV_DATA_STREAM_EXTRA1: (mavlink.MAVLINK_MSG_ID_ATTITUDE,),
    mavlink.MAV_DATA_STREAM_EXTRA2: (mavlink.MAVLINK_MSG_ID_VFR_HUD,),
    mavlink.MAV_DATA_STREAM_EXTRA3: (
        mavlink.MAVLINK_MSG_ID_SYSTEM_TIME,
        mavlink.MAVLINK_MSG_ID_BATTERY_STATUS,
        mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE,
    ),
}

# 2026-11-22T09:00:00Z: what the simulated GPS calls the moment of boot, so that runs are the same every time.
BOOT_UNIX_S = 1795338000.0
SENSORS = (
    mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG
    | mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
    | mavlink.MAV_SYS_STATUS_SENSOR_GPS
    | mavlink.MAV_SYS_STATUS_AHRS
    | mavlink.MAV_SYS_STATUS_SENSOR_BATTERY
)


class Telemetry:
    """Builders of every message that can be asked for, and a schedule a link."""

    def __init__(self, vehicle: VehicleProtocol, missions: Missions, links: int) -> None:
        self._vehicle = vehicle
        self.builders: dict[int, Callable[[], Message | None]] = {
            mavlink.MAVLINK_MSG_ID_HEARTBEAT: lambda: vehicle.autopilot.heartbeat(),
            mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: self.local_position,
            mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: self.global_position,
            mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: lambda: vehicle.autopilot.position_target(),
            mavlink.MAVLINK_MSG_ID_ATTITUDE: self.attitude,
            mavlink.MAVLINK_MSG_ID_VFR_HUD: self.hud,
            mavlink.MAVLINK_MSG_ID_SYS_STATUS: self.sys_status,
            mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: self.extended_state,
            mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: self.system_time,
            mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: self.gps_raw,
            mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: self.battery_status,
            mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: missions.current_message,
            mavlink.MAVLINK_MSG_ID_HOME_POSITION: self.home_position,
            mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: self.global_origin,
            mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: self.attitude_quaternion,
            mavlink.MAVLINK_MSG_ID_ALTITUDE: self.altitude,
            mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: lambda: vehicle.autopilot.version(),
        }
        if vehicle.autopilot.mav_autopilot == mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA:
            self.builders[mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT] = self.ekf_report
        else:
            self.builders[mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS] = self.estimator_status
        rates = DEFAULT_RATES_HZ
        if vehicle.config.speedup > FAST_FROM_SPEEDUP:
            rates = {**DEFAULT_RATES_HZ, **FAST_RATES_HZ}
        self.default_interval_s = {number: 1.0 / rate for number, rate in rates.items()}
        self._interval = [dict(self.default_interval_s) for _ in range(links)]
        # (due_s, message id, link, interval); an entry whose interval no longer holds is dropped when it comes up.
        self._queue: list[tuple[float, int, int, float]] = []
        self._waiting = True
        self.next_due_s = 0.0

    def _enqueue(self, link: int, number: int, now_s: float) -> None:
        # A fixed phase for each message spreads them over the second, the same in every run.
        interval = self._interval[link][number]
        heapq.heappush(self._queue, (now_s + interval * ((number * 37 % 100) / 100.0), number, link, interval))

    def set_interval(self, link: int, message_id: int, interval_s: float | None) -> bool:
        """Sets how often a link gets a message; None stops it. False when the message is unknown."""
        if message_id not in self.builders:
            return False
        if interval_s is None:
            self._interval[link].pop(message_id, None)
        elif self._interval[link].get(message_id) != max(interval_s, 0.02):
            self._interval[link][message_id] = max(interval_s, 0.02)
            if not self._waiting:
                self._enqueue(link, message_id, self._vehicle.time_s)
                self.next_due_s = self._queue[0][0]
        return True

    def request_interval(self, link: int, message_id: int, interval_us: float) -> bool:
        """SET_MESSAGE_INTERVAL: 0 the default rate, negative stops; False for a message unknown here."""
        if interval_us == 0.0:
            return self.set_interval(link, message_id, self.default_interval_s.get(message_id))
        return self.set_interval(link, message_id, interval_us / 1e6 if interval_us > 0.0 else None)

    def interval_s(self, link: int, message_id: int) -> float | None:
        """How often a link gets a message; None: never."""
        return self._interval[link].get(message_id)

    def set_default_interval(self, message_id: int, interval_s: float) -> None:
        """Sets a message's interval on all links."""
        for link in range(len(self._interval)):
            self.set_interval(link, message_id, interval_s)

    def request_stream(self, link: int, stream: int, rate_hz: float) -> None:
        """REQUEST_DATA_STREAM; stream 0 is all of them, rate 0 stops."""
        groups = list(STREAMS.values()) if stream == 0 else [STREAMS.get(stream, ())]
        for group in groups:
            for number in group:
                self.set_interval(link, number, 1.0 / rate_hz if rate_hz > 0 else None)

    def run(self, now_s: float) -> None:
        """Sends what is due."""
        queue = self._queue
        if self._waiting:
            self._waiting = False
            for link, intervals in enumerate(self._interval):
                for number in intervals:
                    self._enqueue(link, number, now_s)
        wanted: dict[int, list[int]] = {}
        while queue and queue[0][0] <= now_s + 1e-9:
            at, number, link, interval = heapq.heappop(queue)
            if self._interval[link].get(number) != interval:
                continue
            links = wanted.setdefault(number, [])
            if link not in links:
                links.append(link)
            at += interval
            heapq.heappush(queue, (at if at > now_s else now_s + interval, number, link, interval))
        self.next_due_s = queue[0][0] if queue else math.inf
        for number, links in wanted.items():
            message = self.builders[number]()
            if message is not None:
                self._vehicle.send_to(message, links)

    # -- builders -----------------------------------------------------------------------------------------------------

    @property
    def _boot_ms(self) -> int:
        return int(self._vehicle.time_s * 1000.0 + 0.5) & 0xFFFFFFFF

    @property
    def _usec(self) -> int:
        return int(self._vehicle.time_s * 1e6)

    def local_position(self) -> Message | None:
        """LOCAL_POSITION_NED; None before there is an estimate."""
        estimate, body = self._vehicle.estimator, self._vehicle.body
        if estimate.origin is None:
            return None
        return mavlink.MAVLink_local_position_ned_message(
            self._boot_ms, estimate.n, estimate.e, estimate.d, body.vn, body.ve, body.vd
        )

    def believed_place(self) -> tuple[float, float, float]:
        """Latitude, longitude (degrees) and altitude AMSL (m) by the estimate; the truth before there is one."""
        estimate, body = self._vehicle.estimator, self._vehicle.body
        if estimate.projection is None or estimate.origin is None:
            return body.lat_deg, body.lon_deg, body.height_m
        lat, lon = estimate.projection.to_geodetic(estimate.n, estimate.e)
        return math.degrees(lat), math.degrees(lon), estimate.origin[2] - estimate.d

    def _heading_cdeg(self) -> int:
        return round(math.degrees(self._vehicle.autopilot.yaw_rad) % 360.0 * 100.0) % 36000

    def global_position(self) -> Message | None:
        """GLOBAL_POSITION_INT: the estimate, with the height above home."""
        vehicle = self._vehicle
        if vehicle.estimator.origin is None:
            return None
        lat, lon, alt = self.believed_place()
        body = vehicle.body
        return mavlink.MAVLink_global_position_int_message(
            self._boot_ms,
            round(lat * 1e7),
            round(lon * 1e7),
            round(alt * 1000.0),
            round(vehicle.autopilot.height_above_home_m * 1000.0),
            _int16(body.vn * 100.0),
            _int16(body.ve * 100.0),
            _int16(body.vd * 100.0),
            self._heading_cdeg(),
        )

    def attitude(self) -> Message:
        """ATTITUDE from the thrust acceleration."""
        yaw = self._vehicle.autopilot.yaw_rad
        roll, pitch = self._vehicle.body.attitude_rad(yaw)
        return mavlink.MAVLink_attitude_message(self._boot_ms, roll, pitch, yaw, 0.0, 0.0, 0.0)

    def attitude_quaternion(self) -> Message:
        """ATTITUDE_QUATERNION: the same as ATTITUDE."""
        yaw = self._vehicle.autopilot.yaw_rad
        roll, pitch = self._vehicle.body.attitude_rad(yaw)
        cr, sr = math.cos(roll / 2), math.sin(roll / 2)
        cp, sp = math.cos(pitch / 2), math.sin(pitch / 2)
        cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
        return mavlink.MAVLink_attitude_quaternion_message(
            self._boot_ms,
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            0.0,
            0.0,
            0.0,
        )

    def altitude(self) -> Message:
        """ALTITUDE: AMSL, local and above home, m."""
        alt = self.believed_place()[2]
        relative = self._vehicle.autopilot.height_above_home_m
        return mavlink.MAVLink_altitude_message(
            self._usec, alt, alt, -self._vehicle.estimator.d, relative, alt, math.nan
        )

    def ekf_report(self) -> Message:
        """EKF_STATUS_REPORT (ArduPilot): flags and variances."""
        good = self._vehicle.ready and self._vehicle.estimator.healthy
        variance = 0.05 if good else 1.2
        return mavlink.MAVLink_ekf_status_report_message(831 if good else 167, variance, variance, 0.02, 0.02, 0.0)

    def estimator_status(self) -> Message:
        """ESTIMATOR_STATUS (PX4): flags and test ratios."""
        good = self._vehicle.ready and self._vehicle.estimator.healthy
        ratio = 0.1 if good else 2.0
        flags = 831 if good else 167
        return mavlink.MAVLink_estimator_status_message(
            self._usec, flags, ratio, ratio, ratio, 0.02, 0.0, 0.0, 0.3 if good else 20.0, 0.4 if good else 20.0
        )

    def hud(self) -> Message:
        """VFR_HUD."""
        body = self._vehicle.body
        air = math.hypot(body.vn - body.wind_n_m_s, body.ve - body.wind_e_m_s)
        heading = self._heading_cdeg() // 100
        throttle = 0 if not self._vehicle.autopilot.rotors else 50
        return mavlink.MAVLink_vfr_hud_message(air, body.speed_m_s, heading, throttle, body.height_m, -body.vd)

    def sys_status(self) -> Message:
        """SYS_STATUS: sensors and battery."""
        battery = self._vehicle.battery
        health = (
            SENSORS
            if self._vehicle.ready and self._vehicle.estimator.healthy
            else SENSORS & ~(mavlink.MAV_SYS_STATUS_AHRS)
        )
        if self._vehicle.ready and self._vehicle.estimator.healthy:
            health |= mavlink.MAV_SYS_STATUS_PREARM_CHECK
        present = SENSORS | mavlink.MAV_SYS_STATUS_PREARM_CHECK
        return mavlink.MAVLink_sys_status_message(
            present,
            present,
            health,
            200,
            max(0, min(65535, round(battery.voltage_v * 1000.0))),
            _int16(battery.current_a * 100.0),
            round(battery.remaining * 100.0),
            0,
            0,
            0,
            0,
            0,
            0,
        )

    def battery_status(self) -> Message:
        """BATTERY_STATUS of the one battery."""
        battery = self._vehicle.battery
        cell = max(0, min(65534, round(battery.voltage_v * 1000.0)))
        return mavlink.MAVLink_battery_status_message(
            0,
            mavlink.MAV_BATTERY_FUNCTION_ALL,
            mavlink.MAV_BATTERY_TYPE_LIPO,
            2500,
            [cell] + [65535] * 9,
            _int16(battery.current_a * 100.0),
            round(battery.used_mah),
            -1,
            round(battery.remaining * 100.0),
        )

    def extended_state(self) -> Message:
        """EXTENDED_SYS_STATE: on the ground, taking off, in the air, landing."""
        vtol = 3 if self._vehicle.autopilot.mav_autopilot == mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA else 0
        return mavlink.MAVLink_extended_sys_state_message(vtol, self._vehicle.autopilot.landed_state)

    def system_time(self) -> Message:
        """SYSTEM_TIME: GPS time and the vehicle's own clock."""
        return mavlink.MAVLink_system_time_message(int((BOOT_UNIX_S + self._vehicle.time_s) * 1e6), self._boot_ms)

    def gps_raw(self) -> Message:
        """GPS_RAW_INT: the true place."""
        body = self._vehicle.body
        speed = body.speed_m_s
        course = round(math.degrees(math.atan2(body.ve, body.vn)) % 360.0 * 100.0) % 36000
        fixed = self._vehicle.gps_ok
        return mavlink.MAVLink_gps_raw_int_message(
            self._usec,
            6 if fixed else 1,
            round(body.lat_deg * 1e7),
            round(body.lon_deg * 1e7),
            round(body.height_m * 1000.0),
            121 if fixed else 9999,
            200 if fixed else 9999,
            min(65535, round(speed * 100.0)),
            course,
            10 if fixed else 0,
        )

    def home_position(self) -> Message | None:
        """HOME_POSITION; None while there is no home."""
        home = self._vehicle.autopilot.home
        if home is None:
            return None
        north, east, down = self._vehicle.autopilot.home_local()
        return mavlink.MAVLink_home_position_message(
            round(home[0] * 1e7),
            round(home[1] * 1e7),
            round(home[2] * 1000.0),
            north,
            east,
            down,
            [1.0, 0.0, 0.0, 0.0],
            0.0,
            0.0,
            0.0,
            self._usec,
        )

    def global_origin(self) -> Message | None:
        """GPS_GLOBAL_ORIGIN of the local frame; None before it is laid."""
        origin = self._vehicle.estimator.origin
        if origin is None:
            return None
        return mavlink.MAVLink_gps_global_origin_message(
            round(math.degrees(origin[0]) * 1e7),
            round(math.degrees(origin[1]) * 1e7),
            round(origin[2] * 1000.0),
            self._usec,
        )


def _int16(value: float) -> int:
    return max(-32768, min(32767, round(value)))
