"""Whole flights: real missions, both autopilot models, from preflight to landing.

In virtual time the core and the simulated vehicle share one clock, so an hour and a half over the Wadden Sea is flown
in minutes and the same every time. Over real UDP and the wall clock, the command line flies against simulators.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache, partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pyproj
import pytest

from gcs.flight import FlightState
from gcs.geodesy.ellipsoid import slant_range_m
from gcs.mission import read_mission
from gcs.plan.model import Plan
from gcs.planning.mission_planning import plan_mission
from link.files.flight_report import report_flight
from link.streamer.supervisor import start_flight
from tests.scorecard.soak import counted
from tests.support.flights.forks import in_fork
from tests.support.flights.processes import (
    Events,
    bad_links,
    free_ports,
    kill,
    mode_seen,
    simulator,
    start_attended,
)
from tests.support.flights.virtual import Proxy, VirtualFlight, handover_gaps_s, one_station_at_a_time, plan_home
from tests.support.paths import MISSIONS
from tests.support.processes.tree import alive

AUTOPILOTS = ("ardupilot", "px4")


@cache
def plan_of(name: str) -> Plan:
    document: dict[str, Any] = json.loads((MISSIONS / name).read_text(encoding="utf-8"))
    document.pop("options", None)
    return plan_mission(read_mission(document), fast=True)


@pytest.mark.slow
@pytest.mark.timeout(1500)
@pytest.mark.parametrize("autopilot", ["px4", pytest.param("ardupilot", marks=pytest.mark.soak)])
def test_wadden_in_virtual_time(autopilot: str) -> None:
    """140 km over the Wadden Sea: every handover as planned, the true place by PROJ's own formulas, always in range."""
    plan = plan_of("wadden_relay.json")
    rate_hz = 10.0
    flight = VirtualFlight(plan, autopilot, request={"rate_hz": rate_hz}, frugal=True, truth_every_s=2.0)
    assert flight.run() is FlightState.COMPLETED
    one_station_at_a_time(flight)
    released = flight.said("handover", state="released")
    assert [e.data["to"] for e in released] == [h.to_station for h in plan.handovers]
    assert len(released) >= 5
    assert max(handover_gaps_s(flight)) <= 2.0 / rate_hz + 1e-6
    (result,) = flight.said("result")
    assert result.data["exit_code"] == 0
    assert 0.0 < float(str(result.data["tracking_rms_m"])) < 2.0
    assert flight.cross_track_m(every=5).max() < 1.0
    # Independently of our geodesy: PROJ's azimuthal equidistant about the plan's origin.
    project = pyproj.Proj(proj="aeqd", lat_0=plan.plane.lat_deg, lon_0=plan.plane.lon_deg, ellps="WGS84")
    cruise = [t for t in flight.truth if t.state is FlightState.CRUISE and t.plan_s is not None][::5]
    east, north = project([t.lon_deg for t in cruise], [t.lat_deg for t in cruise])
    asked = plan.trajectory.evaluate(np.array([t.plan_s for t in cruise]))
    assert np.hypot(asked[:, 0], asked[:, 1]).max() > 60_000.0
    # A tick of the vehicle and one of the core lie between the two readings: 0.125 s at 30 m/s.
    assert np.hypot(east - asked[:, 0], north - asked[:, 1]).max() < 3.0 + 30.0 * 0.125
    for truth in cruise:
        station = plan.station_at(float(truth.plan_s or 0.0))
        place: Any = station.position
        here = (truth.lat_deg, truth.lon_deg, truth.alt_amsl_m)
        assert slant_range_m(*here, place.lat_deg, place.lon_deg, place.alt_amsl_m) < station.range_m


def fly_over_bad_links(name: str, autopilot: str, seed: int) -> VirtualFlight:
    """10 % loss, 100 ms latency and reordering on every link: arrived as planned, one station at a time."""
    plan = plan_of(name)
    far = {"request": {"rate_hz": 10.0}, "truth_every_s": 2.0} if name.startswith("wadden") else {}
    proxy = Proxy(seed=seed, loss=0.1, latency_s=0.1, jitter_s=0.05)
    flight = VirtualFlight(plan, autopilot, proxy=proxy, frugal=True, **far)  # type: ignore[arg-type]
    assert flight.run() is FlightState.COMPLETED, flight.events[-5:]
    one_station_at_a_time(flight)
    # Control may go back for a moment, where by chance nothing gets through for longer than a live link is silent.
    forward = [h.to_station for h in plan.handovers]
    at = 0
    for handover in flight.said("handover", state="released"):
        at += 1 if handover.data["forward"] else -1
        assert handover.data["to"] == (plan.handovers[0].from_station, *forward)[at]
        if not handover.data["forward"]:
            requested = flight.said("handover", state="requested", index=handover.data["index"], forward=False)
            assert "unproved for" in requested[-1].data["reason"]
    assert at == len(forward)
    assert max(handover_gaps_s(flight)) < 0.6
    assert flight.cross_track_m(every=4).max() < 1.0
    # The latency, 5 m at 50 m/s, is led: the vehicle is where the plan has it.
    assert float(np.sqrt((flight.behind_m() ** 2).mean())) < 3.0
    assert not flight.said("alarm")
    return flight


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_bad_links_in_virtual_time(autopilot: str) -> None:
    fly_over_bad_links("paper_like/M30_09.json", autopilot, 7)


@pytest.mark.soak
@pytest.mark.parametrize("autopilot", AUTOPILOTS)
@pytest.mark.parametrize(
    ("name", "seeds"),
    [("paper_like/M30_09.json", 20), ("paper_like/M30_04.json", 5), ("wadden_relay.json", 3)],
)
def test_bad_links_with_many_seeds(name: str, seeds: int, autopilot: str) -> None:
    for seed in counted(f"{name}, {autopilot}: flights over bad links", range(seeds), 1):
        fly_over_bad_links(name, autopilot, seed)


def take_off(name: str, autopilot: str, **settings: object) -> VirtualFlight:
    """A flight that nothing has happened to yet; over the Wadden Sea at a quarter of the usual rate, for time."""
    request: dict[str, object] = {"rate_hz": 5.0} if name.startswith("wadden") else {}
    return VirtualFlight(plan_of(name), autopilot, frugal=True, request={**request, **settings}, truth_every_s=1.0)


def station_dies_s(plan: Plan, handover: int) -> float:
    """When on the plan a station dies as a handover comes up, for `end_past_a_dead_station`."""
    planned = plan.handovers[handover - 1]
    return max(planned.time_s - 2.0, planned.overlap_start_s + 0.5)


def end_past_a_dead_station(flight: VirtualFlight, handover: int, which: str) -> None:
    """The old or the new station's link dies for good as a handover comes up: one in control, in coverage, to an end.

    The old one's: the new one takes over early, or at its time. The new one's: the flight stops, inside the coverage it
    has where it can stop that fast (a second to notice, then v / 2a of the plan's time), waits, turns back, and lands
    where it began or at the plan's safe point.
    """
    plan, begin_s = flight.plan, station_dies_s(flight.plan, handover)
    planned = plan.handovers[handover - 1]
    dead = planned.from_station if which == "old" else planned.to_station
    assert flight.core.state is FlightState.CRUISE
    flight.proxy.cuts.append((dead, flight.now_s, 1e9))
    end = flight.run()
    one_station_at_a_time(flight)
    assert not flight.vehicle.autopilot.armed
    again = dead in plan.station_ids[handover + 1 :] or (which == "old" and dead in plan.station_ids[handover:])
    if which == "old" and not again:
        assert end is FlightState.COMPLETED, flight.events[-5:]
    else:
        assert end is FlightState.CONTINGENCY, flight.events[-5:]
        furthest = max(t.plan_s for t in flight.truth if t.plan_s is not None)
        limits = plan.mission.limits
        stopped_s = begin_s + 1.2 + 1.1 * limits.max_speed_m_s / (2.0 * limits.max_accel_m_s2)
        assert again or furthest < max(planned.overlap_end_s, stopped_s)


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize(("autopilot", "handover", "which"), [("ardupilot", 2, "old"), ("px4", 4, "new")])
def test_a_station_dies_at_a_handover(autopilot: str, handover: int, which: str) -> None:
    flight = take_off("paper_like/M30_09.json", autopilot, wait_for_station_s=5.0)
    begin_s = station_dies_s(flight.plan, handover)
    flight.run(until=lambda: flight.plan_s >= begin_s)
    end_past_a_dead_station(flight, handover, which)


def end_with_the_streamer_killed(flight: VirtualFlight) -> None:
    """From one tick on nothing is sent: the autopilot's own failsafe, checked before the flight, has the vehicle."""
    flight.frozen, silent_s, sent = True, flight.now_s, len(flight.sent)
    flight.run_for(12.0)
    assert len(flight.sent) == sent
    # PX4 holds a second after the stream's end; ArduPilot returns five seconds after the last heartbeat.
    autopilot = flight.request.autopilot
    assert flight.vehicle.autopilot.mode_name == {"px4": "HOLD", "ardupilot": "RTL"}[autopilot]
    assert max(a.time_s for a in flight.accepted) <= silent_s + 0.1
    one_station_at_a_time(flight)


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_a_killed_streamer_leaves_the_vehicle_to_its_failsafe(autopilot: str) -> None:
    flight = take_off("paper_like/M30_09.json", autopilot)
    flight.run(until=lambda: flight.plan_s >= 30.0)
    end_with_the_streamer_killed(flight)


def end_with_the_service_gone(flight: VirtualFlight) -> None:
    """Nobody can speak any more from here on: not a setpoint is missed, and it lands at the destination."""
    flight.core.parent_gone()
    gone_s = flight.now_s
    assert flight.run() is FlightState.COMPLETED
    one_station_at_a_time(flight)
    landing_s = flight.said("state", to="landing")[0].time_s
    assert flight.longest_gap_s(gone_s, landing_s) <= 2.0 / flight.request.rate_hz + 1e-6
    assert [e.data["what"] for e in flight.said("alarm")] == ["nobody attends the flight"]


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_with_the_service_gone_the_flight_ends_as_planned(autopilot: str) -> None:
    flight = take_off("paper_like/M30_09.json", autopilot)
    flight.run(until=lambda: flight.plan_s >= 0.5 * flight.plan.mission_time_s)
    end_with_the_service_gone(flight)


@pytest.mark.soak
@pytest.mark.parametrize("autopilot", AUTOPILOTS)
@pytest.mark.parametrize("name", ["paper_like/M30_09.json", "wadden_relay.json"])
def test_whatever_dies_along_a_flight_it_ends_as_it_must(name: str, autopilot: str) -> None:
    """A station at each handover in turn, the streamer in ten places, the service in two; all in forks of a flight."""
    flight = take_off(name, autopilot, wait_for_station_s=5.0)
    plan, whole_s = flight.plan, flight.plan.mission_time_s
    endings: list[tuple[float, str, Callable[[], None]]] = []
    for handover, which in product(range(1, len(plan.handovers) + 1), ("old", "new")):
        end = partial(end_past_a_dead_station, flight, handover, which)
        endings.append((station_dies_s(plan, handover), f"the {which} station dies at handover {handover}", end))
    for share in np.linspace(0.05, 0.95, 10):
        killed = partial(end_with_the_streamer_killed, flight)
        endings.append((float(share) * whole_s, f"the streamer is killed at {share:.2f} of the way", killed))
    for share in (0.3, 0.8):
        gone = partial(end_with_the_service_gone, flight)
        endings.append((share * whole_s, f"the service is killed at {share:.2f} of the way", gone))
    endings.sort(key=lambda ending: ending[0])
    for number in counted(f"{name}, {autopilot}: endings", range(len(endings)), 1):
        moment_s, what, end = endings[number]
        flight.run(until=lambda moment_s=moment_s: flight.plan_s >= moment_s)  # type: ignore[misc]
        print(f"{what}, {moment_s:.0f} s", flush=True)
        in_fork(end)


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_paper_like_mission_over_udp_on_the_wall_clock(tmp_path: Path) -> None:
    """Both autopilot models at once, in real time, one UDP link per station, through the command line."""
    plan = plan_of("paper_like/M30_09.json")
    plan_file = tmp_path / "plan.json"
    plan_file.write_text(json.dumps(plan.to_document()), encoding="utf-8")
    home = ",".join(str(x) for x in plan_home(plan))
    stations = list(dict.fromkeys(plan.station_ids))
    vehicles, flights = [], {}
    try:
        for autopilot in AUTOPILOTS:
            ports = free_ports(len(stations))
            listen = [part for port in ports for part in ("--listen", f"udpin:127.0.0.1:{port}")]
            command = [sys.executable, "-m", "sitl_fixtures", "--autopilot", autopilot, "--home", home, *listen]
            vehicle = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
            vehicles.append(vehicle)
            assert vehicle.stdout is not None
            assert vehicle.stdout.readline().startswith("ready")
            links = [
                part
                for station, port in zip(stations, ports, strict=True)
                for part in ("--link", f"{station}=udpout:127.0.0.1:{port}")
            ]
            command = [sys.executable, "-m", "api.cli", "fly", str(plan_file), "--autopilot", autopilot, *links]
            command += ["--log", str(tmp_path / f"{autopilot}.tlog")]
            flights[autopilot] = subprocess.Popen(
                command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=tmp_path
            )
        for autopilot, process in flights.items():
            output, _ = process.communicate(timeout=900)
            assert process.returncode == 0, f"{autopilot}:\n{output}"
    finally:
        for process in [*flights.values(), *vehicles]:
            process.send_signal(signal.SIGINT)
        for process in [*flights.values(), *vehicles]:
            process.wait(timeout=30)
    for autopilot in AUTOPILOTS:
        report = report_flight(tmp_path / f"{autopilot}.tlog", plan)
        assert (report.autopilot, report.plan_sha256) == (autopilot, plan.plan_sha256)
        assert report.reached
        assert set(report.setpoints_by_station) == set(stations)
        assert sum(report.setpoints_by_station.values()) == report.setpoints > 0.9 * plan.mission_time_s * 20.0
        # Every handover of the plan, at its time, from the station in control to the next, and no other.
        assert [(h.index, h.from_station, h.to_station) for h in report.handovers] == [
            (h.index, h.from_station, h.to_station) for h in plan.handovers
        ]
        for flown, planned in zip(report.handovers, plan.handovers, strict=True):
            assert flown.flown_s == pytest.approx(planned.time_s, abs=1.0)
        # PX4 gives up after a second of silence; a noisy machine is allowed a tenth of that.
        assert max(h.gap_s for h in report.handovers) <= 0.1
        assert report.tracking_rms_m is not None
        assert report.tracking_rms_m < 3.0
        assert report.off_path_worst_m is not None
        assert report.off_path_worst_m < 3.0
        assert report.margin_least_m is not None
        assert report.margin_least_m > 0.0
        assert "not planned" not in report.to_text()


def on_the_wall_clock(kind: str, autopilot: str, folder: Path) -> None:
    """One flight in real time over real UDP, a proxy before each link, and what is to happen to it."""
    plan = plan_of("paper_like/M30_09.json")
    log = folder / "flight.tlog"
    impairment = ("--loss", "0.1", "--latency", "0.1", "--jitter", "0.05") if kind == "bad links" else ()
    with simulator(plan, autopilot, 1.0) as vehicle, bad_links(vehicle, *impairment) as proxies:
        request = vehicle.request(plan, autopilot, 1.0, wait_for_station_s=5.0, log_path=str(log))
        if kind == "service":
            service, streamer = start_attended(request, folder)
            until = time.monotonic() + 900.0
            while '"cruise"' not in (folder / "run" / "events.jsonl").read_text() and time.monotonic() < until:
                time.sleep(0.5)
            time.sleep(0.4 * plan.mission_time_s)
            kill(service)
            while alive(streamer) and time.monotonic() < until:
                time.sleep(0.5)
            result = json.loads((folder / "run" / "result.json").read_text())
            assert (result["state"], result["exit_code"]) == ("completed", 0)
            told = [json.loads(line) for line in (folder / "run" / "events.jsonl").read_text().splitlines()]
            assert "nobody attends the flight" in [event["data"].get("what") for event in told]
        else:
            events = Events()
            flight = start_flight(request, on_event=events, run_dir=folder / "run")
            try:
                if kind == "station":
                    events.in_cruise(station_dies_s(plan, 2), 900.0)
                    proxies[plan.handovers[1].to_station].kill()
                elif kind == "streamer":
                    events.in_cruise(0.4 * plan.mission_time_s, 900.0)
                    os.kill(flight.pid, signal.SIGKILL)
                ended = flight.wait(900.0)
            finally:
                flight.kill()
            stated = {"bad links": "completed", "station": "contingency", "streamer": "lost"}[kind]
            assert ended.state.value == stated, ended.reason
            released = [(e.data["from"], e.data["to"]) for e in events.all if e.data.get("state") == "released"]
            first = (plan.handovers[0].from_station, plan.handovers[0].to_station)
            if kind == "station":
                assert released == [first, first[::-1]]
            if kind == "bad links":
                # By the flight's own account, which knows how old a position is when it is heard.
                assert 0.0 < float(str(ended.summary["tracking_rms_m"])) < 3.0
                print(f"{autopilot}: {ended.summary['tracking_rms_m']} m rms, links {ended.summary['links']}")
            if kind == "streamer":
                expected = {"px4": "HOLD", "ardupilot": "RTL"}[autopilot]
                assert mode_seen(next(iter(vehicle.links.values())), autopilot, expected) == expected
    report = report_flight(log, plan)
    print(f"{kind}, {autopilot}:\n{report.to_text()}", flush=True)
    # One station at a time: every setpoint on record belongs to one, and control changed hands at the handovers alone.
    assert sum(report.setpoints_by_station.values()) == report.setpoints > 0
    if kind in ("bad links", "service"):
        assert report.reached
        assert [(h.from_station, h.to_station) for h in report.handovers] == [
            (h.from_station, h.to_station) for h in plan.handovers
        ]
        assert report.off_path_worst_m is not None
        assert report.off_path_worst_m < 3.0
        assert report.tracking_rms_m is not None
        assert report.tracking_rms_m < 3.0


@pytest.mark.soak
@pytest.mark.parametrize("kind", ["bad links", "station", "streamer", "service"])
def test_one_of_each_kind_on_the_wall_clock(kind: str, tmp_path: Path) -> None:
    """10 % loss, 100 ms and reordering; a station, the streamer, the service killed: both autopilot models at once."""
    folders = [tmp_path / autopilot for autopilot in AUTOPILOTS]
    for folder in folders:
        folder.mkdir()
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(on_the_wall_clock, [kind] * 2, AUTOPILOTS, folders))
