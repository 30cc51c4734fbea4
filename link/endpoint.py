"""Links as non-blocking byte pipes: UDP both ways, TCP, serial.

An endpoint never blocks, never raises while a flight is on, and never keeps a frame for later: what cannot be sent
now is dropped and counted, because an old setpoint is worse than none. The grammar of URLs is the command line's:
``udpout:HOST:PORT``, ``udpin:HOST:PORT``, ``tcp:HOST:PORT``, ``serial:DEVICE:BAUD``; IPv6 hosts in brackets.

One process per port: two UDP sockets that share a port steal each other's packets, so no reuse option is ever set
and a taken port is an error at opening.
"""

from __future__ import annotations

import abc
import ipaddress
import re
import time
from collections.abc import Callable
from dataclasses import dataclass

from link.errors import EndpointUrlError

RECEIVE_BUFFER_BYTES = 4 << 20
"""Asked of the kernel for every socket: bursts of a hundred datagrams overran the usual 212 kB."""
MAX_QUEUED_BYTES = 2048
"""TCP and serial: with more than this unsent, new frames are dropped (0.2 s at 115,200 baud)."""

STREAM_SCHEMES = ("tcp", "serial")
"""Kinds of link whose bytes come without borders between frames."""
_SCHEMES = ("udpout", "udpin", "tcp", "serial")
_BAUD_RATES = (1200, 4_000_000)


@dataclass
class EndpointStats:
    """Counters since opening. ``frames_dropped`` were not sent: no peer, not connected, or the queue was full."""

    bytes_sent: int = 0
    frames_sent: int = 0
    frames_dropped: int = 0
    bytes_received: int = 0
    packets_received: int = 0
    packets_ignored: int = 0
    send_errors: int = 0
    receive_errors: int = 0
    connects: int = 0
    last_error: str = ""


@dataclass(frozen=True)
class LinkUrl:
    """A parsed link URL: scheme, host and port, or device and baud rate."""

    scheme: str
    host: str
    number: int
    """Port, or baud rate for ``serial``."""

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.scheme}:{host}:{self.number}"


def parse_url(url: str) -> LinkUrl:
    """Take a link URL apart.

    Port 0 is allowed for ``udpin`` alone (any free port). Raises `EndpointUrlError` with the part that is wrong.
    """
    scheme, colon, rest = url.strip().partition(":")
    if scheme not in _SCHEMES or not colon:
        raise EndpointUrlError(url, f"unknown kind {scheme!r}")
    match = re.fullmatch(r"(?:\[(?P<v6>[^\]]*)\]|(?P<host>.*)):(?P<number>[^:]*)", rest)
    what = "device and baud rate" if scheme == "serial" else "host and port"
    if match is None:
        raise EndpointUrlError(url, f"{what} are missing")
    host = match["v6"] if match["v6"] is not None else match["host"]
    if not host:
        raise EndpointUrlError(url, f"the {what.split(' ', 1)[0]} is empty")
    if scheme != "serial":
        if match["v6"] is not None:
            try:
                ipaddress.IPv6Address(host.partition("%")[0])
            except ValueError:
                raise EndpointUrlError(url, f"{host!r} is not an IPv6 address") from None
        elif ":" in host:
            raise EndpointUrlError(url, f"write an IPv6 address in brackets, as in {scheme}:[{host}]:{match['number']}")
        elif "/" in host or re.search(r"\s", host):
            raise EndpointUrlError(url, f"{host!r} is not a host name or address")
    if not re.fullmatch(r"[0-9]{1,9}", match["number"]):
        raise EndpointUrlError(url, f"{match['number']!r} is not a number")
    number = int(match["number"])
    low, high = _BAUD_RATES if scheme == "serial" else (0 if scheme == "udpin" else 1, 65535)
    if not low <= number <= high:
        name = "baud rate" if scheme == "serial" else "port"
        raise EndpointUrlError(url, f"{name} {number} is out of range, allowed is {low} to {high}")
    return LinkUrl(scheme, host, number)


def is_local(url: str) -> bool:
    """Whether a link's URL names this machine itself. Raises `EndpointUrlError`."""
    parsed = parse_url(url)
    if parsed.scheme == "serial":
        return False
    if parsed.host == "localhost":
        return True
    try:
        return ipaddress.ip_address(parsed.host.partition("%")[0]).is_loopback
    except ValueError:
        return False


class Endpoint(abc.ABC):
    """One link: ``url`` as parsed, ``stats``, and ``is_stream``: whether frames may arrive in pieces."""

    is_stream = False

    def __init__(self, url: LinkUrl) -> None:
        self.url = url
        self.stats = EndpointStats()

    def send(self, frame: bytes) -> bool:
        """Send one frame now, whole or not at all; False (and counted) when it could not go. Never raises."""
        sent = self._send(frame)
        if sent:
            self.stats.frames_sent += 1
            self.stats.bytes_sent += len(frame)
        else:
            self.stats.frames_dropped += 1
        return sent

    def receive(self) -> list[bytes]:
        """What has arrived: a datagram an element, or a piece of the stream. Empty when nothing has. Never raises.

        Also does the upkeep (reconnecting), so call it at least once a second.
        """
        received = self._receive()
        self.stats.packets_received += len(received)
        self.stats.bytes_received += sum(map(len, received))
        return received

    def fileno(self) -> int:
        """Descriptor to wait on, -1 while there is none (a lost connection); it changes with a reconnect."""
        return self._descriptor()

    def close(self) -> None:
        """Let go of the port; a closed endpoint drops what it is given."""
        self._close()

    @property
    def is_loopback(self) -> bool:
        """Whether the link cannot leave this machine."""
        return self._loopback()

    @property
    def is_connected(self) -> bool:
        """Whether a frame sent now has somewhere to go (udpin: a peer was heard; tcp, serial: open)."""
        return self._connected()

    def __enter__(self) -> Endpoint:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.url}>"

    @abc.abstractmethod
    def _send(self, frame: bytes) -> bool: ...

    @abc.abstractmethod
    def _receive(self) -> list[bytes]: ...

    @abc.abstractmethod
    def _descriptor(self) -> int: ...

    @abc.abstractmethod
    def _close(self) -> None: ...

    @abc.abstractmethod
    def _loopback(self) -> bool: ...

    def _connected(self) -> bool:
        return self._descriptor() >= 0


def open_endpoint(url: str, *, clock: Callable[[], float] = time.monotonic) -> Endpoint:
    """Open a link by its URL; ``clock`` is the monotonic clock for back-off and peers' silence.

    Raises `EndpointUrlError` for a URL that is not ours, `EndpointError` when the address is unknown, taken or not
    permitted. A TCP peer or serial device that is not there yet is no error: it is tried again with back-off.
    """
    parsed = parse_url(url)
    # Not at the top: they subclass Endpoint.
    from link.endpoint_serial import SerialEndpoint
    from link.endpoint_socket import TcpEndpoint, UdpInEndpoint, UdpOutEndpoint

    if parsed.scheme == "serial":
        return SerialEndpoint(parsed, clock)
    if parsed.scheme == "tcp":
        return TcpEndpoint(parsed, clock)
    return UdpInEndpoint(parsed, clock) if parsed.scheme == "udpin" else UdpOutEndpoint(parsed)
