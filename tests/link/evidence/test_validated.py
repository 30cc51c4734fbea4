"""What the vehicle says of places is validated where it enters: unknown, never an exception, never believed at once."""

from __future__ import annotations

import pytest

from gcs.flight import FlightState, OperatorCommand, TransitionError
from link.dialect import mavlink
from link.monitors.evidence import UNKNOWN
from tests.support.flights.tampered import TamperedFlight, altered, in_the_air, ready, without
from tests.support.plans.planned import relay_plan

BOTH = pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
INT32_MAX = 2**31 - 1


ABSURD = {
    "0/0": {"lat": 0, "lon": 0},
    "INT32_MAX": {"lat": INT32_MAX, "lon": INT32_MAX, "alt": INT32_MAX},
    "far away": {"lat": -353632620, "lon": 1491652370},
    "altitude": {"alt": 90_000_000},
    "speed": {"vx": 32767, "vy": 32767},
}


@BOTH
@pytest.mark.parametrize("fields", ABSURD.values(), ids=ABSURD.keys())
def test_one_absurd_position_in_cruise_changes_nothing(autopilot: str, fields: dict[str, int]) -> None:
    one = in_the_air(autopilot)
    position = one.core.context.vehicle.monitor.position
    assert position is not None
    now = {"lat": round(position.lat_deg * 1e7), "lon": round(position.lon_deg * 1e7), "alt": 45_000, **fields}
    boot_ms = round(position.boot_s * 1e3) + 40
    velocity = (now.get("vx", 0), now.get("vy", 0), 0)
    one.say(mavlink.MAVLink_global_position_int_message(boot_ms, now["lat"], now["lon"], now["alt"], 0, *velocity, 0))
    assert one.core.context.vehicle.monitor.position == position
    one.run(limit_s=200.0)
    assert one.core.state is FlightState.COMPLETED
    assert one.core.containment.faults == 0


@BOTH
@pytest.mark.parametrize("fields", [ABSURD["0/0"], ABSURD["INT32_MAX"]], ids=["0/0", "INT32_MAX"])
def test_absurd_positions_for_long_are_an_unknown_position_told_within_two_seconds(
    autopilot: str, fields: dict[str, int]
) -> None:
    one = in_the_air(autopilot)
    began_s, one.tamper = one.now_s, altered("GLOBAL_POSITION_INT", **fields)
    one.run_for(7.0)
    assert one.first_alarm_s(UNKNOWN, began_s) - began_s <= 2.0
    assert one.core.state is FlightState.HOLDING
    assert one.core.announcer.where()["speed_m_s"] is None
    one.tamper = None
    one.run(limit_s=200.0)
    assert one.core.state is FlightState.COMPLETED


@BOTH
@pytest.mark.parametrize("place", [(0, 0, 0), (INT32_MAX, 0, 0), (-353632620, 1491652370, 0)])
def test_an_absurd_origin_or_home_is_refused_and_told(autopilot: str, place: tuple[int, int, int]) -> None:
    one = in_the_air(autopilot)
    before = one.core.context.vehicle.origin
    one.say(mavlink.MAVLink_gps_global_origin_message(*place, 0))
    one.say(mavlink.MAVLink_home_position_message(*place, 0, 0, 0, [0.0] * 4, 0, 0, 0, 0))
    one.run_for(1.0)
    assert one.alarms("an absurd EKF origin is refused")
    assert one.alarms("an absurd home is refused")
    assert one.core.context.vehicle.origin == before
    one.run(limit_s=200.0)
    assert one.core.state is FlightState.COMPLETED


@BOTH
def test_an_origin_told_once_in_flight_moves_no_setpoint(autopilot: str) -> None:
    one = in_the_air(autopilot)
    before = one.core.context.vehicle.origin
    one.say(mavlink.MAVLink_gps_global_origin_message(529_600_000, 47_900_000, 0, 0))
    one.run_for(3.0)
    assert one.core.context.vehicle.origin == before
    one.run(limit_s=200.0)
    assert one.core.state is FlightState.COMPLETED
    assert one.behind_m().max() < 6.0


@BOTH
def test_a_vehicle_far_from_the_plan_on_the_ground_is_refused_with_where_it_is(autopilot: str) -> None:
    config = {"home": (35.0, 149.0, 500.0)}
    request = {"arm_timeout_s": 5.0}
    one = TamperedFlight(relay_plan(2), autopilot, frugal=True, config=config, request=request)
    one.run(limit_s=200.0)
    assert one.core.state is FlightState.REFUSED
    assert "km from the plan" in str(one.said("state", to="refused")[0].data["reason"])


@BOTH
def test_nothing_is_launched_on_a_position_that_is_old(autopilot: str) -> None:
    one = ready(autopilot)
    one.tamper = without("GLOBAL_POSITION_INT")
    one.run_for(3.0)
    with pytest.raises(TransitionError, match="position is not known"):
        one.core.command(OperatorCommand.LAUNCH)
    assert one.alarms(UNKNOWN)
    one.tamper = None
    one.run_for(2.0)
    one.core.command(OperatorCommand.LAUNCH)
    one.run(limit_s=200.0)
    assert one.core.state is FlightState.COMPLETED


@BOTH
def test_a_position_lost_while_arming_arms_nothing(autopilot: str) -> None:
    one = ready(autopilot)
    one.tamper = without("GLOBAL_POSITION_INT")
    one.run_for(0.9)
    one.core.command(OperatorCommand.LAUNCH)
    one.run(limit_s=60.0)
    assert one.core.state is FlightState.REFUSED
    assert not one.vehicle.autopilot.armed


@BOTH
def test_no_transit_begins_from_a_place_that_is_not_known(autopilot: str) -> None:
    """A position lost in the climb: no exception, and no setpoint from where it was."""
    one = ready(autopilot)
    one.core.command(OperatorCommand.LAUNCH)
    one.run(until=lambda: one.core.state is FlightState.TAKEOFF, limit_s=60.0)
    one.run_for(1.0)
    one.tamper = without("GLOBAL_POSITION_INT")
    one.run_for(3.0)
    assert one.alarms(UNKNOWN)
    one.run(limit_s=200.0, until=lambda: one.core.state not in (FlightState.TAKEOFF,))
    assert one.core.state in (FlightState.LAPSED, FlightState.LANDING)
    assert one.core.containment.faults == 0
