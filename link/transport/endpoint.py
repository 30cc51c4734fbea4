"""Links as non-blocking byte pipes: UDP both ways, TCP, serial.

An endpoint never blocks, never raises while a flight is on, and never keeps a frame for later: what cannot be sent
now is dropped and counted, because an old setpoint is worse than none. The grammar of URLs is the command line's:
``udpout:HOST:PORT``, ``udpin:HOST:PORT``, ``tcp:HOST:PORT``, ``serial:DEVICE:BAUD``; IPv6 hosts in brackets.

One process per port: two UDP sockets that share a port steal each other's packets, so no reuse option is ever set
and a taken port is an error at opening.
"""

from __future__ import annotations

import abc
from dataclasses import dataclass

from link.transport.url import LinkUrl

RECEIVE_BUFFER_BYTES = 4 << 20
"""Asked of the kernel for every socket: bursts of a hundred datagrams overran the usual 212 kB."""
MAX_QUEUED_BYTES = 2048
"""TCP and serial: with more than this unsent, new frames are dropped (0.2 s at 115,200 baud)."""


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


class Endpoint(abc.ABC):
    """One link: ``url`` as parsed, and ``stats``."""

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

    def discard(self, reason: str) -> None:
        """Let nothing sent so far arrive any more, as far as that is in our hands: a stream is reset and begun anew.

        Datagrams are not held. ``reason`` goes into ``stats.last_error`` of a link that is reset.
        """
        self._discard(reason)

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

    def _discard(self, reason: str) -> None:  # noqa: B027 - what holds nothing has nothing to discard
        pass

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
