"""The journal of what flights changed on vehicles, in a folder that every flight of this machine shares.

A file a flight, named by vehicle and flight, written whole or not at all and synced with its folder before `keep`
returns: a power cut leaves the note of before or the new one. A file that cannot be read is told, never deleted.
"""

from __future__ import annotations

import contextlib
import json
import os
import tempfile
from dataclasses import replace
from pathlib import Path

from gcs.settings import default_state_dir
from gcs.timestamps import utc_now_text
from link.errors import MissionItemError
from link.session.changes import VehicleChanges


class FileJournal:
    """A `link.session.changes.ChangeJournal` on disk. ``run_dir``: of the flight that writes, whose process this is."""

    def __init__(self, folder: Path | None = None, *, run_dir: Path | None = None) -> None:
        self.folder = (default_state_dir() if folder is None else folder) / "vehicles"
        self._run_dir = run_dir
        self.unreadable: list[Path] = []
        """Files of the last `pending` that are no notes."""

    def keep(self, changes: VehicleChanges) -> None:
        """Note it, durably. Raises ``OSError``."""
        if self._run_dir is not None:
            changes = replace(changes, run_dir=str(self._run_dir), pid=os.getpid(), utc=changes.utc or utc_now_text())
        self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        write_durably(self.folder / f"{changes.key}.json", json.dumps(changes.to_document(), allow_nan=False).encode())

    def done(self, key: str) -> None:
        """Forget it."""
        with contextlib.suppress(OSError):
            (self.folder / f"{key}.json").unlink()
            _sync(self.folder)

    def pending(self) -> list[VehicleChanges]:
        """Every note, the oldest first."""
        found, self.unreadable = [], []
        for path in sorted(self.folder.glob("*.json")):
            try:
                found.append(VehicleChanges.from_document(json.loads(path.read_bytes())))
            except FileNotFoundError:
                continue
            except (OSError, ValueError, KeyError, TypeError, AttributeError, MissionItemError):
                self.unreadable.append(path)
        return sorted(found, key=lambda one: one.utc)

    def in_use(self, changes: VehicleChanges) -> bool:
        """Whether the streamer that noted it still runs (not this process itself)."""
        if changes.pid is None or changes.run_dir is None or changes.pid == os.getpid():
            return False
        return runs_in(changes.pid, Path(changes.run_dir))


def runs_in(pid: int, run_dir: Path) -> bool:
    """Whether a process number is still that of a run folder's streamer: numbers are given out again."""
    try:
        command = Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")
    except OSError:
        return False
    return str(run_dir).encode() in command


def write_durably(path: Path, data: bytes) -> None:
    """Write a file whole or not at all, on disk with its name when this returns. Raises ``OSError``."""
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".partial")
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
    _sync(path.parent)


def _sync(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
