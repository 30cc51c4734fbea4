"""What must hold before anything is armed: parameters, ownership, the place, the plan, the request."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gcs.plan.failsafe_return import failsafe_returns
from link.autopilot.registry import PROFILES
from link.dialect import mavlink
from link.errors import FlightRequestError
from link.handover.gcs_ids import ENFORCE, GcsIds, wanted, writes
from link.microservices.parameter_value import Parameter
from link.preflight.check import Check, Level, worst, worst_first
from link.preflight.failsafe_return import judge_failsafe_return, return_rules
from link.preflight.identity import Identity, judge_identity
from link.preflight.link import judge_link
from link.preflight.vehicle import judge_clock, judge_performance, judge_place, judge_vehicle
from link.session.request import FlightRequest
from link.telemetry.link_path import LinkQuality
from link.telemetry.vehicle_monitor import VehicleMonitor
from tests.support.flights.on_ground import checks, on_ground
from tests.support.plans.planned import relay_plan


def request(**changes: Any) -> FlightRequest:
    plan = relay_plan()
    links = {s: f"udpout:127.0.0.1:{20000 + k}" for k, s in enumerate(plan.station_ids)}
    document = {"plan": plan.to_document(), "autopilot": "px4", "links": links, **changes}
    return FlightRequest.from_document(document)


def values(autopilot: str, given_values: dict[str, float]) -> dict[str, Parameter | None]:
    found: dict[str, Parameter | None] = {}
    for parameter in PROFILES[autopilot].parameters:
        name = next((n for n in parameter.names if n in given_values), None)
        found[parameter.key] = None if name is None else Parameter(name, given_values[name], 9)
    return found


def test_a_plan_faster_than_px4_allows_is_refused_and_a_steeper_one_told() -> None:
    found = values(
        "px4", {"MPC_XY_VEL_MAX": 12.0, "MPC_Z_VEL_MAX_UP": 3.0, "MPC_Z_VEL_MAX_DN": 0.1, "MPC_TILTMAX_AIR": 10}
    )
    checks = {c.name: c.level for c in judge_performance(PROFILES["px4"], found, relay_plan())}
    assert checks["MPC_XY_VEL_MAX"] is Level.FAILURE  # the plan goes 15 m/s
    assert checks["MPC_Z_VEL_MAX_UP"] is Level.PASS
    assert checks["MPC_TILTMAX_AIR"] is Level.FAILURE  # g tan 10 degrees is 1.7 m/s^2, 2.5 are asked
    ardupilot = values("ardupilot", {"WPNAV_SPEED": 500.0, "ANGLE_MAX": 4500})
    checks = {c.name: c.level for c in judge_performance(PROFILES["ardupilot"], ardupilot, relay_plan())}
    assert checks == {"ANGLE_MAX": Level.PASS}  # its navigation speed does not bound position targets


def test_the_vehicle_must_stand_near_below_the_start_in_the_first_stations_range() -> None:
    plan = relay_plan()
    start = plan.trajectory.evaluate(0.0)
    ground = float(start[2]) - 10.0

    def levels(east_m: float, up_m: float) -> dict[str, Level]:
        checks = judge_place(plan, (float(start[0]) + east_m, float(start[1]), up_m), up_m, request())
        return {c.name: c.level for c in checks}

    assert set(levels(0.0, ground).values()) == {Level.PASS}
    assert levels(600.0, ground)["transit"] is Level.FAILURE
    assert levels(-380.0, ground)["first station"] is Level.FAILURE  # 400 m less the margin of 25 m
    assert levels(-380.0, ground)["transit"] is Level.PASS
    assert levels(0.0, ground + 9.0)["start height"] is Level.FAILURE


def test_an_armed_a_flying_and_a_simulated_vehicle_at_another_pace_are_refused() -> None:
    def failures(**changes: Any) -> set[str]:
        state = {"armed": False, "landed_state": 1, "battery_percent": 90, "simulator_speedup": None, "speedup": 1.0}
        checks = judge_vehicle(**{**state, **changes})
        return {c.name for c in checks if c.level is Level.FAILURE}

    assert failures() == set()
    assert failures(armed=True) == {"disarmed"}
    assert failures(landed_state=2) == {"disarmed"}
    assert failures(speedup=5.0) == {"speedup"}
    assert failures(speedup=5.0, simulator_speedup=4.0) == {"speedup"}
    assert failures(speedup=5.0, simulator_speedup=5.0) == set()
    assert failures(simulator_speedup=5.0) == {"speedup"}
    low = judge_vehicle(armed=False, landed_state=1, battery_percent=20, simulator_speedup=None, speedup=1.0)
    assert [c.name for c in low if c.level is Level.WARNING] == ["battery"]


def test_an_ardupilot_with_the_newer_names_is_judged_alike() -> None:
    new = values("ardupilot", {"WP_SPD": 5.0, "ATC_ANGLE_MAX": 10.0})
    (check,) = judge_performance(PROFILES["ardupilot"], new, relay_plan())
    assert (check.name, check.level) == ("ATC_ANGLE_MAX", Level.FAILURE)
    assert check.remedy == "raise ATC_ANGLE_MAX, or plan with a smaller max_accel_m_s2"


# -- where the failsafe return leads -----------------------------------------------------------------------------------


def own(**changes: float) -> dict[str, Check]:
    """The relay's plan, 840 m long, by an ArduPilot that stands under its start, 35 m up."""
    table = {"RTL_ALT": 1500.0, "RTL_SPEED": 0.0, "WPNAV_SPEED": 1000.0, "WPNAV_SPEED_UP": 250.0, **changes}
    table |= {"WPNAV_SPEED_DN": 150.0, "RALLY_LIMIT_KM": 0.3, "RALLY_INCL_HOME": 1.0}
    plan = relay_plan(3)
    rules = return_rules(PROFILES["ardupilot"], values("ardupilot", table), plan, (0.0, 0.0, 35.0), ())
    returns = failsafe_returns(plan.geometry, plan.trajectory, rules)
    return {c.name: c for c in judge_failsafe_return(plan, rules, returns)}


def test_the_way_home_is_judged_at_the_return_altitude() -> None:
    checks = own()
    assert checks["failsafe return"].level is Level.PASS
    # From the end: 5 m up at 2.5, 840 m and 7.5 m of doubt at 10, 15 m down at 1.5, 8 s to turn: about 105 s.
    assert checks["failsafe return"].value["longest_s"] == pytest.approx(2.0 + 84.7 + 10.0 + 8.0, abs=2.0)  # type: ignore[index]
    assert checks["return altitude"].level is Level.PASS  # 50 m, the band ends at 70 m
    high = own(RTL_ALT=10000.0)
    assert high["return altitude"].level is Level.WARNING
    assert "135 m AMSL, above the mission's 70 m" in high["return altitude"].message
    # 500 m up, no station of 400 m range reaches it.
    out = own(RTL_ALT=50000.0)["failsafe return"]
    assert out.level is Level.WARNING
    assert "leaves every range when begun in 100% of the flight" in out.message
    assert out.remedy


def test_rules_by_autopilot() -> None:
    plan, home, points = relay_plan(3), (0.0, 0.0, 35.0), (("a", (1.0, 2.0, 3.0)),)
    copter = values(
        "ardupilot", {"RTL_ALT_M": 20.0, "RALLY_LIMIT_KM": 0.3, "RALLY_INCL_HOME": 0.0, "RTL_SPEED_MS": 7.0}
    )
    rules = return_rules(PROFILES["ardupilot"], copter, plan, home, points)
    assert (rules.climb_to_up_m, rules.limit_m, rules.home_counts, rules.speed_m_s) == (55.0, 300.0, False, 7.0)
    px4 = values("px4", {"RTL_RETURN_ALT": 30.0, "RTL_TYPE": 1.0, "MPC_XY_CRUISE": 5.0})
    rules = return_rules(PROFILES["px4"], px4, plan, home, points)
    assert (rules.climb_to_up_m, rules.limit_m, rules.home_counts, rules.speed_m_s) == (65.0, None, False, 5.0)
    assert return_rules(PROFILES["px4"], px4, plan, home, ()).home_counts  # nothing else to go to


# -- who it is, its clock, its links ----------------------------------------------------------------------------------


def version(number: int, custom: bytes, board: int = 0) -> Identity:
    fields = {"flight_sw_version": number, "flight_custom_version": list(custom), "board_version": board}
    return Identity.from_message(SimpleNamespace(**fields, vendor_id=0x26AC, product_id=0x11))


def test_versions_as_both_autopilots_write_them() -> None:
    copter = version(0x040700FF, b"4e118caa", 50 << 16)
    assert copter.text == "4.7.0, git 4e118caa, board 50 (26ac:0011)"
    # PX4: the hash as a number, lowest byte first.
    px4 = version(0x011100C0, bytes.fromhex("efcdab8967452301"))
    assert (px4.version, px4.release, px4.git_hash) == ((1, 17, 0), "rc", "0123456789abcdef")
    assert version(0x04070000, bytes(8)).text.startswith("4.7.0-dev, git unknown")


def test_old_firmware_and_silence_about_it_are_told_and_an_aeroplane_is_refused() -> None:
    copter = PROFILES["ardupilot"]
    assert [c.level for c in judge_identity(copter, version(0x040300FF, b"01234567"), 2)] == [Level.PASS, Level.PASS]
    old, _ = judge_identity(copter, version(0x040200FF, b"01234567"), 2)
    assert (old.level, old.required) == (Level.WARNING, "ArduPilot 4.3 or newer")
    silent, kind = judge_identity(copter, None, 1)
    assert (silent.level, kind.level) == (Level.WARNING, Level.FAILURE)
    # A VTOL is PX4's to hover; ArduPilot's is an ArduPlane.
    assert judge_identity(PROFILES["px4"], None, 22)[1].level is Level.PASS
    assert judge_identity(copter, None, 22)[1].level is Level.FAILURE


def test_a_clock_a_second_off_the_vehicles_is_told() -> None:
    assert judge_clock(1000.0, 1000.9, simulated=False).level is Level.PASS
    late = judge_clock(1000.0, 998.5, simulated=False)
    assert (late.level, late.value) == (Level.WARNING, -1.5)
    assert "1.50 s behind the vehicle's UTC" in late.message
    assert judge_clock(1000.0, 9000.0, simulated=True).level is Level.PASS
    assert judge_clock(None, 1000.0, simulated=False).level is Level.PASS


@pytest.mark.parametrize(
    ("changes", "level", "words"),
    [
        ({}, Level.PASS, "2% lost, 100 ms there and back, 5 ms jitter; unsigned, on this machine"),
        ({"signed": True, "loopback": False}, Level.PASS, "; signed"),
        ({"loopback": False}, Level.WARNING, "unsigned, as allowed"),
        ({"quality": LinkQuality(0.4, 0.1, 0.0)}, Level.WARNING, "40% lost"),
        ({"quality": LinkQuality(0.0, 0.4, 0.0)}, Level.WARNING, "400 ms"),
        ({"quality": LinkQuality(0.0, 0.6, 0.0)}, Level.FAILURE, "600 ms"),  # longer than an attempt may take
        ({"quality": None}, Level.PASS, "heard and answers over it; unsigned"),
        ({"works": False}, Level.WARNING, "not heard"),
        ({"works": False, "required": True}, Level.FAILURE, "not heard"),
        ({"same_origin": False}, Level.FAILURE, "another EKF origin"),
    ],
)
def test_a_link_is_judged_by_its_life_its_quality_and_its_signature(
    changes: dict[str, Any], level: Level, words: str
) -> None:
    given_facts = {
        "works": True,
        "same_origin": True,
        "required": False,
        "quality": LinkQuality(0.02, 0.1, 0.005),
        "attempt_s": 0.6,
        "signed": False,
        "loopback": True,
    }
    (check,) = judge_link("s1", "udpout:10.0.0.1:1", **{**given_facts, **changes})
    assert check.level is level
    assert words in check.message
    assert bool(check.remedy) == (level is not Level.PASS)


def test_a_links_quality_comes_from_its_probes() -> None:
    monitor = VehicleMonitor(("s1",), 1, frozenset({241}))
    link = monitor.links["s1"]
    assert link.quality(0.0) is None
    for k in range(10):
        nonce = monitor.probe(float(k), "s1").ts1
        if k % 5 != 4:  # 8 of 10 are answered, after 0.1 and 0.2 s in turn; one answer twice
            for _ in range(1 + (k == 0)):
                answer = mavlink.MAVLink_timesync_message(7, nonce)
                answer._header = mavlink.MAVLink_header(111, srcSystem=1, srcComponent=1)
                monitor.receive(k + (0.1 if k % 2 == 0 else 0.2), "s1", answer)
    quality = link.quality(20.0)
    assert quality is not None
    assert quality.loss == pytest.approx(0.2)
    assert quality.round_trip_s == pytest.approx(0.15)
    assert 0.0 < quality.jitter_s <= 0.1  # from 0.1 to 0.2 s and back, now and then twice the same


# -- all together -----------------------------------------------------------------------------------------------------


def test_the_worst_comes_first_and_decides() -> None:
    names = ("a", "b", "c", "d", "e")
    levels = (Level.PASS, Level.FAILURE, Level.ERROR, Level.WARNING, Level.FAILURE)
    checks = [Check(name, level, "") for name, level in zip(names, levels, strict=True)]
    assert [c.name for c in worst_first(checks)] == ["c", "b", "e", "d", "a"]
    assert worst(checks) is Level.ERROR
    assert worst([]) is Level.PASS
    assert [c.blocks for c in checks] == [False, True, True, False, True]


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_every_finding_that_is_not_a_pass_says_what_to_do(autopilot: str) -> None:
    one = on_ground(autopilot, config={"parameters": ("RALLY_LIMIT_KM=0.01",) if autopilot == "ardupilot" else ()})
    refused = on_ground(autopilot, request={"set_parameters": "no"})
    elsewhere = on_ground(autopilot, config={"home": (52.97, 4.79, 30.0)})
    found = [e.data for flight in (one, refused, elsewhere) for e in flight.said("check")]
    assert {c["level"] for c in found} == {"pass", "warning", "failure"}
    assert [c["name"] for c in found if c["level"] != "pass" and not c["fix"]] == []
    order = [["error", "failure", "warning", "pass"].index(e.data["level"]) for e in refused.said("check")]
    assert order == sorted(order)


def test_the_preflight_tells_who_the_vehicle_is_and_which_plan_every_station_has() -> None:
    one = on_ground("ardupilot", frugal=False)
    told = checks(one)
    assert told["vehicle"]["message"] == "ArduPilot 4.7.0-dev, git simulatd, board unknown"
    assert told["plan"]["value"] == one.plan.plan_sha256
    assert "s1, s2, s3" in told["plan"]["message"]
    assert told["EKF origin"]["message"].startswith("52.95")
    assert told["clock"]["message"] == "a simulator keeps its own time"
    assert "0% lost" in told["link s2"]["message"]


# -- ownership --------------------------------------------------------------------------------------------------------


@given(
    st.integers(1, 250),
    st.integers(0, 250),
    st.booleans(),
    st.lists(st.integers(1, 254), min_size=1, max_size=6, unique=True),
    st.data(),
)
def test_no_write_shuts_out_a_writer_that_is_heard_before_and_after(
    low: int, high: int, enforced: bool, ids: list[int], data: st.DataObject
) -> None:
    before = GcsIds(low, high, ENFORCE if enforced else 0)
    after = wanted({str(i): i for i in ids}, before)
    writer = data.draw(st.sampled_from(ids))
    assert after.hears(writer)
    names = {"gcs_system_id": "low", "gcs_system_id_high": "high", "enforce_gcs": "options"}
    for start, goal in ((before, after), (after, before)):
        now = start
        for key, value in writes(start, goal):
            if start.hears(writer) and goal.hears(writer):
                assert now.hears(writer), f"{writer} cannot write {key} while {now}"
            now = replace(now, **{names[key]: value})
        assert now == goal


def test_the_range_of_a_plan_is_that_of_its_stations_and_one_station_is_no_range() -> None:
    before = GcsIds(255, 0, 4)
    assert wanted({"a": 243, "b": 241}, before) == GcsIds(241, 243, 5)
    assert wanted({"a": 243}, before) == GcsIds(243, 0, 5)
    # Before 4.7 there is no range.
    assert wanted({"a": 243}, GcsIds(255, None, 0)) == GcsIds(243, None, 1)
    # The order trap: HI first, or the writer 255 is shut out while widening to 254..255.
    assert writes(GcsIds(255, 0, 1), GcsIds(254, 255, 1)) == [("gcs_system_id_high", 255), ("gcs_system_id", 254)]
    # And the other way round: SYSID first, or 1 alone is heard while 1..5 narrows to 2.
    assert writes(GcsIds(1, 5, 1), GcsIds(2, 0, 1)) == [("gcs_system_id", 2), ("gcs_system_id_high", 0)]


# -- the request ------------------------------------------------------------------------------------------------------


def test_a_request_survives_its_document() -> None:
    one = request(rate_hz=50.0, authorised_until_s=12.0)
    again = FlightRequest.from_document(json.loads(json.dumps(one.to_document())))
    assert again == one
    assert again.flown_plan.plan_sha256 == relay_plan().plan_sha256


@pytest.mark.parametrize(
    ("changes", "where", "what"),
    [
        ({"rate_hz": 1000.0}, "rate_hz", "5 to 100"),
        ({"rate_hz": float("nan")}, "rate_hz", "5 to 100"),
        ({"rate_hz": True}, "rate_hz", "5 to 100"),
        ({"speedup": 0.0}, "speedup", "0.1 to 1000"),
        ({"autopilot": "betaflight"}, "autopilot", "ardupilot, px4"),
        ({"handover_way": "shout"}, "handover_way", "auto, gate"),
        ({"handover_way": "parameter"}, "handover_way", "PX4 has no parameter"),
        ({"authorised_until_s": -1.0}, "authorised_until_s", "0 or more"),
        ({"links": {}}, "links.s1", "no link"),
        ({"links": {"s1": "udp:1", "s2": "udpout:127.0.0.1:1", "s3": "udpout:127.0.0.1:2"}}, "links.s1", "udpout:HOST"),
        ({"plan": {}}, "plan", "plan"),
        ({"colour": "red"}, "colour", "no such field"),
        ({"signing_key": "0123456789abcdef" * 4}, "signing_key", "file:PATH or env:NAME"),
    ],
)
def test_a_bad_request_is_met_at_the_door(changes: dict[str, Any], where: str, what: str) -> None:
    with pytest.raises(FlightRequestError) as refusal:
        request(**changes)
    problem = next(p for p in refusal.value.problems if p.where.startswith(where))
    assert what in str(problem)
    # A key given by mistake is not repeated.
    assert "0123456789abcdef" not in str(refusal.value)


def test_all_faults_are_told_at_once() -> None:
    with pytest.raises(FlightRequestError) as refusal:
        request(rate_hz=0.0, speedup=0.0, links={})
    assert len(refusal.value.problems) == 5


def test_an_altered_plan_is_refused() -> None:
    document = json.loads(json.dumps(relay_plan().to_document()))
    document["segments"][0]["control_points"][2][2] += 1.0
    with pytest.raises(FlightRequestError, match="altered"):
        request(plan=document)


def test_overlaps_too_short_for_the_confirmation_are_refused_with_what_to_plan_instead() -> None:
    with pytest.raises(FlightRequestError) as refusal:
        request(confirmation_time_s=30.0)
    (first, *_) = refusal.value.problems
    assert first.where == "plan.handovers[1].overlap"
    assert "plan with min_overlap_s 32 or more" in str(first)


def test_a_margin_smaller_than_the_tracking_error_is_refused() -> None:
    margin_m = -relay_plan().certificate.worst["range_m"]
    request(tracking_error_m=margin_m - 0.1)
    with pytest.raises(FlightRequestError, match="range_margin_m"):
        request(tracking_error_m=margin_m + 0.1)


def test_a_gps_week_rollover_is_the_receivers_fault_and_not_this_machines() -> None:
    now_s = 1_795_000_000.0
    for rounds in (1, 2, -1):
        check = judge_clock(now_s - rounds * 1024 * 7 * 86400.0 + 0.3, now_s, simulated=False)
        assert check.level is Level.WARNING
        assert f"{abs(rounds) * 1024} weeks off (GPS week rollover)" in check.message
        assert "NTP" not in check.fix
    assert "NTP" in judge_clock(now_s - 3600.0, now_s, simulated=False).fix
