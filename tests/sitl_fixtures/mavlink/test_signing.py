"""MAVLink 2 signing as the vehicle does it: every rejection silent, the signature looked at before the stamp."""

from __future__ import annotations

import hashlib
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from tests.support.sitl.station import GUIDED, Rig, Station

KEY, WRONG = hashlib.sha256(b"right").digest(), hashlib.sha256(b"wrong").digest()
STAMP = 37_524_196_245_164
SECOND = 100_000


@pytest.fixture
def links() -> tuple[Rig, Station, Station]:
    """A vehicle with a key set over link 1, a station on each link."""
    rig = Rig("ardupilot", links=2)
    first, second = rig.station(0, 255), rig.station(1, 254)
    rig.run(3.0)
    second.send(mavlink.MAVLink_setup_signing_message(1, 1, list(KEY), STAMP))
    return rig, first, second


def read(station: Station, *, key: bytes | None = KEY, link_id: int = 3, stamp: int = STAMP + 60 * SECOND) -> bool:
    """Whether a parameter read, signed or not, is answered."""
    signing = station.mav.signing
    signing.sign_outgoing = key is not None
    signing.secret_key, signing.link_id, signing.timestamp = key, link_id, stamp
    answered = station.read_parameter("GUID_TIMEOUT") is not None
    signing.sign_outgoing = False
    return answered


def last_frame(rig: Rig, link: int) -> bytes:
    return [data for _, at, data in rig.frames if at == link][-1]


def stamp_of(frame: bytes) -> int:
    return int.from_bytes(frame[-12:-6], "little")


def test_frames_are_signed_with_a_stamp_a_minute_ahead_that_moves_by_one(links: tuple[Rig, Station, Station]) -> None:
    rig, _, _ = links
    count = len(rig.frames)
    rig.run(3.0)
    for link in (0, 1):
        signed = [data for _, at, data in rig.frames[count:] if at == link]
        assert all(frame[2] & 1 and frame[-13] == link for frame in signed)
        assert [stamp_of(frame) for frame in signed] == list(
            range(STAMP + 60 * SECOND + 1, STAMP + 60 * SECOND + 1 + len(signed))
        )
        frame = signed[-1]
        assert frame[-6:] == hashlib.sha256(KEY + frame[:-6]).digest()[:6]


def test_the_first_link_takes_anything(links: tuple[Rig, Station, Station]) -> None:
    _, first, _ = links
    assert read(first, key=None)
    assert read(first, key=WRONG)
    assert read(first)


def test_other_links_drop_what_is_not_genuine(links: tuple[Rig, Station, Station]) -> None:
    rig, _, second = links
    assert not read(second, key=None)
    assert not read(second, key=WRONG)
    assert read(second)
    count = len(rig.sim.accepted_setpoints)
    second.set_mode(GUIDED)
    second.local((10, 0, 0))
    assert len(rig.sim.accepted_setpoints) == count


def test_replays_and_old_stamps(links: tuple[Rig, Station, Station]) -> None:
    """A known stream must move on; a new one may be up to 60 s behind the vehicle."""
    _, _, second = links
    now = STAMP + 60 * SECOND
    assert read(second, stamp=now + 500)
    assert not read(second, stamp=now + 500)
    assert not read(second, stamp=now + 499)
    assert read(second, stamp=now + 501)
    assert read(second, link_id=6, stamp=now - 50 * SECOND)
    assert not read(second, link_id=8, stamp=now - 70 * SECOND)


def test_a_forged_stamp_does_not_lock_the_genuine_stream_out(links: tuple[Rig, Station, Station]) -> None:
    _, _, second = links
    now = STAMP + 60 * SECOND
    assert read(second, stamp=now + 1)
    assert not read(second, key=WRONG, stamp=now + 3600 * SECOND)
    assert read(second, stamp=now + 2)


def test_a_genuine_stamp_ahead_is_adopted(links: tuple[Rig, Station, Station]) -> None:
    rig, _, second = links
    ahead = STAMP + 1000 * SECOND
    assert read(second, stamp=ahead)
    assert stamp_of(last_frame(rig, 1)) == ahead + 1
    assert stamp_of(last_frame(rig, 0)) < ahead


def test_set_up_is_refused_while_armed_and_zeros_turn_it_off(links: tuple[Rig, Station, Station]) -> None:
    rig, first, second = links
    first.set_mode(GUIDED)
    first.arm()
    first.send(mavlink.MAVLink_setup_signing_message(1, 1, list(WRONG), STAMP))
    assert "ERROR: Won't setup signing when armed" in first.texts()
    assert read(second)
    first.arm(False)
    first.send(mavlink.MAVLink_setup_signing_message(1, 1, [0] * 32, 0))
    rig.run(1.1)
    assert not last_frame(rig, 1)[2] & 1
    assert read(second, key=None)


def test_px4_does_not_sign() -> None:
    rig = Rig("px4")
    station = rig.station()
    rig.run(3.0)
    station.send(mavlink.MAVLink_setup_signing_message(1, 1, list(KEY), STAMP))
    rig.run(1.1)
    frames: list[Any] = [data for _, _, data in rig.frames]
    assert not any(frame[2] & 1 for frame in frames)
