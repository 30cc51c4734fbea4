"""Identity is the autopilot's own, not a number two vehicles may share; one vehicle is flown by one program."""

from __future__ import annotations

import os
import random
from typing import Any

import pytest

from gcs.flight import FlightState
from link.dialect import mavlink
from link.transport.port_lock import VehicleLock
from link.wire.codec import StationCodec
from tests.scorecard.soak import counted
from tests.support.flights import tampered
from tests.support.flights.shared_sky import SharedSky
from tests.support.flights.virtual import Proxy
from tests.support.plans.planned import relay_plan

AUTOPILOTS = ("ardupilot", "px4")
TWO = "two vehicles speak under one system id"


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
@pytest.mark.parametrize("east_m", [0.5, 3.0, 90.0])
@pytest.mark.parametrize("uid", ["", "none"])
def test_two_boards_with_one_id_are_refused_on_the_ground(autopilot: str, east_m: float, uid: str) -> None:
    """However near they stand; without unique ids by their clocks."""
    sky = SharedSky(relay_plan(2), autopilot)
    sky.vehicle(uid=uid)
    sky.vehicle(uid=uid, on_s=2.3, east_m=east_m)
    one = sky.program(start_s=4.0)
    sky.run()
    assert one.state is FlightState.REFUSED
    assert "two autopilots speak as system 1" in one.reasons
    assert not any(sky.armed_by)


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_two_boards_on_different_links_are_refused_on_the_ground(autopilot: str) -> None:
    """Each alone on its link: every link is asked."""
    sky = SharedSky(relay_plan(2), autopilot)
    sky.vehicle(links=[0])
    sky.vehicle(links=[1], east_m=2.0)
    one = sky.program(start_s=3.0)
    sky.run()
    assert one.state is FlightState.REFUSED
    assert "two autopilots speak" in one.reasons
    assert not any(sky.armed_by)


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
@pytest.mark.parametrize("uid", ["", "none"])
def test_a_second_board_switched_on_before_the_launch_ends_the_waiting(autopilot: str, uid: str) -> None:
    sky = SharedSky(relay_plan(2), autopilot)
    sky.vehicle(uid=uid)
    sky.vehicle(uid=uid, on_s=40.0, east_m=3.0)
    one = sky.program(auto_launch=False)
    sky.run(lambda: sky.now_s > 80.0)
    assert one.state is FlightState.REFUSED
    assert "two autopilots speak" in one.reasons


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
@pytest.mark.parametrize("uid", ["", "none"])
@pytest.mark.parametrize("links", [None, [1]])
def test_a_second_board_switched_on_in_flight_is_alarmed(autopilot: str, uid: str, links: list[int] | None) -> None:
    sky = SharedSky(relay_plan(2), autopilot)
    sky.vehicle(uid=uid)
    one = sky.program()
    sky.run(lambda: one.state is FlightState.CRUISE)
    on_s = sky.now_s + 1.0
    # Its HEARTBEATs say other things of their own; here all else that it sends must tell.
    sky.vehicle(uid=uid, on_s=on_s, east_m=3.0, links=links, ready_after_s=1e3, faults=("heartbeat-loss@0+1000",))
    sky.run(lambda: bool(one.said("alarm", what=TWO)), limit_s=30.0)
    (alarm,) = one.said("alarm", what=TWO)
    assert alarm.time_s - on_s < 12.0


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
@pytest.mark.parametrize("seed", range(3))
def test_one_board_over_bad_links_is_never_two(autopilot: str, seed: int) -> None:
    proxy = Proxy(seed=seed, loss=0.25, latency_s=0.05, jitter_s=0.25, duplicates=0.3)
    sky = SharedSky(relay_plan(2), autopilot, proxy)
    sky.vehicle(uid="none" if seed % 2 else "")
    one = sky.program()
    sky.run()
    assert one.state is FlightState.COMPLETED, one.reasons
    assert not one.said("alarm", what=TWO)


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_a_board_that_restarts_is_not_two(autopilot: str) -> None:
    sky = SharedSky(relay_plan(2), autopilot)
    vehicle = sky.vehicle(uid="none")
    one = sky.program(auto_launch=False)
    sky.run(lambda: one.state is FlightState.READY)
    vehicle.reboot()
    sky.run(lambda: sky.now_s > 60.0)
    assert not one.said("alarm", what=TWO)


# -- one vehicle, two programs -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_a_vehicle_in_flight_is_refused_to_another_program_of_the_machine(autopilot: str) -> None:
    """Other URLs, other ports: the vehicle's own identity decides. And nothing of the first flight is touched."""
    sky = SharedSky(relay_plan(2), autopilot)
    sky.vehicle()
    locks = [VehicleLock(f"test {os.getpid()}") for _ in range(2)]
    first = sky.program(claim=locks[0].claim)
    second = sky.program(claim=locks[1].claim, start_s=25.0)
    sky.run()
    assert first.state is FlightState.COMPLETED, first.reasons
    assert second.state is FlightState.REFUSED
    assert "is on another flight of this machine" in second.reasons
    assert not second.said("parameter")
    for lock in locks:
        lock.release()


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_state_is_looked_at_again_at_launch(autopilot: str) -> None:
    """Two programs that cannot see each other's locks, as on two machines: armed meanwhile, the second stays down."""
    sky = SharedSky(relay_plan(2), autopilot)
    sky.vehicle()
    first = sky.program(auto_launch=False, handover_way="gate")
    second = sky.program(auto_launch=False, handover_way="gate")
    sky.run(lambda: first.state is FlightState.READY and second.state is FlightState.READY, limit_s=60.0)
    assert first.core is not None
    first.core.command("launch")
    sky.run(lambda: first.state is FlightState.CRUISE, limit_s=120.0)
    sky.run(lambda: second.over, limit_s=10.0)
    assert second.state is FlightState.REFUSED, second.reasons
    assert sky.armed_by[0] == {0}


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
@pytest.mark.parametrize("told", ["armed", "in the air", "another station in control"])
def test_what_speaks_against_a_launch_for_a_moment_never_launches(autopilot: str, told: str) -> None:
    """It woke the waiting for the command, was over by the second look, and the flight went off without a command."""
    one = tampered.ready(autopilot)
    flags = mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    kind = mavlink.MAV_TYPE_QUADROTOR
    words = {
        "armed": mavlink.MAVLink_heartbeat_message(kind, one.core.context.vehicle.profile.autopilot_id, flags, 0, 3, 3),
        "in the air": mavlink.MAVLink_extended_sys_state_message(0, mavlink.MAV_LANDED_STATE_IN_AIR),
        "another station in control": mavlink.MAVLink_control_status_message(0, 201, [0] * 10),
    }
    one.say(words[told])
    one.run_for(40.0)
    assert not one.said("state", to="arming")
    assert not one.vehicle.autopilot.armed
    if one.core.state is not FlightState.REFUSED:
        # Over by the second look: the preflight was made again, and the flight waits as before.
        assert one.alarms("the preflight is void")
        assert one.core.state is FlightState.READY


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_a_mode_that_somebody_else_set_is_refused_at_launch(autopilot: str) -> None:
    sky = SharedSky(relay_plan(2), autopilot)
    vehicle = sky.vehicle()
    one = sky.program(auto_launch=False)
    sky.run(lambda: one.state is FlightState.READY)
    _force(vehicle, "return")
    before = sky.now_s
    sky.run(lambda: sky.now_s > before + 3.0)
    assert one.core is not None
    one.core.command("launch")
    sky.run(limit_s=30.0)
    assert one.state is FlightState.REFUSED
    assert "somebody else commands it" in one.reasons
    assert not sky.armed_by[0]


def _force(vehicle: Any, mode: str) -> None:
    from types import SimpleNamespace

    from sitl_fixtures.faults import actions

    actions.force_mode(mode)(SimpleNamespace(vehicle=vehicle, memory={}, value=0.0, text=""))  # type: ignore[arg-type]


def test_whom_the_vehicle_hears_changed_by_another_station_is_refused_at_launch() -> None:
    sky = SharedSky(relay_plan(2), "ardupilot")
    vehicle = sky.vehicle()
    one = sky.program(auto_launch=False)
    sky.run(lambda: one.state is FlightState.READY)
    vehicle.parameters.put("MAV_GCS_SYSID_HI", 250)
    assert one.core is not None
    one.core.command("launch")
    sky.run(limit_s=60.0)
    assert one.state is FlightState.REFUSED
    assert "another station changed whom the vehicle hears" in one.reasons


# -- frames under our ids ----------------------------------------------------------------------------------------------


def _beat(system_id: int, component_id: int = 190) -> bytes:
    message = mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, 8, 0, 0, 4, 3)
    codec = StationCodec(system_id, component_id)
    # Several: one alone may be, byte for byte, one of ours.
    return b"".join(codec.encode(message) for _ in range(5))


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
@pytest.mark.parametrize("which", [0, 1])
@pytest.mark.parametrize("link", [0, 1])
def test_frames_under_our_ids_that_we_did_not_send_are_alarmed(autopilot: str, which: int, link: int) -> None:
    sky = SharedSky(relay_plan(2), autopilot)
    sky.vehicle()
    one = sky.program()
    sky.run(lambda: one.state is FlightState.CRUISE)
    own = list(one.request.system_ids.values())[which]
    sky.inject(link, _beat(own))
    sky.run(lambda: bool(one.said("alarm")), limit_s=2.0)
    assert one.said("alarm", what="somebody else speaks under our system id", system_id=own)


def test_frames_of_ours_that_come_back_are_not_alarmed() -> None:
    """A vehicle forwards what it hears to its other links."""
    sky = SharedSky(relay_plan(2), "px4")
    sky.vehicle()
    one = sky.program()
    up = sky._up

    def up_and_back(number: int, station: str, data: bytes) -> None:
        up(number, station, data)
        for link in range(len(sky.links)):
            sky.inject(link, data)

    sky._up = up_and_back  # type: ignore[method-assign]
    sky.run()
    assert one.state is FlightState.COMPLETED
    assert not one.said("alarm")


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_another_program_under_our_ids_before_arming_is_refused(autopilot: str) -> None:
    sky = SharedSky(relay_plan(2), autopilot)
    sky.vehicle()
    one = sky.program(auto_launch=False)
    sky.run(lambda: one.state is FlightState.READY)
    sky.inject(0, _beat(one.request.system_ids["s1"]))
    sky.run(limit_s=20.0)
    assert one.state is FlightState.REFUSED
    assert "another program speaks as our own system" in one.reasons


def test_an_answer_to_a_command_we_never_sent_is_alarmed() -> None:
    sky = SharedSky(relay_plan(2), "px4")
    vehicle = sky.vehicle()
    one = sky.program()
    sky.run(lambda: one.state is FlightState.CRUISE)
    own = one.request.system_ids["s1"]
    from pymavlink.dialects.v20 import ardupilotmega as stock

    vehicle.send(stock.MAVLink_command_ack_message(183, 0, 0, 0, own, 190))
    sky.run(lambda: bool(one.said("alarm")), limit_s=2.0)
    assert one.said("alarm", what="the vehicle answers a command we never sent", command=183)


# -- never two that fly one -------------------------------------------------------------------------------------------


def two_programs(seed: int) -> None:
    """Two programs of one machine for one vehicle: at most one arms it, and it obeys one alone."""
    draw = random.Random(seed)
    autopilot = draw.choice(AUTOPILOTS)
    lossy = Proxy(seed=seed, loss=0.1, latency_s=0.05, jitter_s=0.05, duplicates=0.1)
    sky = SharedSky(relay_plan(2), autopilot, draw.choice([Proxy(), lossy]))
    sky.vehicle(uid=draw.choice(["", "none"]))
    locks = [VehicleLock(f"test {os.getpid()}") for _ in range(2)]
    starts = [0.0, draw.choice([0.0, draw.uniform(0.0, 1.0), draw.uniform(0.0, 40.0)])]
    ways = [{"handover_way": draw.choice(["auto", "gate"])} for _ in range(2)]
    programs = [sky.program(start_s=starts[k], claim=locks[k].claim, **ways[k]) for k in range(2)]

    def settled() -> bool:
        flying = [p for p in programs if p.state is FlightState.CRUISE]
        return sky.now_s > max(starts) + 15.0 and len(flying) + sum(p.over for p in programs) == 2

    sky.run(settled, limit_s=400.0)
    for lock in locks:
        lock.release()
    fliers = [k for k, p in enumerate(programs) if p.said("state", to="arming")]
    assert len(fliers) == 1, (seed, [p.reasons for p in programs])
    assert sky.armed_by[0] == set(fliers), seed
    assert {number for _, number in sky.obeyed[0]} <= set(fliers), seed
    other = programs[1 - fliers[0]]
    assert other.state is FlightState.REFUSED, (seed, other.reasons)


@pytest.mark.parametrize("seed", range(12))
def test_never_two_that_fly_one(seed: int) -> None:
    two_programs(seed)


@pytest.mark.soak
def test_two_hundred_tries_and_never_two_that_fly_one() -> None:
    for seed in counted("two programs, one vehicle", range(200), 1):
        two_programs(seed)
