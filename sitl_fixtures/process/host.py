"""The simulator as a process: sockets, the wall clock and the speed-up around the core.

Vehicle time is wall time since the start times the speed-up. When the process is late, because the machine is busy, it
catches up: every datagram is taken at the vehicle time of its arrival, by the kernel's timestamp, so a stream that came
in evenly is flown evenly, and a stall of this process does not look like a stall of the stream. Only when it is
hopelessly behind is vehicle time dropped.

Sped up, a stall of the ground's process that nobody would notice in real time lasts seconds of vehicle time. So while
a stream of setpoints comes in, vehicle time keeps step with the stamps they carry (time_boot_ms, which no autopilot
reads): it goes on from one to the next as they were sent, and waits for the next one for a while (`PATIENCE_S`); then
the silence is the ground's, and the vehicle acts on it. And vehicle time that the machine has no room for is dropped at
once (`PACED_LAG_S`), so that answers stay prompt in vehicle time. At speed-up 1 nothing of this applies.
"""

from __future__ import annotations

import contextlib
import select
import signal
import socket
import struct
import sys
import time
from dataclasses import dataclass
from typing import Any

from sitl_fixtures.errors import ConfigurationError
from sitl_fixtures.vehicle.vehicle import SimulatedAutopilot

RECEIVE_BUFFER_BYTES = 4 << 20
SLICE_STEPS = 25
MAX_LAG_S = 2.0
PACED_LAG_S = 0.25
STREAM_LEAD_S = 0.5
STREAM_QUIET_S = 0.02
PATIENCE_S = 1.0
# SET_POSITION_TARGET_LOCAL_NED and _GLOBAL_INT, as the lowest byte of a MAVLink 2 frame's message id.
SETPOINT_IDS = (84, 86)
# Linux; Python has no name for it.
SO_TIMESTAMPNS = 35


@dataclass(frozen=True, slots=True)
class Address:
    """A link address: ``udpin`` waits for the ground station, ``udpout`` speaks first."""

    kind: str
    host: str
    port: int

    @classmethod
    def parse(cls, text: str) -> Address:
        """Reads ``udpin:HOST:PORT`` or ``udpout:HOST:PORT``.

        Raises:
            ConfigurationError: anything else.
        """
        kind, _, rest = text.partition(":")
        host, _, port = rest.rpartition(":")
        allowed = "udpin:HOST:PORT or udpout:HOST:PORT, port 1 to 65535"
        if kind not in ("udpin", "udpout") or not host or not port.isdigit() or not 0 < int(port) < 65536:
            raise ConfigurationError("--listen", text, allowed, "write it like udpin:127.0.0.1:14540")
        return cls(kind, host.strip("[]"), int(port))


class UdpLink:
    """One UDP socket of the vehicle."""

    def __init__(self, address: Address) -> None:
        family = socket.AF_INET6 if ":" in address.host else socket.AF_INET
        self.socket = socket.socket(family, socket.SOCK_DGRAM)
        self.socket.setblocking(False)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, RECEIVE_BUFFER_BYTES)
        self.peer: Any = None
        with contextlib.suppress(OSError):
            self.socket.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        try:
            if address.kind == "udpin":
                self.socket.bind((address.host, address.port))
            else:
                self.peer = (address.host, address.port)
        except OSError as error:
            self.socket.close()
            raise ConfigurationError(
                "--listen",
                f"{address.host}:{address.port}",
                "a free address of this machine",
                f"choose another: {error}",
            ) from None

    def receive(self) -> list[tuple[float, bytes]]:
        """Datagrams that wait, each with its age in seconds; the last sender is who the vehicle answers."""
        found: list[tuple[float, bytes]] = []
        now = time.time()
        while len(found) < 1000:
            try:
                data, ancillary, _, peer = self.socket.recvmsg(2048, 64)
            except (BlockingIOError, InterruptedError):
                break
            except ConnectionError:
                continue
            self.peer = peer
            age = 0.0
            for level, kind, stamp in ancillary:
                if level == socket.SOL_SOCKET and kind == SO_TIMESTAMPNS:
                    seconds, nanoseconds = struct.unpack("qq", stamp)
                    # A jump of the wall clock must not throw a datagram far into the past.
                    age = min(max(0.0, now - seconds - nanoseconds * 1e-9), MAX_LAG_S)
            found.append((age, data))
        return found

    def send(self, data: bytes) -> None:
        """Sends to the peer; without one, or with the buffer full, the datagram is lost, as on a radio."""
        if self.peer is not None:
            with contextlib.suppress(OSError):
                self.socket.sendto(data, self.peer)


class Host:
    """Runs a vehicle on the wall clock.

    Args:
        vehicle: the core.
        addresses: one a link, in the core's order.
        speedup: vehicle seconds a wall second.
    """

    def __init__(self, vehicle: SimulatedAutopilot, addresses: list[Address], speedup: float) -> None:
        self.vehicle = vehicle
        self.speedup = speedup
        self.links: list[UdpLink] = []
        try:
            for address in addresses:
                self.links.append(UdpLink(address))
        except ConfigurationError:
            self.close()
            raise
        self._stop = False
        self.skipped_s = 0.0
        # The last setpoint: vehicle time it was taken at, wall time it came, the stamp it carried.
        self._stream_s = -float("inf")
        self._stream_wall_s = -float("inf")
        self._stamp_s = 0.0

    def close(self) -> None:
        """Closes the sockets."""
        for link in self.links:
            link.socket.close()

    def stop(self, *_: object) -> None:
        """Ends ``run`` at the next round; fit for a signal handler."""
        self._stop = True

    def run(self, duration_s: float | None = None) -> None:
        """Runs until stopped, or for a number of wall seconds."""
        vehicle, speedup = self.vehicle, self.speedup
        slice_s = vehicle.config.tick_s * SLICE_STEPS
        max_lag_s = MAX_LAG_S if speedup <= 1.0 else PACED_LAG_S
        start = time.monotonic()
        reached = 0.0
        sockets = [link.socket for link in self.links]
        vehicle.step(0.0)
        self._flush()
        while not self._stop:
            wall = time.monotonic() - start
            if duration_s is not None and wall >= duration_s:
                return
            now = wall * speedup - self.skipped_s
            held = self._held_s(now, wall)
            self.skipped_s += held
            now -= held
            if now - reached > max_lag_s:
                slip = min(slice_s, max_lag_s)
                self.skipped_s += now - reached - slip
                now = reached + slip
            arrived = [
                (now - age * speedup, index, data)
                for index, link in enumerate(self.links)
                for age, data in link.receive()
            ]
            arrived.sort(key=lambda datagram: datagram[0])
            for at, index, data in arrived:
                reached = self._advance(reached, self._keeping_step(max(at, reached), data, wall), slice_s)
                vehicle.receive(index, data, reached)
            reached = self._advance(reached, now, slice_s)
            self._flush()
            wait = (vehicle.next_event_s() - (time.monotonic() - start) * speedup + self.skipped_s) / speedup
            if held > 0.0:
                wait = max(wait, 0.0005)
            if wait > 0.0:
                select.select(sockets, [], [], min(wait, 0.1))

    def _keeping_step(self, at: float, data: bytes, wall: float) -> float:
        """Vehicle time at which to take a datagram that came at ``at``: sped up, a setpoint's own stamp says.

        The first of a stream is taken when it came, or now when the vehicle is past that already.
        """
        if self.speedup <= 1.0 or len(data) < 14 or data[7] not in SETPOINT_IDS or data[8] or data[9]:
            return at
        stamp_s = struct.unpack_from("<I", data, 10)[0] * 1e-3
        since_s = stamp_s - self._stamp_s
        if wall - self._stream_wall_s <= PATIENCE_S and 0.0 <= since_s <= 1.0:
            at = self._stream_s + since_s
        self._stream_s, self._stream_wall_s, self._stamp_s = at, wall, stamp_s
        return at

    def _held_s(self, now: float, wall: float) -> float:
        """Vehicle seconds to wait, sped up, for a stream that was there a moment ago."""
        quiet = wall - self._stream_wall_s
        if self.speedup <= 1.0 or quiet > PATIENCE_S:
            return 0.0
        return max(0.0, now - (self._stream_s + (STREAM_LEAD_S if quiet > STREAM_QUIET_S else 0.0)))

    def _advance(self, reached: float, to: float, slice_s: float) -> float:
        """Steps on in slices, sending what each brings, so that answers and telemetry leave in order."""
        while to - reached > slice_s:
            reached += slice_s
            self.vehicle.step(reached)
            self._flush()
        reached = max(reached, to)
        self.vehicle.step(reached)
        return reached

    def _flush(self) -> None:
        for index, data in self.vehicle.take_outgoing():
            self.links[index].send(data)


def run_process(vehicle: SimulatedAutopilot, addresses: list[Address], speedup: float, duration_s: float | None) -> int:
    """Runs a vehicle until SIGINT, SIGTERM or the end of its time; the exit code."""
    host = Host(vehicle, addresses, speedup)
    signal.signal(signal.SIGINT, host.stop)
    signal.signal(signal.SIGTERM, host.stop)
    sys.stdout.write(f"ready {vehicle.config.autopilot} {' '.join(f'{a.kind}:{a.host}:{a.port}' for a in addresses)}\n")
    sys.stdout.flush()
    try:
        host.run(duration_s)
    finally:
        host.close()
    return 0
