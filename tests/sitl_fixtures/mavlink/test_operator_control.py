"""CONTROL_STATUS and command 32100, which no stock autopilot speaks: ``operator_control.py``, row by row."""

from __future__ import annotations

import struct

import pytest

from tests.support.sitl.station import ACCEPTED, FAILED, OFFBOARD, UNSUPPORTED, Rig, Station

REQUEST = 32100
NOT_IN_CONTROL = 10


def crc(data: bytes) -> int:
    """CRC-16/MCRF4XX, bit by bit."""
    value = 0xFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (0x8408 if value & 1 else 0)
    return value


def statuses(rig: Rig, link: int = 0) -> list[tuple[float, int, int]]:
    """(time, flags, gcs_main) of every CONTROL_STATUS on a link, read off the raw frames."""
    found = []
    for now, at, frame in rig.frames:
        if at == link and int.from_bytes(frame[7:10], "little") == 512:
            end = 10 + frame[1]
            assert struct.unpack("<H", frame[end : end + 2])[0] == crc(frame[1:end] + bytes((21,)))
            payload = frame[10:end].ljust(12, b"\0")
            assert payload[2:] == bytes(10)
            found.append((now, payload[0], payload[1]))
    return found


@pytest.fixture
def stations() -> tuple[Rig, Station, Station]:
    rig = Rig("px4", links=2, speaks_operator_control=True)
    a, b = rig.station(0, 255), rig.station(1, 254)
    rig.run(4.0)
    return rig, a, b


def test_status_comes_once_a_second_on_every_link(stations: tuple[Rig, Station, Station]) -> None:
    rig, _, _ = stations
    start = rig.now
    rig.run(10.0)
    for link in (0, 1):
        recent = [s for s in statuses(rig, link) if s[0] > start]
        assert len(recent) in (9, 10, 11)
        assert {(flags, owner) for _, flags, owner in recent} == {(1, 0)}


def test_nobody_in_control_anyone_may_take_it(stations: tuple[Rig, Station, Station]) -> None:
    rig, a, b = stations
    assert b.set_mode(OFFBOARD) == [ACCEPTED, ACCEPTED]
    assert a.command(REQUEST, 1, 0, 10, 255) == [ACCEPTED]
    assert statuses(rig)[-1][1:] == (1, 255)
    assert statuses(rig)[-1][0] == rig.now  # on change, at once


def test_others_are_told_that_they_are_not_in_control(stations: tuple[Rig, Station, Station]) -> None:
    rig, a, b = stations
    a.command(REQUEST, 1, 0, 10, 255)
    assert b.set_mode(OFFBOARD) == [NOT_IN_CONTROL]
    assert b.arm() == [NOT_IN_CONTROL]
    assert b.set_parameter("COM_OF_LOSS_T", 2.0) is None
    assert b.read_parameter("COM_OF_LOSS_T")
    assert b.command(512, 148) == [ACCEPTED]
    a.set_mode(OFFBOARD)
    count = len(rig.sim.accepted_setpoints)
    b.local((1, 0, 0))
    assert len(rig.sim.accepted_setpoints) == count
    a.local((1, 0, 0))
    assert len(rig.sim.accepted_setpoints) == count + 1


def test_a_request_is_refused_forwarded_and_granted(stations: tuple[Rig, Station, Station]) -> None:
    rig, a, b = stations
    a.command(REQUEST, 1, 0, 10, 255)
    assert b.command(REQUEST, 1, 0, 10, 254) == [FAILED]
    forwarded = a.last["COMMAND_LONG"]
    assert (forwarded.command, forwarded.target_system, forwarded.param4) == (REQUEST, 255, 254)
    assert "COMMAND_LONG" not in b.last
    assert a.command(REQUEST, 1, 1, 10, 255) == [ACCEPTED]
    assert statuses(rig)[-1][1:] == (3, 255)
    assert b.command(REQUEST, 1, 0, 10, 254) == [ACCEPTED]
    assert statuses(rig)[-1][1:] == (1, 254)
    assert a.arm() == [NOT_IN_CONTROL]


def test_the_window_closes_after_ten_seconds(stations: tuple[Rig, Station, Station]) -> None:
    rig, a, b = stations
    a.command(REQUEST, 1, 0, 10, 255)
    a.command(REQUEST, 1, 1, 10, 255)
    rig.run(9.9)
    assert statuses(rig)[-1][1:] == (3, 255)
    rig.run(0.3)
    assert statuses(rig)[-1][1:] == (1, 255)
    assert b.command(REQUEST, 1, 0, 10, 254) == [FAILED]


def test_release_and_a_lost_owner_leave_nobody(stations: tuple[Rig, Station, Station]) -> None:
    rig, a, b = stations
    a.command(REQUEST, 1, 0, 10, 255)
    assert b.command(REQUEST, 0) == [FAILED]
    assert a.command(REQUEST, 0) == [ACCEPTED]
    assert statuses(rig)[-1][2] == 0
    a.command(REQUEST, 1, 0, 10, 255)
    a.beating = False
    rig.run(6.5)
    assert statuses(rig)[-1][2] == 0


def test_without_the_option_it_is_not_spoken() -> None:
    rig = Rig("px4")
    station = rig.station()
    rig.run(3.0)
    assert station.command(REQUEST, 1, 0, 10, 255) == [UNSUPPORTED]
    assert statuses(rig) == []
