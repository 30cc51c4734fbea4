"""A flight in virtual time recorded as the streamer records one, over a log's bytes; and damage done to such a log."""

from __future__ import annotations

import random
import struct
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from gcs.plan.model import Plan
from link.streamer.recorder import Recorder
from tests.support.flights.virtual import EPOCH_UNIX_S, VirtualFlight
from tests.support.plans.planned import relay_plan

PLAN_STATIONS = 2


def plan() -> Plan:
    return relay_plan(PLAN_STATIONS)


@cache
def recorded(autopilot: str = "ardupilot", ways: int = 3) -> bytes:
    """The log of a whole flight, each station with ``ways`` links."""
    with TemporaryDirectory() as folder:
        one = VirtualFlight(plan(), autopilot, ways=ways)
        path = Path(folder) / "flight.tlog"
        urls = [url for urls in one.request.urls.values() for url in urls]
        recorder = Recorder(Path(folder), str(path), EPOCH_UNIX_S, urls=urls)
        one.core._on_frame = recorder.frame
        one.run()
        recorder.close()
        assert one.core.state.value == "completed"
        return path.read_bytes()


def records(log: bytes) -> list[bytes]:
    """The log's records, of MAVLink 2 alone."""
    found, start = [], 0
    while start < len(log):
        assert log[start + 8] == 0xFD
        end = start + 8 + 12 + log[start + 9] + (13 if log[start + 10] & 1 else 0)
        found.append(log[start:end])
        start = end
    return found


def stepped(log: bytes, by_s: float, share: float = 0.5) -> bytes:
    """The ground's clock stepped after a share of the records."""
    pieces = records(log)
    at = int(share * len(pieces))
    moved = [struct.pack(">Q", int.from_bytes(p[:8], "big") + round(by_s * 1e6)) + p[8:] for p in pieces[at:]]
    return b"".join([*pieces[:at], *moved])


def damaged(log: bytes, seed: int) -> tuple[str, bytes]:
    """What was done to the log, in flight, and what it is then."""
    draw = random.Random(seed)
    kind = ("cut", "hole", "overwritten", "flipped", "repeated", "stepped")[seed % 6]
    at = draw.randrange(len(log) // 3, 3 * len(log) // 4)
    if kind == "cut":
        return kind, log[:at]
    if kind == "hole":
        return kind, log[:at] + log[at + draw.randrange(400, 40_000) :]
    if kind == "overwritten":
        size = draw.randrange(60, 4000)
        return kind, log[:at] + draw.randbytes(size) + log[at + size :]
    if kind == "flipped":
        # In frames, not in their times: a time moved by less than the next one is away cannot be seen, and is nothing.
        pieces = records(log)
        for number in draw.sample(range(len(pieces) // 3, 3 * len(pieces) // 4), draw.randrange(1, 20)):
            piece = bytearray(pieces[number])
            piece[draw.randrange(8, len(piece))] ^= 1 << draw.randrange(8)
            pieces[number] = bytes(piece)
        return kind, b"".join(pieces)
    if kind == "repeated":
        pieces = records(log)
        low = draw.randrange(len(pieces) // 3, 3 * len(pieces) // 4)
        high = low + draw.randrange(1, 400)
        return kind, b"".join([*pieces[:high], *pieces[low:high], *pieces[high:]])
    return kind, stepped(
        log, draw.choice((-1.0, 1.0)) * draw.choice((2.5, 60.0, 3600.0, 86400.0)), draw.uniform(0.2, 0.8)
    )
