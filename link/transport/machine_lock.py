"""Locks that every program of this machine sees, by name, however it was started.

A lock kept in a temporary folder is another one for a service whose TMPDIR is its own (systemd's PrivateTmp).
These are names of Linux's abstract socket space: they belong to no folder and no user, and the kernel lets go of them
when their process dies, however it dies. Programs in different network namespaces (containers) do not see each other's;
nor do two machines: what is known of the vehicle must tell those (`link.preflight.identity`).

Where there is no such space, files in the machine's own lock folder stand in.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import hashlib
import os
import socket
import struct
import sys
from dataclasses import dataclass
from pathlib import Path

_FOLDERS = ("/run/lock", "/var/lock", "/tmp")
_PREFIX = "skyrelay-lock-"


@dataclass(frozen=True)
class Holder:
    """The program that holds a lock; ``pid`` None where that cannot be told."""

    pid: int | None

    @property
    def command(self) -> tuple[str, ...]:
        """Its command line; empty where it cannot be read."""
        if self.pid is None:
            return ()
        try:
            return tuple(Path(f"/proc/{self.pid}/cmdline").read_bytes().decode(errors="replace").split("\0")[:-1])
        except OSError:
            return ()

    @property
    def text(self) -> str:
        """For people: the process, and the folder of the flight where it is a streamer."""
        command = self.command
        folder = f", of the flight in {command[-1]}" if "link.streamer" in command else ""
        return "another program" if self.pid is None else f"process {self.pid}{folder}"


class MachineLock:
    """One name, held. Made by `take`; let go of by `release`, or by the end of the process."""

    def __init__(self, descriptor: int | socket.socket) -> None:
        self._descriptor = descriptor

    @classmethod
    def take(cls, name: str) -> MachineLock | Holder:
        """The lock of a name (any text), or who has it. Raises ``OSError`` where no lock can be made at all."""
        digest = hashlib.sha256(name.encode("utf-8", "surrogatepass")).hexdigest()
        return _take_socket(digest) if sys.platform == "linux" else _take_file(digest)

    def release(self) -> None:
        """Let go. More than once does nothing."""
        if isinstance(self._descriptor, socket.socket):
            self._descriptor.close()
        elif self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1


def _take_socket(digest: str) -> MachineLock | Holder:
    address = f"\0{_PREFIX}{digest}"
    held = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        held.bind(address)
        # Whoever comes later connects, and is told by the kernel whose it is.
        held.listen(8)
    except OSError as error:
        held.close()
        if error.errno != errno.EADDRINUSE:
            raise
        return Holder(_owner_of(address))
    return MachineLock(held)


def _owner_of(address: str) -> int | None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as asking, contextlib.suppress(OSError):
        asking.settimeout(1.0)
        asking.connect(address)
        size = struct.calcsize("3i")
        pid, _, _ = struct.unpack("3i", asking.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, size))
        return int(pid) or None
    return None


def _take_file(digest: str) -> MachineLock | Holder:
    folder = next(f for f in _FOLDERS if os.access(f, os.W_OK))
    path = os.path.join(folder, _PREFIX + digest)
    # For every user: whose flight it is does not matter to the vehicle.
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o666)
    with contextlib.suppress(OSError):
        os.fchmod(descriptor, 0o666)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(descriptor)
        return Holder(None)
    return MachineLock(descriptor)
