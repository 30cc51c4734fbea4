"""The dialect is what the overlay says, regenerates to the same bytes, and agrees with the stock dialects."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common

from link.dialect import mavlink, regenerate


def test_regenerating_gives_the_committed_module(tmp_path: Path) -> None:
    regenerate.generate(tmp_path / "skyrelay.py")
    assert (tmp_path / "skyrelay.py").read_bytes() == regenerate.MODULE.read_bytes()


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
    assert set(mavlink.mavlink_map) - set(common.mavlink_map) == {512}


def test_what_a_flight_needs_is_there() -> None:
    """ArduPilot and PX4 messages a flight uses; nothing of ardupilotmega.xml is among them."""
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
        242,
        245,
        253,
    )
    assert [i for i in wanted if i not in mavlink.mavlink_map] == []


def test_speaks_mavlink_2_whatever_the_environment_says() -> None:
    """mavutil speaks MAVLink 1 unless MAVLINK20 is set; our module does not ask."""
    code = (
        "from link.dialect import mavlink as m; "
        "print(m.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(m.MAVLink(None, 241, 190))[0])"
    )
    clean = {name: value for name, value in os.environ.items() if not name.startswith("MAVLINK")}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=clean)
    assert done.stdout.strip() == "253"
