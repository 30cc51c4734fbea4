"""One frame, or one kind of message, decides nothing: a verdict that ends a flight has two witnesses that agree."""

from __future__ import annotations

import pytest

from gcs.flight import FlightState
from link.dialect import mavlink
from link.telemetry.boot_clock import BootClock
from tests.scorecard import fault_outcomes
from tests.support.flights.tampered import TamperedFlight, altered, in_the_air

BOTH = pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])


def own_beat(one: TamperedFlight, *, armed: bool, mode: int | None = None) -> object:
    beat = one.core.context.vehicle.monitor.heartbeat
    assert beat is not None
    flags = beat.base_mode & ~128 | (128 if armed else 0)
    return mavlink.MAVLink_heartbeat_message(
        beat.vehicle_type, beat.autopilot, flags, beat.custom_mode if mode is None else mode, 4, 3
    )


@BOTH
def test_stamps_of_another_clock_in_one_kind_are_no_restart(autopilot: str) -> None:
    one = in_the_air(autopilot)
    boot_ms = round(one.vehicle.time_s * 1e3)
    one.say(mavlink.MAVLink_distance_sensor_message(boot_ms + 600_000, 10, 1000, 500, 0, 0, 25, 0))
    one.run_for(1.0)
    for _ in range(5):
        one.say(mavlink.MAVLink_distance_sensor_message(0, 10, 1000, 500, 0, 0, 25, 0))
        one.run_for(0.1)
    for _ in range(3):
        one.say(mavlink.MAVLink_attitude_message(0, 0, 0, 0, 0, 0, 0))
        one.run_for(0.1)
    assert one.core.context.vehicle.monitor.reboots == 0
    one.run(limit_s=200.0)
    assert one.core.state is FlightState.COMPLETED


@BOTH
def test_a_heartbeat_without_the_armed_bit_ends_nothing(autopilot: str) -> None:
    one = in_the_air(autopilot)
    one.say(own_beat(one, armed=False))
    one.run(limit_s=200.0)
    assert one.core.state is FlightState.COMPLETED
    assert one.states.count("cruise") == 1


@BOTH
def test_a_speed_told_with_a_place_that_never_changes_keeps_no_flight_open(autopilot: str) -> None:
    """The place got stuck in flight, with its speed: down and disarmed the flight ends all the same."""
    one = in_the_air(autopilot)
    stuck = one.core.context.vehicle.monitor.position
    assert stuck is not None
    east_m_s = round(100 * stuck.velocity_ned_m_s[1])
    assert east_m_s > 500
    one.core.command("land")
    one.tamper = altered(
        "GLOBAL_POSITION_INT",
        lat=round(stuck.lat_deg * 1e7),
        lon=round(stuck.lon_deg * 1e7),
        alt=round(stuck.alt_amsl_m * 1e3),
        vy=east_m_s,
    )
    one.run(limit_s=300.0)
    assert one.core.state.ended
    assert not one.vehicle.autopilot.armed


@BOTH
@pytest.mark.parametrize("after", ["landing", "lapsed"])
def test_two_witnesses_of_one_frame_each_end_nothing_in_the_air(autopilot: str, after: str) -> None:
    """Landed told once and the armed bit missing once, of a vehicle that hardly moves, forty metres up."""
    one = in_the_air(autopilot)
    if after == "landing":
        one.core.command("land")
    else:
        one.core.airborne._lose_link("a test", pin=True)
    one.run_for(4.0)
    for _ in range(8):
        for _ in range(3):
            one.say(mavlink.MAVLink_extended_sys_state_message(0, mavlink.MAV_LANDED_STATE_ON_GROUND))
        one.say(own_beat(one, armed=False))
        one.run_for(0.55)
    assert not one.core.state.ended
    assert one.vehicle.autopilot.armed


@BOTH
def test_heartbeats_that_never_show_the_armed_bit_end_nothing_while_it_flies(autopilot: str) -> None:
    one = in_the_air(autopilot)
    one.tamper = altered("HEARTBEAT", base_mode=own_beat(one, armed=False).base_mode)  # type: ignore[attr-defined]
    one.run_for(10.0)
    assert one.core.state is FlightState.CRUISE
    assert one.alarms("HEARTBEAT shows motors off, nothing else does")
    one.tamper = None
    one.run(limit_s=200.0)
    assert one.core.state is FlightState.COMPLETED


@BOTH
def test_a_landing_detected_in_the_air_ends_nothing(autopilot: str) -> None:
    one = in_the_air(autopilot)
    one.tamper = altered("EXTENDED_SYS_STATE", landed_state=1)
    one.run_for(6.0)
    assert one.core.state is FlightState.CRUISE
    one.core.command("hold")
    one.run_for(8.0)
    assert one.core.state is FlightState.HOLDING
    assert one.alarms("the vehicle says that it has landed, nothing else does")
    one.core.command("resume")
    one.tamper = None
    one.run(limit_s=200.0)
    assert one.core.state is FlightState.COMPLETED


@BOTH
def test_one_heartbeat_of_another_mode_is_no_lapse(autopilot: str) -> None:
    one = in_the_air(autopilot)
    profile = one.core.context.vehicle.profile
    one.say(own_beat(one, armed=True, mode=profile.modes[profile.return_mode]), links=one.links[:1])
    one.run(limit_s=200.0)
    assert one.core.state is FlightState.COMPLETED
    assert "lapsed" not in one.states


@BOTH
def test_a_motor_that_stops_and_a_vehicle_that_falls_is_an_end(autopilot: str) -> None:
    one = in_the_air(autopilot)
    one.vehicle.rotors_stopped = True
    began_s = one.now_s
    one.run_for(1.5)
    assert one.first_alarm_s("descends and was not told to", began_s) - began_s <= 1.05


def test_a_restart_needs_two_witnesses_and_nobody_who_contradicts() -> None:
    clock = BootClock()
    for k in range(50):
        clock.heard(0.1 * k)
        clock.stamp(0.1 * k, "A", 100.0 + 0.1 * k)
        clock.stamp(0.1 * k, "B", 100.0 + 0.1 * k)
    # A alone goes back for ever; B goes on.
    for k in range(50, 100):
        clock.heard(0.1 * k)
        clock.stamp(0.1 * k, "A", 0.1 * k - 5.0)
        clock.stamp(0.1 * k, "B", 100.0 + 0.1 * k)
    assert clock.reboots == 0
    # Both: one restart, a second after the last of the old clock.
    for k in range(100, 125):
        clock.heard(0.1 * k)
        clock.stamp(0.1 * k, "A", 0.1 * k - 5.0)
        clock.stamp(0.1 * k, "B", 0.1 * k - 5.0)
    assert clock.reboots == 1


@pytest.mark.parametrize("witness", ["silence", "booting", "stopped streams"])
def test_one_clock_that_goes_back_beside_another_witness_is_a_restart(witness: str) -> None:
    clock = BootClock()
    for k in range(50):
        clock.heard(0.1 * k)
        for kind in ("A", "B", "TIMESYNC"):
            clock.stamp(0.1 * k, kind, 100.0 + 0.1 * k)
    start_s = 7.0 if witness == "silence" else 5.0
    for k in range(40):
        now_s = start_s + 0.1 * k
        clock.heard(now_s, booting=witness == "booting" and k == 3)
        clock.stamp(now_s, "TIMESYNC", 0.1 * k)
    assert clock.reboots == 1


def test_a_clock_set_forward_is_followed_and_no_restart() -> None:
    clock = BootClock()
    for k in range(100):
        now_s = 0.1 * k
        clock.heard(now_s)
        ahead_s = 3600.0 if k >= 50 else 0.0
        fresh = [clock.stamp(now_s, kind, 100.0 + now_s + ahead_s) for kind in ("A", "B")]
    assert clock.reboots == 0
    assert all(fresh)


@pytest.mark.parametrize(("followers", "follows"), [(2, False), (3, True)])
def test_a_clock_is_followed_where_the_majority_goes_and_one_kind_stays_behind(followers: int, follows: bool) -> None:
    """TIMESYNC answers by a clock of its own that does not jump: three streams that do outvote it, two do not."""
    clock = BootClock()
    kinds = [f"stream {n}" for n in range(followers)]
    fresh: list[bool] = []
    for k in range(100):
        now_s = 0.1 * k
        clock.heard(now_s)
        clock.stamp(now_s, "TIMESYNC", 100.0 + now_s)
        fresh = [clock.stamp(now_s, kind, 100.0 + now_s + (3600.0 if k >= 50 else 0.0)) for kind in kinds]
    assert clock.reboots == 0
    assert all(fresh) is follows


@BOTH
@pytest.mark.parametrize("fault", ["clock-jump", "clock-rate"])
def test_a_vehicle_whose_clock_jumps_or_runs_slowly_completes_its_flight(autopilot: str, fault: str) -> None:
    (row,) = [row for row in fault_outcomes.ROWS if row.name == fault]
    assert fault_outcomes.judge(row, autopilot, fault_outcomes.fly(row, autopilot)) == []
