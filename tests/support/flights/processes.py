"""A simulator process with real UDP links, for tests that fly on the wall clock."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gcs.flight import FlightEvent
from gcs.plan.model import Plan
from link.autopilot.registry import PROFILES
from link.dialect import mavlink
from link.session.request import FlightRequest
from link.transport.opening import open_endpoint
from link.wire.codec import StationCodec
from tests.support.flights.virtual import plan_home
from tests.support.heartbeats import is_autopilot
from tests.support.paths import ROOT


def free_ports(count: int) -> list[int]:
    """Free UDP ports of this machine."""
    sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(count)]
    try:
        for one in sockets:
            one.bind(("127.0.0.1", 0))
        return [int(one.getsockname()[1]) for one in sockets]
    finally:
        for one in sockets:
            one.close()


def open_files() -> list[str]:
    """What the descriptors of this process stand for."""
    return [os.readlink(one) for one in Path("/proc/self/fd").iterdir() if one.is_symlink()]


@dataclass
class Simulator:
    """A running simulator and the links to it by station."""

    process: subprocess.Popen[bytes]
    links: dict[str, str]

    def request(self, plan: Plan, autopilot: str, speedup: float, **changes: Any) -> FlightRequest:
        """A request for a flight of ``plan`` over its links."""
        return FlightRequest(plan=plan.to_document(), autopilot=autopilot, links=self.links, speedup=speedup, **changes)


@contextlib.contextmanager
def simulator(plan: Plan, autopilot: str, speedup: float, *arguments: str) -> Iterator[Simulator]:
    """``python -m sitl_fixtures`` under the plan's start, one UDP link a station; ended with the block."""
    stations = list(dict.fromkeys(plan.station_ids))
    ports = free_ports(len(stations))
    home = ",".join(str(x) for x in plan_home(plan))
    command = [sys.executable, "-m", "sitl_fixtures", "--autopilot", autopilot, "--home", home]
    command += ["--speedup", str(speedup), *arguments]
    for port in ports:
        command += ["--listen", f"udpin:127.0.0.1:{port}"]
    process = subprocess.Popen(command, cwd=ROOT)
    try:
        yield Simulator(process, {s: f"udpout:127.0.0.1:{p}" for s, p in zip(stations, ports, strict=True)})
    finally:
        process.terminate()
        process.wait(20)


@contextlib.contextmanager
def bad_links(vehicle: Simulator, *arguments: str) -> Iterator[dict[str, subprocess.Popen[bytes]]]:
    """A lossy proxy before each station's link (``arguments`` are its own), ended with the block; by station.

    The simulator's ``links`` lead through the proxies inside the block.
    """
    direct, proxies = dict(vehicle.links), {}
    ports = free_ports(len(direct))
    try:
        for seed, ((station, url), port) in enumerate(zip(direct.items(), ports, strict=True)):
            command = [sys.executable, "-m", "sitl_fixtures.process.proxy", "--listen", f"udpin:127.0.0.1:{port}"]
            command += ["--target", url, "--seed", str(seed), *arguments]
            proxies[station] = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL)
            vehicle.links[station] = f"udpout:127.0.0.1:{port}"
        yield proxies
    finally:
        vehicle.links.update(direct)
        for proxy in proxies.values():
            proxy.terminate()
        for proxy in proxies.values():
            proxy.wait(20)


ATTENDANT = """
import json, sys, time
from pathlib import Path
from link.session.request import FlightRequest
from link.streamer.supervisor import start_flight
flight = start_flight(FlightRequest.from_document(json.load(open(sys.argv[1]))), run_dir=Path(sys.argv[2]))
print(flight.pid, flush=True)
time.sleep(3600)
"""


def start_attended(request: FlightRequest, folder: Path) -> tuple[subprocess.Popen[bytes], int]:
    """A process to kill that starts a flight in ``folder/run`` and attends it; it, and the streamer's pid."""
    (folder / "request.json").write_text(json.dumps(request.to_document()))
    attendant = subprocess.Popen(
        [sys.executable, "-c", ATTENDANT, str(folder / "request.json"), str(folder / "run")],
        stdout=subprocess.PIPE,
        cwd=ROOT,
        start_new_session=True,
    )
    assert attendant.stdout is not None
    return attendant, int(attendant.stdout.readline())


def kill(process: subprocess.Popen[bytes]) -> None:
    """SIGKILL, and its end waited for."""
    process.kill()
    process.wait()
    if process.stdout is not None:
        process.stdout.close()


def mode_seen(url: str, autopilot: str, expected: str, timeout_s: float = 30.0) -> str | None:
    """The mode of the vehicle's own heartbeat, heard by a listener of its own: ``expected``, or the last in vain."""
    profile, codec, mode = PROFILES[autopilot], StationCodec(99), None
    deadline = time.monotonic() + timeout_s
    with open_endpoint(url) as link:
        while mode != expected and time.monotonic() < deadline:
            # TIMESYNC says where to answer and commands nothing.
            link.send(codec.encode(mavlink.MAVLink_timesync_message(0, 1)))
            time.sleep(0.05)
            for data in link.receive():
                for message in codec.decode(data):
                    if is_autopilot(profile, message):
                        mode = profile.mode_of(message)
    return mode


class Events:
    """Collects a flight's events; waits for one."""

    def __init__(self) -> None:
        self.all: list[FlightEvent] = []

    def __call__(self, event: FlightEvent) -> None:
        self.all.append(event)

    def append(self, event: FlightEvent) -> None:
        """As a journal."""
        self.all.append(event)

    def wait_for(self, condition: Callable[[FlightEvent], bool], timeout_s: float = 60.0) -> FlightEvent:
        """The first event for which ``condition`` holds, seen so far or to come."""
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline:
            for event in list(self.all):
                if condition(event):
                    return event
            time.sleep(0.01)
        raise AssertionError(f"no such event among {[(e.kind.value, dict(e.data)) for e in self.all][-8:]}")

    def in_cruise(self, plan_s: float = 0.0, timeout_s: float = 60.0) -> FlightEvent:
        """Wait until the flight is at a time of its plan."""
        return self.wait_for(
            lambda e: e.kind.value == "progress" and e.state.value == "cruise" and (e.data["plan_s"] or 0.0) >= plan_s,
            timeout_s,
        )
