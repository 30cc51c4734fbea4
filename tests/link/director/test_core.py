"""The director against the simulated autopilots, in virtual time: every phase, every word, every refusal."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from gcs.flight import FlightState, OperatorCommand, TransitionError
from gcs.mission.model import LocalPosition
from link.session.timeline import plain
from tests.support.flights.virtual import Proxy, Truth, VirtualFlight
from tests.support.plans.planned import relay_plan

BOTH = pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
HOLD = {"px4": "HOLD", "ardupilot": "GUIDED"}
"""Where the vehicle itself stays when the stream stops."""


def flight(autopilot: str, stations: int = 2, **settings: Any) -> VirtualFlight:
    settings.setdefault("frugal", True)
    return VirtualFlight(relay_plan(stations), autopilot, **settings)


def in_cruise(autopilot: str, plan_s: float = 0.0, stations: int = 2, **settings: Any) -> VirtualFlight:
    """A flight that has reached a time of its plan."""
    one = flight(autopilot, stations, **settings)
    one.run(until=lambda: one.plan_s > plan_s, limit_s=300.0)
    assert one.core.state is FlightState.CRUISE
    return one


def refusal(one: VirtualFlight) -> str:
    """Runs a flight that must be refused; why it was."""
    assert one.run(limit_s=400.0) is FlightState.REFUSED
    assert not one.vehicle.autopilot.armed
    assert one.said("result")[0].data["exit_code"] == 4
    return str(one.said("state", to="refused")[0].data["reason"])


def accepted_after(one: VirtualFlight, duration_s: float) -> int:
    """Setpoints the vehicle obeys in the next while."""
    before = len(one.accepted)
    one.run_for(duration_s)
    return len(one.accepted) - before


# -- on the ground ----------------------------------------------------------------------------------------------------


def test_a_vehicle_that_is_not_there_is_told_by_link_and_id() -> None:
    one = flight("px4", proxy=Proxy(loss=1.0), request={"connect_timeout_s": 3.0})
    reason = refusal(one)
    assert "no heartbeat of system 1, component 1 over the link of s1 (udpout:127.0.0.1:20000) in 3 s" in reason


def test_another_autopilot_than_asked_for_is_refused() -> None:
    one = flight("ardupilot")
    from sitl_fixtures.vehicle import SimulatedAutopilot, SimulatorConfig

    one.vehicle = SimulatedAutopilot(SimulatorConfig(autopilot="px4", home=one.vehicle.home_place, links=2))
    assert "not ArduPilot" in refusal(one)


@BOTH
def test_unsafe_failsafes_refuse_the_flight_and_nothing_is_touched(autopilot: str) -> None:
    one = flight(autopilot, request={"set_parameters": "no"})
    reason = refusal(one)
    name = {"px4": "COM_OBL_RC_ACT", "ardupilot": "FS_GCS_ENABLE"}[autopilot]
    assert f"preflight: {name}: unsafe" in reason
    (check,) = one.said("check", name=name)
    assert check.data["set"]["name"] == name
    assert not one.said("parameter")
    assert not one.sent_messages("PARAM_SET")


@BOTH
def test_on_our_simulator_they_are_set_and_read_back(autopilot: str) -> None:
    one = in_cruise(autopilot)
    name, value = {"px4": ("COM_OBL_RC_ACT", 5), "ardupilot": ("FS_GCS_ENABLE", 1)}[autopilot]
    (event,) = one.said("parameter", name=name)
    assert (event.data["before"], event.data["after"]) == (0, value)
    assert one.vehicle.parameters[name] == value


@BOTH
def test_a_parameter_that_does_not_take_refuses_the_flight(autopilot: str) -> None:
    reason = refusal(flight(autopilot, config={"faults": ("param-set-ignored",)}))
    assert "preflight:" in reason


def test_a_vehicle_elsewhere_is_refused_with_the_distance() -> None:
    one = flight("px4", config={"home": (52.97, 4.79, 30.0)})
    reason = refusal(one)
    assert "m from the plan's start (required: at most 500 m)" in reason


def test_a_dead_link_of_a_later_station_is_found_before_take_off() -> None:
    one = flight("px4", proxy=Proxy(cuts=[("s2", 0.0, 1e9)]))
    assert "link s2: no C2 link: the vehicle is not heard over it" in refusal(one)


@BOTH
def test_arming_is_asked_until_the_vehicle_is_ready_and_its_words_are_kept(autopilot: str) -> None:
    one = flight(autopilot, config={"faults": ("arm-refused@0+12",)})
    one.run(until=lambda: one.core.state.airborne, limit_s=60.0)
    assert one.core.state.airborne
    assert one.said("command", name="arm")[0].data["result"] in ("TEMPORARILY_REJECTED", "FAILED")
    assert any("rm" in str(e.data["text"]) for e in one.said("text") if e.data["severity"] <= 3)


@BOTH
def test_the_ground_waits_for_the_word_and_judges_again_when_it_comes_late(autopilot: str) -> None:
    one = flight(autopilot, request={"auto_launch": False})
    one.run_for(90.0)
    assert one.core.state is FlightState.READY
    assert one.core.status()["preflight_age_s"] > 60.0
    assert not one.vehicle.autopilot.armed
    one.core.command(OperatorCommand.LAUNCH, by="pilot")
    one.run(until=lambda: one.core.state.airborne, limit_s=60.0)
    assert one.states.count("preflight") == 2
    assert one.core.state.airborne


@BOTH
def test_an_abort_on_the_ground_gives_everything_back(autopilot: str) -> None:
    one = flight(autopilot, request={"auto_launch": False})
    one.run(until=lambda: one.core.state is FlightState.READY)
    one.core.command("abort", by="pilot")
    assert "aborted: pilot" in refusal(one)
    if autopilot == "ardupilot":
        assert [one.vehicle.parameters[n] for n in ("MAV_GCS_SYSID", "MAV_GCS_SYSID_HI", "MAV_OPTIONS")] == [255, 0, 0]


@BOTH
@pytest.mark.parametrize("word", ["resume", "hold", "land", "launch", "sing"])
def test_words_out_of_place_change_nothing(autopilot: str, word: str) -> None:
    one = flight(autopilot)
    one.run_for(0.3)
    with pytest.raises(TransitionError):
        one.core.command(word)
    assert not one.said("word")


# -- ownership --------------------------------------------------------------------------------------------------------


def test_ardupilot_is_told_whom_to_hear_in_an_order_that_keeps_us_in() -> None:
    one = in_cruise("ardupilot", stations=3)
    sets = [(m.param_id, m.param_value) for _, _, _, m in one.sent_messages("PARAM_SET") if "GCS_" in m.param_id[4:]]
    order = list(
        dict.fromkeys(m.param_id for _, _, _, m in one.sent_messages("PARAM_SET") if m.param_id.startswith("MAV_"))
    )
    assert order == ["MAV_GCS_SYSID_HI", "MAV_GCS_SYSID", "MAV_OPTIONS"]
    assert sets
    assert [one.vehicle.parameters[name] for name in order] == [243, 241, 1]


@pytest.mark.slow
def test_a_vehicle_locked_to_others_is_refused_or_taken_and_given_back_as_it_was() -> None:
    locked = ("MAV_GCS_SYSID=200", "MAV_OPTIONS=1")
    reason = refusal(flight("ardupilot", config={"parameters": locked}))
    assert "answers no command" in reason
    assert "unlock it with skyrelay vehicle restore --link" in reason
    assert "--rescue" in reason
    one = flight("ardupilot", config={"parameters": locked}, request={"rescue": True})
    assert one.run(limit_s=400.0) is FlightState.COMPLETED
    assert one.said("alarm", what="rescue")
    names = ("MAV_GCS_SYSID", "MAV_GCS_SYSID_HI", "MAV_OPTIONS")
    assert [one.vehicle.parameters[name] for name in names] == [200, 0, 1]


# -- take-off ---------------------------------------------------------------------------------------------------------


def test_ardupilot_gets_no_setpoint_before_its_climb_is_over() -> None:
    one = in_cruise("ardupilot")
    (takeoff,) = [t for t, _, _, m in one.sent_messages("COMMAND_LONG") if m.command == 22]
    first = one.sent_messages("SET_POSITION_TARGET_LOCAL_NED")[0][0]
    climbed = one.said("state", to="transit")[0].time_s
    assert takeoff < climbed <= first
    assert one.vehicle.body.height_m == pytest.approx(40.0, abs=1.5)


def test_px4_gets_a_second_of_setpoints_before_it_is_asked_for_offboard() -> None:
    one = in_cruise("px4")
    asked = next(t for t, _, _, m in one.sent_messages("COMMAND_LONG") if m.command == 176 and m.param2 == 6.0)
    before = [t for t, _, _, m in one.sent_messages("SET_POSITION_TARGET_GLOBAL_INT") if t < asked]
    assert asked - before[0] >= 1.0
    assert len(before) >= 20
    armed = one.said("state", to="takeoff")[0].time_s
    # Until the motors run the setpoint stays where the vehicle is.
    on_ground = [m.alt for t, _, _, m in one.sent_messages("SET_POSITION_TARGET_GLOBAL_INT") if t < armed]
    assert max(on_ground) < 36.0


def test_an_acknowledged_mode_that_is_not_taken_is_not_believed() -> None:
    reason = refusal(flight("px4", config={"faults": ("mode-without-effect",)}))
    assert "does not enter OFFBOARD: it stays in HOLD" in reason


# -- in flight --------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@BOTH
def test_heartbeats_and_control_come_from_the_station_in_control_alone_and_end_with_the_flight(autopilot: str) -> None:
    one = flight(autopilot)
    assert one.run(limit_s=400.0) is FlightState.COMPLETED
    airborne = one.said("state", to="takeoff")[0].time_s
    moves = [(e.time_s, e.data["event"]) for e in one.said("handover")]
    request_s = next(t for t, event in moves if event == "request")
    release_s = next(t for t, event in moves if event == "release")
    for time_s, station, holder, message in one.sent_messages():
        kind = message.get_type()
        moving = kind == "HEARTBEAT" and request_s <= time_s <= release_s
        on_ground = kind == "HEARTBEAT" and time_s <= airborne
        if kind != "TIMESYNC" and not moving and not on_ground:
            assert station == holder, f"{kind} at {time_s}"
    beats = [t for t, _, _, m in one.sent_messages("HEARTBEAT") if t > airborne]
    assert max(b - a for a, b in pairwise(beats)) <= 0.6
    one.run_for(10.0)
    assert one.sent[-1][0] <= one.said("result")[0].time_s


@pytest.mark.slow
@BOTH
def test_hold_stops_on_the_path_and_resume_goes_on(autopilot: str) -> None:
    one = in_cruise(autopilot, 12.0)
    one.core.command("hold", by="pilot")
    one.run_for(30.0)
    assert one.core.state is FlightState.HOLDING
    body = one.vehicle.body
    assert body.speed_m_s < 0.1
    kinds = ("SET_POSITION_TARGET_GLOBAL_INT", "SET_POSITION_TARGET_LOCAL_NED")
    last = one.sent_messages(*kinds)[-1][3]
    assert (last.vx, last.vy, last.vz, last.afx, last.afy, last.afz) == pytest.approx((0.0,) * 6, abs=1e-9)
    east, north = one.plan.plane.to_plane(body.lat_deg, body.lon_deg)
    at = one.plan.trajectory.evaluate(one.plan_s)
    assert math.hypot(float(east) - at[0], float(north) - at[1]) < 0.2
    one.core.command("resume")
    assert one.run(limit_s=300.0) is FlightState.COMPLETED
    # The schedule was told anew, by about the time stood.
    shifts = [e.data["shift_s"] for e in one.said("retimed")]
    assert shifts[0] == 0.0
    assert 28.0 < shifts[-1] < 40.0
    # And at the end how late it came.
    (result,) = one.said("result")
    assert result.data["late_s"] == pytest.approx(shifts[-1], abs=2.0)
    (alarm,) = one.said("alarm", what="arrived late")
    assert alarm.data["late_s"] == pytest.approx(result.data["late_s"], abs=0.06)


@pytest.mark.slow
@BOTH
def test_abort_goes_back_along_the_path_handing_over_backwards_and_lands_at_the_start(autopilot: str) -> None:
    one = in_cruise(autopilot, 25.0)
    assert one.core.airborne.chain.leg == 1
    one.core.command("abort", by="pilot")
    assert one.run(limit_s=300.0) is FlightState.CONTINGENCY
    assert one.said("handover", state="released", forward=False)
    body = one.vehicle.body
    east, north = one.plan.plane.to_plane(body.lat_deg, body.lon_deg)
    assert math.hypot(float(east), float(north)) < 2.0
    assert one.said("result")[0].data["exit_code"] == 4


@BOTH
def test_land_lands_here(autopilot: str) -> None:
    one = in_cruise(autopilot, 12.0)
    one.core.command("land")
    assert one.run(limit_s=200.0) is FlightState.LANDED
    assert one.vehicle.body.on_ground
    assert one.states[-2:] == ["landing", "landed"]


@pytest.mark.slow
@BOTH
def test_the_flight_stands_at_the_time_it_is_authorised_to_and_goes_on_with_the_next_word(autopilot: str) -> None:
    one = in_cruise(autopilot, 1.0, request={"authorised_until_s": 15.0})
    one.run(until=lambda: one.core.state is FlightState.HOLDING, limit_s=60.0)
    assert 14.0 < one.plan_s <= 15.0
    one.core.command("authorise", until_s=1000.0)
    assert one.run(limit_s=300.0) is FlightState.COMPLETED


@pytest.mark.slow
@BOTH
def test_nobody_there_means_as_far_as_authorised_then_a_hold_then_the_contingency(autopilot: str) -> None:
    one = in_cruise(autopilot, 1.0, request={"authorised_until_s": 15.0, "hold_limit_s": 20.0})
    one.core.parent_gone()
    assert one.run(limit_s=300.0) is FlightState.CONTINGENCY
    assert one.states[-5:] == ["cruise", "holding", "returning", "landing", "contingency"]
    held = one.said("state", to="holding")[0].time_s
    assert one.said("state", to="returning")[0].time_s - held == pytest.approx(20.0, abs=0.2)


@BOTH
def test_a_hold_asked_for_by_a_person_who_is_gone_ends_too(autopilot: str) -> None:
    one = in_cruise(autopilot, 12.0, request={"hold_limit_s": 20.0})
    one.core.command("hold")
    one.run_for(40.0)
    assert one.core.state is FlightState.HOLDING  # somebody attends
    one.core.parent_gone()
    one.run_for(1.0)
    assert one.core.state is FlightState.RETURNING


@pytest.mark.slow
@BOTH
def test_a_slow_vehicle_slows_its_reference_and_stays_on_the_path(autopilot: str) -> None:
    one = in_cruise(autopilot, 1.0, config={"max_speed_m_s": 9.0})
    assert one.run(limit_s=300.0) is FlightState.COMPLETED
    assert one.said("alarm", what="the vehicle falls behind")
    summary = one.said("result")[0].data
    assert summary["tracking_worst_m"] < 30.0
    assert one.cross_track_m(2).max() < 2.0
    assert one.said("retimed")[-1].data["shift_s"] > 5.0


# -- lapses -----------------------------------------------------------------------------------------------------------


@BOTH
def test_a_hung_process_within_the_autopilots_patience_goes_on(autopilot: str) -> None:
    one = in_cruise(autopilot, 12.0)
    one.frozen = True
    one.run_for(0.6)
    one.frozen = False
    one.run_for(5.0)
    assert one.core.state is FlightState.CRUISE
    assert one.core.lateness.skipped >= 11
    assert not one.said("alarm")


@pytest.mark.slow
@BOTH
def test_a_stream_that_lapsed_is_not_taken_up_again_until_a_person_says_so(autopilot: str) -> None:
    one = in_cruise(autopilot, 12.0, request={"hold_limit_s": 1000.0})
    one.frozen = True
    one.run_for(4.0)  # ArduPilot's ground-station failsafe would act at 5 s
    one.frozen = False
    one.run_for(0.2)
    assert one.core.state is FlightState.LAPSED
    assert accepted_after(one, 60.0) == 0
    assert one.vehicle.autopilot.mode_name == HOLD[autopilot]
    assert one.vehicle.body.speed_m_s < 0.5
    one.core.command("resume", by="pilot")
    one.run(until=lambda: one.core.state is FlightState.TRANSIT, limit_s=20.0)
    assert one.core.state is FlightState.TRANSIT
    assert one.run(limit_s=300.0) is FlightState.COMPLETED
    if autopilot == "px4":
        # HOLD, then a second of setpoints, then OFFBOARD.
        lapse = one.said("alarm", what="lapse")[0].time_s
        modes = [(t, m.param2, m.param3) for t, _, _, m in one.sent_messages("COMMAND_LONG") if m.command == 176]
        offboard = next(t for t, main, _ in modes if t > lapse and main == 6.0)
        again = [t for t, _, _, _ in one.sent_messages("SET_POSITION_TARGET_GLOBAL_INT") if t > lapse + 1.0]
        assert offboard - again[0] >= 1.0
    assert one.said("state", to="transit")[-1].data["reason"] == "back to the path, on a person's word"


def test_px4_that_still_shows_offboard_after_a_lapse_is_told_to_hold() -> None:
    one = in_cruise("px4", 12.0, config={"parameters": ("COM_OF_LOSS_T=5",)}, request={"set_parameters": "auto"})
    # The limit is the one read back, 5 s: silence of 4.9 s is a lapse for us, not yet for the vehicle.
    one.frozen = True
    one.run_for(4.85)
    one.frozen = False
    one.run(until=lambda: one.vehicle.autopilot.mode_name == "HOLD", limit_s=2.0)
    assert one.core.state is FlightState.LAPSED
    assert one.vehicle.autopilot.mode_name == "HOLD"


@pytest.mark.slow
@BOTH
def test_without_a_word_the_autopilots_own_return_is_the_last_resort(autopilot: str) -> None:
    one = in_cruise(autopilot, 12.0, request={"hold_limit_s": 15.0})
    one.frozen = True
    one.run_for(4.0)
    one.frozen = False
    assert one.run(limit_s=300.0) is FlightState.CONTINGENCY
    assert one.said("alarm", what="last resort")[0].data["mode"] == "RTL"
    assert one.vehicle.body.on_ground


@BOTH
def test_a_pilot_who_takes_over_is_not_fought(autopilot: str) -> None:
    one = in_cruise(autopilot, 5.0, config={"faults": ("pilot-takes-over@T20",)}, request={"hold_limit_s": 1000.0})
    one.run(until=lambda: one.core.state is FlightState.LAPSED, limit_s=60.0)
    assert one.core.state is FlightState.LAPSED
    lapse = one.now_s
    one.run_for(10.0)
    after = [m.get_type() for t, _, _, m in one.sent_messages() if t > lapse]
    assert set(after) <= {"HEARTBEAT", "TIMESYNC"}


@BOTH
def test_a_restarted_autopilot_gets_nothing_more(autopilot: str) -> None:
    one = in_cruise(autopilot, 12.0)
    one.vehicle.reboot()
    restarted = one.now_s
    one.run(until=lambda: one.core.state is not FlightState.CRUISE, limit_s=10.0)
    assert one.now_s - restarted <= 2.0
    stopped = one.now_s
    one.run_for(20.0)
    kinds = ("SET_POSITION_TARGET_GLOBAL_INT", "SET_POSITION_TARGET_LOCAL_NED")
    assert not [t for t, _, _, _ in one.sent_messages(*kinds) if t > stopped]


@pytest.mark.slow
@BOTH
def test_somebody_elses_targets_are_noticed_within_a_second(autopilot: str) -> None:
    # On ArduPilot the range of ids keeps the stranger out: nothing to notice.
    # Between two of ours: in the same tick, just before ours, the vehicle would never follow it.
    one = in_cruise(autopilot, 5.0, config={"faults": ("foreign-station-streams@T20.02+5",)})
    one.run_for(30.0)
    strange = one.said("alarm", what="the vehicle holds a target that is not ours")
    assert bool(strange) == (autopilot == "px4")
    first = next((a.time_s for a in one.accepted if a.system_id == 99), None)
    if autopilot == "px4":
        assert first is not None
        assert strange[0].time_s - first <= 1.0
    else:
        assert first is None


# -- the newer operator-control protocol ------------------------------------------------------------------------------


@BOTH
def test_where_the_vehicle_arbitrates_control_is_asked_for_and_granted(autopilot: str) -> None:
    one = flight(autopilot, config={"speaks_operator_control": True})
    assert one.run(limit_s=400.0) is FlightState.COMPLETED
    (released,) = one.said("handover", state="released")
    assert released.data["way"] == "operator_control"
    assert one.said("handover", state="confirmed")[0].data["reason"] == "control granted to it"


# -- what people see --------------------------------------------------------------------------------------------------


def test_status_and_events_are_plain_json_whatever_the_vehicle_says() -> None:
    import json

    one = in_cruise("px4", 5.0, config={"faults": ("position-nan", "text-rubbish")})
    json.dumps(one.core.status(), allow_nan=False)
    for event in one.events:
        json.dumps(event.to_document(), allow_nan=False)
    assert plain({"a": [float("nan"), (1.0, float("inf"))]}) == {"a": [None, [1.0, None]]}
    assert [e.sequence for e in one.events] == list(range(1, len(one.events) + 1))


@pytest.mark.slow
def test_progress_says_where_the_flight_is_and_what_comes_next() -> None:
    one = in_cruise("px4", 8.0)
    data = one.said("progress")[-1].data
    assert data["station"] == "s1"
    assert data["handovers"][0]["to"] == "s2"
    assert 0.0 < data["margin_m"] < 400.0
    assert data["error_m"] < 2.0
    assert data["links"]["s2"]["proven_s_ago"] < 2.0


# -- latency ----------------------------------------------------------------------------------------------------------


@BOTH
def test_the_links_latency_is_led(autopilot: str) -> None:
    """200 ms to the vehicle: without a lead it is that much of its speed behind, with one it is where the plan is."""
    behind = {}
    for limit_s in (0.0, 0.5):
        settings = {"lead_limit_s": limit_s}
        one = flight(autopilot, proxy=Proxy(seed=1, latency_s=0.2), request=settings, truth_every_s=0.1)
        one.run(until=lambda one=one: one.plan_s >= 14.0, limit_s=100.0)  # type: ignore[misc]
        fast = [off for off, t in zip(one.behind_m(), _cruise(one), strict=True) if float(t.plan_s or 0.0) > 8.0]
        behind[limit_s] = float(np.mean(fast))
        # What is told is what is true.
        assert one.said("progress")[-1].data["error_m"] == pytest.approx(fast[-1], abs=0.8)
        assert not one.said("alarm")
    # About 15 m/s x 0.2 s; ArduPilot moves a late target on along its velocity by itself, a little.
    assert 1.8 < behind[0.0] < 4.0
    assert behind[0.5] < min(1.0, 0.5 * behind[0.0])


def _cruise(one: VirtualFlight) -> list[Truth]:
    return [t for t in one.truth if t.state is FlightState.CRUISE and t.plan_s is not None]


def test_the_lead_follows_the_link_and_steps_with_the_station() -> None:
    """The second station's link is 150 ms later: from its first setpoint on the lead is its own."""
    proxy = Proxy(seed=1, latency_s=0.05, later_s={"s2": 0.15})
    one = VirtualFlight(relay_plan(2), "px4", proxy=proxy, frugal=True, truth_every_s=0.1)
    one.run(until=lambda: one.plan_s >= 10.0, limit_s=100.0)
    assert one.core.airborne.latency.ahead_s == pytest.approx(0.05, abs=0.02)
    one.run(until=lambda: one.core.context.control.gate.holder == "s2", limit_s=60.0)
    one.run_for(0.1)
    assert one.core.airborne.latency.ahead_s == pytest.approx(0.2, abs=0.02)
    handover_s = one.now_s
    one.run_for(4.0)
    around = [off for off, t in zip(one.behind_m(), _cruise(one), strict=True) if abs(t.time_s - handover_s) < 3.0]
    assert max(around) < 1.5


# -- a vehicle that cannot follow -------------------------------------------------------------------------------------


@pytest.mark.slow
@BOTH
def test_a_vehicle_that_tops_out_silently_never_leaves_coverage(autopilot: str) -> None:
    """The stock vehicle's 10.5 m/s against the plan's 15: slower, told, re-timed; range by its own position."""
    one = flight(autopilot, config={"faults": ("slow-vehicle",)})
    assert one.run(limit_s=400.0) is FlightState.COMPLETED
    assert one.said("alarm", what="the vehicle falls behind")
    told = one.said("retimed")
    assert told[-1].data["shift_s"] > 2.0
    assert all(h["t_plus_s"] > 0.0 for e in told for h in e.data["handovers"])
    for progress in one.said("progress"):
        if progress.state is FlightState.CRUISE:
            assert progress.data["margin_m"] > 0.0
    assert one.cross_track_m(2).max() < 2.0


def test_the_range_told_is_the_vehicles_own_not_the_plans() -> None:
    """A gust carries it off the path; the margin is that of where it says it is."""
    one = in_cruise("px4", 8.0, config={"faults": ("wind-gust:15",)})
    one.run_for(6.0)
    progress = one.said("progress")[-1]
    station = one.plan.mission.stations[one.plan.mission.station_index(str(progress.data["station"]))]
    data = progress.data
    east, north = one.plan.plane.to_plane(data["lat_deg"], data["lon_deg"])
    at = station.position
    assert isinstance(at, LocalPosition)
    away_m = float(np.linalg.norm([east - at.east_m, north - at.north_m, data["alt_amsl_m"] - at.up_m]))
    assert data["margin_m"] == pytest.approx(station.range_m - away_m, abs=0.2)


def test_a_vehicle_out_of_range_is_told_and_the_neighbour_that_has_it_takes_over() -> None:
    """By where it says it is, while the plan has it well inside: 450 m from the first station, which reaches 400 m."""
    one = in_cruise("px4", 12.0)
    air, context = one.core.airborne, one.core.context
    position = context.vehicle.monitor.position
    assert position is not None
    assert not air.range.left
    beyond = replace(position, boot_s=position.boot_s + 0.01, lon_deg=4.79 + 450.0 / 67_200.0)
    context.vehicle.monitor.places.position = beyond
    air.range.update()
    assert air.range.margin_m == pytest.approx(-52.0, abs=10.0)
    one.run_for(0.2)
    (alarm,) = one.said("alarm", what="the vehicle is out of range")
    assert alarm.data["station"] == "s1"


def test_a_second_ground_station_is_told_within_a_second() -> None:
    from link.dialect import mavlink
    from link.wire.codec import StationCodec

    one = in_cruise("px4", 5.0)
    beat = mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3)
    one.core.receive("s1", StationCodec(77).encode(beat), one.now_s)
    heard_s = one.now_s
    one.run_for(1.0)
    (alarm,) = one.said("alarm", what="another ground station is on the link")
    assert alarm.data["system_id"] == 77
    assert alarm.time_s - heard_s <= 1.0
