"""Whole flights: real missions, both autopilots' personalities, from preflight to landing.

In virtual time the core and the simulated vehicle share one clock, so an hour and a half over the Wadden Sea is flown
in minutes and the same every time. Over real UDP and the wall clock, the command line flies against simulators.
"""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from gcs.flight import FlightState
from gcs.mission import Mission
from gcs.plan import Plan
from gcs.planning import plan_mission
from link.report import report_flight
from virtual_flight import Proxy, VirtualFlight

MISSIONS = Path(__file__).resolve().parent.parent / "sitl_fixtures" / "missions"
AUTOPILOTS = ("ardupilot", "px4")


@cache
def plan_of(name: str) -> Plan:
    document: dict[str, Any] = json.loads((MISSIONS / name).read_text(encoding="utf-8"))
    document.pop("options", None)
    return plan_mission(Mission.from_document(document), fast=True)


def assert_one_station_at_a_time(flight: VirtualFlight) -> None:
    """Every setpoint obeyed was sent by the station that held the gate then, with that station's own system id."""
    ids = {s.id: s.system_id for s in flight.plan.mission.stations}
    assert flight.accepted
    for setpoint in flight.accepted:
        assert setpoint.station == setpoint.holder_when_sent
        assert setpoint.system_id == ids[setpoint.station]


@pytest.mark.slow
@pytest.mark.timeout(1500)
@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_wadden_in_virtual_time(autopilot: str) -> None:
    plan = plan_of("wadden_relay.json")
    rate_hz = 10.0
    flight = VirtualFlight(plan, autopilot, request={"rate_hz": rate_hz}, frugal=True, truth_every_s=2.0)
    assert flight.run() is FlightState.COMPLETED
    assert_one_station_at_a_time(flight)
    released = flight.said("handover", state="released")
    assert [e.data["to"] for e in released] == [h.to_station for h in plan.handovers]
    # From two seconds before each handover to two after, in the vehicle's own time.
    for event in released:
        assert flight.longest_gap_s(event.time_s - 2.0, event.time_s + 2.0) <= 2.0 / rate_hz + 1e-6
    (result,) = flight.said("result")
    assert result.data["exit_code"] == 0
    assert 0.0 < float(str(result.data["tracking_rms_m"])) < 2.0
    # True place on the WGS84 earth against the plan, up to 150 km from where the vehicle's own map begins.
    assert flight.cross_track_m(every=5).max() < 1.0


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_bad_links_in_virtual_time(autopilot: str) -> None:
    """10 % loss, 100 ms latency and reordering on every link: arrived, one station at a time."""
    flight = VirtualFlight(
        plan_of("paper_like/M30_09.json"), autopilot, proxy=Proxy(seed=7, loss=0.1, latency_s=0.1, jitter_s=0.05)
    )
    assert flight.run() is FlightState.COMPLETED
    assert_one_station_at_a_time(flight)


def free_ports(count: int) -> list[int]:
    sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(count)]
    for s in sockets:
        s.bind(("127.0.0.1", 0))
    ports = [int(s.getsockname()[1]) for s in sockets]
    for s in sockets:
        s.close()
    return ports


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_paper_like_mission_over_udp_on_the_wall_clock(tmp_path: Path) -> None:
    """Both personalities at once, in real time, one UDP link per station, through the command line."""
    plan = plan_of("paper_like/M30_09.json")
    plan_file = tmp_path / "plan.json"
    plan_file.write_text(json.dumps(plan.to_document()), encoding="utf-8")
    start = plan.trajectory.evaluate(0.0)
    lat_deg, lon_deg = plan.plane.to_geodetic(start[0], start[1])
    home = f"{float(lat_deg)},{float(lon_deg)},{float(start[2]) + plan.plane.alt_amsl_m - 15.0}"
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
        assert report.reached
        assert set(report.setpoints_by_station) == set(stations)
        assert [h.to_station for h in report.handovers] == [h.to_station for h in plan.handovers]
        # PX4 gives up after a second of silence; a noisy machine is allowed a tenth of that.
        assert max(h.gap_s for h in report.handovers) <= 0.1
        assert report.tracking_rms_m is not None
        assert report.tracking_rms_m < 3.0
