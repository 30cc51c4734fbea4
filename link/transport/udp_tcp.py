"""UDP and TCP endpoints; see `link.transport.endpoint` for what they promise."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import ipaddress
import os
import socket
import struct
import termios
from collections.abc import Callable
from typing import Any

from link.errors import EndpointError
from link.transport.endpoint import MAX_QUEUED_BYTES, RECEIVE_BUFFER_BYTES, Endpoint
from link.transport.url import LinkUrl

PEER_SILENCE_S = 10.0
"""udpin: a peer silent for this long is forgotten while another one is heard; the last one heard never is."""
MAX_PEERS = 8
_MARKERS = (0xFD, 0xFE)
_MAX_DATAGRAM = 65_535
_MAX_PER_CALL = 1_000
STAND_S = 0.25
"""TCP: a queue of which nothing has left for so long (two ticks at 8 Hz), and a round trip more, stands."""
_TCP_INFO_RTT = 68
"""Where Linux's tcp_info has the smoothed round trip and its deviation: two 32-bit numbers, microseconds."""
BACKOFF_S = (0.5, 8.0)
"""First and longest pause between attempts to connect."""

Address = tuple[Any, ...]


def resolve(url: LinkUrl, kind: socket.SocketKind) -> tuple[socket.AddressFamily, Address]:
    """An address of a link's host, IPv4 before IPv6 (autopilots listen on the former). `EndpointError` without any."""
    try:
        found = socket.getaddrinfo(url.host, url.number, type=kind)
    except (OSError, UnicodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not a host name"
        raise EndpointError(
            f"{url}: host {url.host!r} is unknown ({reason}); give an address or a known name"
        ) from None
    family, _, _, _, address = min(found, key=lambda entry: entry[0] != socket.AF_INET)
    return family, address


def is_loopback_address(address: Address | None) -> bool:
    """Whether a socket address stays on this machine."""
    return address is not None and ipaddress.ip_address(str(address[0]).partition("%")[0]).is_loopback


def unsent_bytes(descriptor: int) -> int:
    """Bytes the kernel holds for this socket or terminal that have not gone out."""
    with contextlib.suppress(OSError):
        answer = fcntl.ioctl(descriptor, termios.TIOCOUTQ, struct.pack("i", 0))
        return int(struct.unpack("i", answer)[0])
    return 0


def acknowledged_within_s(connection: socket.socket) -> float:
    """How long an acknowledgement of this connection may take: round trip and four deviations (RFC 6298), s; else 0."""
    with contextlib.suppress(OSError, struct.error):
        info = connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _TCP_INFO_RTT + 8)
        round_trip_us, deviation_us = struct.unpack_from("=II", info, _TCP_INFO_RTT)
        return 1e-6 * float(round_trip_us + 4 * deviation_us)
    return 0.0


class _UdpEndpoint(Endpoint):
    """What both UDP ends share."""

    def __init__(self, url: LinkUrl) -> None:
        super().__init__(url)
        family, self._address = resolve(url, socket.SOCK_DGRAM)
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)

    def _send_to(self, frame: bytes, address: Address | None) -> bool:
        try:
            sent = self._socket.sendto(frame, address) if address is not None else self._socket.send(frame)
        except OSError as error:
            # A refused datagram only means that nobody listens yet; the link stays usable.
            self.stats.send_errors += 1
            self.stats.last_error = os.strerror(error.errno) if error.errno else str(error)
            return False
        return sent == len(frame)

    def _read(self) -> list[tuple[bytes, Address]]:
        packets: list[tuple[bytes, Address]] = []
        # Bounded, so that a flood cannot keep a caller in here.
        for _ in range(_MAX_PER_CALL):
            try:
                data, address = self._socket.recvfrom(_MAX_DATAGRAM)
            except (BlockingIOError, InterruptedError):
                break
            except OSError as error:
                if error.errno in (errno.EBADF, errno.ENOTSOCK):
                    break
                self.stats.receive_errors += 1
                self.stats.last_error = os.strerror(error.errno) if error.errno else str(error)
                continue
            packets.append((data, address))
        return packets

    @property
    def local_address(self) -> tuple[str, int]:
        """Host and port this end is bound to."""
        host, port = self._socket.getsockname()[:2]
        return host, port

    def _descriptor(self) -> int:
        return self._socket.fileno()

    def _close(self) -> None:
        self._socket.close()

    def _loopback(self) -> bool:
        return is_loopback_address(self._address)


class UdpOutEndpoint(_UdpEndpoint):
    """Sends to one address and hears that address alone."""

    def __init__(self, url: LinkUrl) -> None:
        super().__init__(url)
        try:
            self._socket.connect(self._address)
        except OSError as error:
            self._socket.close()
            raise EndpointError(f"{url}: cannot be reached from this machine ({error.strerror})") from None

    def _send(self, frame: bytes) -> bool:
        return self._descriptor() >= 0 and self._send_to(frame, None)

    def _receive(self) -> list[bytes]:
        return [data for data, _ in self._read()]


class UdpInEndpoint(_UdpEndpoint):
    """Listens on an address; peers are learnt from what they send, and every live peer gets what is sent.

    Only a datagram that starts like MAVLink makes a peer. Signing, not this, keeps foreign stations out.
    """

    def __init__(self, url: LinkUrl, clock: Callable[[], float]) -> None:
        super().__init__(url)
        self._clock = clock
        self._heard_s: dict[Address, float] = {}
        try:
            if self._socket.family == socket.AF_INET6:
                self._socket.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 0)
            self._socket.bind(self._address)
        except OSError as error:
            self._socket.close()
            if error.errno == errno.EADDRINUSE:
                raise EndpointError(
                    f"{url}: the port is taken by another program on this machine; stop it or choose another port"
                ) from None
            if error.errno == errno.EADDRNOTAVAIL:
                raise EndpointError(
                    f"{url}: this machine has no address {url.host}; use 0.0.0.0 for all, 127.0.0.1 for itself"
                ) from None
            raise EndpointError(f"{url}: {error.strerror}; choose another address or port") from None

    @property
    def peers(self) -> tuple[Address, ...]:
        """Addresses that get what is sent, the one heard last at the end."""
        return tuple(self._heard_s)

    def _send(self, frame: bytes) -> bool:
        sent = False
        for address in list(self._heard_s):
            sent |= self._send_to(frame, address)
        return sent

    def _receive(self) -> list[bytes]:
        received = []
        now_s = self._clock()
        for data, address in self._read():
            if not data or data[0] not in _MARKERS:
                self.stats.packets_ignored += 1
                continue
            self._heard_s.pop(address, None)
            self._heard_s[address] = now_s
            received.append(data)
        if len(self._heard_s) > 1:
            last = next(reversed(self._heard_s))
            live = [a for a, t in self._heard_s.items() if a == last or now_s - t < PEER_SILENCE_S][-MAX_PEERS:]
            self._heard_s = {address: self._heard_s[address] for address in live}
        return received

    def _connected(self) -> bool:
        return bool(self._heard_s) and self._descriptor() >= 0


class TcpEndpoint(Endpoint):
    """A TCP client that connects and reconnects by itself, doubling its pause from 0.5 s to 8 s."""

    def __init__(self, url: LinkUrl, clock: Callable[[], float]) -> None:
        super().__init__(url)
        self._clock = clock
        self._family, self._address = resolve(url, socket.SOCK_STREAM)
        self._socket: socket.socket | None = None
        self._is_up = False
        self._closed = False
        self._rest = b""
        self._pause_s = BACKOFF_S[0]
        self._next_try_s = -float("inf")
        # Bytes put into this connection, how many of them had left it when last looked at, and when that last changed.
        self._put, self._left, self._left_s = 0, -1, clock()
        self._upkeep()

    def _upkeep(self) -> None:
        if self._closed:
            return
        if self._socket is None:
            if self._clock() < self._next_try_s:
                return
            self._next_try_s = self._clock() + self._pause_s
            self._pause_s = min(2.0 * self._pause_s, BACKOFF_S[1])
            self._socket = socket.socket(self._family, socket.SOCK_STREAM)
            self._socket.setblocking(False)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        if self._is_up:
            return
        code = self._socket.connect_ex(self._address)
        if code in (0, errno.EISCONN):
            self._is_up = True
            self._pause_s = BACKOFF_S[0]
            self._put, self._left, self._left_s = 0, -1, self._clock()
            self.stats.connects += 1
        elif code not in (errno.EINPROGRESS, errno.EALREADY, errno.EWOULDBLOCK):
            self._drop(os.strerror(code))
        elif self._clock() >= self._next_try_s:
            self._drop("no answer")

    def _drop(self, reason: str) -> None:
        self.stats.last_error = reason
        if self._socket is not None:
            self._socket.close()
        self._socket, self._is_up, self._rest = None, False, b""

    def _discard(self, reason: str) -> None:
        if self._socket is None or not self._is_up:
            return
        # Closed with nothing lingering the kernel throws its queue away and says so to the other side.
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        self._drop(reason)
        self._next_try_s = -float("inf")

    def _stands(self, queued: int) -> bool:
        """Whether nothing of what is queued has left for `STAND_S` and a round trip: what came late would be old.

        The kernel counts what is on its way as queued until it is acknowledged, on a healthy link for a round trip.
        """
        assert self._socket is not None
        left = self._put - queued
        if queued == 0 or left > self._left:
            self._left, self._left_s = left, self._clock()
        return self._clock() - self._left_s > STAND_S + acknowledged_within_s(self._socket)

    def _send(self, frame: bytes) -> bool:
        self._upkeep()
        if self._socket is None or not self._is_up:
            return False
        queued = unsent_bytes(self._socket.fileno())
        if self._stands(queued):
            self._discard("reset: its queue stood")
            return False
        if queued > MAX_QUEUED_BYTES:
            return False
        try:
            if self._rest:
                # A frame once begun must be finished, or the peer loses its place in the stream.
                gone = self._socket.send(self._rest)
                self._rest, self._put = self._rest[gone:], self._put + gone
                if self._rest:
                    return False
            count = self._socket.send(frame)
        except (BlockingIOError, InterruptedError):
            return False
        except OSError as error:
            self.stats.send_errors += 1
            self._drop(os.strerror(error.errno) if error.errno else str(error))
            return False
        self._rest, self._put = frame[count:], self._put + count
        return True

    def _receive(self) -> list[bytes]:
        self._upkeep()
        pieces: list[bytes] = []
        while self._socket is not None and self._is_up and len(pieces) < 16:
            try:
                data = self._socket.recv(_MAX_DATAGRAM)
            except (BlockingIOError, InterruptedError):
                break
            except OSError as error:
                self.stats.receive_errors += 1
                self._drop(os.strerror(error.errno) if error.errno else str(error))
                break
            if not data:
                self._drop("closed by the other side")
                break
            pieces.append(data)
        return pieces

    def _descriptor(self) -> int:
        return self._socket.fileno() if self._socket is not None else -1

    def _connected(self) -> bool:
        return self._is_up

    def _loopback(self) -> bool:
        return is_loopback_address(self._address)

    def _close(self) -> None:
        self._closed = True
        self._drop("closed")
