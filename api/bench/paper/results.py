"""Results of long measurements, kept as they come: one JSON object a line, appended, so that a run can be resumed.

What is measured once is found again by its key: the unit of work, the mission's content and the settings. A later line
with the same key replaces the earlier one. A last line cut short, as a crash or a full disk leaves it, is dropped.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any


class ResultsError(Exception):
    """A results file that cannot be used; the text says what and where."""


def fingerprint(document: Any) -> str:
    """Sixteen hexadecimal digits of a mission's content, whatever its file is called."""
    text = json.dumps(document, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


class Results:
    """What was measured, in a file where one is given. Raises `ResultsError` for a file that is something else."""

    def __init__(self, path: Path | None = None) -> None:
        self._path = path
        self._found: dict[str, dict[str, Any]] = {}
        self.dropped_torn_line = False
        if path is not None and path.exists():
            self._read(path)

    def __len__(self) -> int:
        return len(self._found)

    def get(self, unit: str, mission: str, settings: Mapping[str, Any]) -> dict[str, Any] | None:
        """What ``unit`` measured on the mission of that fingerprint under the same settings, or None."""
        record = self._found.get(_key(unit, mission, settings))
        return None if record is None else record["measured"]

    def of(self, unit: str, mission: str) -> list[tuple[dict[str, Any], dict[str, Any]]]:
        """(settings, measured) of that unit on that mission, under whatever settings."""
        mine = (r for r in self._found.values() if (r["unit"], r["mission"]) == (unit, mission))
        return [(record["settings"], record["measured"]) for record in mine]

    def machines(self) -> list[dict[str, Any]]:
        """The different machines that what is kept was measured on, where a record says."""
        found: list[dict[str, Any]] = []
        for record in self._found.values():
            if "machine" in record and record["machine"] not in found:
                found.append(record["machine"])
        return found

    def add(
        self,
        unit: str,
        mission: str,
        settings: Mapping[str, Any],
        measured: Mapping[str, Any],
        **more: Any,
    ) -> None:
        """Keep a measurement; it is in the file, flushed, when this returns. ``more`` is for readers of the file."""
        record = {"unit": unit, "mission": mission, "settings": dict(settings), **more, "measured": dict(measured)}
        if self._path is not None:
            try:
                with self._path.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(record, allow_nan=False, separators=(",", ":")) + "\n")
                    file.flush()
                    os.fsync(file.fileno())
            except OSError as error:
                raise ResultsError(f"cannot write to {self._path}: {error.strerror}") from error
        self._found[_key(unit, mission, settings)] = record

    def _read(self, path: Path) -> None:
        try:
            data = path.read_bytes()
        except OSError as error:
            raise ResultsError(f"cannot read {path}: {error.strerror}") from error
        whole, _, rest = data.rpartition(b"\n")
        for number, line in enumerate(whole.splitlines(), start=1):
            if line.strip():
                record = _record(line)
                if record is None:
                    raise ResultsError(f"line {number} of {path} is not a result of this command")
                self._found[_key(record["unit"], record["mission"], record["settings"])] = record
        if rest:
            # Cut off, so that the next line does not grow onto it. A file without any whole line of ours may be
            # anything: that one is left alone.
            if data and not self._found:
                raise ResultsError(f"{path} holds no result of this command")
            os.truncate(path, len(data) - len(rest))
            self.dropped_torn_line = True


def _record(line: bytes) -> dict[str, Any] | None:
    try:
        record = json.loads(line)
    except ValueError:
        return None
    wanted = {"unit": str, "mission": str, "settings": dict, "measured": dict}
    if isinstance(record, dict) and all(isinstance(record.get(name), kind) for name, kind in wanted.items()):
        return record
    return None


def _key(unit: str, mission: str, settings: Mapping[str, Any]) -> str:
    return json.dumps([unit, mission, dict(settings)], sort_keys=True)
