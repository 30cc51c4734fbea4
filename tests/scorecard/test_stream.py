"""Scorecard 3-8 and 19: what becomes of the stream when processes hang, die or restart, or the wall clock jumps.

In virtual time a hung or killed process is a core that is no longer stepped. Large counts are under ``-m soak``.
"""

from __future__ import annotations

import itertools
import json
import math
import os
import random
import signal
import socket
import time
from pathlib import Path

import pytest

from gcs.flight import FlightState
from link.director.core import FlightCore
from link.streamer.supervisor import start_flight
from link.transport.gate import Sender
from link.wire.codec import StationCodec
from link.wire.signing import Signing, SigningKey
from link.wire.signing_timestamps import SigningStore
from tests.scorecard.soak import counted
from tests.support.flights.moments import SETPOINTS, at_moments, in_cruise, soak_moments
from tests.support.flights.processes import Events, simulator
from tests.support.flights.virtual import EPOCH_UNIX_S, Proxy, VirtualFlight
from tests.support.plans.planned import relay_plan

AUTOPILOTS = ("px4", "ardupilot")
BOTH = pytest.mark.parametrize("autopilot", AUTOPILOTS)
LOSS_TIMEOUT_S = {"px4": 1.0, "ardupilot": 3.0}


def sent_after(one: VirtualFlight, time_s: float) -> list[float]:
    """When setpoints were sent after a time."""
    return [t for t, _, _, _ in one.sent_messages(*SETPOINTS) if t > time_s]


# -- 3: setpoints older than one tick ---------------------------------------------------------------------------------


def told_off_plan_m(one: VirtualFlight, frames: list[tuple[float, str, str | None, bytes]]) -> float:
    """How far the first setpoint of these frames lies from the plan's place of the moment it was sent, m."""
    context, decoder = one.core.context, StationCodec(99)
    sent_s, message = next((t, m) for t, _, _, f in frames for m in decoder.decode(f) if m.get_type() in SETPOINTS)
    if message.get_type() == SETPOINTS[0]:
        lat_deg, lon_deg = 1e-7 * message.lat_int, 1e-7 * message.lon_int
    else:
        assert context.vehicle.origin is not None
        lat_deg, lon_deg = context.vehicle.profile.lat_lon_deg(context.vehicle.origin, message.x, message.y)
    assert context.timeline.launched_s is not None
    return math.dist(
        one.plan.plane.to_plane(lat_deg, lon_deg),
        one.plan.trajectory.evaluate(sent_s - context.timeline.launched_s)[:2],
    )


def stalled(autopilot: str, stalls: int, seed: int) -> tuple[float, float]:
    """A flight whose process stalls so often; the most that a setpoint after a stall was behind the flight's clock, s,
    and that the place it told was off the plan's place of that very moment, m."""
    draw, one = random.Random(seed), in_cruise(autopilot)
    period_s = 1.0 / one.request.rate_hz
    oldest_s = furthest_m = 0.0
    for _ in range(stalls):
        one.run_for(draw.uniform(0.05, 0.5))
        assert one.core.state is FlightState.CRUISE
        one.frozen = True
        one.run_for(draw.uniform(0.0, 0.45))
        one.frozen = False
        before, frames = one.core.context.control.setpoints_sent, len(one.sent)
        one.run(until=lambda before=before: one.core.context.control.setpoints_sent > before, limit_s=1.0)  # type: ignore[misc]
        # The place sent is that of the newest tick due: behind the clock since T+0 by less than a tick.
        shift_s = one.core.announcer.shift_s
        assert shift_s is not None
        oldest_s = max(oldest_s, shift_s)
        furthest_m = max(furthest_m, told_off_plan_m(one, one.sent[frames:]))
    assert oldest_s < period_s + 1e-6
    # At most 15 m/s, and what a float32 and 1e-7 degrees leave.
    assert furthest_m < 15.0 * period_s + 0.05
    return oldest_s, furthest_m


@BOTH
def test_after_a_stall_the_setpoint_is_that_of_now(autopilot: str) -> None:
    stalled(autopilot, 20, 1)


@pytest.mark.soak
@BOTH
def test_after_two_thousand_stalls_no_setpoint_was_old(autopilot: str) -> None:
    found = [stalled(autopilot, 40, seed) for seed in counted(f"{autopilot}: flights of 40 stalls", range(50), 10)]
    oldest_s, furthest_m = (max(one) for one in zip(*found, strict=True))
    print(
        f"{autopilot}: {40 * len(found)} stalls, the setpoint after them at most {1e3 * oldest_s:.1f} ms old and"
        f" {furthest_m:.2f} m from the plan's place of then, at a tick of 50 ms"
    )


# -- 4: an owner hung or dead -----------------------------------------------------------------------------------------


def hung(one: VirtualFlight, draw: random.Random) -> float:
    """The streamer hangs now; how long after that the last setpoint is obeyed, s."""
    at_s = one.now_s
    one.frozen = True
    one.run_for(2.0)
    return max([a.time_s for a in one.accepted if a.time_s > at_s], default=at_s) - at_s


def unattended(one: VirtualFlight, draw: random.Random) -> float:
    """Its service dies now, authorised for some seconds more; how long after that time it still moves along, s."""
    until_s = one.plan_s + draw.uniform(8.0, 12.0)
    one.core.command("authorise", until_s=until_s)
    one.core.parent_gone()
    end_s = one.now_s + 40.0
    while one.now_s < end_s and one.core.state is FlightState.CRUISE:
        one.run_for(0.05)
        # Backwards from a limit that came too near is allowed, on beyond it is not.
        assert one.plan_s <= max(until_s, 0.0) + 1e-6
    standing_s = one.now_s
    if one.core.state is FlightState.ARRIVED:
        return 0.0
    assert one.core.state is FlightState.HOLDING
    assert one.plan_s <= until_s
    # On time: it stands no later than the plan says it may be there, and the time its braking takes.
    assert one.core.context.timeline.launched_s is not None
    return standing_s - one.core.context.timeline.launched_s - until_s


@pytest.mark.slow
@BOTH
def test_a_hung_streamer_sends_nothing_more(autopilot: str) -> None:
    assert max(at_moments(in_cruise(autopilot), 10, 3, hung)) <= 0.5


@BOTH
def test_an_unattended_flight_goes_as_far_as_authorised_and_holds(autopilot: str) -> None:
    assert len(at_moments(in_cruise(autopilot, hold_limit_s=300.0), 2, 4, unattended)) == 2


@pytest.mark.soak
@BOTH
def test_five_hundred_hung_owners_each(autopilot: str) -> None:
    longest = soak_moments(f"{autopilot}: hung", in_cruise(autopilot), 500, 5, hung)
    print(f"{autopilot}: {len(longest)} hung, the last setpoint at most {1e3 * max(longest):.0f} ms after the hang")
    assert max(longest) <= 0.5


@pytest.mark.soak
@BOTH
def test_five_hundred_unattended_flights_each(autopilot: str) -> None:
    one = in_cruise(autopilot, hold_limit_s=300.0)
    overs = soak_moments(f"{autopilot}: unattended", one, 500, 6, unattended)
    print(f"{autopilot}: {len(overs)} unattended flights held at what they were authorised to")


# -- 5: heartbeats of an unhealthy streamer ---------------------------------------------------------------------------


def heartbeats_after(one: VirtualFlight, draw: random.Random) -> int:
    """The streamer hangs, or fails inside a tick; heartbeats that reach the vehicle from two seconds on."""
    at_s = one.now_s
    if draw.random() < 0.5:
        one.frozen = True
    else:

        def fail(*_: object) -> None:
            raise ZeroDivisionError("drawn")

        place = draw.choice(["tick", "send", "heartbeats"])
        if place == "tick":
            one.core.airborne.tick = fail  # type: ignore[method-assign]
        elif place == "send":
            one.core.context.control.gate.send = fail  # type: ignore[method-assign, assignment]
        else:
            one.core.links.heartbeats = fail  # type: ignore[method-assign]
        with pytest.raises(ZeroDivisionError):
            one.run_for(2.0)
        # The process ends with the exception: nothing it had in hand goes out.
        one.frozen = True
    one.run_for(6.0)
    return len([t for t, _, _, _ in one.sent_messages("HEARTBEAT") if t > at_s + 2.0])


@BOTH
def test_an_unhealthy_streamer_beats_no_more(autopilot: str) -> None:
    assert sum(at_moments(in_cruise(autopilot), 8, 7, heartbeats_after)) == 0


@pytest.mark.soak
@BOTH
def test_two_hundred_unhealthy_streamers_beat_no_more(autopilot: str) -> None:
    found = soak_moments(f"{autopilot}: unhealthy", in_cruise(autopilot), 200, 8, heartbeats_after)
    print(f"{autopilot}: {sum(found)} heartbeats after 2 s in {len(found)} faults")
    assert sum(found) == 0


# -- 6: its clients are killed -----------------------------------------------------------------------------------------


def kill_clients(run_dir: Path, count: int, draw: random.Random) -> None:
    """Processes that attach to a flight, and are killed in the middle of whatever they do."""
    for _ in range(count):
        child = os.fork()
        if child == 0:
            try:
                client = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
                client.connect(str(run_dir / "control.sock"))
                client.sendall(b'{"attach": 0}\n')
                for number in itertools.count():
                    client.sendall(json.dumps({"id": number, "status": True}).encode() + b"\n")
                    if draw.random() < 0.5:
                        client.recv(1 << 16)
                    time.sleep(0.002)
            finally:
                os._exit(0)
        time.sleep(draw.uniform(0.02, 0.12))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)


@pytest.mark.soak
def test_two_hundred_killed_clients_cost_no_tick(tmp_path: Path) -> None:
    """Real processes, real time; the flight's own count of missed ticks, before and after."""
    plan = relay_plan(3)
    with simulator(plan, "px4", 1.0) as vehicle:
        events = Events()
        flight = start_flight(vehicle.request(plan, "px4", 1.0, climb_m_s=5.0), on_event=events, run_dir=tmp_path / "r")
        try:
            events.in_cruise(1.0, 120.0)
            before = flight.status()["lateness"]["skipped_ticks"]
            kill_clients(tmp_path / "r", 200, random.Random(9))
            status = flight.status()
            assert status["state"] == "cruise"
            missed = status["lateness"]["skipped_ticks"] - before
        finally:
            flight.kill()
    print(f"200 kills, {missed} ticks missed")
    assert missed == 0


# -- 7: the streamer is killed ----------------------------------------------------------------------------------------

FAILSAFE = {"px4": "HOLD", "ardupilot": "RTL"}
"""COM_OBL_RC_ACT 5 within a second; FS_GCS_ENABLE 1 five seconds after the last heartbeat."""


def killed(one: VirtualFlight, draw: random.Random) -> str:
    """The streamer dies now; the mode the vehicle is in six seconds later, by its own heartbeat."""
    one.frozen = True
    one.run_for(6.0)
    return str(one.vehicle.autopilot.mode_name)


@pytest.mark.slow
@BOTH
def test_a_killed_streamer_is_followed_by_the_failsafe_that_was_set(autopilot: str) -> None:
    assert set(at_moments(in_cruise(autopilot), 8, 10, killed)) == {FAILSAFE[autopilot]}


@pytest.mark.soak
@BOTH
def test_a_hundred_killed_streamers(autopilot: str) -> None:
    modes = soak_moments(f"{autopilot}: killed", in_cruise(autopilot), 100, 11, killed)
    print(f"{autopilot}: {modes.count(FAILSAFE[autopilot])} of {len(modes)} in {FAILSAFE[autopilot]}")
    assert set(modes) == {FAILSAFE[autopilot]}


# -- 8: automatic re-entry --------------------------------------------------------------------------------------------


def taken_up_again(one: VirtualFlight, draw: random.Random) -> int:
    """After a failsafe (a stall past the autopilot's patience) or a restart of the streamer: setpoints sent unasked."""
    if draw.random() < 0.5:
        one.frozen = True
        one.run_for(LOSS_TIMEOUT_S[one.request.autopilot] + draw.uniform(0.05, 6.0))
        one.frozen = False
        woken_s = one.now_s
        one.run_for(0.3)
        assert one.core.state in (FlightState.LAPSED, FlightState.CONTINGENCY, FlightState.LOST)
        one.run_for(30.0)
        return len(sent_after(one, woken_s + 1e-9))
    one.frozen = True
    one.run_for(draw.uniform(0.1, 20.0))
    restarted_s = one.now_s
    one.core = FlightCore(one.request, now_s=one.now_s, epoch_unix_s=EPOCH_UNIX_S)
    one._core_s, one.frozen = one.now_s, False
    one.run(limit_s=60.0)
    assert one.core.state is FlightState.REFUSED
    one.run_for(10.0)
    return len(sent_after(one, restarted_s))


@pytest.mark.slow
@BOTH
def test_nothing_is_taken_up_again_unasked(autopilot: str) -> None:
    assert sum(at_moments(in_cruise(autopilot, hold_limit_s=300.0), 4, 12, taken_up_again)) == 0


@pytest.mark.soak
@BOTH
def test_two_hundred_and_fifty_lapses_and_restarts_each_without_re_entry(autopilot: str) -> None:
    one = in_cruise(autopilot, hold_limit_s=300.0)
    found = soak_moments(f"{autopilot}: lapsed or restarted", one, 250, 13, taken_up_again)
    print(f"{autopilot}: {sum(n > 0 for n in found)} re-entries in {len(found)}")
    assert sum(found) == 0


# -- 19: the wall clock jumps -----------------------------------------------------------------------------------------


def handovers_under_jumps(
    autopilot: str, jumps: random.Random | None, monkeypatch: pytest.MonkeyPatch
) -> list[tuple[float, str]]:
    """(flight's clock, event) of the handovers of a signed flight while the wall clock jumps by up to a day, ten times
    a second."""
    wall = [1_795_338_000.0]
    monkeypatch.setattr(time, "time", lambda: wall[0])
    monkeypatch.setattr(time, "time_ns", lambda: int(wall[0] * 1e9))
    key = SigningKey(bytes(range(1, 33)))
    one = VirtualFlight(relay_plan(2), autopilot, frugal=True, proxy=Proxy(seed=1, latency_s=0.02))
    context = one.core.context
    for station in one.stations:
        # What comes from the simulated vehicle is unsigned; what goes to it is stamped.
        signing = Signing(
            key, context.control.system_ids[station], SigningStore.in_memory(), allow_unsigned=range(70_000)
        )
        one.core.codecs[station] = codec = StationCodec(context.control.system_ids[station], signing=signing)
        context.control.gate._encoders[Sender(station)] = codec.encode
    while one.core.state is not FlightState.ARRIVED and one.now_s < 200.0:
        one.run_for(0.1)
        if jumps is not None:
            wall[0] += jumps.choice([-1.0, 1.0]) * jumps.choice([1.0, 60.0, 3600.0, 86_400.0])
    assert one.core.state is FlightState.ARRIVED
    stamps = [frame[-12:-6] for _, station, _, frame in one.sent if station == "s1"]
    numbers = [int.from_bytes(stamp, "little") for stamp in stamps]
    assert all(b > a for a, b in itertools.pairwise(numbers))
    return [(round(e.time_s, 3), str(e.data["event"])) for e in one.said("handover")]


@pytest.mark.slow
@BOTH
def test_a_wall_clock_that_jumps_by_a_day_moves_no_handover(autopilot: str, monkeypatch: pytest.MonkeyPatch) -> None:
    still = handovers_under_jumps(autopilot, None, monkeypatch)
    assert handovers_under_jumps(autopilot, random.Random(1), monkeypatch) == still
    assert [event for _, event in still] == ["proved", "request", "evidence", "release"]


@pytest.mark.soak
@BOTH
def test_fifty_flights_of_jumping_clocks(autopilot: str, monkeypatch: pytest.MonkeyPatch) -> None:
    still = handovers_under_jumps(autopilot, None, monkeypatch)
    for seed in counted(f"{autopilot}: flights of jumping clocks", range(50), 10):
        assert handovers_under_jumps(autopilot, random.Random(seed), monkeypatch) == still
    print(f"{autopilot}: every handover at {still}")
