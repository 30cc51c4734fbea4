"""Serial endpoint over pyserial; see `link.transport.endpoint` for what it promises."""

from __future__ import annotations

import contextlib
import os
import select
from collections.abc import Callable
from typing import Any

import serial

from link.transport.endpoint import MAX_QUEUED_BYTES, Endpoint
from link.transport.udp_tcp import BACKOFF_S, unsent_bytes
from link.transport.url import LinkUrl

_MAX_PIECE = 65_536


class SerialEndpoint(Endpoint):
    """A serial device, opened exclusively and opened again when it was unplugged."""

    def __init__(self, url: LinkUrl, clock: Callable[[], float]) -> None:
        super().__init__(url)
        self._clock = clock
        self._port: Any = None
        self._closed = False
        self._rest = b""
        self._pause_s = BACKOFF_S[0]
        self._next_try_s = -float("inf")
        self._upkeep()

    def _upkeep(self) -> None:
        if self._closed or self._port is not None or self._clock() < self._next_try_s:
            return
        self._next_try_s = self._clock() + self._pause_s
        self._pause_s = min(2.0 * self._pause_s, BACKOFF_S[1])
        try:
            self._port = serial.Serial(self.url.host, self.url.number, timeout=0, write_timeout=0, exclusive=True)
        except (serial.SerialException, OSError, ValueError) as error:
            self.stats.last_error = str(error)
            return
        self._pause_s = BACKOFF_S[0]
        self.stats.connects += 1

    def _drop(self, reason: str) -> None:
        self.stats.last_error = reason
        if self._port is not None:
            with contextlib.suppress(serial.SerialException, OSError):
                self._port.close()
        self._port, self._rest = None, b""

    def _send(self, frame: bytes) -> bool:
        self._upkeep()
        if self._port is None or unsent_bytes(self._port.fileno()) > MAX_QUEUED_BYTES:
            return False
        try:
            # pyserial's own write waits for the device; the descriptor does not.
            if self._rest:
                self._rest = self._rest[os.write(self._port.fileno(), self._rest) :]
                if self._rest:
                    return False
            count = os.write(self._port.fileno(), frame)
        except (BlockingIOError, InterruptedError):
            return False
        except (serial.SerialException, OSError) as error:
            self.stats.send_errors += 1
            self._drop(str(error))
            return False
        self._rest = frame[count:]
        return True

    def _receive(self) -> list[bytes]:
        self._upkeep()
        if self._port is None:
            return []
        try:
            data = os.read(self._port.fileno(), _MAX_PIECE)
        except (BlockingIOError, InterruptedError):
            return []
        except (serial.SerialException, OSError) as error:
            self.stats.receive_errors += 1
            self._drop(str(error))
            return []
        if not data:
            # Nothing there, or the device is gone: only the poll tells.
            poll = select.poll()
            poll.register(self._port.fileno(), select.POLLIN)
            if any(flags & (select.POLLHUP | select.POLLERR | select.POLLNVAL) for _, flags in poll.poll(0)):
                self._drop("device disconnected")
            return []
        return [data]

    def _descriptor(self) -> int:
        return int(self._port.fileno()) if self._port is not None else -1

    def _loopback(self) -> bool:
        return False

    def _close(self) -> None:
        self._closed = True
        self._drop("closed")
