"""The faults of set-points, modes and the vehicle itself."""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl_fixtures.faults import actions as do
from sitl_fixtures.faults.fault import Acting, Fault, Hook
from sitl_fixtures.faults.foreign_station import (
    foreign_station_beats,
    foreign_station_commands_return,
    foreign_station_sets_parameter,
    foreign_station_streams,
)


def _jump_estimate(acting: Acting) -> None:
    acting.vehicle.estimator.bias_e_m += acting.value


def _unjump_estimate(acting: Acting) -> None:
    acting.vehicle.estimator.bias_e_m -= acting.value


def _raise_estimate(acting: Acting) -> None:
    acting.vehicle.estimator.bias_d_m -= acting.value


def _shift_origin(acting: Acting) -> None:
    vehicle = acting.vehicle
    estimate = vehicle.estimator
    if estimate.origin is None:
        return
    lat, lon, alt = estimate.origin
    estimate.set_origin(lat, lon + acting.value / 6371000.0 / math.cos(lat), alt)
    vehicle.send(vehicle.telemetry.global_origin())


def _shift_home(acting: Acting) -> None:
    autopilot = acting.vehicle.autopilot
    if autopilot.home is not None:
        lat, lon, alt = autopilot.home
        autopilot.home = (lat + math.degrees(acting.value / 6371000.0), lon, alt)
        acting.vehicle.send(acting.vehicle.telemetry.home_position())


def _estimate(healthy: bool) -> tuple[Hook, Hook]:
    def begin(acting: Acting) -> None:
        acting.vehicle.estimator.healthy = healthy

    def end(acting: Acting) -> None:
        acting.vehicle.estimator.healthy = not healthy

    return begin, end


def _gps(acting: Acting) -> None:
    acting.vehicle.gps_ok = False
    acting.vehicle.autopilot.text("GPS glitch", mavlink.MAV_SEVERITY_CRITICAL)


def _gps_lost_long(acting: Acting, dt: float) -> None:
    # The filter dead-reckons for ten seconds, then it has nothing to go by.
    if acting.vehicle.time_s - acting.began_s > 10.0:
        acting.vehicle.estimator.healthy = False


def _gps_back(acting: Acting) -> None:
    acting.vehicle.gps_ok = True
    acting.vehicle.estimator.healthy = True


def _battery_to(acting: Acting) -> None:
    battery = acting.vehicle.battery
    battery.used_mah = battery.capacity_mah * (1.0 - acting.value)


def _drain(acting: Acting) -> None:
    acting.vehicle.battery.drain_factor = acting.value


def _drain_end(acting: Acting) -> None:
    acting.vehicle.battery.drain_factor = 1.0


def _wind(acting: Acting) -> None:
    acting.memory["wind"] = acting.vehicle.body.wind_e_m_s
    acting.vehicle.body.wind_e_m_s += acting.value


def _wind_end(acting: Acting) -> None:
    acting.vehicle.body.wind_e_m_s = acting.memory["wind"]


def _thrust(acting: Acting) -> None:
    acting.vehicle.body.thrust_factor = acting.value


def _thrust_end(acting: Acting) -> None:
    acting.vehicle.body.thrust_factor = 1.0


def _drag(acting: Acting) -> None:
    acting.vehicle.body.drag_linear_1_s *= acting.value
    acting.vehicle.body.drag_quadratic_1_m *= acting.value


def _fall(acting: Acting, dt: float) -> None:
    acting.vehicle.autopilot.rotors = False
    acting.vehicle.rotors_stopped = True


def _hang(acting: Acting) -> None:
    acting.vehicle.hung = True


def _unhang(acting: Acting) -> None:
    acting.vehicle.hung = False


def _rate(acting: Acting) -> None:
    acting.vehicle.clock_rate = acting.value


def _reboot(acting: Acting) -> None:
    acting.vehicle.defer(acting.vehicle.reboot)


def _disarm(acting: Acting) -> None:
    acting.vehicle.autopilot.armed = False


FROZEN, THAWED = _estimate(False)
NO_CLIMB, CLIMB_AGAIN = do.set_body(max_up_m_s2=0.05)

FLIGHT_FAULTS = [
    # Set-points and modes
    Fault(
        "setpoints-lost",
        "flight",
        "set-points are not heard",
        start="T10",
        duration_s=5.0,
        incoming=do.drop(*do.SETPOINTS),
    ),
    Fault(
        "setpoints-lost-share",
        "flight",
        "a share of set-points is not heard",
        "SHARE",
        0.3,
        incoming=do.drop_share(*do.SETPOINTS),
    ),
    Fault(
        "setpoints-late", "flight", "set-points are heard late", "SECONDS", 0.3, incoming=do.hear_late(*do.SETPOINTS)
    ),
    Fault(
        "setpoints-stuck",
        "flight",
        "only the first set-point counts",
        start="T10",
        duration_s=5.0,
        incoming=do.hear_first_only(*do.SETPOINTS),
    ),
    Fault("mode-to-hold", "flight", "changes to hold by itself", start="T10", begin=do.force_mode("hold")),
    Fault("mode-to-return", "flight", "returns by itself", start="T10", begin=do.force_mode("return")),
    Fault("mode-to-land", "flight", "lands by itself", start="T10", begin=do.force_mode("land")),
    Fault("pilot-takes-over", "flight", "a pilot's switch changes the mode", start="T10", begin=do.force_mode("pilot")),
    Fault("disarm-in-flight", "flight", "disarms in the air", start="T10", begin=_disarm),
    Fault(
        "foreign-station-streams",
        "flight",
        "station 99 streams a target M north",
        "METRES",
        20.0,
        "T10",
        5.0,
        step=foreign_station_streams,
    ),
    Fault(
        "foreign-station-returns",
        "flight",
        "station 99 commands a return",
        start="T10",
        begin=foreign_station_commands_return,
    ),
    Fault(
        "foreign-station-parameter",
        "flight",
        "station 99 sets a parameter",
        "NAME=VALUE",
        "MAV_GCS_SYSID=99",
        "T10",
        begin=foreign_station_sets_parameter,
    ),
    Fault("foreign-station-heartbeat", "flight", "station 99 sends heartbeats", step=foreign_station_beats),
    # The vehicle
    Fault("reboot", "vehicle", "the autopilot reboots", start="T10", begin=_reboot),
    Fault(
        "hang",
        "vehicle",
        "the autopilot hangs: no step, no answer",
        start="T10",
        duration_s=3.0,
        begin=_hang,
        end=_unhang,
    ),
    Fault("clock-rate", "vehicle", "runs at a share of the time given", "SHARE", 0.9, begin=_rate),
    Fault("ekf-failure", "vehicle", "the position estimate fails", start="T10", begin=FROZEN, end=THAWED),
    Fault(
        "gps-loss",
        "vehicle",
        "no satellites; the estimate fails 10 s later",
        start="T10",
        duration_s=30.0,
        begin=_gps,
        step=_gps_lost_long,
        end=_gps_back,
    ),
    Fault(
        "gps-jump",
        "vehicle",
        "the estimate jumps east",
        "METRES",
        30.0,
        "T10",
        begin=_jump_estimate,
        end=_unjump_estimate,
    ),
    Fault("altitude-bias", "vehicle", "the estimate is too high", "METRES", 5.0, "T10", begin=_raise_estimate),
    Fault(
        "origin-shift",
        "vehicle",
        "the EKF origin is laid anew, east of the old",
        "METRES",
        50.0,
        "T10",
        begin=_shift_origin,
    ),
    Fault("home-shift", "vehicle", "home moves north", "METRES", 100.0, "T10", begin=_shift_home),
    Fault("never-ready", "vehicle", "never gets a position", begin=_gps),
    Fault("battery-low", "vehicle", "the battery drops to a share", "SHARE", 0.12, "T10", begin=_battery_to),
    Fault("battery-critical", "vehicle", "the battery drops to a share", "SHARE", 0.04, "T10", begin=_battery_to),
    Fault("battery-drain", "vehicle", "the battery drains faster", "TIMES", 20.0, begin=_drain, end=_drain_end),
    Fault("wind-gust", "vehicle", "wind towards east for a while", "M_S", 12.0, "T10", 5.0, begin=_wind, end=_wind_end),
    Fault("wind", "vehicle", "steady wind towards east", "M_S", 8.0, begin=_wind, end=_wind_end),
    Fault(
        "slow-vehicle",
        "vehicle",
        "30 degrees of lean, topping out at a speed",
        "M_S",
        10.5,
        step=lambda a, dt: do.slow_vehicle(a),
    ),
    Fault("drag", "vehicle", "more drag", "TIMES", 5.0, "T10", begin=_drag),
    Fault(
        "thrust-loss", "vehicle", "a share of the thrust is left", "SHARE", 0.6, "T10", begin=_thrust, end=_thrust_end
    ),
    Fault("cannot-climb", "vehicle", "no upward thrust beyond hover", begin=NO_CLIMB, end=CLIMB_AGAIN),
    Fault("crash", "vehicle", "the rotors stop", start="T10", step=_fall),
]
