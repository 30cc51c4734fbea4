"""Stamps that outlive the process: a small file per station, in shared memory while it is in use.

Why in memory: stamps change with every frame, and both directions must survive a crash exactly. ArduPilot raises its
stamp by one a frame, not with time, so a reserve taken in advance would lock it out; and a file write with every
frame has no place in a 50 Hz loop. A store into shared memory costs under a microsecond and is kept by the kernel when
the process is killed at any instant (`link.wire.memory_file`); `save` copies all to the file, which the kernel writes
out in its own time. A power cut may lose up to half a minute of *incoming* stamps; ours are carried on by the clock.

Layout: 512 unsigned 64-bit words in the machine's byte order: a magic number, our own stamp, then pairs of a stream's
mark (in use << 24 | link id << 16 | system << 8 | component) and its stamp. Words are stored whole, so a kill never
leaves half a stamp. The file is allocated in full beforehand, so that a full disk cannot fail a store later.
"""

from __future__ import annotations

import fcntl
import os
from pathlib import Path

from link.errors import SigningError
from link.wire.memory_file import MemoryFile

_WORDS = 512
_SIZE = 8 * _WORDS
_MAGIC = int.from_bytes(b"SKYSIGN1", "little")
_IN_USE = 1 << 24

Stream = tuple[int, int, int]
"""(link id, system, component)."""


class SigningStore:
    """Own stamp and last stamp of every stream; made by `open` or `in_memory`. Close it when the station is done."""

    def __init__(self, words: memoryview, file: tuple[MemoryFile, int] | None = None) -> None:
        self._words = words
        self._file = file
        self._own = int(words[1])
        self._places: dict[Stream, int] = {}
        self._stamps: dict[Stream, int] = {}
        for place in range(2, _WORDS, 2):
            mark = words[place]
            if mark & _IN_USE:
                stream = (mark >> 16 & 255, mark >> 8 & 255, mark & 255)
                self._places[stream] = place
                self._stamps[stream] = int(words[place + 1])

    @classmethod
    def in_memory(cls) -> SigningStore:
        """A store that forgets: tests, and links where nothing is at stake."""
        return cls(memoryview(bytearray(_SIZE)).cast("Q"))

    @classmethod
    def open(cls, path: str | Path) -> SigningStore:
        """The store in a file, made if it is not there; one process at a time.

        Raises `SigningError` when it cannot be made, is not ours, or is in use by another process: two senders with
        one set of stamps would shut each other out.
        """
        path = Path(path)
        descriptor: int | None = None
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                raise SigningError(f"signing state {path} is in use by another process; stop that one first") from None
            fresh = os.fstat(descriptor).st_size <= _SIZE and not any(os.pread(descriptor, _SIZE, 0))
            if fresh:
                # New, or its maker died before the magic number was in: nothing was ever sent with it.
                os.posix_fallocate(descriptor, 0, _SIZE)
                os.pwrite(descriptor, _MAGIC.to_bytes(8, "little"), 0)
                os.fsync(descriptor)
            magic = os.pread(descriptor, 8, 0)
            if os.fstat(descriptor).st_size != _SIZE or int.from_bytes(magic, "little") != _MAGIC:
                raise SigningError(
                    f"signing state {path} is damaged or not ours: restore it; without it, stamps start at the "
                    "clock and a vehicle may not listen for a minute"
                )
            file = MemoryFile(descriptor, _SIZE, fresh=fresh)
            saved = memoryview(file.saved).cast("Q")
            if file.words[0] != _MAGIC:
                file.words[:] = saved
            store = cls(file.words, (file, descriptor))
            store._take_up(cls(saved))
            return store
        except OSError as error:
            if descriptor is not None:
                os.close(descriptor)
            raise SigningError(f"signing state {path}: {error.strerror}; give a writable place") from None
        except SigningError:
            if descriptor is not None:
                os.close(descriptor)
            raise

    def _take_up(self, other: SigningStore) -> None:
        """What is newer there: of memory and file, either may have been in use last."""
        self.own_stamp = max(self.own_stamp, other.own_stamp)
        for stream, stamp in other._stamps.items():
            if stamp > self._stamps.get(stream, -1):
                self.remember(stream, stamp)

    @property
    def own_stamp(self) -> int:
        """The last stamp we sent or adopted."""
        return self._own

    @own_stamp.setter
    def own_stamp(self, stamp: int) -> None:
        self._words[1] = stamp
        self._own = stamp

    def last_stamp(self, stream: Stream) -> int | None:
        """The last stamp accepted from a stream, None for one never heard."""
        return self._stamps.get(stream)

    def remember(self, stream: Stream, stamp: int) -> bool:
        """Store a stream's stamp; False when the table is full (255 streams, all of holders of the key)."""
        place = self._places.get(stream)
        if place is None:
            place = 2 + 2 * len(self._places)
            if place >= _WORDS:
                return False
            # The stamp goes in before the mark that makes it count.
            self._words[place + 1] = stamp
            self._words[place] = _IN_USE | stream[0] << 16 | stream[1] << 8 | stream[2]
            self._places[stream] = place
        else:
            self._words[place + 1] = stamp
        self._stamps[stream] = stamp
        return True

    def save(self) -> None:
        """Copy all stamps to the file, so that a power cut loses few; from a thread that may wait for a disk.

        Raises `OSError` where the file cannot be written.
        """
        if self._file is not None:
            self._file[0].save()

    def close(self) -> None:
        """Write out and let go of the file; further stamps are kept in memory alone."""
        if self._file is None:
            return
        (file, descriptor), self._file = self._file, None
        self._words = memoryview(bytearray(self._words)).cast("Q")
        try:
            file.close()
        finally:
            os.close(descriptor)
