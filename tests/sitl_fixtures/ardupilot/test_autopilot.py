"""ArduCopter beyond the recordings: ownership, traps, failsafes."""

from __future__ import annotations

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl_fixtures.errors import ConfigurationError
from sitl_fixtures.vehicle import SimulatedAutopilot, SimulatorConfig
from tests.support.sitl.station import (
    ACCEPTED,
    ALL,
    AP_LAND,
    AP_LOITER,
    AP_RTL,
    BRAKE,
    DENIED,
    FAILED,
    GUIDED,
    POSITION,
    POSITION_VELOCITY,
    UNSUPPORTED,
    VELOCITY,
    Rig,
    Station,
    airborne,
)


def moving(rig: Rig, station: Station, speed: float = 15.0, mask: int = ALL, seconds: float = 12.0) -> float:
    """Streams a straight run north until the vehicle follows; when it started."""
    start = rig.now
    step = station.stream(
        lambda now: {"position": (speed * (now - start), 0, -50), "velocity": (speed, 0, 0), "mask": mask}
    )
    rig.run(seconds)
    step()
    return start


def test_before_4_7_one_station_is_heard_under_older_names_and_there_is_no_range() -> None:
    enforced = ("SYSID_MYGCS=254", "SYSID_ENFORCE=1")
    old = SimulatedAutopilot(SimulatorConfig(autopilot="ardupilot", firmware="4.6", parameters=enforced))
    assert [old.autopilot.is_owner(i) for i in (253, 254, 255)] == [False, True, False]
    assert not any(name in old.parameters for name in ("MAV_GCS_SYSID", "MAV_GCS_SYSID_HI", "MAV_OPTIONS", "MAV_SYSID"))
    assert old.autopilot.version().flight_sw_version >> 16 == 0x0406
    for autopilot, firmware in (("px4", "4.6"), ("ardupilot", "3.2")):
        with pytest.raises(ConfigurationError, match=r"4\.6, with --autopilot ardupilot"):
            SimulatorConfig(autopilot=autopilot, firmware=firmware)


def test_arming_checks_speak_before_there_is_a_position() -> None:
    rig = Rig("ardupilot", ready_after_s=10.0)
    station = rig.station()
    rig.run(1.0)
    assert station.set_mode(GUIDED) == [ACCEPTED]
    assert station.arm() == [FAILED]
    assert station.texts()[-2:] == ["Arm: Accels inconsistent", "Arm: AHRS: waiting for home"]
    assert station.command(22, 0, 0, 0, 0, 0, 0, 10) == [FAILED]
    rig.run(6.0)
    assert station.arm() == [FAILED]
    assert station.texts()[-1] == "Arm: Need Position Estimate"
    rig.run(5.0)
    before = len(station.heard)
    assert station.arm() == [ACCEPTED]
    assert [m.get_type() for _, m in station.heard[before:]] == [
        "COMMAND_ACK",
        "GPS_GLOBAL_ORIGIN",
        "HOME_POSITION",
        "STATUSTEXT",
    ]


def test_mode_change_sends_an_extra_heartbeat_after_the_acknowledgement() -> None:
    rig = Rig("ardupilot")
    station = rig.station()
    rig.run(3.05)
    before = len(station.heard)
    assert station.set_mode(GUIDED) == [ACCEPTED]
    answer = [m for _, m in station.heard[before:]]
    assert [m.get_type() for m in answer] == ["COMMAND_ACK", "HEARTBEAT"]
    assert answer[1].custom_mode == GUIDED
    before = len(station.heard)
    assert station.set_mode(GUIDED) == [ACCEPTED]
    assert [m.get_type() for _, m in station.heard[before:]] == ["COMMAND_ACK"]
    assert station.set_mode(99) == [FAILED]
    assert station.texts()[-1] == "No such mode 99"


def test_setpoints_do_not_take_off_and_idling_disarms() -> None:
    rig = Rig("ardupilot")
    station = rig.station()
    rig.run(4.0)
    station.set_mode(GUIDED)
    station.arm()
    station.stream(lambda now: {"position": (0, 0, -50)})
    rig.run(9.5)
    assert rig.sim.body.on_ground
    assert rig.sim.autopilot.armed
    rig.run(1.0)
    assert not rig.sim.autopilot.armed


def test_a_setpoint_during_the_climb_ends_the_take_off() -> None:
    rig = Rig("ardupilot")
    station = rig.station()
    rig.run(4.0)
    station.set_mode(GUIDED)
    station.arm()
    assert station.command(22, 0, 0, 0, 0, 0, 0, 60) == [ACCEPTED]
    rig.run(8.0)
    climbed = -rig.place[2]
    assert 5.0 < climbed < 40.0
    station.local((0, 0, -climbed))
    rig.run(15.0)
    assert -rig.place[2] == pytest.approx(climbed, abs=4.0)


@pytest.mark.parametrize("mask", [ALL, POSITION_VELOCITY])
@pytest.mark.parametrize("timeout_s", [0.5, 1.0, 3.0])
def test_stream_loss_runs_on_for_the_timeout_then_comes_back(mask: int, timeout_s: float) -> None:
    """15 m/s: the point flown back to lies 15 x GUID_TIMEOUT beyond the last set-point."""
    rig, station = airborne("ardupilot", parameters=(f"GUID_TIMEOUT={timeout_s}",))
    start = moving(rig, station, mask=mask)
    last = 15.0 * (rig.now - start)
    stopped = rig.now
    furthest = 0.0
    for _ in range(300):
        rig.run(0.1)
        furthest = max(furthest, rig.place[0])
    assert rig.place[0] - last == pytest.approx(15.0 * timeout_s, abs=1.5)
    assert furthest - rig.place[0] > 15.0
    assert rig.mode == "GUIDED"
    assert station.texts(stopped) == []


def test_a_position_alone_never_times_out() -> None:
    rig, station = airborne("ardupilot")
    station.local((300.0, 0.0, -50.0), mask=POSITION)
    rig.run(40.0)
    assert rig.off(300.0, 0.0) < 0.5


@pytest.mark.parametrize(
    "bad",
    [
        {"frame": 3},
        {"frame": 99},
        {"mask": 0x0C38},
        {"mask": 0x0DFF},
        {"mask": POSITION_VELOCITY, "velocity": (math.nan, 0, 0)},
    ],
)
def test_a_bad_setpoint_stops_the_vehicle_without_a_word(bad: dict[str, object]) -> None:
    rig, station = airborne("ardupilot")
    moving(rig, station)
    start = rig.now
    station.local(**{"position": (999.0, 0.0, -50.0), **bad})  # type: ignore[arg-type]
    rig.run(6.0)
    assert rig.sim.body.speed_m_s < 0.5
    assert station.texts(start) == []
    echo = station.last["POSITION_TARGET_LOCAL_NED"]
    assert (echo.type_mask, echo.x, echo.y, echo.z) == (0x0C07, 0, 0, 0)


def test_a_nan_spoils_the_controller_for_good() -> None:
    rig, station = airborne("ardupilot")
    station.local((math.nan, 0, -50))
    rig.run(1.0)
    assert "Internal Errors 0x400" in station.texts()
    station.local((30.0, 0.0, -50.0))
    rig.run(10.0)
    assert rig.off(0.0, 0.0) < 2.0


def test_global_setpoints_drop_the_acceleration_and_use_ardupilots_scale() -> None:
    """0.001 degree is 111.31885 m north; east 111.31885 cos 53 = 66.994 m (mean latitude)."""
    rig, station = airborne("ardupilot", home=(53.0, 5.0, 10.0))
    station.send(
        mavlink.MAVLink_set_position_target_global_int_message(
            0, 1, 1, 5, ALL, 530010000, 50010000, 60.0, 1, 0, 0, 2, 0, 0, 0, 0
        )
    )
    target = rig.sim.accepted_setpoints[-1][4]
    assert target["position"] == pytest.approx((111.318845, 66.99266, -50.0), abs=2e-3)
    assert target["accel"] == (0.0, 0.0, 0.0)


def test_owner_is_enforced_by_silence() -> None:
    rig, owner = airborne("ardupilot", links=3)
    foreign, own_id = rig.station(1, 254), rig.station(2, 1)
    assert foreign.read_parameter("GUID_TIMEOUT") is not None
    assert owner.set_parameter("MAV_OPTIONS", 1.0).param_value == 1.0
    start = rig.now
    assert foreign.read_parameter("GUID_TIMEOUT") is None
    assert foreign.set_parameter("GUID_TIMEOUT", 1.0) is None
    assert foreign.set_mode(BRAKE) == []
    foreign.local((50, 0, -50))
    foreign.send(mavlink.MAVLink_timesync_message(0, 1234))
    foreign.send(mavlink.MAVLink_mission_request_list_message(1, 1, 0))
    rig.run(3.0)
    assert rig.off(0, 0) < 0.5
    assert not foreign.of("TIMESYNC", start)
    assert not foreign.of("MISSION_COUNT", start)
    assert len(foreign.of("HEARTBEAT", start)) >= 3  # telemetry is never cut
    assert own_id.read_parameter("MAV_GCS_SYSID").param_value == 255.0  # the back door


def test_handover_by_parameter_takes_effect_with_its_answer() -> None:
    rig, a = airborne("ardupilot", links=2, parameters=("MAV_OPTIONS=1",))
    b = rig.station(1, 254)
    assert a.set_parameter("MAV_GCS_SYSID", 254.0).param_value == 254.0
    b.local((20, 0, -50))
    assert rig.sim.accepted_setpoints[-1][2] == 254
    count = len(rig.sim.accepted_setpoints)
    a.local((-20, 0, -50))
    assert len(rig.sim.accepted_setpoints) == count
    assert a.set_parameter("MAV_GCS_SYSID", 255.0) is None


def test_range_of_owners_and_its_order_trap() -> None:
    """HI first, then SYSID: both are in. SYSID first with HI = 0 shuts the owner out."""
    rig = Rig("ardupilot", links=3, parameters=("MAV_OPTIONS=1",))
    a, b, c = rig.station(0, 255), rig.station(1, 254), rig.station(2, 250)
    rig.run(1.0)
    assert a.set_parameter("MAV_GCS_SYSID_HI", 255.0)
    assert a.set_parameter("MAV_GCS_SYSID", 254.0)
    assert a.read_parameter("MAV_OPTIONS")
    assert b.read_parameter("MAV_OPTIONS")
    assert c.read_parameter("MAV_OPTIONS") is None
    assert b.set_parameter("MAV_GCS_SYSID_HI", 0.0)
    assert a.read_parameter("MAV_OPTIONS") is None
    assert b.set_parameter("MAV_GCS_SYSID", 255.0)
    assert b.read_parameter("MAV_OPTIONS") is None


def test_without_the_option_the_last_message_wins() -> None:
    rig, a = airborne("ardupilot", links=2)
    b = rig.station(1, 254)
    a.stream(lambda now: {"position": (10, 0, -50)})
    b.stream(lambda now: {"position": (-10, 0, -50)})
    rig.run(10.0)
    assert rig.off(-10, 0) < 0.5


def test_gcs_failsafe_counts_the_owners_heartbeats_alone() -> None:
    rig, a = airborne("ardupilot", links=2, parameters=("FS_GCS_ENABLE=1",))
    b = rig.station(1, 254)
    a.stream(lambda now: {"position": (0, 0, -50)})
    a.heartbeat()
    a.beating = False
    start = rig.now
    took = rig.until(lambda: rig.mode == "RTL", 7.0)
    assert 5.0 <= took <= 5.4
    assert "GCS Failsafe" in a.texts(start)
    rig.run(0.1)
    assert b.last["HEARTBEAT"].system_status == mavlink.MAV_STATE_CRITICAL
    a.beating = True
    rig.run(2.0)
    assert a.texts(start)[-1] == "GCS Failsafe Cleared"
    assert rig.mode == "RTL"
    assert a.set_mode(GUIDED) == [ACCEPTED]
    rig.run(3.0)
    assert rig.mode == "GUIDED"


def test_gcs_failsafe_is_never_armed_before_an_owner_was_heard() -> None:
    rig = Rig("ardupilot", parameters=("FS_GCS_ENABLE=1",))
    station = rig.station()
    station.beating = False
    rig.run(4.0)
    station.set_mode(GUIDED)
    station.arm()
    station.command(22, 0, 0, 0, 0, 0, 0, 20)
    rig.run(20.0)
    assert rig.mode == "GUIDED"


def test_loiter_without_a_pilot_sinks() -> None:
    rig, station = airborne("ardupilot")
    assert station.set_mode(AP_LOITER) == [ACCEPTED]
    rig.run(6.0)
    assert 50.0 + rig.place[2] == pytest.approx(12.5, abs=2.5)


def test_brake_stops_and_stays() -> None:
    rig, station = airborne("ardupilot")
    moving(rig, station)
    station.set_mode(BRAKE)
    rig.run(10.0)
    assert rig.sim.body.speed_m_s < 0.2
    assert rig.place[2] == pytest.approx(-50.0, abs=1.0)


def test_return_climbs_to_the_return_altitude_flies_home_and_disarms() -> None:
    rig, station = airborne("ardupilot", height_m=10.0, parameters=("RTL_ALT=4000",))
    station.local((200, 0, -10))
    rig.run(30.0)
    station.set_mode(AP_RTL)
    highest = 0.0
    while rig.sim.autopilot.armed:
        rig.run(0.5)
        highest = max(highest, -rig.place[2])
        assert rig.now < 400.0
    assert highest == pytest.approx(40.0, abs=1.0)
    assert rig.off(0, 0) < 1.0
    assert station.texts()[-1] == "Disarming motors"


@pytest.mark.parametrize(("limit_km", "expected"), [(0.5, 200.3), (0.05, 0.0)])
def test_return_goes_to_a_rally_point_within_its_limit(limit_km: float, expected: float) -> None:
    rig, station = airborne("ardupilot", parameters=(f"RALLY_LIMIT_KM={limit_km}",))
    lat, lon = rig.sim.body.lat_deg, rig.sim.body.lon_deg
    station.send(mavlink.MAVLink_mission_count_message(1, 1, 1, 2))
    station.send(
        mavlink.MAVLink_mission_item_int_message(
            1, 1, 0, 3, 5100, 0, 1, 0, 0, 0, 0, round((lat + 0.0018) * 1e7), round(lon * 1e7), 30.0, 2
        )
    )
    assert rig.sim.parameters["RALLY_TOTAL"] == 1
    station.local((300, 0, -50))
    rig.run(40.0)
    station.set_mode(AP_RTL)
    rig.until(lambda: not rig.sim.autopilot.armed, 300.0)
    assert rig.place[0] == pytest.approx(expected, abs=2.0)


def test_battery_failsafe_acts_after_its_timer() -> None:
    rig, station = airborne(
        "ardupilot", parameters=("BATT_FS_LOW_ACT=2", "BATT_LOW_MAH=20000"), faults=("battery-low:0.1@A40",)
    )
    start = rig.now
    rig.until(lambda: rig.mode == "RTL", 40.0)
    assert any(text.startswith("Battery 1 is low") for text in station.texts(start))


def test_estimate_failure_lands() -> None:
    rig, station = airborne("ardupilot", faults=("ekf-failure@A40",))
    rig.until(lambda: rig.mode == "LAND", 40.0)
    assert "EKF variance" in station.texts()


def test_disarm_in_flight_needs_force() -> None:
    rig, station = airborne("ardupilot")
    assert station.arm(False) == [FAILED]
    assert rig.sim.autopilot.armed
    assert station.arm(False, force=21196.0) == [ACCEPTED]
    rig.run(6.0)
    assert rig.sim.body.on_ground
    assert rig.sim.body.impact_m_s > 10.0


def test_addressing_and_answers() -> None:
    rig, station = airborne("ardupilot")
    assert station.command(12345) == [UNSUPPORTED]
    assert station.command(32100, 1, 1, 10, 255) == [UNSUPPORTED]
    assert station.command(176, 1, 4, system=9) == []
    assert station.command(176, 1, 4, system=0) == [ACCEPTED]
    assert station.command(176, 1, 4, component=190) == [ACCEPTED]
    assert station.command(512, 512) == [FAILED]
    assert station.command(511, 512, 1e6) == [DENIED]
    before = len(station.heard)
    assert station.command(512, 148) == [ACCEPTED]
    assert [m.get_type() for _, m in station.heard[before:]] == ["COMMAND_ACK", "AUTOPILOT_VERSION"]
    count = len(rig.sim.accepted_setpoints)
    station.local((0, 0, -50), component=190)
    assert len(rig.sim.accepted_setpoints) == count + 1


def test_stock_vehicle_cannot_follow_and_never_complains() -> None:
    """30 degrees of lean and the drag that tops out at 10.5 m/s: asked for 18, it falls behind for good."""
    rig, station = airborne("ardupilot", faults=("slow-vehicle",))
    start = moving(rig, station, speed=18.0, seconds=40.0)
    assert rig.sim.body.speed_m_s == pytest.approx(10.5, abs=0.4)
    assert 18.0 * (rig.now - start) - rig.place[0] > 250.0
    assert rig.mode == "GUIDED"
    assert station.texts(start) == []


@pytest.mark.parametrize("mask", [ALL, POSITION_VELOCITY])
def test_speed_parameter_does_not_bound_setpoints(mask: int) -> None:
    rig, station = airborne("ardupilot", parameters=("WPNAV_SPEED=1000",))
    start = moving(rig, station, speed=30.0, mask=mask, seconds=60.0)
    assert rig.sim.body.speed_m_s == pytest.approx(30.0, abs=0.2)
    assert 30.0 * (rig.now - start) - rig.place[0] == pytest.approx(0.0, abs=3.0)


def test_velocity_setpoints_time_out_too() -> None:
    rig, station = airborne("ardupilot")
    station.local(velocity=(5, 0, 0), mask=VELOCITY)
    rig.run(2.5)
    assert rig.sim.body.vn == pytest.approx(5.0, abs=0.3)
    rig.run(4.0)
    assert rig.sim.body.speed_m_s < 0.3


def test_land_slows_down_near_the_ground() -> None:
    rig, station = airborne("ardupilot", height_m=20.0)
    station.set_mode(AP_LAND)
    rig.run(4.0)
    assert rig.sim.body.vd == pytest.approx(1.5, abs=0.1)
    rig.until(lambda: rig.place[2] > -6.0, 30.0)
    assert rig.sim.body.vd == pytest.approx(0.5, abs=0.1)
    rig.until(lambda: not rig.sim.autopilot.armed, 40.0)
    assert rig.sim.body.impact_m_s == pytest.approx(0.5, abs=0.1)
