"""A restart, a moved origin or home, or a moved vehicle voids the preflight; what is watched by is asked for again."""

from __future__ import annotations

import contextlib
import math

import pytest

from gcs.flight import FlightState, OperatorCommand, TransitionError
from link.dialect import mavlink
from tests.support.flights.tampered import TamperedFlight, altered, in_the_air, ready

BOTH = pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])

NORTH_50_M = round(50.0 / 0.0111319)


def preflights_after(one: TamperedFlight, time_s: float) -> int:
    """Passed preflights since."""
    return len([e for e in one.said("state", to="ready") if e.time_s > time_s])


@BOTH
@pytest.mark.parametrize("then_s", [0.5, 3.0, 8.0])
def test_a_restart_between_preflight_and_launch_voids_it(autopilot: str, then_s: float) -> None:
    one = ready(autopilot)
    began_s = one.now_s
    one.vehicle.defer(one.vehicle.reboot)
    one.run_for(then_s)
    with contextlib.suppress(TransitionError):
        one.core.command(OperatorCommand.LAUNCH)
    one.run(limit_s=90.0, until=lambda: one.vehicle.autopilot.armed or preflights_after(one, began_s) > 0)
    assert not one.vehicle.autopilot.armed, "armed on the preflight of before the restart"
    assert one.core.context.vehicle.monitor.reboots == 1
    if preflights_after(one, began_s):
        assert one.alarms("the preflight is void")
    if one.core.state is FlightState.READY:
        one.run_for(2.0)
        with contextlib.suppress(TransitionError):  # given already, on the new preflight
            one.core.command(OperatorCommand.LAUNCH)
        one.run(limit_s=200.0)
        assert one.core.state is FlightState.COMPLETED
        assert one.behind_m().max() < 6.0


@BOTH
def test_a_restart_while_arming_arms_nothing(autopilot: str) -> None:
    one = ready(autopilot)
    one.core.command(OperatorCommand.LAUNCH)
    one.run(until=lambda: one.core.state is FlightState.ARMING, limit_s=10.0)
    one.vehicle.defer(one.vehicle.reboot)
    one.run(limit_s=90.0)
    assert one.core.state is FlightState.REFUSED
    assert not one.vehicle.autopilot.armed


@BOTH
def test_an_origin_or_a_home_moved_on_the_ground_voids_the_preflight(autopilot: str) -> None:
    for kind in ("GPS_GLOBAL_ORIGIN", "HOME_POSITION"):
        one = ready(autopilot)
        began_s = one.now_s
        origin = one.core.context.vehicle.origin
        assert origin is not None
        one.tamper = altered(kind, latitude=round(origin.lat_deg * 1e7) + NORTH_50_M)
        one.run_for(45.0)
        assert one.alarms("the preflight is void"), kind
        assert preflights_after(one, began_s) >= 1 or one.core.state is FlightState.REFUSED


@BOTH
def test_home_far_from_the_vehicle_is_refused(autopilot: str) -> None:
    one = TamperedFlight(relay_plan_2(), autopilot, frugal=True)
    one.tamper = altered("HOME_POSITION", latitude=531_300_000, longitude=47_900_000)
    one.run(limit_s=100.0)
    assert one.core.state is FlightState.REFUSED
    assert "home" in str(one.said("state", to="refused")[0].data["reason"])


def relay_plan_2() -> object:
    from tests.support.plans.planned import relay_plan

    return relay_plan(2)


@BOTH
def test_home_moved_in_flight_is_told(autopilot: str) -> None:
    one = in_the_air(autopilot, 3.0)
    home = one.core.context.vehicle.monitor.home
    assert home is not None
    place = (round((home.lat_deg + 0.001) * 1e7), round(home.lon_deg * 1e7), round(home.alt_amsl_m * 1e3))
    one.say(mavlink.MAVLink_home_position_message(*place, 0, 0, 0, [0.0] * 4, 0, 0, 0, 0))
    one.run_for(1.0)
    assert one.alarms("home has moved")


@BOTH
def test_an_origin_whose_one_announcement_was_lost_is_asked_for_again(autopilot: str) -> None:
    one = in_the_air(autopilot, 4.0)
    estimate = one.vehicle.estimator
    assert estimate.origin is not None
    lat, lon, alt = estimate.origin
    estimate.set_origin(lat, lon + 50.0 / 6_371_000.0 / math.cos(lat), alt)  # and not a word of it
    began_s = one.now_s
    one.run(limit_s=200.0)
    if autopilot == "ardupilot":
        assert one.first_alarm_s("EKF origin moved", began_s) - began_s <= 10.0
    assert one.core.state is FlightState.COMPLETED


@BOTH
@pytest.mark.parametrize("message_id", [33, 85, 245, 1, 24])
def test_a_stream_that_another_station_switched_off_is_asked_for_again(autopilot: str, message_id: int) -> None:
    one = in_the_air(autopilot, 4.0)
    for link in range(len(one.links)):
        one.vehicle.telemetry.set_interval(link, message_id, None)
    before_s = one.now_s
    one.run_for(6.0)
    assert one.core.context.vehicle.monitor.kinds_s[message_id] > before_s + 3.0
    one.run(limit_s=200.0)
    assert one.core.state is FlightState.COMPLETED
