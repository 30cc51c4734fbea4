"""What is told of the battery in flight, by simulated autopilots in virtual time."""

from __future__ import annotations

import pytest

from gcs.flight import FlightState
from tests.support.flights.virtual import VirtualFlight
from tests.support.plans.planned import relay_plan

BOTH = pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])


def in_cruise(autopilot: str) -> VirtualFlight:
    one = VirtualFlight(relay_plan(3), autopilot, frugal=True)
    one.run(until=lambda: one.core.state is FlightState.CRUISE and one.plan_s > 1.0, limit_s=300.0)
    return one


def leave(one: VirtualFlight, share: float) -> None:
    """Take the battery to a share of its charge."""
    battery = one.vehicle.battery
    battery.used_mah = battery.capacity_mah * (1.0 - share)


@BOTH
def test_little_left_and_very_little_are_told_once_each(autopilot: str) -> None:
    one = in_cruise(autopilot)
    leave(one, 0.25)
    one.run_for(3.0)
    assert not one.said("alarm", what="battery low")
    leave(one, 0.19)
    one.run_for(5.0)
    leave(one, 0.09)
    one.run_for(5.0)
    assert [e.data["percent"] for e in one.said("alarm", what="battery low")] == [pytest.approx(19, abs=1)]
    assert [e.data["percent"] for e in one.said("alarm", what="battery critical")] == [pytest.approx(9, abs=1)]


@BOTH
def test_a_fall_past_both_levels_is_told_as_what_it_is(autopilot: str) -> None:
    one = in_cruise(autopilot)
    leave(one, 0.05)
    one.run_for(5.0)
    assert one.said("alarm", what="battery critical")
    assert not one.said("alarm", what="battery low")


@BOTH
def test_a_battery_that_will_not_last_is_told_while_there_is_time(autopilot: str) -> None:
    """Drained so that about 5 % are left at the end of the plan: told long before it is low."""
    one = in_cruise(autopilot)
    battery = one.vehicle.battery
    left_s = one.plan.mission_time_s - one.plan_s
    battery.used_mah = 0.0
    one.run_for(1.0)
    battery.drain_factor = 0.95 * battery.capacity_mah * 3.6 / (battery.current_a * left_s)
    one.run(until=lambda: battery.remaining < 0.5, limit_s=300.0)
    told = one.said("alarm", what="the battery will not last")
    assert told
    assert not one.said("alarm", what="battery low")
    first = told[0].data
    assert first["percent"] > 50
    assert first["at_end_percent"] < 10.0
    assert len(told) < 8  # again only where it has become worse


@pytest.mark.slow
@BOTH
def test_a_battery_that_lasts_is_not_spoken_of(autopilot: str) -> None:
    one = in_cruise(autopilot)
    one.vehicle.battery.drain_factor = 5.0
    assert one.run(limit_s=300.0) is FlightState.COMPLETED
    assert not one.said("alarm")
