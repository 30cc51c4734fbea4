"""Telemetry logs: every frame behind its time, as ground-station programs write them.

A record is eight bytes, big endian, microseconds since 1970-01-01 UTC, then one whole MAVLink frame (signature
included). There is no header and no index: a log is readable up to the byte where its writer died.

The lowest bits of the time say which link brought the frame, as MAVProxy and pymavlink have it (``mavlogdump --link``
reads two of them; a flight's log uses four: `MOST_LINKS` links, in the order of the flight's request).
"""

from __future__ import annotations

import errno
import io
import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO

from link.dialect import mavlink
from link.errors import TlogError
from link.wire.codec import frame_length

_STAMP_BYTES = 8
MOST_LINKS = 16
"""Links that a flight's log tells apart; those beyond are noted as the last."""
_EARLIEST_US, _LATEST_US = 0, 4_102_444_800_000_000
"""1970 (a recorder without a clock) and 2100: a stamp outside is damage."""
_PLAUSIBLE_US = 946_684_800_000_000
"""2000: while looking for the next record after damage, an earlier stamp is taken for chance."""
_BLOCK = 1 << 20
_MARKERS = (mavlink.PROTOCOL_MARKER_V1, mavlink.PROTOCOL_MARKER_V2)


def record(frame: bytes, time_utc_us: int) -> bytes:
    """One record. Raises `TlogError` for a time outside 1970 to 2100."""
    if not _EARLIEST_US <= time_utc_us <= _LATEST_US:
        raise TlogError(f"log time {time_utc_us} us is outside 1970 to 2100")
    return time_utc_us.to_bytes(_STAMP_BYTES, "big") + frame


class TlogWriter:
    """Writes records to a file of its own, each with one unbuffered write, so that a killed process loses nothing.

    A flight a file: where the name is taken the next free one is used, ``flight-2.tlog`` for ``flight.tlog``; ``path``
    tells. Devices and pipes are written as they are.

    With ``tolerant`` a full disk never disturbs a flight: records are dropped and counted in ``dropped``, and
    ``last_error`` says why. Otherwise `TlogError`.
    """

    def __init__(self, path: str | Path, *, tolerant: bool = False) -> None:
        self.path = Path(path)
        self.tolerant = tolerant
        self.written = 0
        self.dropped = 0
        self.last_error = ""
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._descriptor = self._create()
        except OSError as error:
            raise TlogError(f"log {self.path}: {error.strerror}; give a writable place") from None

    def _create(self) -> int:
        """A new file, and its name in ``path``."""
        flags = os.O_WRONLY | os.O_APPEND | os.O_CLOEXEC
        asked, number = self.path, 1
        while True:
            try:
                return os.open(self.path, flags | os.O_CREAT | os.O_EXCL, 0o644)
            except FileExistsError:
                if number == 1 and asked.exists() and not asked.is_file():
                    return os.open(asked, flags)
                number += 1
                self.path = asked.with_name(f"{asked.stem}-{number}{asked.suffix}")

    def write(self, frame: bytes, time_utc_us: int) -> bool:
        """Append one frame; False when it was dropped. Raises `TlogError` unless tolerant."""
        data = record(frame, time_utc_us)
        try:
            if self._descriptor < 0:
                raise OSError(errno.EBADF, "closed")
            if os.write(self._descriptor, data) != len(data):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError as error:
            self.dropped += 1
            self.last_error = error.strerror or str(error)
            if not self.tolerant:
                raise TlogError(f"log {self.path}: {self.last_error}; free space or choose another place") from None
            return False
        self.written += 1
        return True

    def close(self) -> None:
        """Close the file; what was written stays. Writing afterwards counts as dropped."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1

    def __enter__(self) -> TlogWriter:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()


@dataclass(frozen=True)
class TlogRecord:
    """One frame of a log. ``message`` is None for an id our dialect does not know. Signatures are not verified.

    ``skipped_bytes``: of damage just before it.
    """

    time_utc_us: int
    frame: bytes
    message: Any
    skipped_bytes: int = 0

    @property
    def link(self) -> int:
        """Which link brought it, in a flight's log; in others it means nothing."""
        return self.time_utc_us % MOST_LINKS

    @property
    def time_utc_s(self) -> float:
        """Seconds since 1970-01-01 UTC."""
        return self.time_utc_us / 1e6


@dataclass
class TlogBytes:
    """What the bytes of a log were: ``read`` in all, ``skipped`` of them no record; ``tail`` of those at its end."""

    read: int = 0
    skipped: int = 0
    tail: int = 0


def read_tlog(source: str | Path | BinaryIO, count: TlogBytes | None = None) -> Iterator[TlogRecord]:
    """The records of a log in file order, decoded one at a time; damaged stretches and a cut tail are skipped,
    and counted in ``count`` once all is read.

    Raises `TlogError` when the file cannot be read, or holds bytes but not one record.
    """
    if isinstance(source, (str, Path)):
        try:
            with open(source, "rb") as stream:
                yield from _read(stream, str(source), count or TlogBytes())
        except OSError as error:
            raise TlogError(f"log {source}: {error.strerror}") from None
    else:
        yield from _read(source, getattr(source, "name", "log"), count or TlogBytes())


def _read(stream: BinaryIO | io.BufferedIOBase, name: str, count: TlogBytes) -> Iterator[TlogRecord]:
    decoder = mavlink.MAVLink(None)
    buffer = bytearray()
    found = False
    # Whether the last record ended exactly here.
    in_step = True
    while True:
        block = stream.read(_BLOCK)
        count.read += len(block)
        buffer += block
        start = 0
        while start + _STAMP_BYTES < len(buffer):
            length = _record_length(buffer, start, in_step)
            if length is None or start + length + _STAMP_BYTES >= len(buffer):
                # Up to the next marker, which tells whether this record ends there; behind the last one is nothing.
                if block:
                    break
                if length is None or start + length > len(buffer):
                    length = 0
            taken = _open(decoder, buffer, start, length, in_step) if length else None
            in_step = taken is not None
            if taken is None:
                start += 1
                count.tail += 1
                continue
            found = True
            start += length
            count.skipped += count.tail
            skipped, count.tail = count.tail, 0
            yield replace(taken, skipped_bytes=skipped) if skipped else taken
        del buffer[:start]
        if not block:
            break
    count.tail += len(buffer)
    count.skipped += count.tail
    if count.read and not found:
        raise TlogError(f"{name} is no telemetry log: not one MAVLink frame behind a time in {count.read} bytes")


def _record_length(buffer: bytearray, start: int, in_step: bool) -> int | None:
    """Length of the record at ``start``, 0 when there is none, None while its header is incomplete."""
    if buffer[start + _STAMP_BYTES] not in _MARKERS:
        return 0
    stamp_us = int.from_bytes(buffer[start : start + _STAMP_BYTES], "big")
    if not (_EARLIEST_US if in_step else _PLAUSIBLE_US) <= stamp_us <= _LATEST_US:
        return 0
    length = frame_length(buffer, start + _STAMP_BYTES)
    return _STAMP_BYTES + length if length else length


def _open(decoder: Any, buffer: bytearray, start: int, length: int, in_step: bool) -> TlogRecord | None:
    frame = bytes(buffer[start + _STAMP_BYTES : start + length])
    try:
        message = decoder.decode(bytearray(frame))
    except (mavlink.MAVError, ValueError, IndexError):
        return None
    if isinstance(message, mavlink.MAVLink_unknown):
        # Its checksum cannot be known: believed only between one record and another.
        follows = buffer[start + length + _STAMP_BYTES : start + length + _STAMP_BYTES + 1]
        if not in_step or (follows and follows[0] not in _MARKERS):
            return None
        message = None
    return TlogRecord(int.from_bytes(buffer[start : start + _STAMP_BYTES], "big"), frame, message)
