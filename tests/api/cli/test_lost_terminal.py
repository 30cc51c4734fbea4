"""A terminal that goes away is not a lost aircraft: the flight is found, shown and commanded from another one."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from gcs.plan.model import Plan
from link.dialect import mavlink
from link.streamer.flight_register import registered_flights
from tests.support.flights.processes import Simulator, free_ports, simulator
from tests.support.plans.planned import relay_plan
from tests.support.processes.cli_process import SKYRELAY, run_process

SPEEDUP = 2.0
NOWHERE = "http://127.0.0.1:9"


@pytest.fixture
def plan_file(tmp_path: Path) -> Path:
    path = tmp_path / "plan.json"
    path.write_text(json.dumps(relay_plan(3).to_document()))
    return path


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A machine of its own: no other test's flights are found."""
    monkeypatch.setenv("SKYRELAY_STATE_DIR", str(tmp_path / "state"))
    monkeypatch.setenv("SKYRELAY_SERVICE", NOWHERE)
    return tmp_path


@pytest.fixture
def vehicle(here: Path) -> Iterator[Simulator]:
    with simulator(relay_plan(3), "ardupilot", SPEEDUP) as made:
        yield made


def fly(plan_file: Path, vehicle: Simulator, *more: str) -> subprocess.Popen[str]:
    links = [part for s, url in vehicle.links.items() for part in ("--link", f"{s}={url}")]
    command = [
        *SKYRELAY,
        "fly",
        str(plan_file),
        "--autopilot",
        "ardupilot",
        "--speedup",
        str(SPEEDUP),
        *links,
        "--json",
    ]
    # As from a terminal, even where the tests run under nohup.
    return subprocess.Popen(
        [*command, *more],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_DFL),
    )


def until(process: subprocess.Popen[str], state: str) -> None:
    assert process.stdout is not None
    for line in process.stdout:
        if json.loads(line)["state"] == state:
            return
    raise AssertionError(process.stderr.read() if process.stderr else "")


def gone(pid: int, timeout_s: float = 90.0) -> None:
    deadline = time.monotonic() + timeout_s
    while time.monotonic() < deadline and any(one.pid == pid for one in registered_flights()):
        time.sleep(0.1)
    assert not any(one.pid == pid for one in registered_flights())


@pytest.mark.slow
def test_after_a_hangup_the_flight_is_found_held_resumed_attended_and_ended(
    vehicle: Simulator, plan_file: Path
) -> None:
    process = fly(plan_file, vehicle)
    until(process, "cruise")
    process.send_signal(signal.SIGHUP)
    assert process.wait(20) == 128 + signal.SIGHUP
    (one,) = registered_flights()
    for word, said in (("hold", "holding"), ("look", "in control")):
        told = run_process("flight", one.flight_id, word)
        assert (told.code, said in told.out) == (0, True), told.err
    listed = run_process("flight")
    assert (listed.code, one.flight_id in listed.out) == (0, True), listed.err
    second = fly(plan_file, vehicle)
    _, complaint = second.communicate(timeout=30)
    assert second.returncode == 2
    assert f"skyrelay flight {one.flight_id} attach" in complaint
    refused = run_process("flight", one.flight_id, "replan")
    assert (refused.code, "needs a service" in refused.err) == (2, True)
    attended = subprocess.Popen([*SKYRELAY, "flight", one.flight_id, "attach"], stderr=subprocess.PIPE, text=True)
    assert attended.stderr is not None
    assert any("attending flight" in line for line in attended.stderr)
    attended.send_signal(signal.SIGHUP)
    assert attended.wait(20) == 0
    attended.stderr.close()
    assert [flight.pid for flight in registered_flights()] == [one.pid]
    resumed = run_process("flight", one.flight_id, "resume")
    assert (resumed.code, "T+" in resumed.out) == (0, True), resumed.err
    assert run_process("flight", one.flight_id, "abort").code == 0
    gone(one.pid)
    assert json.loads((Path(one.run_dir) / "result.json").read_text())["state"] == "contingency"


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGTERM, signal.SIGINT])
def test_ended_on_the_ground_the_vehicle_gets_back_what_was_changed(
    vehicle: Simulator, plan_file: Path, number: signal.Signals, here: Path
) -> None:
    process = fly(plan_file, vehicle)
    notes = here / "state" / "vehicles"
    deadline = time.monotonic() + 60.0
    while not list(notes.glob("*.json")) and time.monotonic() < deadline:
        time.sleep(0.002)
    (one,) = registered_flights()
    process.send_signal(number)
    process.communicate(timeout=60)
    gone(one.pid)
    assert list(notes.glob("*.json")) == []


@pytest.mark.slow
def test_a_killed_streamers_vehicle_says_who_locked_it_and_is_given_back(
    vehicle: Simulator, plan_file: Path, here: Path
) -> None:
    process = fly(plan_file, vehicle)
    assert process.stdout is not None
    # Locked, and not armed yet.
    assert any(json.loads(line)["data"].get("name") == "MAV_OPTIONS" for line in process.stdout)
    (one,) = registered_flights()
    os.kill(one.pid, signal.SIGKILL)
    out, complaint = process.communicate(timeout=60)
    last = json.loads(out.splitlines()[-1])
    assert last["data"]["what"] == "streamer died"
    assert "skyrelay vehicle restore --link" in last["data"]["fix"]
    assert "stations 241 to 243 alone" in last["data"]["hears"]
    assert any("MAV_OPTIONS (was 0)" in text for text in last["data"]["keeps"])
    url = one.urls[0]
    told = json.loads(run_process("vehicle", "identify", "--link", url, "--json").out)
    assert (told["armed"], told["locked"], told["answers"], told["signed"]) == (False, True, False, False)
    done = run_process("vehicle", "restore", "--link", url)
    assert (done.code, "given back" in done.out) == (0, True), done.err + done.out
    after = json.loads(run_process("vehicle", "identify", "--link", url, "--json").out)
    assert (after["locked"], after["answers"]) == (False, True)
    assert complaint


@pytest.mark.slow
def test_a_terminal_that_asks_sends_no_heartbeat(here: Path) -> None:
    """Neither `vehicle identify` nor its restoration: the vehicle's failsafe would take it for a ground station."""
    (port,) = free_ports(1)
    heard: list[int] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", port))
        listener.settimeout(0.2)

        def listen() -> None:
            while len(heard) < 10_000:
                try:
                    data = listener.recv(300)
                except TimeoutError:
                    if asked.is_set():
                        return
                    continue
                heard.append(int.from_bytes(data[7:10], "little"))

        asked = threading.Event()
        thread = threading.Thread(target=listen)
        thread.start()
        done = run_process("vehicle", "identify", "--link", f"udpout:127.0.0.1:{port}", "--timeout", "2")
        asked.set()
        thread.join()
    assert (done.code, "no autopilot was heard" in done.err) == (2, True)
    assert heard
    assert mavlink.MAVLINK_MSG_ID_HEARTBEAT not in heard


def test_a_lock_nobody_noted_is_ended_only_when_told_so(here: Path) -> None:
    plan: Plan = relay_plan(3)
    lock = [part for text in ("MAV_OPTIONS=1", "MAV_GCS_SYSID=11", "MAV_GCS_SYSID_HI=12") for part in ("--param", text)]
    with simulator(plan, "ardupilot", 1.0, *lock) as vehicle:
        url = next(iter(vehicle.links.values()))
        kept = json.loads(run_process("vehicle", "restore", "--link", url, "--json").out)
        assert (kept["notes"], kept["locked"], kept["given_back"]) == (0, True, [])
        ended = json.loads(run_process("vehicle", "restore", "--link", url, "--unlock", "--json").out)
        assert (ended["locked"], ended["given_back"]) == (False, ["MAV_OPTIONS"])
