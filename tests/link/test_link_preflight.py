"""What must hold before anything is armed: parameters, ownership, the place, the plan, the request."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flight_plans import relay_plan
from link.errors import FlightRequestError
from link.ownership import ENFORCE, Ownership, wanted, writes
from link.params import Parameter
from link.preflight import Level, judge_parameters, judge_performance, judge_place, judge_vehicle, judge_way_home
from link.profiles import PROFILES
from link.request import FlightRequest

SAFE: dict[str, dict[str, float]] = {
    "px4": {
        "COM_OF_LOSS_T": 1.0,
        "COM_OBL_RC_ACT": 5,
        "NAV_DLL_ACT": 2,
        "COM_DL_LOSS_T": 10,
        "COM_RCL_EXCEPT": 4,
        "COM_RC_IN_MODE": 1,
        "NAV_RCL_ACT": 2,
    },
    "ardupilot": {"GUID_TIMEOUT": 3.0, "FS_GCS_ENABLE": 1, "FS_GCS_TIMEOUT": 5, "FS_OPTIONS": 4},
}
STOCK: dict[str, dict[str, float]] = {
    "px4": {**SAFE["px4"], "COM_OBL_RC_ACT": 0, "NAV_DLL_ACT": 0, "COM_RCL_EXCEPT": 0},
    "ardupilot": {**SAFE["ardupilot"], "FS_GCS_ENABLE": 0, "FS_OPTIONS": 16},
}


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


def judged(autopilot: str, **changes: float | None) -> dict[str, Any]:
    table = {k: v for k, v in {**SAFE[autopilot], **changes}.items() if v is not None}
    checks = judge_parameters(PROFILES[autopilot], values(autopilot, table), request(autopilot=autopilot))
    return {check.name: check for check in checks}


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_safe_parameters_pass_and_the_stock_ones_do_not(autopilot: str) -> None:
    assert {c.level for c in judged(autopilot).values()} == {Level.PASS}
    stock = judge_parameters(PROFILES[autopilot], values(autopilot, STOCK[autopilot]), request(autopilot=autopilot))
    failures = {c.name: c.set for c in stock if c.level is Level.FAILURE}
    assert (
        failures
        == {
            "px4": {
                "COM_OBL_RC_ACT": ("COM_OBL_RC_ACT", 5),
                "NAV_DLL_ACT": ("NAV_DLL_ACT", 2),
                "COM_RCL_EXCEPT": ("COM_RCL_EXCEPT", 4),
            },
            "ardupilot": {"FS_GCS_ENABLE": ("FS_GCS_ENABLE", 1)},
        }[autopilot]
    )


@pytest.mark.parametrize(
    ("autopilot", "name", "value", "fix"),
    [
        ("px4", "COM_OF_LOSS_T", 0.1, 1.0),  # shorter than a few ticks
        ("px4", "COM_OF_LOSS_T", 60.0, 1.0),
        ("px4", "COM_OF_LOSS_T", float("nan"), 1.0),
        ("px4", "COM_OBL_RC_ACT", 1, 5),  # altitude mode: needs a pilot
        ("px4", "COM_OBL_RC_ACT", 6, 5),  # terminate
        ("px4", "COM_OBL_RC_ACT", 7, 5),  # disarm
        ("px4", "NAV_DLL_ACT", 6, 2),
        ("px4", "COM_DL_LOSS_T", 600, 10),
        ("px4", "COM_RCL_EXCEPT", 3, 7),  # keeps what was set
        ("ardupilot", "GUID_TIMEOUT", 5.0, 3.0),
        ("ardupilot", "GUID_TIMEOUT", 0.1, 3.0),
        ("ardupilot", "FS_GCS_ENABLE", 2, 1),  # went on in AUTO; obsolete
        ("ardupilot", "FS_GCS_TIMEOUT", 120, 5),
    ],
)
def test_every_unsafe_value_is_a_failure_with_its_remedy(autopilot: str, name: str, value: float, fix: float) -> None:
    check = judged(autopilot, **{name: value})[name]
    assert check.level is Level.FAILURE
    assert check.set == (name, fix)
    json.dumps(check.to_document(), allow_nan=False)


def test_a_vehicle_without_stick_input_needs_no_exception_for_its_loss() -> None:
    checks = judged("px4", COM_RC_IN_MODE=4, COM_RCL_EXCEPT=0)
    assert "COM_RCL_EXCEPT" not in checks


def test_a_parameter_the_vehicle_does_not_know_is_a_failure_without_a_remedy() -> None:
    check = judged("px4", COM_OBL_RC_ACT=None)["COM_OBL_RC_ACT"]
    assert (check.level, check.set) == (Level.FAILURE, None)
    assert "not known to the vehicle" in check.message


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


def test_where_the_autopilots_own_return_leads_is_told() -> None:
    plan = relay_plan()
    assert judge_way_home(plan).level is Level.PASS
    away = replace(plan, contingencies=tuple(replace(c, straight_home_covered=False) for c in plan.contingencies))
    check = judge_way_home(away)
    assert check.level is Level.WARNING
    assert "100%" in check.message


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
    before = Ownership(low, high, ENFORCE if enforced else 0)
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
    before = Ownership(255, 0, 4)
    assert wanted({"a": 243, "b": 241}, before) == Ownership(241, 243, 5)
    assert wanted({"a": 243}, before) == Ownership(243, 0, 5)
    # The order trap: HI first, or the writer 255 is shut out while widening to 254..255.
    assert writes(Ownership(255, 0, 1), Ownership(254, 255, 1)) == [("gcs_system_id_high", 255), ("gcs_system_id", 254)]


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
