"""Commands in states that the normal path did not set up, phases without an end, and what is told after a lapse."""

from __future__ import annotations

import math
from typing import Any

import pytest

from gcs.flight import FlightState
from gcs.operator_commands import DISARM_ASKED_AFTER_S, GROUND_ARMED_LIMIT_S
from link.dialect import mavlink
from link.monitors.range_margin import AGAIN_S
from link.session.coverage import choices, margin_m
from tests.support.flights.moments import SETPOINTS, in_cruise
from tests.support.flights.virtual import VirtualFlight
from tests.support.plans.planned import relay_plan

BOTH = pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])


def lapsed(autopilot: str, plan_s: float = 8.0, **request: Any) -> VirtualFlight:
    """A flight whose process hung for longer than any autopilot waits."""
    one = in_cruise(autopilot, plan_s, **request)
    one.frozen = True
    one.run_for(4.0)
    one.frozen = False
    one.run(until=lambda: one.core.state is FlightState.LAPSED, limit_s=5.0)
    assert one.core.state is FlightState.LAPSED
    return one


# -- kind A: a command in a state whose entry conditions only the normal path sets up ---------------------------------


@BOTH
@pytest.mark.parametrize("command", ["abort", "land"])
def test_kind_a_leaving_a_climb_lands_at_once_and_never_lapses(autopilot: str, command: str) -> None:
    one = VirtualFlight(relay_plan(2), autopilot, frugal=True)
    ground_m = one.vehicle.body.height_m
    one.run(until=lambda: one.vehicle.body.height_m > ground_m + 3.0, limit_s=300.0)
    assert one.core.state is FlightState.TAKEOFF
    one.core.command(command, by="Ctrl-C")
    one.run_for(3.0)
    assert one.vehicle.body.height_m < ground_m + 5.0
    assert one.core.context.vehicle.mode == "LAND"
    state = one.run(limit_s=200.0)
    assert state is (FlightState.CONTINGENCY if command == "abort" else FlightState.LANDED)
    assert not one.said("alarm", what="lapse")
    assert one.vehicle.body.on_ground


@BOTH
def test_kind_a_land_after_a_lost_link_is_asked_for_and_nothing_is_streamed(autopilot: str) -> None:
    one = lapsed(autopilot)
    before = len(one.sent_messages(*SETPOINTS))
    one.core.command("land", by="pilot")
    one.run_for(0.2)
    assert one.core.state is FlightState.LANDING
    assert one.run(limit_s=200.0) is FlightState.CONTINGENCY
    assert len(one.sent_messages(*SETPOINTS)) == before


@BOTH
def test_kind_a_an_arm_command_under_way_is_taken_back_by_an_abort(autopilot: str) -> None:
    """The answer and the heartbeat come half a second late: at the abort nothing shows that the vehicle has armed."""
    one = VirtualFlight(relay_plan(2), autopilot, frugal=True)
    one.run(until=lambda: one.core.state is FlightState.ARMING, limit_s=300.0)
    one.proxy.latency_s = 0.4
    one.run(until=lambda: one.vehicle.autopilot.armed, limit_s=300.0)
    assert not one.core.context.vehicle.armed
    one.core.command("abort", by="pilot")
    assert one.run(limit_s=120.0) in (FlightState.REFUSED, FlightState.CONTINGENCY)
    assert not one.vehicle.autopilot.armed
    one.run_for(20.0)
    assert not one.vehicle.autopilot.armed


def test_kind_a_a_launch_after_an_abort_is_refused_in_words() -> None:
    from gcs.flight import TransitionError

    one = VirtualFlight(relay_plan(2), "px4", frugal=True, request={"auto_launch": False})
    one.run(until=lambda: one.core.state is FlightState.READY, limit_s=200.0)
    one.core.command("abort", by="pilot")
    with pytest.raises(TransitionError, match="too late"):
        one.core.command("launch", by="pilot")
    assert one.run(limit_s=60.0) is FlightState.REFUSED


@BOTH
def test_kind_a_land_while_control_is_being_moved_reaches_the_vehicle(autopilot: str) -> None:
    one = in_cruise(autopilot, 10.0)
    one.run(until=lambda: one.core.airborne.chain.moving, limit_s=100.0)
    assert one.core.airborne.chain.moving
    one.core.command("land", by="pilot")
    assert one.run(limit_s=200.0) is FlightState.LANDED
    assert one.core.airborne.chain.handover is None or not one.core.airborne.chain.moving


@BOTH
def test_kind_a_a_plan_joined_further_on_before_t_plus_0_is_joined_at_rest(autopilot: str) -> None:
    one = VirtualFlight(relay_plan(2), autopilot, frugal=True)
    one.run(until=lambda: one.core.state is FlightState.TRANSIT, limit_s=200.0)
    one.core.airborne.guidance.join_s = 9.0
    one.run(until=lambda: one.core.state is FlightState.CRUISE, limit_s=100.0)
    assert one.core.airborne.guidance.reference.rate < 0.1
    assert one.core.context.timeline.t_plus_s == pytest.approx(9.0, abs=0.2)


@BOTH
def test_an_ordered_landing_ends_as_landed_by_command(autopilot: str) -> None:
    one = in_cruise(autopilot, 12.0)
    one.core.command("land", by="pilot")
    assert one.run(limit_s=200.0) is FlightState.LANDED
    assert "by command (pilot)" in one.said("state", to="landed")[0].data["reason"]
    assert one.said("result")[0].data["exit_code"] == 0


@BOTH
@pytest.mark.slow
def test_handovers_there_and_back_count_after_an_abort(autopilot: str) -> None:
    one = in_cruise(autopilot, 25.0)
    assert one.core.airborne.chain.leg == 1
    one.core.command("abort", by="pilot")
    assert one.run(limit_s=300.0) is FlightState.CONTINGENCY
    data = one.said("result")[0].data
    assert (data["handovers"], data["handovers_back"]) == (2, 1)


# -- kind F: phases without an end ------------------------------------------------------------------------------------


@BOTH
@pytest.mark.slow
def test_kind_f_a_vehicle_that_does_not_disarm_is_asked_and_then_given_up_with_the_reason(
    autopilot: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = in_cruise(autopilot, 12.0)
    monkeypatch.setattr(one.vehicle.autopilot, "disarm", lambda *_: None)
    monkeypatch.setattr(one.vehicle.autopilot, "_disarm", lambda *_: None, raising=False)
    one.core.command("land", by="pilot")
    one.run(until=lambda: one.vehicle.body.on_ground, limit_s=200.0)
    down_s = one.now_s
    assert one.run(limit_s=400.0) is FlightState.LOST
    assert one.now_s - down_s < GROUND_ARMED_LIMIT_S + 30.0
    asked = [
        time_s
        for time_s, _, _, m in one.sent_messages("COMMAND_LONG")
        if m.command == mavlink.MAV_CMD_COMPONENT_ARM_DISARM and m.param1 == 0.0
    ]
    assert asked
    assert DISARM_ASKED_AFTER_S <= asked[0] - down_s < DISARM_ASKED_AFTER_S + 10.0
    assert "on the ground, armed, does not disarm" in one.said("state", to="lost")[0].data["reason"]


@BOTH
def test_kind_f_a_landing_that_a_pilot_took_over_is_not_fought(autopilot: str) -> None:
    one = in_cruise(autopilot, 12.0)
    one.core.command("land", by="pilot")
    one.run(until=lambda: one.core.airborne.landing.seen, limit_s=30.0)
    landing = one.core.airborne.landing
    landing._lands_s = -math.inf
    heartbeat = one.core.context.vehicle.monitor.heartbeat
    assert heartbeat is not None
    asked = landing._asked_s
    object.__setattr__(heartbeat, "custom_mode", one.core.context.vehicle.profile.modes["RTL"])
    landing.ask()
    assert landing._asked_s == asked
    assert "left LAND for RTL" in landing.taken_over


# -- after a lapse ----------------------------------------------------------------------------------------------------


@BOTH
def test_after_a_lapse_it_is_said_what_happens_until_when_and_what_may_be_commanded(autopilot: str) -> None:
    one = lapsed(autopilot, hold_limit_s=60.0)
    one.run_for(1.5)
    told = one.said("alarm", what="lost C2 link")
    assert told
    data = told[-1].data
    assert data["mode"] == one.core.context.vehicle.mode
    assert data["nearest_station"] == "s1"
    assert data["commands"] == "resume, land, abort"
    assert 50.0 < float(str(data["until_in_s"])) <= 60.0
    assert data["then"] == "then told to RTL"
    one.run(until=lambda: one.core.context.vehicle.mode == "RTL", limit_s=90.0)
    one.run_for(1.0)
    assert one.said("alarm", what="lost C2 link", mode="RTL")


@BOTH
def test_no_countdown_to_a_handover_stands_while_lapsed_or_holding(autopilot: str) -> None:
    one = in_cruise(autopilot, 5.0)
    one.run_for(1.2)
    assert one.said("progress")[-1].data["handovers"]
    one.core.command("hold", by="pilot")
    one.run_for(5.0)
    assert one.said("progress")[-1].data["handovers"] == []
    one.frozen = True
    one.run_for(4.0)
    one.frozen = False
    one.run_for(4.0)
    assert one.core.state is FlightState.LAPSED
    assert one.said("progress")[-1].data["handovers"] == []
    assert one.said("progress")[-1].data["lapse"]["mode"]


@BOTH
def test_a_station_out_of_range_is_no_choice_while_one_in_range_is_heard(autopilot: str) -> None:
    """The first station's link is cut for a while; the second, proved all along, is out of range."""
    one = in_cruise(autopilot, 1.0)
    margin = margin_m(one.core.context, "s2")
    assert margin is not None
    assert margin < 0.0
    assert choices(one.core.context) == ["s1"]
    one.proxy.cuts.append(("s1", one.now_s, one.now_s + 8.0))
    one.run_for(12.0)
    assert one.core.state is FlightState.LAPSED
    assert choices(one.core.context) == ["s1"]
    assert one.core.context.control.gate.holder == "s1"


@BOTH
@pytest.mark.slow
def test_out_of_range_is_told_again(autopilot: str, monkeypatch: pytest.MonkeyPatch) -> None:
    one = lapsed(autopilot, hold_limit_s=600.0)
    monkeypatch.setattr(one.core.context.plan.geometry.__class__, "outside_m", lambda *_: [50.0])
    one.run_for(2.5 * AGAIN_S)
    assert len(one.said("alarm", what="the vehicle is out of range")) == 3


@BOTH
def test_a_pilots_return_and_landing_are_told(autopilot: str) -> None:
    one = VirtualFlight(relay_plan(2), autopilot, frugal=True, config={"faults": ("mode-to-return",)})
    assert one.run(limit_s=600.0) is FlightState.CONTINGENCY
    told = one.said("alarm", what="lost C2 link")
    assert {e.data["mode"] for e in told} >= {"RTL"}
