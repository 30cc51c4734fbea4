"""``skyrelay doctor --vehicle``: a simulated vehicle looked at through MAVSDK; exit codes and what is said."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.support.flights.processes import ROOT, free_ports

mavsdk = pytest.importorskip("mavsdk")
pytestmark = pytest.mark.slow

SAFE = {
    "px4": ("COM_OBL_RC_ACT=5", "NAV_DLL_ACT=2", "COM_RCL_EXCEPT=4", "COM_LOW_BAT_ACT=3"),
    "ardupilot": ("FS_GCS_ENABLE=1", "BATT_FS_LOW_ACT=2"),
}
NAMED = {"px4": "COM_OBL_RC_ACT", "ardupilot": "FS_GCS_ENABLE"}


@contextlib.contextmanager
def vehicle(autopilot: str, *parameters: str) -> Iterator[str]:
    """A simulated vehicle; the link URL to it."""
    (port,) = free_ports(1)
    command = [sys.executable, "-m", "sitl_fixtures", "--autopilot", autopilot, "--speedup", "5"]
    command += ["--listen", f"udpin:127.0.0.1:{port}", *(f"--param={p}" for p in parameters)]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE)
    try:
        assert process.stdout is not None
        assert process.stdout.readline().startswith(b"ready")
        yield f"udpout:127.0.0.1:{port}"
    finally:
        process.terminate()
        process.wait(20)


def doctor(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "api.cli", "doctor", *arguments]
    return subprocess.run(
        command, cwd=ROOT, env={**os.environ, **environment}, capture_output=True, text=True, timeout=120
    )


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_a_stock_vehicle_is_not_fit_and_a_safe_one_is(autopilot: str) -> None:
    with vehicle(autopilot) as url:
        stock = doctor("--vehicle", url, "--json")
    assert stock.returncode == 4
    assert stock.stderr == ""
    document = json.loads(stock.stdout)
    assert document["fit"] is False
    assert document["vehicle"]["autopilot"] == autopilot
    assert document["vehicle"]["version"] == {"px4": "1.17.0", "ardupilot": "4.7.0"}[autopilot]
    assert document["vehicle"]["git_hash"] == "simulatd"
    found: dict[str, Any] = {check["name"]: check for check in document["checks"]}
    assert found[NAMED[autopilot]]["level"] == "failure"
    assert found[NAMED[autopilot]]["set"]["name"] == NAMED[autopilot]
    order = [["error", "failure", "warning", "pass"].index(c["level"]) for c in document["checks"]]
    assert order == sorted(order)

    with vehicle(autopilot, *SAFE[autopilot]) as url:
        safe = doctor("--vehicle", url)
    assert safe.returncode == 0, safe.stdout + safe.stderr
    assert safe.stdout.rstrip().endswith("fit for a flight")
    assert "NOT" not in safe.stdout
    assert "git simulatd" in safe.stdout


def test_a_vehicle_that_hears_others_alone_is_asked_as_one_of_them() -> None:
    locked = ("MAV_OPTIONS=1", "MAV_GCS_SYSID=200", *SAFE["ardupilot"])
    with vehicle("ardupilot", *locked) as url:
        one_of_them = doctor("--vehicle", url, "--system-id", "200")
    assert one_of_them.returncode == 0, one_of_them.stdout + one_of_them.stderr


@pytest.mark.parametrize(
    ("url", "said"),
    [
        ("udp://127.0.0.1:14540", "unknown kind"),
        ("udpout:127.0.0.1", "where:    --vehicle"),
        ("serial:/dev/no-such-device:57600", "the link cannot be opened"),
    ],
)
def test_a_link_that_cannot_be_used_is_bad_input(url: str, said: str) -> None:
    result = doctor("--vehicle", url)
    assert result.returncode == 2
    assert result.stdout == ""
    assert said in result.stderr
    assert "Traceback" not in result.stderr


def test_nobody_there_is_said_with_what_to_look_at() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as silent:
        silent.bind(("127.0.0.1", 0))
        result = doctor("--vehicle", f"udpout:127.0.0.1:{silent.getsockname()[1]}", "--timeout", "1")
    assert result.returncode == 2
    assert "no autopilot was heard in 1 s" in result.stderr
    assert "fix:" in result.stderr


def test_a_link_a_flight_uses_is_left_alone(tmp_path: Path) -> None:
    from link.transport.port_lock import LinkLocks

    url = "udpout:127.0.0.1:14999"
    locks = LinkLocks([url])
    try:
        result = doctor("--vehicle", url)
    finally:
        locks.release()
    assert result.returncode == 2
    assert "another flight on this machine uses this link" in result.stderr


def test_without_mavsdk_it_says_what_to_install(tmp_path: Path) -> None:
    (tmp_path / "mavsdk.py").write_text("raise ImportError('not here')\n")
    result = doctor("--vehicle", "udpout:127.0.0.1:14998", PYTHONPATH=f"{tmp_path}{os.pathsep}{ROOT}")
    assert result.returncode == 2
    assert "skyrelay[witness]" in result.stderr
