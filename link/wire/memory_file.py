"""A small file whose contents live in shared memory while it is in use, so that a store never waits for a disk.

A store into a file mapped from a disk is fast until the kernel writes the page out. The next one has to tell the file
system that the page changes again and may wait for its journal, with the interpreter's lock held: up to 9 ms beside
three writers on a fast disk (2 ms in shared memory), and no limit to it on a slow one. So the words live in shared
memory (`FOLDER`), which nothing writes out and which the kernel keeps when the process is killed at any instant.
`MemoryFile.save` copies them to the file, from a thread that may wait. Where there is no shared memory the file itself
is mapped.
"""

from __future__ import annotations

import contextlib
import mmap
import os
import stat
from pathlib import Path

FOLDER = Path("/dev/shm")


class MemoryFile:
    """``words`` of the open file of ``size`` bytes, unsigned 64-bit, and ``saved``, the bytes it was found with.

    ``words`` are zeros where nothing was in memory, else what a process left there that was killed; not so where the
    file is ``fresh``. The descriptor stays the caller's. Raises `OSError` when the file cannot be read or mapped.
    """

    def __init__(self, descriptor: int, size: int, *, fresh: bool) -> None:
        self._descriptor = descriptor
        status = os.fstat(descriptor)
        path = FOLDER / f"skyrelay-{os.geteuid()}-{status.st_dev:x}-{status.st_ino:x}"
        if fresh:
            with contextlib.suppress(OSError):
                path.unlink()
        self.saved = os.pread(descriptor, size, 0)
        shared = _shared(path, size)
        self._path = None if shared is None else path
        self._mapping = mmap.mmap(descriptor, size) if shared is None else shared
        self.words = memoryview(self._mapping).cast("Q")

    def save(self) -> None:
        """Copy the words to the file; may wait for the disk, but lets other threads run. Raises `OSError`."""
        if self._path is not None:
            os.pwrite(self._descriptor, self._mapping[:], 0)

    def close(self) -> None:
        """Write the file out and let go of the memory. Raises `OSError` where it cannot be written."""
        contents = self._mapping[:]
        self.words.release()
        self._mapping.close()
        os.pwrite(self._descriptor, contents, 0)
        os.fsync(self._descriptor)
        if self._path is not None:
            # Only now: until then it is what would be found after a kill.
            self._path.unlink(missing_ok=True)


def _shared(path: Path, size: int) -> mmap.mmap | None:
    """``path`` mapped, made where it is not there; None where that cannot be, or where it is someone else's."""
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
    except OSError:
        return None
    try:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode) or status.st_uid != os.geteuid() or status.st_size not in (0, size):
            return None
        # In full beforehand: a store into memory that cannot be had would end the process.
        os.posix_fallocate(descriptor, 0, size)
        return mmap.mmap(descriptor, size)
    except OSError:
        return None
    finally:
        os.close(descriptor)
