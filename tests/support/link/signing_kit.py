"""Clocks, codecs and frames for the tests of message signing."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from typing import Any

from link.dialect import mavlink
from link.wire.codec import StationCodec
from link.wire.signing import (
    EPOCH_UNIX_S,
    UNITS_PER_S,
    Signing,
    SigningKey,
    Verdict,
)
from link.wire.signing_timestamps import SigningStore

SECRET = bytes(range(1, 33))
KEY = SigningKey(SECRET)
HEARTBEAT = mavlink.MAVLink_heartbeat_message(2, 3, 81, 4, 4, 3)

NOW = int((1_795_338_000 - EPOCH_UNIX_S) * UNITS_PER_S)  # 2026-11-22T09:00:00Z


class Clock:
    """Stamps moved by hand."""

    def __init__(self, stamp: int = NOW) -> None:
        self.stamp = stamp

    def __call__(self) -> int:
        return self.stamp

    def advance(self, seconds: float) -> None:
        self.stamp += int(seconds * UNITS_PER_S)


def make(
    clock: Callable[[], int],
    *,
    system: int = 241,
    component: int = 190,
    link_id: int | None = None,
    key: SigningKey = KEY,
    store: SigningStore | None = None,
    allow: tuple[int, ...] = (),
) -> StationCodec:
    signing = Signing(
        key,
        link_id if link_id is not None else system,
        store if store is not None else SigningStore.in_memory(),
        allow_unsigned=allow,
        now=clock,
    )
    return StationCodec(system, component, signing=signing)


def vehicle(clock: Callable[[], int], **options: Any) -> StationCodec:
    return make(clock, **{"system": 1, "component": 1, "link_id": 0, **options})


def sign(
    message: Any = HEARTBEAT,
    *,
    stamp: int = NOW,
    link_id: int = 0,
    secret: bytes = SECRET,
    system: int = 1,
    component: int = 1,
    sequence: int = 0,
) -> bytes:
    """A frame signed by hand, straight from the rule in the MAVLink guide."""
    state = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)
    state.seq = sequence
    plain = bytearray(message.pack(state))
    plain[2] |= 1
    crc = mavlink.x25crc(bytes(plain[1:-2]) + bytes([mavlink.mavlink_map[message.get_msgId()].crc_extra])).crc
    plain[-2:] = crc.to_bytes(2, "little")
    plain += bytes([link_id]) + stamp.to_bytes(6, "little")
    return bytes(plain) + hashlib.sha256(secret + bytes(plain)).digest()[:6]


def stamp_of(frame: bytes) -> int:
    return int.from_bytes(frame[-12:-6], "little")


def taken(codec: StationCodec, frame: bytes) -> bool:
    return len(codec.decode(frame)) == 1


def refused(codec: StationCodec, frame: bytes, verdict: Verdict) -> bool:
    before = codec.stats.refused.get(verdict.value, 0)
    return codec.decode(frame) == [] and codec.stats.refused.get(verdict.value, 0) == before + 1
