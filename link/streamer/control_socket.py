"""JSON lines over a Unix socket, for a process that must never wait for its clients."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

SOCKET_FILE = "control.sock"
_MAX_NAME_BYTES = 100

MAX_BACKLOG_BYTES = 8 << 20
"""A client that does not read is cut off with this much unsent."""
MAX_LINE_BYTES = 1 << 20


@contextlib.contextmanager
def _short(path: Path) -> Iterator[str]:
    """A name of ``path`` that a socket's address has room for (104 to 108 bytes), whatever folder it lies in."""
    if len(os.fsencode(path)) <= _MAX_NAME_BYTES:
        yield str(path)
        return
    # Not in TMPDIR, which may be the long name itself.
    with tempfile.TemporaryDirectory(prefix="skyrelay-", dir="/tmp") as folder:
        shortcut = Path(folder) / "run"
        shortcut.symlink_to(path.parent.absolute(), target_is_directory=True)
        yield str(shortcut / path.name)


def connect(path: Path) -> socket.socket:
    """A blocking connection to the server on ``path``. Raises ``OSError``."""
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        with _short(path) as name:
            connection.connect(name)
    except BaseException:
        connection.close()
        raise
    return connection


class _Client:
    def __init__(self, connection: socket.socket) -> None:
        self.connection = connection
        self.incoming = bytearray()
        self.outgoing = bytearray()
        self.subscribed = False


class ControlServer:
    """Clients of a streamer. Everything is non-blocking; a slow or broken client is dropped."""

    def __init__(self, path: Path) -> None:
        with contextlib.suppress(FileNotFoundError):
            path.unlink()
        self._path = path
        self._server = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._server.setblocking(False)
        with _short(path) as name:
            self._server.bind(name)
        os.chmod(path, 0o600)
        self._server.listen(8)
        self._clients: dict[int, _Client] = {}
        self._count = 0
        self._told: bool | None = None

    def filenos(self) -> list[int]:
        """Descriptors to wait for reading on."""
        return [self._server.fileno(), *(c.connection.fileno() for c in self._clients.values())]

    def writers(self) -> list[int]:
        """Descriptors to wait for writing on: clients with something unsent."""
        return [c.connection.fileno() for c in self._clients.values() if c.outgoing]

    def pending(self) -> bool:
        """Whether something is unsent."""
        return any(c.outgoing for c in self._clients.values())

    @property
    def attended(self) -> bool | None:
        """Whether somebody attends (is told of events), when that has changed since the last look; None: it has not.

        The time before the first is not a change; who only asks does not attend.
        """
        now = any(client.subscribed for client in self._clients.values())
        if self._told is None and not now:
            return None
        if now == self._told:
            return None
        first, self._told = self._told is None, now
        return None if first else now

    def receive(self) -> list[tuple[int, dict[str, Any]]]:
        """Accept, read and write what can be without waiting; (client, object) for every whole line."""
        with contextlib.suppress(BlockingIOError, OSError):
            while True:
                connection, _ = self._server.accept()
                connection.setblocking(False)
                self._count += 1
                self._clients[self._count] = _Client(connection)
        lines = []
        for number, client in list(self._clients.items()):
            lines += [(number, line) for line in self._read(number, client)]
            if number in self._clients:
                self._flush(number, client)
        return lines

    def subscribe(self, number: int) -> None:
        """Send a client every broadcast from now on."""
        if number in self._clients:
            self._clients[number].subscribed = True

    def send(self, number: int, document: dict[str, Any]) -> None:
        """Send one client a line."""
        client = self._clients.get(number)
        if client is not None:
            client.outgoing += json.dumps(document, allow_nan=False).encode() + b"\n"
            self._flush(number, client)

    def broadcast(self, document: dict[str, Any]) -> None:
        """Send every subscribed client a line."""
        for number, client in list(self._clients.items()):
            if client.subscribed:
                self.send(number, document)

    def close(self) -> None:
        """Close all and remove the socket."""
        for number in list(self._clients):
            self._drop(number)
        self._server.close()
        with contextlib.suppress(OSError):
            self._path.unlink()

    def _read(self, number: int, client: _Client) -> list[dict[str, Any]]:
        try:
            while True:
                data = client.connection.recv(65536)
                if not data:
                    self._drop(number)
                    break
                client.incoming += data
                if len(client.incoming) > MAX_LINE_BYTES:
                    self._drop(number)
                    return []
        except BlockingIOError:
            pass
        except OSError:
            self._drop(number)
        lines = []
        while (end := client.incoming.find(b"\n")) >= 0:
            line, client.incoming = bytes(client.incoming[:end]), client.incoming[end + 1 :]
            try:
                document = json.loads(line)
            except ValueError:
                continue
            if isinstance(document, dict):
                lines.append(document)
        return lines

    def _flush(self, number: int, client: _Client) -> None:
        try:
            while client.outgoing:
                sent = client.connection.send(client.outgoing)
                del client.outgoing[:sent]
        except BlockingIOError:
            if len(client.outgoing) > MAX_BACKLOG_BYTES:
                self._drop(number)
        except OSError:
            self._drop(number)

    def _drop(self, number: int) -> None:
        client = self._clients.pop(number, None)
        if client is not None:
            client.connection.close()
