"""Every fault does what its line in the list says, and nothing happens before its time."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl_fixtures.errors import ConfigurationError
from sitl_fixtures.faults import FAULTS, listing
from sitl_fixtures.vehicle import SimulatedAutopilot, SimulatorConfig
from tests.support.sitl.station import ACCEPTED, DENIED, FAILED, GUIDED, OFFBOARD, UNSUPPORTED, Rig, Station, airborne

Check = Callable[[Rig, Station], None]
CHECKS: dict[str, tuple[str, Check]] = {}


def ground(*specifications: str) -> Callable[[Check], Check]:
    """Registers a check of faults on a PX4 on the ground, 4 s after boot."""

    def keep(check: Check) -> Check:
        for specification in specifications:
            CHECKS[specification] = ("ground", check)
        return check

    return keep


def air(*specifications: str, autopilot: str = "ardupilot") -> Callable[[Check], Check]:
    """Registers a check in the air; faults that begin at arming + 25 s act when it is called."""

    def keep(check: Check) -> Check:
        for specification in specifications:
            CHECKS[specification] = (autopilot, check)
        return check

    return keep


def count(rig: Rig, station: Station, name: str, seconds: float = 4.0) -> int:
    """Messages of a name heard in a span."""
    start = rig.now + 0.001
    rig.run(seconds)
    return len(station.of(name, start))


# -- link -------------------------------------------------------------------------------------------------------------


@ground("telemetry-loss@0", "link-mute:0@0")
def silent(rig: Rig, station: Station) -> None:
    assert station.heard == []
    assert rig.sim.ports[0].received > 2  # it hears
    rig.run(2.0)
    assert station.heard


@ground("link-cut:0@0+4.5")
def cut(rig: Rig, station: Station) -> None:
    assert station.heard == []
    station.send(mavlink.MAVLink_param_set_message(1, 1, b"COM_OF_LOSS_T", 3.0, 9))
    assert rig.sim.parameters["COM_OF_LOSS_T"] == 1.0
    rig.run(1.0)
    assert station.set_parameter("COM_OF_LOSS_T", 3.0)


@ground("link-deaf:0@0", "uplink-loss@0", "command-lost")
def deaf(rig: Rig, station: Station) -> None:
    assert station.of("HEARTBEAT")
    assert station.command(512, 148) == []


@ground("telemetry-loss-share:0.5")
def half_lost(rig: Rig, station: Station) -> None:
    sent = rig.sim.telemetry.default_interval_s[mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED]
    assert 0.3 < count(rig, station, "LOCAL_POSITION_NED", 60.0) * sent / 60.0 < 0.7


@ground("uplink-loss-share:0.5", "command-lost-first:10")
def some_unheard(rig: Rig, station: Station) -> None:
    answered = sum(bool(station.command(512, 148)) for _ in range(40))
    assert 8 < answered < 32


@ground("telemetry-late:0.5", "ack-late:0.5", "command-late:0.5", "uplink-late:0.5")
def late_answers(rig: Rig, station: Station) -> None:
    assert station.command(512, 148) == []
    rig.run(0.45)
    assert not station.of("COMMAND_ACK")
    rig.run(0.6)
    assert [m.result for m in station.of("COMMAND_ACK")] == [ACCEPTED]


@ground("telemetry-repeated:2", "ack-repeated:2")
def twice(rig: Rig, station: Station) -> None:
    station.command(512, 148)
    rig.run(0.1)
    assert len(station.of("COMMAND_ACK")) == 2


@ground("telemetry-reordered")
def reordered(rig: Rig, station: Station) -> None:
    rig.run(20.0)
    stamps = [m.time_boot_ms for m in station.of("LOCAL_POSITION_NED")]
    assert stamps != sorted(stamps)


@ground("frames-damaged:0.4", "frames-short:0.4")
def damaged(rig: Rig, station: Station) -> None:
    start = len(station.heard)
    frames = len(rig.frames)
    rig.run(20.0)
    whole = [m for _, m in station.heard[start:] if m.get_type() != "BAD_DATA"]
    assert 0.3 < len(whole) / (len(rig.frames) - frames) < 0.9


@ground("frames-littered:0.5")
def littered(rig: Rig, station: Station) -> None:
    assert any(m.get_type() == "BAD_DATA" for _, m in station.heard)
    assert count(rig, station, "HEARTBEAT", 10.0) >= 7


@ground("sequence-jumps:0.3")
def jumps(rig: Rig, station: Station) -> None:
    sequence = [frame[4] for _, _, frame in rig.frames]
    assert any((b - a) % 256 > 1 for a, b in itertools.pairwise(sequence))


@ground("unknown-messages:1")
def unknown(rig: Rig, station: Station) -> None:
    assert any(int.from_bytes(frame[7:10], "little") not in mavlink.mavlink_map for _, _, frame in rig.frames)


# -- telemetry --------------------------------------------------------------------------------------------------------


@ground("heartbeat-loss@0")
def no_heartbeat(rig: Rig, station: Station) -> None:
    assert not station.of("HEARTBEAT")
    assert station.of("ATTITUDE")


@ground("heartbeat-stuck@0")
def stuck_heartbeat(rig: Rig, station: Station) -> None:
    station.set_mode(OFFBOARD)
    rig.run(2.0)
    assert rig.mode == "OFFBOARD"
    assert station.last["HEARTBEAT"].custom_mode >> 16 & 255 == 4


@ground("heartbeat-late:2")
def late_heartbeat(rig: Rig, station: Station) -> None:
    station.set_mode(OFFBOARD)
    rig.run(1.8)
    assert station.last["HEARTBEAT"].custom_mode >> 16 & 255 == 4
    rig.run(1.5)
    assert station.last["HEARTBEAT"].custom_mode >> 16 & 255 == 6


@ground("heartbeat-critical@0")
def critical(rig: Rig, station: Station) -> None:
    assert station.last["HEARTBEAT"].system_status == mavlink.MAV_STATE_CRITICAL


@ground("heartbeat-wrong-autopilot")
def wrong_autopilot(rig: Rig, station: Station) -> None:
    assert station.last["HEARTBEAT"].autopilot == 20


@ground("other-vehicle")
def other_vehicle(rig: Rig, station: Station) -> None:
    assert {m.get_srcSystem() for m in station.of("HEARTBEAT")} == {1, 42}


@ground("position-loss@0")
def no_position(rig: Rig, station: Station) -> None:
    assert not station.of("LOCAL_POSITION_NED")
    assert not station.of("GLOBAL_POSITION_INT")


@air("position-stuck@A25")
def stuck_position(rig: Rig, station: Station) -> None:
    before = station.last["LOCAL_POSITION_NED"]
    station.local((30, 0, -50))
    rig.run(8.0)
    after = station.last["LOCAL_POSITION_NED"]
    assert rig.place[0] > 25.0
    assert abs(after.x - before.x) < 1.0
    assert after.time_boot_ms > before.time_boot_ms + 6000


@ground("position-nan@0")
def nan_position(rig: Rig, station: Station) -> None:
    assert math.isnan(station.last["LOCAL_POSITION_NED"].x)


@ground("position-late:1")
def late_position(rig: Rig, station: Station) -> None:
    rig.run(2.0)
    assert rig.sim.time_s * 1000 - station.last["LOCAL_POSITION_NED"].time_boot_ms >= 990


@air("echo-loss")
def no_echo(rig: Rig, station: Station) -> None:
    assert not station.of("POSITION_TARGET_LOCAL_NED")


@air("echo-stuck@A25")
def stuck_echo(rig: Rig, station: Station) -> None:
    rig.run(0.5)
    station.local((30, 0, -50))
    rig.run(2.0)
    assert station.last["POSITION_TARGET_LOCAL_NED"].x != 30


@ground("clock-jump:3600@0")
def clock_jump(rig: Rig, station: Station) -> None:
    assert station.last["SYSTEM_TIME"].time_boot_ms == pytest.approx(3_604_000, abs=1500)


@ground("clock-stuck@3")
def clock_stuck(rig: Rig, station: Station) -> None:
    before = station.last["SYSTEM_TIME"].time_boot_ms
    rig.run(5.0)
    assert station.last["SYSTEM_TIME"].time_boot_ms == before


@ground("text-flood@0")
def flood(rig: Rig, station: Station) -> None:
    assert len(station.of("STATUSTEXT")) > 150


@ground("text-rubbish@0")
def rubbish(rig: Rig, station: Station) -> None:
    assert station.of("STATUSTEXT")
    assert count(rig, station, "HEARTBEAT") >= 3


@ground("home-unknown", "origin-unknown", "version-unknown")
def something_unknown(rig: Rig, station: Station) -> None:
    rig.run(2.1)
    for number in (242, 49, 148):
        station.command(512, number)
    known = {name for name in ("HOME_POSITION", "GPS_GLOBAL_ORIGIN", "AUTOPILOT_VERSION") if station.of(name)}
    assert len(known) == 2


# -- commands ---------------------------------------------------------------------------------------------------------


@ground("ack-lost")
def ack_lost(rig: Rig, station: Station) -> None:
    assert station.set_mode(OFFBOARD) == []
    assert rig.mode == "OFFBOARD"


@ground("ack-lost-first:1")
def first_ack_lost(rig: Rig, station: Station) -> None:
    assert station.command(512, 148) == []
    assert station.command(512, 148) == [ACCEPTED]


@ground("ack-foreign")
def foreign_ack(rig: Rig, station: Station) -> None:
    station.command(512, 148)
    assert station.last["COMMAND_ACK"].target_system == 77


@ground("ack-wrong-command")
def wrong_command(rig: Rig, station: Station) -> None:
    assert station.command(512, 148) == []
    assert station.last["COMMAND_ACK"].command == 513


@ground("ack-without-effect", "mode-without-effect")
def no_effect(rig: Rig, station: Station) -> None:
    assert station.set_mode(OFFBOARD) == [ACCEPTED]
    rig.run(1.0)
    assert rig.mode == "HOLD"


@ground("command-denied", "command-failed:400", "command-unsupported:400")
def refused(rig: Rig, station: Station) -> None:
    assert station.arm() in ([DENIED], [FAILED], [UNSUPPORTED])
    assert not rig.sim.autopilot.armed


@ground("command-rejected-once:400")
def rejected_once(rig: Rig, station: Station) -> None:
    assert station.arm() == [1]
    assert station.arm() == [ACCEPTED]


@ground("command-in-progress:2")
def in_progress(rig: Rig, station: Station) -> None:
    assert station.arm() == [mavlink.MAV_RESULT_IN_PROGRESS]
    assert not rig.sim.autopilot.armed
    rig.run(2.1)
    assert rig.sim.autopilot.armed
    assert [m.result for m in station.of("COMMAND_ACK")] == [5, 0]


@ground("arm-refused", "never-ready")
def arm_refused(rig: Rig, station: Station) -> None:
    rig.run(5.0)
    assert station.arm() == [1]
    assert station.texts()[-1].startswith("Arming denied: ")


@ground("takeoff-ignored")
def no_takeoff(rig: Rig, station: Station) -> None:
    station.arm()
    assert station.command(22, 0, 0, 0, 0, 0, 0, 600) == [ACCEPTED]
    rig.run(6.0)
    assert rig.sim.body.on_ground


# -- flight -----------------------------------------------------------------------------------------------------------


@air("setpoints-lost@A25", "setpoints-stuck@A25")
def setpoints_lost(rig: Rig, station: Station) -> None:
    station.local((0, 0, -50))
    station.local((30, 0, -50))
    rig.run(4.0)
    assert rig.off(0, 0) < 0.5
    rig.run(4.0)
    station.local((30, 0, -50))
    rig.run(8.0)
    assert rig.off(30, 0) < 0.5


@air("setpoints-lost-share:0.5@A25")
def setpoints_half_lost(rig: Rig, station: Station) -> None:
    before = len(rig.sim.accepted_setpoints)
    for _ in range(100):
        station.local((0, 0, -50))
    assert 30 < len(rig.sim.accepted_setpoints) - before < 70


@air("setpoints-late:0.5@A25")
def setpoints_late(rig: Rig, station: Station) -> None:
    station.local((30, 0, -50))
    before = len(rig.sim.accepted_setpoints)
    rig.run(0.45)
    assert len(rig.sim.accepted_setpoints) == before
    rig.run(0.1)
    assert len(rig.sim.accepted_setpoints) == before + 1


@air("mode-to-hold@A25", "mode-to-return@A25", "mode-to-land@A25", "pilot-takes-over@A25")
def mode_left(rig: Rig, station: Station) -> None:
    rig.run(1.0)
    assert rig.mode in ("BRAKE", "RTL", "LAND", "LOITER")
    assert station.last["HEARTBEAT"].custom_mode != GUIDED


@air("disarm-in-flight@A25", "crash@A25")
def falls(rig: Rig, station: Station) -> None:
    rig.run(5.0)
    assert rig.sim.body.on_ground
    assert rig.sim.body.impact_m_s > 15.0


@air("foreign-station-streams:20@A25+30")
def foreign_station_streams(rig: Rig, station: Station) -> None:
    rig.run(10.0)
    assert rig.off(20, 0) < 1.0
    assert rig.sim.accepted_setpoints[-1][2] == 99


@air("foreign-station-returns@A25")
def foreign_station_returns(rig: Rig, station: Station) -> None:
    assert rig.mode == "RTL"


@air("foreign-station-parameter:GUID_TIMEOUT=0.5@A25")
def foreign_station_parameter(rig: Rig, station: Station) -> None:
    assert station.read_parameter("GUID_TIMEOUT").param_value == 0.5


@air("foreign-station-heartbeat", autopilot="px4")
def foreign_station_beats(rig: Rig, station: Station) -> None:
    rig.beating = False
    rig.run(15.0)
    failsafe: Any = rig.sim.autopilot
    assert not failsafe.failsafe.gcs_lost


# -- parameters and missions ------------------------------------------------------------------------------------------


@ground("param-set-ignored:COM_OF_LOSS_T")
def set_ignored(rig: Rig, station: Station) -> None:
    assert station.set_parameter("COM_OF_LOSS_T", 2.0) is None
    assert station.read_parameter("COM_OF_LOSS_T").param_value == 1.0
    assert station.set_parameter("COM_OBC_LOSS_T", 2.0).param_value == 2.0


@ground("param-set-refused")
def set_refused(rig: Rig, station: Station) -> None:
    assert station.set_parameter("COM_OF_LOSS_T", 2.0).param_value == 1.0


@ground("param-reply-lost:1")
def reply_lost(rig: Rig, station: Station) -> None:
    assert station.read_parameter("COM_OF_LOSS_T") is None
    assert station.read_parameter("COM_OF_LOSS_T")


@ground("param-reply-late:1")
def reply_late(rig: Rig, station: Station) -> None:
    assert station.read_parameter("COM_OF_LOSS_T") is None
    rig.run(1.05)
    assert station.last["PARAM_VALUE"].param_id == "COM_OF_LOSS_T"


@ground("param-silent")
def params_silent(rig: Rig, station: Station) -> None:
    assert station.set_parameter("COM_OF_LOSS_T", 2.0) is None
    assert rig.sim.parameters["COM_OF_LOSS_T"] == 2.0


@ground("param-list-gaps")
def list_gaps(rig: Rig, station: Station) -> None:
    station.send(mavlink.MAVLink_param_request_list_message(1, 1))
    rig.run(3.0)
    seen = {m.param_index for m in station.of("PARAM_VALUE")}
    total = len(rig.sim.parameters)
    assert total * 0.8 < len(seen) < total
    assert station.last["PARAM_VALUE"].param_count == total


@ground("param-wrong-value:1")
def wrong_value(rig: Rig, station: Station) -> None:
    assert station.read_parameter("COM_OF_LOSS_T").param_value == 2.0


@ground("param-revert@5")
def reverts(rig: Rig, station: Station) -> None:
    station.set_parameter("COM_OF_LOSS_T", 2.0)
    rig.run(2.0)
    assert station.read_parameter("COM_OF_LOSS_T").param_value == 1.0


def start_upload(station: Station) -> None:
    station.send(mavlink.MAVLink_mission_count_message(1, 1, 1, 0))


def one_item(station: Station) -> None:
    station.send(mavlink.MAVLink_mission_item_int_message(1, 1, 0, 6, 16, 0, 1, 0, 0, 0, 0, 470000000, 80000000, 30, 0))


@ground("mission-ack-lost:1")
def mission_ack_lost(rig: Rig, station: Station) -> None:
    start_upload(station)
    one_item(station)
    assert not station.of("MISSION_ACK")
    assert rig.sim.missions.total == 1


@ground("mission-request-lost:1", "mission-silent")
def no_requests(rig: Rig, station: Station) -> None:
    start_upload(station)
    rig.run(2.0)
    assert not station.of("MISSION_REQUEST_INT")


@ground("mission-request-repeated:2")
def requests_twice(rig: Rig, station: Station) -> None:
    start_upload(station)
    rig.run(0.1)
    assert len(station.of("MISSION_REQUEST_INT")) == 2


@ground("mission-item-lost:1")
def items_lost(rig: Rig, station: Station) -> None:
    start_upload(station)
    one_item(station)
    assert not station.of("MISSION_ACK")
    assert rig.sim.missions.total == 0


@ground("mission-refused")
def mission_refused(rig: Rig, station: Station) -> None:
    start_upload(station)
    one_item(station)
    assert station.last["MISSION_ACK"].type == 4


@ground("mission-count-off:1")
def count_off(rig: Rig, station: Station) -> None:
    station.send(mavlink.MAVLink_mission_request_list_message(1, 1, 0))
    assert station.last["MISSION_COUNT"].count == 1


# -- vehicle ----------------------------------------------------------------------------------------------------------


@air("reboot@A25")
def reboots(rig: Rig, station: Station) -> None:
    start = rig.now + 0.1
    assert not rig.sim.autopilot.armed
    rig.run(0.8)
    assert not station.of("HEARTBEAT", start)
    rig.run(1.5)
    assert station.last["SYSTEM_TIME"].time_boot_ms < 4000
    assert station.last["HEARTBEAT"].base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED == 0


@air("hang@A25")
def hangs(rig: Rig, station: Station) -> None:
    start = rig.now + 0.1
    rig.run(2.5)
    assert not [t for t, _ in station.heard if t > start]
    rig.run(2.0)
    assert station.of("HEARTBEAT", start)


@ground("clock-rate:0.9")
def slow_clock(rig: Rig, station: Station) -> None:
    rig.run(16.0)
    assert rig.sim.time_s == pytest.approx(18.0, abs=0.1)


@air("ekf-failure@A25", "gps-loss@A15")
def estimate_fails(rig: Rig, station: Station) -> None:
    rig.run(12.0)
    assert rig.mode == "LAND"


@air("gps-jump:30@A25+20")
def estimate_jumps(rig: Rig, station: Station) -> None:
    """The vehicle believes it is 30 m too far east and flies 30 m west of where it should be."""
    lon = rig.sim.body.lon_rad
    station.local((0, 0, -50))
    rig.run(15.0)
    west_m = (lon - rig.sim.body.lon_rad) * 6_378_137.0 * math.cos(rig.sim.body.lat_rad)
    assert west_m == pytest.approx(30.0, abs=1.0)


@air("altitude-bias:5@A25")
def estimate_too_high(rig: Rig, station: Station) -> None:
    station.local((0, 0, -50))
    rig.run(10.0)
    assert rig.sim.body.height_m - rig.sim.body.ground_m == pytest.approx(45.0, abs=0.3)


@air("origin-shift:50@A25")
def origin_shifts(rig: Rig, station: Station) -> None:
    assert rig.place[1] == pytest.approx(-50.0, abs=1.0)
    assert len(station.of("GPS_GLOBAL_ORIGIN")) == 3


@air("home-shift:100@A25")
def home_shifts(rig: Rig, station: Station) -> None:
    assert station.last["HOME_POSITION"].x == pytest.approx(100.0, abs=0.5)


@air("battery-low:0.12@A25", "battery-critical:0.04@A25", "battery-drain:2000@A25")
def battery_goes(rig: Rig, station: Station) -> None:
    rig.run(10.0)
    assert station.last["SYS_STATUS"].battery_remaining <= 15


@air("wind-gust:12@A25+10", "wind:8@A25")
def wind_blows(rig: Rig, station: Station) -> None:
    assert rig.sim.body.wind_e_m_s >= 8.0
    rig.run(2.0)
    assert rig.sim.body.ae < -0.05  # it leans into it


@air("slow-vehicle:10.5", "drag:200@A25")
def cannot_follow(rig: Rig, station: Station) -> None:
    start = rig.now
    station.stream(lambda now: {"position": (20 * (now - start), 0, -50), "velocity": (20, 0, 0), "mask": 0x0C00})
    rig.run(25.0)
    assert rig.sim.body.speed_m_s < 11.0
    assert 20 * (rig.now - start) - rig.place[0] > 150.0


@air("thrust-loss:0.3@A25")
def weak(rig: Rig, station: Station) -> None:
    assert rig.sim.body.thrust_factor == 0.3
    station.local((500, 0, -50))
    rig.run(2.0)
    assert math.hypot(rig.sim.body.an, rig.sim.body.ae) <= 0.3 * 9.81


@air("cannot-climb@A25")
def stays_low(rig: Rig, station: Station) -> None:
    station.local((0, 0, -80))
    rig.run(6.0)
    assert -rig.place[2] < 55.0


@pytest.mark.parametrize("specification", sorted(CHECKS))
def test_fault(specification: str) -> None:
    setting, check = CHECKS[specification]
    if setting == "ground":
        rig = Rig("px4", faults=(specification,))
        station = rig.station()
        rig.run(4.0)
    else:
        rig, station = airborne(setting, faults=(specification,))
        since = rig.sim.faults.acting[0]
        if since.since == "A" and rig.sim.autopilot.armed:
            rig.run(max(0.0, rig.sim.autopilot.armed_at_s + since.start_s - rig.sim.time_s) + 0.02)
    check(rig, station)


def test_every_fault_is_checked() -> None:
    checked = {re.split(r"[:@]", specification)[0] for specification in CHECKS}
    assert checked == set(FAULTS)
    assert len(FAULTS) >= 90


def test_nothing_happens_before_its_time() -> None:
    """A fault that starts in an hour changes no byte of what is sent."""
    plain, armed = Rig("px4"), Rig("px4", faults=("telemetry-loss@3600", "ekf-failure@T10", "reboot@A5"))
    for rig in (plain, armed):
        rig.station()
        rig.run(10.0)
    assert plain.frames == armed.frames


def test_the_same_seed_gives_the_same_run() -> None:
    runs = []
    for seed in (7, 7, 8):
        rig = Rig("px4", faults=("frames-damaged:0.3", "telemetry-loss-share:0.2"), seed=seed)
        rig.station()
        rig.run(8.0)
        runs.append(rig.frames)
    assert runs[0] == runs[1]
    assert runs[0] != runs[2]


def test_launch_time_starts_with_the_first_setpoint_obeyed() -> None:
    rig, station = airborne("ardupilot", faults=("mode-to-hold@T5",))
    rig.run(20.0)
    assert rig.mode == "GUIDED"
    station.local((0, 0, -50))
    rig.run(4.8)
    assert rig.mode == "GUIDED"
    rig.run(0.4)
    assert rig.mode == "BRAKE"


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        ("no-such-fault", "see"),
        ("telemetry-gone", "did you mean telemetry-loss"),
        ("Ack-lost", "list-faults"),
        ("ack-late:soon", "a number: SECONDS"),
        ("ack-late:nan", "a number: SECONDS"),
        ("ack-lost:3", "without an argument"),
        ("ack-lost@soon", "list-faults"),
        ("ack-lost@1.2.3", "START and DURATION"),
    ],
)
def test_a_fault_that_cannot_be_is_named(bad: str, words: str) -> None:
    with pytest.raises(ConfigurationError, match=re.escape(bad)) as found:
        SimulatedAutopilot(SimulatorConfig(faults=(bad,)))
    assert words in str(found.value) or words == "see"


def test_scripts_with_the_former_names_still_run() -> None:
    vehicle = SimulatedAutopilot(SimulatorConfig(faults=("stranger-streams:50@T5",)))
    assert [acting.fault.name for acting in vehicle.faults.acting] == ["foreign-station-streams"]


def test_listing_has_a_line_for_each() -> None:
    text = listing()
    assert all(re.search(rf"^  {name}[ :]", text, re.MULTILINE) for name in FAULTS)
