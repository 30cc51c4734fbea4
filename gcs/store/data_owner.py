"""One service a data directory, and the name it is known by."""

from __future__ import annotations

import fcntl
import os
import uuid
from pathlib import Path

from gcs.errors import StoreUnavailable

_HELD: set[str] = set()


class DataOwner:
    """A data directory, held by this service until `close`, or until its process ends however it ends.

    ``name`` is the service's: the same whenever it is started on this directory, another one on any other. Two services
    on one directory would end each other's flights. Raises `StoreUnavailable` when another service has it.
    """

    def __init__(self, data_dir: Path) -> None:
        self._path = (data_dir / "service.lock").resolve()
        if str(self._path) in _HELD:
            raise StoreUnavailable(_said(data_dir, str(os.getpid())))
        # A record lock: it is not handed on to planners and streamers, which may outlive the service.
        self._descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            fcntl.lockf(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            holder = os.read(self._descriptor, 32).decode(errors="replace").strip()
            os.close(self._descriptor)
            raise StoreUnavailable(_said(data_dir, holder)) from None
        _HELD.add(str(self._path))
        os.ftruncate(self._descriptor, 0)
        os.pwrite(self._descriptor, f"{os.getpid()}\n".encode(), 0)
        self.name = _name(data_dir / "service.id")

    def close(self) -> None:
        """Let go."""
        if str(self._path) in _HELD:
            _HELD.discard(str(self._path))
            os.close(self._descriptor)


def _name(path: Path) -> str:
    try:
        kept = path.read_text().strip()
    except OSError:
        kept = ""
    if not kept:
        kept = uuid.uuid4().hex
        path.write_text(kept + "\n")
    return kept


def _said(data_dir: Path, holder: str) -> str:
    who = f" (process {holder})" if holder else ""
    return (
        f"another service{who} uses the data directory {data_dir}: two would end each other's flights; stop that one, "
        "or give this one another with --data"
    )
