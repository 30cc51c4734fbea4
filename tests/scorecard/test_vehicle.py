"""Scorecard 16-18 and 20: strangers, values that must not reach the wire, reboots, unsafe parameters."""

from __future__ import annotations

import dataclasses
import itertools
import math
import random
from typing import Any

import pytest

from gcs.flight import FlightState
from link.autopilot.local_frame import EkfOrigin
from link.autopilot.registry import PROFILES
from link.dialect import mavlink
from link.errors import UnsafeSetpoint
from link.microservices.parameter_value import Parameter
from link.preflight.check import Level
from link.preflight.vehicle import judge_parameters
from link.session.request import FlightRequest
from link.setpoints.sampler import SetpointSampler
from link.wire.codec import StationCodec
from tests.scorecard.soak import counted
from tests.support.flights.moments import SETPOINTS, at_moments, in_cruise, soak_moments
from tests.support.flights.virtual import VirtualFlight
from tests.support.plans.planned import relay_plan

BOTH = pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])


# -- 16: wrong system ids and other ground stations -------------------------------------------------------------------


def strangers_message(draw: random.Random) -> Any:
    """Something that would matter if it came from the vehicle."""
    place = (draw.randrange(-(10**9), 10**9), draw.randrange(-(10**9), 10**9), draw.randrange(10**6))
    return draw.choice(
        [
            mavlink.MAVLink_heartbeat_message(2, 3, 209, 6, 4, 3),
            mavlink.MAVLink_heartbeat_message(2, 12, 209, 0x06000000, 4, 3),
            mavlink.MAVLink_global_position_int_message(2**31, *place, 0, 0, 0, 0, 0),
            mavlink.MAVLink_command_ack_message(512, 0, 0, 0, draw.choice([0, 241, 242]), 190),
            mavlink.MAVLink_command_ack_message(32100, 0, 0, 0, draw.choice([0, 241, 242]), 190),
            mavlink.MAVLink_param_value_message(b"GUID_TIMEOUT", 0.0, 9, 1, 0),
            mavlink.MAVLink_gps_global_origin_message(*place, 0),
            mavlink.MAVLink_extended_sys_state_message(0, 1),
            mavlink.MAVLink_timesync_message(1, draw.randrange(2**40)),
            mavlink.MAVLink_position_target_local_ned_message(2**31, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0),
            mavlink.MAVLink_statustext_message(0, b"Crash: Disarming", 0, 0),
            mavlink.MAVLink_control_status_message(1, 99, bytes(10)),
        ]
    )


def state_of(one: VirtualFlight) -> tuple[Any, ...]:
    """What strangers must not be able to move."""
    c, m = one.core.context, one.core.context.vehicle.monitor
    links = tuple((link.heard_s, link.proven_s, link.origin) for link in m.links.values())
    known = (m.heartbeat, m.position, m.target_s, m.landed_state, m.control_main, m.control_s, m.reboots, m.version)
    return (
        *known,
        links,
        c.timeline.state,
        c.vehicle.origin,
        c.control.gate.in_force,
        one.core.parameters,
        len(m.take_texts()),
    )


def acted_on(autopilot: str, count: int, seed: int) -> int:
    """Frames of wrong system ids, or of other components of the vehicle, that changed anything."""
    draw, one = random.Random(seed), in_cruise(autopilot, 5.0)
    acted = 0
    before = state_of(one)
    for _ in range(count):
        own = draw.random() < 0.2
        system = 1 if own else draw.choice([i for i in range(2, 256) if i not in (241, 242)])
        component = draw.choice([2, 100, 154, 190]) if own else draw.choice([1, 190])
        frame = StationCodec(system, component).encode(strangers_message(draw))
        one.core.receive(draw.choice(one.stations), frame, one.now_s)
        after = state_of(one)
        acted += after != before
        before = after
    return acted


@BOTH
def test_what_does_not_come_from_the_vehicles_autopilot_changes_nothing(autopilot: str) -> None:
    assert acted_on(autopilot, 500, 1) == 0


@pytest.mark.soak
@BOTH
def test_ten_thousand_frames_of_strangers_change_nothing(autopilot: str) -> None:
    acted = acted_on(autopilot, 10_000, 2)
    print(f"{autopilot}: {acted} of 10,000 acted on")
    assert acted == 0


def alarmed_after_s(one: VirtualFlight, draw: random.Random) -> float:
    """A second ground station's heartbeat is heard now; how long until the alarm, s."""
    told = len(one.said("alarm"))
    frame = StationCodec(draw.randrange(100, 200), 190).encode(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
    one.core.receive(draw.choice(one.stations), frame, one.now_s)
    heard_s = one.now_s
    one.run(until=lambda: len(one.said("alarm")) > told, limit_s=5.0)
    assert one.said("alarm")[-1].data["what"] == "another ground station is on the link"
    return one.now_s - heard_s


@BOTH
def test_another_ground_station_is_told_within_a_second(autopilot: str) -> None:
    assert max(at_moments(in_cruise(autopilot), 5, 3, alarmed_after_s)) <= 1.0


@pytest.mark.soak
@BOTH
def test_two_hundred_other_ground_stations_are_told_within_a_second(autopilot: str) -> None:
    found = soak_moments(f"{autopilot}: strangers", in_cruise(autopilot), 200, 4, alarmed_after_s)
    longest_s = max(found)
    print(f"{autopilot}: {len(found)} strangers, the alarm at most {longest_s:.3f} s later")
    assert longest_s <= 1.0


# -- 17: what must not reach the wire ---------------------------------------------------------------------------------

WILD = (math.nan, math.inf, -math.inf, 1e300, -1e300, 1e39, 91.0, -91.0, 181.0, -1e6, 1e6, 341.0, -201.0, 0.0, 1.0)
FIELDS = ("lat_deg", "lon_deg", "alt_amsl_m", "yaw_deg", "velocity_ned_m_s", "acceleration_ned_m_s2")


def on_the_wire(autopilot: str, count: int, seed: int) -> tuple[int, int]:
    """Setpoints with one to three fields drawn wild; (messages made, of them with a value no autopilot may get)."""
    draw, profile = random.Random(seed), PROFILES[autopilot]
    base = SetpointSampler(relay_plan(2), 20.0).at(10.0)
    origin = EkfOrigin(base.lat_deg, base.lon_deg, base.alt_amsl_m)
    made = bad = 0
    for _ in range(count):
        changes: dict[str, Any] = {}
        for name in draw.sample(FIELDS, draw.choice((1, 1, 2, 3))):
            value = draw.choice(WILD) if draw.random() < 0.5 else draw.uniform(-400.0, 400.0)
            if name.endswith(("_m_s", "_m_s2")):
                axes = list(getattr(base, name))
                axes[draw.randrange(3)] = value
                changes[name] = tuple(axes)
            else:
                changes[name] = value
        try:
            message = profile.encode(dataclasses.replace(base, **changes), target_system=1, origin=origin)
        except UnsafeSetpoint:
            continue
        made += 1
        speed = max(abs(message.vx), abs(message.vy), abs(message.vz))
        acceleration = max(abs(message.afx), abs(message.afy), abs(message.afz))
        place = (message.x, message.y, message.z) if autopilot == "ardupilot" else (message.alt,)
        fine = speed <= 340.0 and acceleration <= 200.0 and all(abs(p) <= 1e6 for p in place)
        if autopilot == "px4":
            fine = fine and abs(message.lat_int) <= 900_000_000 and abs(message.lon_int) <= 1_800_000_000
        bad += not (fine and abs(message.yaw) <= math.pi + 1e-9 and message.yaw_rate == 0.0)
    return made, bad


@BOTH
def test_nothing_wild_reaches_the_wire(autopilot: str) -> None:
    made, bad = on_the_wire(autopilot, 10_000, 1)
    assert bad == 0
    assert 500 < made < 9_500  # some are only odd, and fly


@pytest.mark.soak
@BOTH
def test_five_million_each_and_nothing_wild_reaches_the_wire(autopilot: str) -> None:
    drawn = made = 0
    for seed in counted(f"{autopilot}: hundreds of thousands of setpoints", range(50), 1):
        more, bad = on_the_wire(autopilot, 100_000, seed)
        assert bad == 0
        drawn, made = drawn + 100_000, made + more
    print(f"{autopilot}: 0 bad of {drawn} drawn, {made} of them sendable")


# -- 18: the autopilot reboots ----------------------------------------------------------------------------------------


def noticed_after_s(one: VirtualFlight, draw: random.Random) -> float:
    """The autopilot restarts now; when the last setpoint is sent, s later."""
    at_s = one.now_s
    one.vehicle.reboot()
    one.run_for(12.0)
    assert one.core.state in (FlightState.LAPSED, FlightState.LOST, FlightState.CONTINGENCY)
    sent = [t for t, _, _, _ in one.sent_messages(*SETPOINTS) if t >= at_s]
    return max(sent, default=at_s) - at_s


@pytest.mark.slow
@BOTH
def test_a_restarted_autopilot_gets_its_last_setpoint_within_two_seconds(autopilot: str) -> None:
    assert max(at_moments(in_cruise(autopilot), 5, 5, noticed_after_s)) <= 2.0


@pytest.mark.soak
@BOTH
def test_a_hundred_restarts(autopilot: str) -> None:
    found = soak_moments(f"{autopilot}: restarts", in_cruise(autopilot), 100, 6, noticed_after_s)
    print(f"{autopilot}: {sum(s <= 2.0 for s in found)} of {len(found)} within 2 s, the slowest {max(found):.2f} s")
    assert max(found) <= 2.0


# -- 20: unsafe failsafe parameters -----------------------------------------------------------------------------------

SAFE: dict[str, dict[str, tuple[tuple[float, ...], tuple[float, ...]]]] = {
    # key: what is safe, what is not, by the autopilots' own documentation (limits at 20 Hz)
    "px4": {
        "offboard_loss_timeout": ((0.3, 1.0, 5.0), (0.0, 0.29, 5.01, 60.0, math.nan)),
        "offboard_loss_action": ((3, 4, 5), (-1, 0, 1, 2, 6, 7)),
        "data_link_loss_action": ((1, 2, 3), (0, 5, 6)),
        "data_link_loss_timeout": ((3, 10, 60), (0, 2, 61, 300)),
        "rc_loss_exceptions": ((4, 7), (0, 3)),
    },
    "ardupilot": {
        "offboard_loss_timeout": ((0.3, 1.0, 3.0), (0.0, 0.29, 3.01, 5.0, math.nan)),
        "gcs_failsafe": ((1, 3, 5), (0, 2, 8)),
        "gcs_failsafe_timeout": ((2, 5, 30), (0, 1, 31, 120)),
    },
}


@BOTH
def test_every_unsafe_combination_of_failsafe_parameters_is_refused_and_every_safe_one_passes(autopilot: str) -> None:
    profile, table = PROFILES[autopilot], SAFE[autopilot]
    plan = relay_plan(2)
    links = {s: f"udpout:127.0.0.1:{20000 + k}" for k, s in enumerate(plan.station_ids)}
    request = FlightRequest(plan=plan.to_document(), autopilot=autopilot, links=links)
    names = {key: profile.parameter(key).names[0] for key in table}
    refused = passed = 0
    for drawn in itertools.product(*([*safe, *unsafe] for safe, unsafe in table.values())):
        chosen = dict(zip(table, drawn, strict=True))
        values: dict[str, Parameter | None] = {
            p.key: Parameter(p.names[0], float(chosen.get(p.key, 1.0)), 9, 0, 1) for p in profile.parameters
        }
        wanted = {names[key] for key, value in chosen.items() if value not in table[key][0]}
        checks = judge_parameters(profile, values, request)
        failures = {c.name for c in checks if c.level is Level.FAILURE} & set(names.values())
        assert failures == wanted, chosen
        refused += bool(wanted)
        passed += not wanted
    assert passed == math.prod(len(safe) for safe, _ in table.values())
    assert refused > 100
