"""Small flights in virtual time: nominal, with links that die at handovers, with every kind of fault.

What every flight must hold: each setpoint the vehicle obeyed was sent by the station in control at that moment, and
no two setpoints it obeyed lie further apart than two sample periods across a handover (where no link is bad).
"""

from __future__ import annotations

import gzip
import json
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sitl_fixtures
from flight_plans import relay_plan
from gcs.flight import FlightState
from gcs.plan import Plan
from virtual_flight import VirtualFlight, handover_gaps_s, one_station_at_a_time

BOTH = pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
MISSIONS = Path(sitl_fixtures.__file__).parent / "missions"


def rest_error_m(one: VirtualFlight) -> float:
    """Horizontal distance of the landed vehicle from the plan's destination."""
    east, north = one.plan.plane.to_plane(one.vehicle.body.lat_deg, one.vehicle.body.lon_deg)
    end = one.plan.trajectory.evaluate(one.plan.mission_time_s)
    return float(np.hypot(east - end[0], north - end[1]))


@BOTH
def test_a_flight_over_three_stations(autopilot: str) -> None:
    one = VirtualFlight(relay_plan(3), autopilot, frugal=True)
    assert one.run(limit_s=400.0) is FlightState.COMPLETED
    one_station_at_a_time(one)
    # The exported schedule is the one flown: each handover at the first sample at or after its time.
    launched = one.core.context.launched_s
    assert launched is not None
    for event, planned in zip(one.said("handover", state="requested"), one.plan.handovers, strict=True):
        assert 0.0 <= event.time_s - launched - planned.time_s < 0.05 + 1e-6
    assert max(handover_gaps_s(one)) <= 0.1 + 1e-9
    assert one.cross_track_m().max() < 1.0
    assert one.said("result")[0].data["tracking_rms_m"] < 1.0
    assert rest_error_m(one) < 0.5
    assert not one.said("alarm")


@BOTH
@pytest.mark.parametrize("which", ["old", "new"])
@pytest.mark.parametrize("handover", [1, 2])
def test_a_link_dead_before_a_handover_ends_in_one_owner_and_in_coverage(
    autopilot: str, which: str, handover: int
) -> None:
    """The old station's link dies within the overlap: the next takes over. The next one's: the flight turns back."""
    planned = relay_plan(3).handovers[handover - 1]
    dead = planned.from_station if which == "old" else planned.to_station
    one = VirtualFlight(relay_plan(3), autopilot, frugal=True, request={"wait_for_station_s": 5.0})
    one.run(until=lambda: one.plan_s >= max(planned.time_s - 2.0, planned.overlap_start_s + 0.5), limit_s=200.0)
    one.proxy.cuts.append((dead, one.now_s, 1e9))
    end = one.run(limit_s=500.0)
    one_station_at_a_time(one)
    assert not one.vehicle.personality.armed
    if which == "old":
        assert end is FlightState.COMPLETED
        patience_s = {"px4": 0.6, "ardupilot": 1.8}[autopilot]
        assert max(handover_gaps_s(one)) <= patience_s + 0.15
        assert one.cross_track_m().max() < 2.0
    else:
        assert end is FlightState.CONTINGENCY
        assert "returning" in one.states
        # It stopped inside the old station's coverage: the path beyond it was not flown.
        furthest = max(t.plan_s for t in one.truth if t.plan_s is not None)
        assert furthest < planned.overlap_end_s


@cache
def snapshot_plan() -> Plan:
    return relay_plan(2)


@BOTH
@pytest.mark.parametrize("offset_s", [-0.05, 0.05, 0.5, 1.5])
@pytest.mark.parametrize("which", ["old", "new"])
def test_a_link_cut_anywhere_across_a_handover(autopilot: str, which: str, offset_s: float) -> None:
    """Ends flown, back, or in the autopilot's own hold: one owner, and never a second stream."""
    planned = snapshot_plan().handovers[0]
    dead = planned.from_station if which == "old" else planned.to_station
    settings: dict[str, Any] = {"wait_for_station_s": 3.0, "hold_limit_s": 5.0, "lost_after_s": 20.0}
    one = VirtualFlight(snapshot_plan(), autopilot, frugal=True, request=settings)
    one.run(until=lambda: one.plan_s >= planned.time_s + offset_s, limit_s=200.0)
    one.proxy.cuts.append((dead, one.now_s, 1e9))
    one.run_for(8.0)
    one_station_at_a_time(one)
    relay, context = one.core.airborne.relay, one.core.context
    assert not relay.moving
    if one.core.state is FlightState.LAPSED:
        assert one.vehicle.personality.mode_name in ("HOLD", "GUIDED", "RTL")
        assert one.vehicle.body.speed_m_s < 20.0
    else:
        assert context.gate.holder == context.plan.station_ids[relay.leg]
        # Whoever is in control has a link that works.
        assert context.gate.holder != dead
        assert one.vehicle.personality.mode_name in ("OFFBOARD", "GUIDED")


# -- faults -----------------------------------------------------------------------------------------------------------

REFUSED, COMPLETED, CONTINGENCY, LOST = "refused", "completed", "contingency", "lost"
EXPECTED: dict[str, tuple[str, str]] = {
    # fault: how a flight ends with PX4, with ArduPilot
    "telemetry-late": (COMPLETED, COMPLETED),
    "frames-damaged": (COMPLETED, COMPLETED),
    "ack-late": (COMPLETED, COMPLETED),
    "command-in-progress": (COMPLETED, COMPLETED),
    "param-reply-lost": (COMPLETED, COMPLETED),
    "origin-unknown": (REFUSED, REFUSED),
    "mode-without-effect": (REFUSED, REFUSED),
    "echo-stuck": (COMPLETED, COMPLETED),
    "mode-to-return": (CONTINGENCY, CONTINGENCY),
    "ekf-failure": (CONTINGENCY, CONTINGENCY),
    "disarm-in-flight": (LOST, LOST),
    "reboot": (LOST, LOST),
    "wind-gust": (COMPLETED, COMPLETED),
}


def fly_with(fault: str, autopilot: str) -> VirtualFlight:
    settings = {
        "hold_limit_s": 15.0,
        "wait_for_station_s": 8.0,
        "lost_after_s": 20.0,
        "arm_timeout_s": 10.0,
        "connect_timeout_s": 8.0,
    }
    one = VirtualFlight(snapshot_plan(), autopilot, frugal=True, config={"faults": (fault,)}, request=settings)
    one.run(limit_s=400.0)
    return one


def holds_whatever_happens(one: VirtualFlight) -> None:
    """What no fault may break."""
    for accepted in one.accepted:
        if accepted.system_id in one.core.context.system_ids.values():
            assert accepted.holder_when_sent == accepted.station
    lapses = [e.time_s for e in one.said("state", to="lapsed")]
    if lapses:
        kinds = ("SET_POSITION_TARGET_GLOBAL_INT", "SET_POSITION_TARGET_LOCAL_NED")
        assert not [t for t, _, _, _ in one.sent_messages(*kinds) if t > lapses[0]], "streamed again after a lapse"
    json.dumps([e.to_document() for e in one.events], allow_nan=False)


@BOTH
@pytest.mark.slow
@pytest.mark.parametrize("fault", sorted(EXPECTED))
def test_a_fault_ends_as_it_must(fault: str, autopilot: str) -> None:
    one = fly_with(fault, autopilot)
    holds_whatever_happens(one)
    assert one.core.state.value == EXPECTED[fault][autopilot == "ardupilot"]


@BOTH
@pytest.mark.soak
def test_no_fault_of_the_simulator_breaks_what_must_hold(autopilot: str) -> None:
    from sitl_fixtures.faults import listing

    names = [line.split()[0].split(":")[0] for line in listing().splitlines() if line.startswith("  ")]
    assert len(names) >= 90
    for name in names:
        one = fly_with(name, autopilot)
        holds_whatever_happens(one)


@pytest.mark.soak
@BOTH
@pytest.mark.parametrize("which", ["old", "new"])
def test_a_link_cut_every_ten_milliseconds_across_a_handover(autopilot: str, which: str) -> None:
    for k in range(-200, 201):
        test_a_link_cut_anywhere_across_a_handover(autopilot, which, 0.01 * k)


def recorded(name: str) -> Iterator[dict[str, Any]]:
    with gzip.open(MISSIONS.parent / "recordings" / name, "rt") as stream:
        next(stream)
        for line in stream:
            yield json.loads(line)


def test_real_px4_echoes_name_the_setpoint_they_hold() -> None:
    """From a recorded flight: what the monitor believes about echoes is what a real PX4 says."""
    from types import SimpleNamespace

    from link.telemetry import EchoTracker, Sent

    echoes, named, asked = EchoTracker(runs_on=False), 0, 0
    for line in recorded("px4-nominal.jsonl.gz"):
        f = line.get("fields", {})
        if line.get("msg") == "SET_POSITION_TARGET_LOCAL_NED" and f["type_mask"] == 3072:
            echoes.note(
                Sent(
                    line["t"],
                    "a",
                    1,
                    (f["x"], f["y"], f["z"]),
                    (f["vx"], f["vy"], f["vz"]),
                    (f["afx"], f["afy"], f["afz"]),
                )
            )
        elif line.get("msg") == "POSITION_TARGET_LOCAL_NED" and 30.0 < line["t"] < 85.0:
            asked += 1
            held = echoes.held(SimpleNamespace(**f))
            named += bool(held) and line["t"] - held[-1].sent_s < 0.3
    assert asked > 200
    assert named > 0.97 * asked
