"""The receiving end of a flight's links, with the kernel's own time stamps; the vehicle is behind it.

On loopback a datagram is stamped (SO_TIMESTAMPNS) inside the sender's own ``sendto``, so the stamps tell when the
sender sent, however late whoever reads them wakes up. They are taken to the clock the senders' deadlines are on.
"""

from __future__ import annotations

import contextlib
import math
import select
import socket
import struct
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from link.dialect import mavlink
from link.wire import StationCodec

Array = NDArray[np.float64]

SO_TIMESTAMPNS = 35
"""Linux; Python has no name for it."""
_BUFFER_BYTES = 4 << 20
_SETPOINTS = (
    mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED,
    mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT,
)


@dataclass
class Heard:
    """Datagrams of one sender: when each was sent (monotonic clock, s) and the MAVLink system id it came under."""

    time_s: list[float] = field(default_factory=list)
    system_id: list[int] = field(default_factory=list)


def stamped_socket() -> socket.socket:
    """A UDP socket of this machine that stamps what it gets."""
    one = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    one.setblocking(False)
    one.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
    one.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
    one.bind(("127.0.0.1", 0))
    return one


def url_of(one: socket.socket) -> str:
    """How a station speaks to it."""
    return f"udpout:127.0.0.1:{one.getsockname()[1]}"


class Wiretap:
    """Stands between a flight's stations and its vehicle: ``links`` are the vehicle's ports by station.

    Frames of stations are passed on as they are; with ``vehicle`` given (a codec that signs), frames of the
    vehicle are packed anew by it, so that a vehicle that cannot sign takes part in a signed flight. ``reference`` gets
    the datagrams of a sender that flies nothing.
    """

    def __init__(self, links: Mapping[str, int], vehicle: StationCodec | None) -> None:
        self._vehicle = vehicle
        self._reader = StationCodec(255)
        self.setpoints, self.reference = Heard(), Heard()
        self._stations = {name: stamped_socket() for name in links}
        self._ports: dict[str, socket.socket] = {}
        for name, port in links.items():
            self._ports[name] = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self._ports[name].setblocking(False)
            self._ports[name].connect(("127.0.0.1", port))
        self._reference = stamped_socket()
        self._peers: dict[str, Any] = {}

    @property
    def links(self) -> dict[str, str]:
        """The URL of each station."""
        return {name: url_of(one) for name, one in self._stations.items()}

    @property
    def reference_port(self) -> int:
        """Where the reference sends to."""
        return int(self._reference.getsockname()[1])

    def run(self, until: Callable[[], bool], timeout_s: float) -> bool:
        """Pass on until ``until`` holds (looked at ten times a second); whether it did in time."""
        everything = [*self._stations.values(), *self._ports.values(), self._reference]
        end_s = time.monotonic() + timeout_s
        next_s = 0.0
        while (now_s := time.monotonic()) < end_s:
            if now_s >= next_s:
                next_s = now_s + 0.1
                if until():
                    return True
            select.select(everything, [], [], 0.05)
            self._pass_on()
        return False

    def close(self) -> None:
        """Close the sockets."""
        for one in (*self._stations.values(), *self._ports.values(), self._reference):
            one.close()

    def _pass_on(self) -> None:
        for name, station in self._stations.items():
            for data, sent_s, peer in _read(station):
                self._peers[name] = peer
                if len(data) > 9 and data[7] in _SETPOINTS and not data[8] | data[9]:
                    self.setpoints.time_s.append(sent_s)
                    self.setpoints.system_id.append(data[5])
                with contextlib.suppress(OSError):
                    self._ports[name].send(data)
        for name, port in self._ports.items():
            for data, _, _ in _read(port):
                if name in self._peers:
                    for frame in self._signed(data):
                        with contextlib.suppress(OSError):
                            self._stations[name].sendto(frame, self._peers[name])
        for _, sent_s, _ in _read(self._reference):
            self.reference.time_s.append(sent_s)
            self.reference.system_id.append(0)

    def _signed(self, data: bytes) -> list[bytes]:
        if self._vehicle is None:
            return [data]
        return [self._vehicle.encode(message) for message in self._reader.decode(data)]


def _read(one: socket.socket) -> list[tuple[bytes, float, Any]]:
    found = []
    behind_s = _wall_ahead_s()
    for _ in range(1000):
        try:
            data, ancillary, _, peer = one.recvmsg(2048, 64)
        except OSError:  # nothing there, or a refused datagram from before
            break
        sent_s = time.monotonic()
        for level, kind, stamp in ancillary:
            if level == socket.SOL_SOCKET and kind == SO_TIMESTAMPNS:
                seconds, nanoseconds = struct.unpack("qq", stamp)
                sent_s = seconds + nanoseconds * 1e-9 - behind_s
        found.append((data, sent_s, peer))
    return found


def _wall_ahead_s() -> float:
    """How far the wall clock is ahead of the monotonic one; the narrowest of a few readings."""
    best_s, ahead_s = float("inf"), 0.0
    for _ in range(3):
        before_s = time.monotonic()
        wall_s = time.time()
        after_s = time.monotonic()
        if after_s - before_s < best_s:
            best_s, ahead_s = after_s - before_s, wall_s - 0.5 * (before_s + after_s)
    return ahead_s


_MOST, _JUST_BEFORE, _STRAYS = 0.9, 0.15, 5e-4


def lateness_ms(time_s: Array, rate_hz: float) -> Array:
    """How late each datagram is against the earliest deadline not served before it, on the sender's even grid.

    The grid's phase is not known to us. Taken modulo the period, the shortest arc with nine tenths of the datagrams is
    where they are when little is wrong; the earliest of them, or just before them, is taken for a deadline, but for a
    few strays: in a long run some are late by nearly a whole period. So a sender that is late by the same amount all
    the time is not found out; one that misses deadlines is charged from the first.
    """
    turns = (time_s - time_s[0]) * rate_hz
    within = np.sort(np.mod(turns, 1.0))
    most = math.ceil(_MOST * len(within))
    twice = np.concatenate([within, within + 1.0])
    first = float(within[int((twice[most - 1 : most - 1 + len(within)] - within).argmin())])
    before = np.mod(first - within, 1.0)
    before = np.sort(before[before <= _JUST_BEFORE])[::-1]
    phase = first - float(before[min(int(_STRAYS * len(within)), len(before) - 1)])
    index = np.floor(turns - phase + 1e-9)
    owed = np.concatenate([index[:1], np.minimum(index[1:], index[:-1] + 1.0)])
    return np.asarray((turns - phase - owed) / rate_hz * 1e3)


def missed(time_s: Array, rate_hz: float) -> int:
    """Deadlines without a datagram between the first and the last one."""
    return max(0, round(float(time_s[-1] - time_s[0]) * rate_hz) + 1 - len(time_s))
