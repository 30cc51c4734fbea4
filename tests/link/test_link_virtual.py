"""Whole flights in virtual time: nominal, lossy, with links that die at handovers, and a mission on the real earth.

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
from gcs.geodesy import slant_range_m
from gcs.mission import Mission
from gcs.plan import Plan
from gcs.planning import plan_mission
from virtual_flight import Proxy, VirtualFlight

BOTH = pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
MISSIONS = Path(sitl_fixtures.__file__).parent / "missions"


def one_station_at_a_time(one: VirtualFlight) -> None:
    """Every setpoint obeyed came from the station in control when it was sent, under that station's system id."""
    ids = {one.core.context.system_ids[s]: s for s in one.stations}
    assert one.accepted
    for accepted in one.accepted:
        assert accepted.holder_when_sent == accepted.station == ids[accepted.system_id]


def handover_gaps_s(one: VirtualFlight, around_s: float = 3.0) -> list[float]:
    return [
        one.longest_gap_s(e.time_s - around_s, e.time_s + around_s)
        for e in one.said("handover", state="requested")
        if e.time_s + around_s < one.said("state", to="landing")[0].time_s
    ]


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
def test_ten_percent_loss_a_hundred_milliseconds_and_reordering_on_every_link(autopilot: str) -> None:
    proxy = Proxy(seed=7, loss=0.1, latency_s=0.1, jitter_s=0.1, duplicates=0.05)
    one = VirtualFlight(relay_plan(3), autopilot, proxy=proxy, frugal=True)
    assert one.run(limit_s=500.0) is FlightState.COMPLETED
    one_station_at_a_time(one)
    assert [e.data["index"] for e in one.said("handover", state="released")] == [1, 2]
    assert one.cross_track_m().max() < 1.0
    assert rest_error_m(one) < 1.0
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
def wadden_plan() -> Plan:
    document = json.loads((MISSIONS / "wadden_relay.json").read_text(encoding="utf-8"))
    return plan_mission(Mission.from_document(document), fast=True)


@pytest.mark.slow
@BOTH
def test_den_helder_to_borkum_on_the_real_earth(autopilot: str) -> None:
    """140 km, a dozen stations to choose from; flown truth against the plan, converted by PROJ's own formulas.

    "Within 1 m": the true WGS84 position of the aircraft, in cruise, from the nearest point of the planned path within
    5 s of the reference ("time-matched cross-track"); and from the point planned for that very moment within 3 m.
    """
    pyproj = pytest.importorskip("pyproj")
    plan = wadden_plan()
    one = VirtualFlight(
        plan, autopilot, frugal=True, truth_every_s=2.0, config={"tick_s": 0.025}, request={"rate_hz": 10.0}
    )
    assert one.run(limit_s=8000.0) is FlightState.COMPLETED
    one_station_at_a_time(one)
    assert len(one.said("handover", state="released")) == len(plan.handovers) >= 5
    assert max(handover_gaps_s(one)) <= 0.2 + 1e-9
    assert one.cross_track_m(5).max() < 1.0
    # Independently of our geodesy: PROJ's azimuthal equidistant about the plan's origin.
    project = pyproj.Proj(proj="aeqd", lat_0=plan.plane.lat_deg, lon_0=plan.plane.lon_deg, ellps="WGS84")
    cruise = [t for t in one.truth if t.state is FlightState.CRUISE and t.plan_s is not None][::5]
    east, north = project([t.lon_deg for t in cruise], [t.lat_deg for t in cruise])
    asked = plan.trajectory.evaluate(np.array([t.plan_s for t in cruise]))
    off = np.hypot(east - asked[:, 0], north - asked[:, 1])
    far = np.hypot(asked[:, 0], asked[:, 1])
    assert far.max() > 60_000.0
    # A tick of the vehicle and one of the core lie between the two readings: 0.125 s at 30 m/s.
    assert off.max() < 3.0 + 30.0 * 0.125
    # Covered by the station in control all the way, by true slant range.
    for truth in cruise:
        station = plan.station_at(float(truth.plan_s or 0.0))
        place: Any = station.position
        left = station.range_m - slant_range_m(
            truth.lat_deg, truth.lon_deg, truth.alt_amsl_m, place.lat_deg, place.lon_deg, place.alt_amsl_m
        )
        assert left > 0.0
    assert one.said("result")[0].data["tracking_rms_m"] < 3.0


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
