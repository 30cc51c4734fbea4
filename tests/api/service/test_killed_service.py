"""Scorecard 6: the service is killed in flight, again and again, and not a tick of the stream is missed."""

from __future__ import annotations

import contextlib
import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import httpx
import pytest

from api.processes import start_simulator
from api.processes.children import Children
from api.processes.quick_mission import QUICK_MISSION
from gcs.plan import read_plan
from link.errors import SupervisorError
from link.streamer.control_socket import connect
from link.streamer.supervisor import attach
from tests.scorecard.soak import counted
from tests.support.flights.processes import ROOT
from tests.support.processes.rest_client import launch, wait_for, wait_for_planning

# Eight minutes for one flight: the mission of the demonstration, slowly.
SLOW_MISSION = QUICK_MISSION | {"limits": QUICK_MISSION["limits"] | {"max_speed_m_s": 3.0}}

# The service costs seconds of processor time to load, which a run of two hundred cannot have each time.
LOADED = """
import os, signal, sys
import uvicorn
import api.rest.app, api.cli, api.cli.commands.serve, api.rest.routes, link.streamer.supervisor, gcs.store.store
signal.signal(signal.SIGCHLD, signal.SIG_IGN)
print("loaded", flush=True)
for line in sys.stdin:
    child = os.fork()
    if child == 0:
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        os.close(0)
        os.setsid()
        sys.argv = ["skyrelay", "serve", "--port", "0", "--data", line.strip()]
        try:
            api.cli.main()
        finally:
            os._exit(1)
    print("pid", child, flush=True)
"""


class Service:
    """``skyrelay serve``, forked off a process that has it loaded, over one folder of data; one at a time."""

    def __init__(self, loaded: subprocess.Popen[str], data: Path) -> None:
        self._data = data
        assert loaded.stdin is not None
        assert loaded.stdout is not None
        self._ask: IO[str] = loaded.stdin
        self._hear: IO[str] = loaded.stdout
        self._pid: int | None = None
        self.address = ""

    def start(self) -> None:
        """Returns once it serves."""
        self._ask.write(f"{self._data}\n")
        self._ask.flush()
        self.address = ""
        while self._pid is None or not self.address:
            line = self._hear.readline()
            assert line, "the service has ended"
            if line.startswith("pid"):
                self._pid = int(line.split()[1])
            elif "serves at" in line:
                self.address = line.split()[-1].rstrip("/")

    def kill(self) -> None:
        """SIGKILL, if it runs."""
        if self._pid is not None:
            os.kill(self._pid, signal.SIGKILL)
        self._pid = None


@contextlib.contextmanager
def loaded_service(data: Path) -> Iterator[Service]:
    """A `Service` to start and kill; nothing of it is left after the block."""
    command = [sys.executable, "-c", LOADED]
    with (data.parent / "service.log").open("w") as log:
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, text=True, cwd=ROOT
        )
        service = Service(process, data)
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "loaded\n"
            yield service
        finally:
            service.kill()
            process.kill()
            process.communicate()


def status_of(run_dir: Path) -> dict[str, Any]:
    """The streamer's own word on its flight, without attending it."""
    with connect(run_dir / "control.sock") as client, client.makefile("r") as lines:
        client.sendall(b'{"id": 1, "status": true}\n')
        answer: dict[str, Any] = json.loads(lines.readline())["status"]
        return answer


def kill_services(service: Service, flight_id: str, numbers: Iterator[int]) -> int:
    """Kill the service that runs, start it again, let it find its flight, and so on; how many were killed.

    Each is killed at a drawn moment of its life: while it finds the flight, is asked about it, or plans a mission.
    """
    killed = 0
    for number in numbers:
        draw = random.Random(number)
        with contextlib.suppress(httpx.HTTPError), httpx.Client(base_url=service.address, timeout=5.0) as client:
            if draw.random() < 0.5:
                client.post("/v1/missions", json=SLOW_MISSION)
            if draw.random() < 0.8:
                client.get(f"/v1/flights/{flight_id}")
        time.sleep(draw.uniform(0.0, 0.3))
        service.kill()
        killed += 1
        service.start()
    return killed


def prepared(client: httpx.Client, wanted: dict[str, Any]) -> dict[str, Any]:
    """A flight made ready by the service; on a very busy machine a streamer may not come up in time the first time."""
    for _ in range(3):
        answer = client.post("/v1/flights", json=wanted)
        if answer.status_code == 201:
            flight: dict[str, Any] = answer.json()
            return wait_for(client, flight["id"], "ready")
    raise AssertionError(answer.text)


@pytest.mark.soak
@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_a_hundred_killed_services_cost_no_tick(autopilot: str, tmp_path: Path) -> None:
    """Real processes, real time, a flight that the service launched."""
    data = tmp_path / "data"
    with loaded_service(data) as service, Children() as children:
        service.start()
        with httpx.Client(base_url=service.address, timeout=120) as client:
            mission = wait_for_planning(client, client.post("/v1/missions", json=SLOW_MISSION).json()["id"])
            plan = read_plan(client.get(f"/v1/missions/{mission['id']}/plan").json())
            _, urls = start_simulator(children, plan, autopilot=autopilot, speedup=1.0)
            for station, url in urls.items():
                client.put(f"/v1/links/{station}", json={"url": url})
            client.put("/v1/vehicles/drone", json={"autopilot": autopilot, "links": {s: s for s in urls}})
            wanted = {"mission_id": mission["id"], "plan_sha256": mission["plan_sha256"], "vehicle_id": "drone"}
            flight = prepared(client, wanted)
            launch(client, flight)
            wait_for(client, flight["id"], "cruise")
        run_dir = data / "flights" / flight["id"]
        try:
            before = status_of(run_dir)["lateness"]
            numbers = counted(f"{autopilot}: killed services", range(100), 10)
            killed = kill_services(service, flight["id"], numbers)
            after = status_of(run_dir)
            missed = after["lateness"]["skipped_ticks"] - before["skipped_ticks"]
            print(f"{autopilot}: {killed} kills, {missed} ticks missed; {after['lateness']}")
            assert after["state"] == "cruise"
            assert missed == 0
            told = [
                json.loads(line)["data"].get("what") for line in (run_dir / "events.jsonl").read_text().splitlines()
            ]
            assert told.count("nobody attends the flight") > 0.5 * killed
        finally:
            with contextlib.suppress(SupervisorError):
                attach(run_dir).kill()
