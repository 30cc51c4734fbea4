"""The dialect is what the overlay says, generated to the same bytes everywhere, and agrees with the stock dialects."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega, common

from link.dialect import mavlink, regenerate
from tests.support.paths import ROOT

# The module pymavlink 2.4.50 makes of the overlay. It changes with either of them and with nothing else: read the diff
# of the module before and after, then write the new digest here.
SHA256 = "68fc9f0ed4895fa67edc0c08c3fdd84a78b1a6b24a0d8ce3d3168cf993b32527"


def digest(module: Path) -> str:
    return hashlib.sha256(module.read_bytes()).hexdigest()


def test_generated_to_the_same_bytes_everywhere(tmp_path: Path) -> None:
    regenerate.generate(tmp_path / "skyrelay.py")
    assert digest(tmp_path / "skyrelay.py") == SHA256


def test_the_module_in_use_is_the_one_the_overlay_makes() -> None:
    assert digest(regenerate.MODULE) == SHA256, "run `make setup`"


def test_built_with_the_pymavlink_it_runs_with() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    pins = [
        [line for line in lines if line.startswith("pymavlink")]
        for lines in (project["build-system"]["requires"], project["project"]["dependencies"])
    ]
    assert pins[0] == pins[1] == ["pymavlink==2.4.50"]


def test_a_missing_module_is_refused_with_what_to_do(tmp_path: Path) -> None:
    """A checkout nobody has set up yet: the error names the command, and the generator works."""
    folder = tmp_path / "link" / "dialect"
    folder.mkdir(parents=True)
    (tmp_path / "link" / "__init__.py").touch()
    for name in ("__init__.py", "regenerate.py", "skyrelay.xml"):
        shutil.copy(regenerate.HERE / name, folder)
    code = "from link.dialect import mavlink; print(mavlink.DIALECT)"
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, *arguments], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
        )

    refused = run("-c", code)
    assert refused.returncode == 1
    assert "ImportError: the MAVLink dialect link/dialect/skyrelay.py is generated" in refused.stderr
    assert "run `make setup`" in refused.stderr
    assert run("link/dialect/regenerate.py").returncode == 0
    assert run("-c", code).stdout == "skyrelay\n"


def test_command_line_writes_the_module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(regenerate, "MODULE", tmp_path / "skyrelay.py")
    assert regenerate.main() == 0
    assert (tmp_path / "skyrelay.py").stat().st_size > 1_000_000


def test_a_broken_overlay_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A message id taken twice: mavgen's words reach the developer."""
    broken = tmp_path / "skyrelay.xml"
    broken.write_text(regenerate.OVERLAY.read_text().replace('message id="512"', 'message id="84"'))
    monkeypatch.setattr(regenerate, "OVERLAY", broken)
    with pytest.raises(RuntimeError, match="Duplicate message id 84"):
        regenerate.generate(tmp_path / "out.py")


def test_control_status_is_the_current_upstream_form() -> None:
    """CRC_EXTRA 21 (the form of April 2026; the older one, 184, would be dropped by peers)."""
    kind = mavlink.MAVLink_control_status_message
    assert (kind.id, kind.crc_extra) == (512, 21)
    assert kind.ordered_fieldnames == ["flags", "gcs_main", "gcs_secondary"]
    sender = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    frame = kind(3, 241, [242, 243, 0, 0, 0, 0, 0, 0, 0, 0]).pack(sender)
    got = mavlink.MAVLink(None).decode(bytearray(frame))
    assert (got.flags, got.gcs_main, got.gcs_secondary[:3]) == (3, 241, [242, 243, 0])


def test_operator_control_command_and_result() -> None:
    assert mavlink.MAV_CMD_REQUEST_OPERATOR_CONTROL == 32100
    assert mavlink.MAV_RESULT_NOT_IN_CONTROL == 10
    assert mavlink.enums["MAV_CMD"][32100].label[3] == "Timeout"
    # Merged into the stock enums, not in place of them.
    assert mavlink.MAV_RESULT_ACCEPTED == 0
    assert mavlink.enums["MAV_RESULT"][10].name == "MAV_RESULT_NOT_IN_CONTROL"
    assert mavlink.MAV_CMD_DO_SET_MODE == 176


def test_every_message_of_common_is_there_unchanged() -> None:
    for message_id, kind in common.mavlink_map.items():
        ours = mavlink.mavlink_map[message_id]
        assert (ours.msgname, ours.crc_extra, ours.fieldnames) == (kind.msgname, kind.crc_extra, kind.fieldnames)
    assert set(mavlink.mavlink_map) - set(common.mavlink_map) == {193, 512}


def test_what_a_flight_needs_is_there() -> None:
    """ArduPilot and PX4 messages a flight uses; of ardupilotmega.xml only 193 is among them, as it is there."""
    wanted = (
        0,
        1,
        2,
        20,
        22,
        23,
        24,
        30,
        32,
        33,
        44,
        47,
        48,
        49,
        51,
        73,
        76,
        77,
        84,
        85,
        86,
        87,
        109,
        111,
        147,
        148,
        193,
        242,
        245,
        253,
    )
    assert [i for i in wanted if i not in mavlink.mavlink_map] == []
    ours, theirs = mavlink.MAVLink_ekf_status_report_message, ardupilotmega.MAVLink_ekf_status_report_message
    assert (ours.crc_extra, ours.fieldnames, ours.fieldtypes) == (
        theirs.crc_extra,
        theirs.fieldnames,
        theirs.fieldtypes,
    )


def test_speaks_mavlink_2_whatever_the_environment_says() -> None:
    """mavutil speaks MAVLink 1 unless MAVLINK20 is set; our module does not ask."""
    code = (
        "from link.dialect import mavlink as m; "
        "print(m.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(m.MAVLink(None, 241, 190))[0])"
    )
    clean = {name: value for name, value in os.environ.items() if not name.startswith("MAVLINK")}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=clean)
    assert done.stdout.strip() == "253"
