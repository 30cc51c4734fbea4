"""The demonstration: it flies, it reports, and it leaves nothing behind."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import httpx
import pytest

from api.cli.demo.story import Pace
from tests.support.missions.malformed import GOOD
from tests.support.processes.cli_process import SKYRELAY, Outcome, run_process
from tests.support.processes.tree import descendants, gone

Cli = Callable[..., Outcome]


def sessions_of(marker: str) -> set[int]:
    """Processes that carry ``marker`` in their environment: children in sessions of their own are found too."""
    found = set()
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                if marker.encode() in (entry / "environ").read_bytes():
                    found.add(int(entry.name))
            except OSError:
                continue
    return found - {os.getpid()}


@pytest.mark.slow
def test_the_quick_demonstration_flies_and_reports(tmp_path: Path) -> None:
    marker = f"DEMO_TEST={tmp_path.name}-{time.monotonic_ns()}"
    environment = {**os.environ, "DEMO_TEST": marker.split("=", 1)[1], "TMPDIR": str(tmp_path)}
    outcome = run_process("demo", "--quick", env=environment, cwd=tmp_path, timeout_s=240)
    assert (outcome.code, outcome.err) == (0, "")
    for said in ("west > east", "west in control", "handover 1, west to east: done", "arrived", "Tracking", "Arrived."):
        assert said in outcome.out
    assert re.search(r"east in control, T\+ 0:\d\d:\d\d of", outcome.out)
    assert gone(sessions_of(marker))
    left = list(os.listdir(tmp_path))
    assert left == []  # not in the current folder, not in the temporary one


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_demonstration_leaves_no_process(tmp_path: Path, number: int) -> None:
    marker = f"DEMO_TEST={tmp_path.name}-{time.monotonic_ns()}"
    environment = {**os.environ, "DEMO_TEST": marker.split("=", 1)[1]}
    command = subprocess.Popen(
        [*SKYRELAY, "demo", "--quick"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
    )
    assert command.stdout is not None
    assert command.stderr is not None
    for line in command.stdout:
        if "takeoff" in line or "cruise" in line:
            break
    children = sessions_of(marker)
    assert len(children) >= 3  # itself, the simulator, the streamer
    command.send_signal(number)
    time.sleep(0.5)
    command.send_signal(number)  # in the air the first is the word to abort
    command.stdout.read()
    said = command.stderr.read()
    assert command.wait(30) == 128 + number
    assert "Traceback" not in said
    assert gone(children)
    command.stdout.close()
    command.stderr.close()


@pytest.mark.slow
def test_the_service_of_the_demonstration_flies_stays_up_and_ends_with_ctrl_c(tmp_path: Path) -> None:
    marker = f"DEMO_TEST={tmp_path.name}-{time.monotonic_ns()}"
    environment = {**os.environ, "DEMO_TEST": marker.split("=", 1)[1]}
    command = subprocess.Popen(
        [*SKYRELAY, "demo", "--serve", "--quick"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
    )
    assert command.stdout is not None
    assert command.stderr is not None
    said = ""
    for line in command.stdout:
        said += line
        if "stays up at" in line:
            break
    assert "Arrived." in said, said + command.stderr.read()
    address = re.search(r"stays up at (http://\S+)", said)
    assert address is not None
    page = httpx.get(address.group(1))
    assert "skyrelay" in page.text
    (flight,) = httpx.get(f"{address.group(1)}v1/flights").json()["items"]
    assert flight["state"] == "completed"
    processes = sessions_of(marker) | descendants(command.pid)
    command.send_signal(signal.SIGINT)
    command.stdout.read()
    complaint = command.stderr.read()
    assert command.wait(30) == 130
    assert complaint == ""
    assert gone(processes)
    command.stdout.close()
    command.stderr.close()


@pytest.mark.parametrize(
    ("mission_time_s", "wall_s", "speedup", "rate_hz"),
    [(5000.0, 70.0, 5120.0 / 70.0, 10.0), (60.0, 15.0, 12.0, 20.0), (0.0, 1000.0, 1.0, 20.0), (1e6, 70.0, 100.0, 8.0)],
)
def test_the_pace_fits_the_wall_time(mission_time_s: float, wall_s: float, speedup: float, rate_hz: float) -> None:
    pace = Pace.of(mission_time_s, wall_s)
    assert (pace.speedup, pace.rate_hz) == (pytest.approx(speedup), rate_hz)
    assert pace.slower().speedup == max(1.0, pace.speedup / 2)


def test_missions_that_cannot_be_flown_are_met_before_anything_starts(cli: Cli, tmp_path: Path) -> None:
    import json

    (tmp_path / "bad.json").write_text(json.dumps({**GOOD, "stations": []}))
    outcome = cli("demo", "--mission", tmp_path / "bad.json")
    assert outcome.code == 2
    assert "stations" in outcome.err
    assert outcome.out == ""
    assert cli("demo", "--quick", "--mission", tmp_path / "bad.json").code == 2
