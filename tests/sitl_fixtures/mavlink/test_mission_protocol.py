"""Mission, rally and fence transfer: codes, clocks, what is left after a failure; and flying a mission."""

from __future__ import annotations

from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from tests.support.sitl.station import ACCEPTED, GUIDED, Rig, Station, airborne


def item(seq: int, command: int = 16, lat: float = 0.0, lon: float = 0.0, alt: float = 30.0, kind: int = 0) -> Any:
    """A MISSION_ITEM_INT relative to home, degrees from 53 N 5 E."""
    return mavlink.MAVLink_mission_item_int_message(
        1, 1, seq, 3, command, 0, 1, 0, 0, 0, 0, round((53.0 + lat) * 1e7), round((5.0 + lon) * 1e7), alt, kind
    )


def upload(station: Station, items: list[Any], kind: int = 0) -> int:
    """Uploads, answering each request; the type of the MISSION_ACK."""
    station.last.pop("MISSION_ACK", None)
    station.send(mavlink.MAVLink_mission_count_message(1, 1, len(items), kind))
    while "MISSION_ACK" not in station.last:
        asked = [m for _, m in station.heard if m.get_type() in ("MISSION_REQUEST", "MISSION_REQUEST_INT")][-1]
        station.send(items[asked.seq])
    return int(station.last["MISSION_ACK"].type)


def download(station: Station, kind: int = 0) -> list[tuple[int, float]]:
    """(command, altitude) of every item the vehicle has."""
    station.send(mavlink.MAVLink_mission_request_list_message(1, 1, kind))
    found = []
    for seq in range(station.last["MISSION_COUNT"].count):
        station.send(mavlink.MAVLink_mission_request_int_message(1, 1, seq, kind))
        got = station.last["MISSION_ITEM_INT"]
        assert got.seq == seq
        found.append((got.command, round(got.z, 1)))
    station.send(mavlink.MAVLink_mission_ack_message(1, 1, 0, kind))
    return found


def ready(autopilot: str, **options: Any) -> tuple[Rig, Station]:
    rig = Rig(autopilot, home=(53.0, 5.0, 10.0), **options)
    station = rig.station()
    rig.run(3.0)
    return rig, station


GOOD = [item(0), item(1, 22, alt=20.0), item(2, lat=0.001), item(3, lat=0.001, lon=0.001), item(4, 21)]


def test_ardupilot_asks_with_mission_request_and_keeps_home_as_item_zero() -> None:
    _, station = ready("ardupilot")
    assert upload(station, GOOD) == 0
    assert station.of("MISSION_REQUEST")
    assert not station.of("MISSION_REQUEST_INT")
    assert download(station) == [(16, 10.0), (22, 20.0), (16, 30.0), (16, 30.0), (21, 30.0)]
    assert "Flight plan received" in station.texts()


def test_px4_asks_with_mission_request_int_and_keeps_item_zero() -> None:
    _, station = ready("px4")
    assert upload(station, GOOD) == 0
    assert not station.of("MISSION_REQUEST")
    assert download(station) == [(16, 30.0), (22, 20.0), (16, 30.0), (16, 30.0), (21, 30.0)]


@pytest.mark.parametrize(
    ("autopilot", "again_s", "end_s", "text", "left"),
    [
        ("ardupilot", 1.0, 8.0, "Mission upload timeout", [(16, 10.0), (22, 99.0), (16, 30.0), (16, 30.0), (21, 30.0)]),
        ("px4", 0.255, 5.0, "Operation timeout", [(16, 30.0), (22, 20.0), (16, 30.0), (16, 30.0), (21, 30.0)]),
    ],
)
def test_a_broken_upload(
    autopilot: str, again_s: float, end_s: float, text: str, left: list[tuple[int, float]]
) -> None:
    """ArduPilot is left with a mixture of new and old, PX4 with the old one whole."""
    rig, station = ready(autopilot)
    upload(station, GOOD)
    station.last.pop("MISSION_ACK")
    start = rig.now
    station.send(mavlink.MAVLink_mission_count_message(1, 1, 5, 0))
    station.send(item(0, alt=99.0))
    station.send(item(1, 22, alt=99.0))
    asked = {"ardupilot": "MISSION_REQUEST", "px4": "MISSION_REQUEST_INT"}[autopilot]
    rig.run(end_s - 0.1)
    repeats = [m for m in station.of(asked, start) if m.seq == 2]
    assert len(repeats) == pytest.approx(1 + (end_s - 0.1) / again_s, abs=1.0)
    assert text not in station.texts(start)
    rig.run(0.3)
    assert text in station.texts(start)
    assert ("MISSION_ACK" in station.last) == (autopilot == "ardupilot")
    if autopilot == "ardupilot":
        assert station.last["MISSION_ACK"].type == 15
    assert download(station) == left


@pytest.mark.parametrize(("autopilot", "ends"), [("ardupilot", False), ("px4", True)])
def test_the_stations_cancel(autopilot: str, ends: bool) -> None:
    rig, station = ready(autopilot)
    station.send(mavlink.MAVLink_mission_count_message(1, 1, 5, 0))
    station.send(mavlink.MAVLink_mission_ack_message(1, 1, 15, 0))
    start = rig.now + 0.01
    rig.run(3.0)
    again = station.of("MISSION_REQUEST", start) + station.of("MISSION_REQUEST_INT", start)
    assert (again == []) == ends


@pytest.mark.parametrize(("autopilot", "answer"), [("ardupilot", 13), ("px4", None)])
def test_out_of_order(autopilot: str, answer: int | None) -> None:
    _, station = ready(autopilot)
    station.send(mavlink.MAVLink_mission_count_message(1, 1, 5, 0))
    station.send(item(3))
    ack = station.last.get("MISSION_ACK")
    assert (ack and ack.type) == answer
    for index in range(5):
        station.send(GOOD[index])
    assert station.last["MISSION_ACK"].type == 0


@pytest.mark.parametrize(
    ("autopilot", "bad", "code"),
    [
        ("ardupilot", item(0, 12345), 3),
        ("px4", item(0, 12345), 3),
        ("ardupilot", item(0, lat=42.0), 10),
        ("px4", item(0, lat=42.0), 0),
    ],
)
def test_items_refused_or_not(autopilot: str, bad: Any, code: int) -> None:
    _, station = ready(autopilot)
    assert upload(station, [bad]) == code


@pytest.mark.parametrize(("autopilot", "codes"), [("ardupilot", (14, 1, 4)), ("px4", (1, 1, 4))])
def test_second_station_stray_item_and_too_many(autopilot: str, codes: tuple[int, int, int]) -> None:
    rig, a = ready(autopilot, links=2)
    b = rig.station(1, 254)
    a.send(item(1))
    assert a.last["MISSION_ACK"].type == codes[1]
    a.send(mavlink.MAVLink_mission_count_message(1, 1, 60000, 0))
    assert a.last["MISSION_ACK"].type == codes[2]
    a.send(mavlink.MAVLink_mission_count_message(1, 1, 5, 0))
    b.send(mavlink.MAVLink_mission_count_message(1, 1, 5, 0))
    assert b.last["MISSION_ACK"].type == codes[0]


def test_plans_of_each_kind_are_kept_apart_and_cleared_alone() -> None:
    _, station = ready("px4")
    upload(station, GOOD)
    assert upload(station, [item(0, 5100, kind=2), item(1, 5100, lat=0.01, kind=2)], kind=2) == 0
    assert upload(station, [item(0, 16, kind=2)], kind=2) == 3
    station.send(mavlink.MAVLink_mission_clear_all_message(1, 1, 0))
    assert download(station) == []
    assert [command for command, _ in download(station, 2)] == [5100, 5100]
    station.send(mavlink.MAVLink_mission_count_message(1, 1, 0, 2))
    assert station.last["MISSION_ACK"].type == 0
    assert download(station, 2) == []


def test_wrong_target_is_met_with_silence() -> None:
    _, station = ready("ardupilot")
    station.send(mavlink.MAVLink_mission_count_message(9, 1, 5, 0))
    assert not station.of("MISSION_REQUEST")


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_flies_the_mission_it_was_given(autopilot: str) -> None:
    rig, station = airborne(autopilot, 20.0, home=(53.0, 5.0, 10.0))
    items = [item(0, 16), item(1, 16, lat=0.001), item(2, 16, lat=0.001, lon=0.002), item(3, 21, lat=0.001, lon=0.002)]
    if autopilot == "px4":
        items = [item(0, 16, lat=0.001), item(1, 16, lat=0.001, lon=0.002), item(2, 21, lat=0.001, lon=0.002)]
    assert upload(station, items) == 0
    rig.streams.clear()
    assert station.command(300) == [ACCEPTED]
    rig.until(lambda: not rig.sim.autopilot.armed, 250.0)
    reached = [m.seq for m in station.of("MISSION_ITEM_REACHED")]
    assert reached == ([0, 1] if autopilot == "px4" else [1, 2])
    # 0.001 degree of latitude is 111 m, 0.002 of longitude at 53 N 134 m.
    assert (rig.place[0], rig.place[1]) == pytest.approx((111.25, 134.1), abs=1.5)


def test_a_mission_takes_off_by_itself() -> None:
    rig, station = ready("ardupilot")
    upload(station, [item(0), item(1, 22, alt=20.0), item(2, lat=0.0005, alt=20.0), item(3, 20)])
    assert station.set_mode(GUIDED) == [ACCEPTED]
    station.arm()
    assert station.set_mode(3) == [ACCEPTED]
    rig.until(lambda: rig.place[2] < -19.0, 60.0)
    rig.until(lambda: not rig.sim.autopilot.armed, 200.0)
    assert rig.off(0, 0) < 1.0


def test_px4_refuses_a_mission_it_does_not_have() -> None:
    rig, station = airborne("px4")
    station.set_mode((4, 4))
    assert rig.mode == "OFFBOARD"
    assert "Switching to Mission is currently not available" in station.texts()
