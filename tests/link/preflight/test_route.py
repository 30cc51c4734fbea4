"""What a crew is told of the way: ground higher than the path, and handovers behind which no stop is in time."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from gcs.flight import FlightState
from gcs.mission import parse_mission_json, read_mission
from gcs.mission.model import ANSWERS_S, NOTICED_S
from gcs.plan.model import Plan
from gcs.planning.mission_planning import plan_mission
from link.handover.handover_chain import TAKEOVER_SHARE
from link.preflight.check import Level
from link.preflight.route import HANDED_OVER_S, judge_lowest, judge_stops
from tests.support.flights.on_ground import checks, on_ground
from tests.support.flights.virtual import VirtualFlight
from tests.support.paths import MISSIONS
from tests.support.plans.planned import relay_document, relay_plan

BOTH = pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])


@cache
def falling_plan() -> Plan:
    """From 40 m down to 31 m AMSL."""
    document: dict[str, Any] = relay_document(2)
    document["destination"]["up_m"] = 31.0
    return plan_mission(read_mission(document), fast=True)


@cache
def tight_plan(**options: object) -> Plan:
    """Stations whose ranges share little, for a vehicle of 15 m/s that brakes at 1.5 m/s^2: 5 s of the path to stop."""
    document: dict[str, Any] = relay_document(2, spacing_m=650.0, **options)
    document["limits"]["max_accel_m_s2"] = 1.5
    return plan_mission(read_mission(document), fast=True)


def test_a_plan_that_goes_below_the_ground_the_vehicle_stands_on_is_told_with_figures() -> None:
    check = judge_lowest(falling_plan(), 36.0)
    assert check.level is Level.WARNING
    assert check.value == pytest.approx(31.0, abs=0.05)
    assert "goes down to 31.0 m AMSL" in check.message
    assert "stands at 36.0 m: 5.0 m higher" in check.message
    assert "map of the terrain" in check.remedy
    level = judge_lowest(falling_plan(), 30.5)
    assert (level.level, level.remedy) == (Level.PASS, "")


@BOTH
def test_it_is_told_by_either_autopilot_and_keeps_nobody_on_the_ground(autopilot: str) -> None:
    start = relay_plan(2).plane
    one = on_ground(autopilot, falling_plan(), config={"home": (start.lat_deg, start.lon_deg, 36.0)})
    assert one.core.state is FlightState.READY
    found = checks(one)
    assert found["lowest altitude"]["level"] == "warning"
    assert found["handovers"]["level"] == "pass"


def test_a_handover_behind_which_no_stop_is_in_time_is_told_with_what_would_do() -> None:
    plan = tight_plan()
    (handover,) = plan.handovers
    left_s = handover.overlap_end_s - handover.time_s
    assert 3.0 < left_s < 5.5
    (check,) = judge_stops(plan, 1.0)
    assert (check.name, check.level) == ("handover 1", Level.WARNING)
    # 0.3 s to be handed over, 0.6 s of the time-out to notice, v / 2a = 5 s to stop.
    assert check.required == "at least 5.9 s"
    assert check.value == pytest.approx(left_s, abs=0.01)
    assert "min_overlap_s 12" in check.remedy
    # That much further on the path, at its speed.
    way = plan.trajectory.evaluate(np.array([handover.time_s + 5.9]))
    outside_m = float(plan.geometry.outside_m(np.array([plan.trajectory.sequence[0]]), way)[0])
    assert f"gets {outside_m:.0f} m out of range" in check.message
    assert outside_m > 5.0
    # A slower autopilot's patience: 1.2 s more to notice.
    (slower,) = judge_stops(plan, 3.0)
    assert slower.required == "at least 7.1 s"


@pytest.mark.slow
def test_where_there_is_room_it_passes_and_the_flight_does_stop_in_time() -> None:
    plan = relay_plan(2)
    (check,) = judge_stops(plan, 1.0)
    assert (check.name, check.level) == ("handovers", Level.PASS)
    (handover,) = plan.handovers
    # 15 m/s, 2.5 m/s^2: 0.9 s to notice and 3 s to stop.
    assert check.value == pytest.approx(handover.overlap_end_s - handover.time_s - 3.9, abs=0.1)
    one = VirtualFlight(plan, "px4", frugal=True, request={"wait_for_station_s": 5.0})
    one.run(until=lambda: bool(one.said("handover", state="released")), limit_s=300.0)
    one.proxy.cuts.append((handover.to_station, one.now_s, 1e9))
    assert one.run(limit_s=400.0) is FlightState.CONTINGENCY
    assert not one.said("alarm", what="the vehicle is out of range")
    assert not one.said("alarm", what="lapse")


@pytest.mark.slow
def test_a_failure_right_after_a_handover_without_room_takes_the_vehicle_as_far_out_as_was_told() -> None:
    plan = tight_plan()
    (check,) = judge_stops(plan, 1.0)
    told_m = float(check.message.split(" gets ")[1].split(" m ")[0])
    one = VirtualFlight(plan, "px4", frugal=True, request={"wait_for_station_s": 5.0})
    one.run(until=lambda: bool(one.said("handover", state="released")), limit_s=300.0)
    one.proxy.cuts.append((plan.handovers[0].to_station, one.now_s, 1e9))
    assert one.run(limit_s=400.0) is FlightState.CONTINGENCY
    assert one.said("alarm", what="the vehicle is out of range")
    old = np.array([plan.trajectory.sequence[0]])
    flown = [t for t in one.truth if t.plan_s is not None]
    away = [float(plan.geometry.outside_m(old, plan.trajectory.evaluate(np.array([t.plan_s])))[0]) for t in flown]
    assert max(away) == pytest.approx(told_m, abs=6.0)


@pytest.mark.parametrize("loss_timeout_s", [1.0, 3.0])
def test_the_demos_own_plan_can_stop_everywhere(loss_timeout_s: float) -> None:
    """With PX4's time-out by default (COM_OF_LOSS_T 1 s) and with ArduPilot's (GUID_TIMEOUT 3 s)."""
    plan = plan_mission(parse_mission_json((MISSIONS / "wadden_relay.json").read_bytes()))
    assert [check.level for check in judge_stops(plan, loss_timeout_s)] == [Level.PASS]


def test_the_planner_aims_at_what_preflight_asks() -> None:
    assert ANSWERS_S == HANDED_OVER_S
    assert pytest.approx(TAKEOVER_SHARE * 3.0) == NOTICED_S
