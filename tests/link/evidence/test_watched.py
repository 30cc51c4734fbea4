"""Receiver, estimator and silence are watched; "arrived" and "as planned" are said of where the vehicle is."""

from __future__ import annotations

import pytest

from gcs.flight import FlightState
from link.monitors.evidence import SILENT
from tests.support.flights.tampered import TamperedFlight, altered, in_the_air, ready

BOTH = pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])

DOUBT = "the vehicle's position estimate is in doubt"


@BOTH
@pytest.mark.parametrize("kind", ["GPS_RAW_INT", "SYS_STATUS", "estimator"])
@pytest.mark.slow
def test_trouble_of_the_estimate_is_told_within_two_seconds_and_its_end_too(autopilot: str, kind: str) -> None:
    one = in_the_air(autopilot, 2.0)
    began_s = one.now_s
    estimator = "EKF_STATUS_REPORT" if autopilot == "ardupilot" else "ESTIMATOR_STATUS"
    one.tamper = {
        "GPS_RAW_INT": altered("GPS_RAW_INT", fix_type=1),
        "SYS_STATUS": altered("SYS_STATUS", onboard_control_sensors_health=0),
        "estimator": altered(estimator, flags=167),
    }[kind]
    one.run_for(3.0)
    assert one.first_alarm_s(DOUBT, began_s) - began_s <= (2.1 if kind != "SYS_STATUS" else 3.0)
    one.tamper = None
    one.run_for(3.0)
    assert one.alarms("the vehicle's position estimate is good again")
    one.run(limit_s=200.0)
    assert one.core.state is FlightState.COMPLETED


@BOTH
def test_a_handover_waits_for_the_estimate(autopilot: str) -> None:
    one = in_the_air(autopilot, 2.0)
    one.tamper = altered("GPS_RAW_INT", fix_type=1)
    one.run_for(40.0)
    assert not one.said("handover", state="requested")
    one.tamper = None
    one.run(limit_s=300.0)
    assert one.core.state is FlightState.COMPLETED
    assert one.core.airborne.chain.leg == 1


@BOTH
@pytest.mark.parametrize("state", ["cruise", "landing", "ready"])
def test_a_silent_vehicle_is_told_within_two_seconds(autopilot: str, state: str) -> None:
    one: TamperedFlight
    if state == "ready":
        one = ready(autopilot)
    else:
        one = in_the_air(autopilot, 2.0)
        if state == "landing":
            one.core.command("land")
            one.run_for(5.0)
    one.tamper = lambda now_s, link, message: ()
    began_s = one.now_s
    one.run_for(2.5)
    assert one.first_alarm_s(SILENT, began_s) - began_s <= 2.0


@BOTH
@pytest.mark.slow
def test_a_vehicle_that_falls_has_not_arrived_and_is_told_within_a_second(autopilot: str) -> None:
    one = in_the_air(autopilot, 3.0)
    one.run(until=lambda: one.plan_s > one.plan.mission_time_s - 5.0, limit_s=100.0)
    one.vehicle.rotors_stopped = True
    began_s = one.now_s
    one.run_for(30.0)
    assert one.first_alarm_s("descends and was not told to", began_s) - began_s <= 1.0
    assert "arrived" not in one.states
    assert one.core.state is not FlightState.COMPLETED
    one.run(limit_s=400.0)
    assert one.core.state is not FlightState.COMPLETED
