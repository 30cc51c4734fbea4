"""Files as commands read and write them: ``-`` is standard input or output; a file appears whole or not at all."""

from __future__ import annotations

import contextlib
import os
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import BinaryIO

from api.cli.errors import BadInputError, FaultError

MAX_DOCUMENT_BYTES = 256 * 1024 * 1024


def read_bytes(name: str, *, what: str, limit_bytes: int = MAX_DOCUMENT_BYTES) -> bytes:
    """The content of file ``name``, or of standard input for ``-``.

    Raises `BadInputError` when it cannot be read or is larger than ``limit_bytes``.
    """
    try:
        if name == "-":
            data = sys.stdin.buffer.read(limit_bytes + 1)
        else:
            with open(name, "rb") as file:
                data = file.read(limit_bytes + 1)
    except OSError as error:
        raise BadInputError(
            f"the {what} cannot be read", {"where": name, "what": error.strerror or str(error), "fix": _read_fix(error)}
        ) from error
    if len(data) > limit_bytes:
        raise BadInputError(f"the {what} is too large", {"where": name, "allowed": f"at most {limit_bytes} bytes"})
    return data


def _read_fix(error: OSError) -> str:
    if isinstance(error, FileNotFoundError):
        return "check the name; `-` reads from standard input"
    if isinstance(error, IsADirectoryError):
        return "name a file in that directory"
    return "check the file's permissions"


def write_chunks(chunks: Iterable[bytes], name: str | None) -> None:
    """Write to file ``name``, or to standard output for ``None`` and ``-``.

    A file is written beside its place and renamed into it at the end, so that a reader never sees half of one and an
    error leaves what was there before. Pipes and devices are written straight.

    Raises `BadInputError` when the place cannot be written, `FaultError` when the disk is full.
    """
    if name is None or name == "-":
        for chunk in chunks:
            sys.stdout.buffer.write(chunk)
        sys.stdout.buffer.flush()
        return
    target = Path(os.path.realpath(name))
    try:
        if target.exists() and not target.is_file():
            if target.is_dir():
                raise IsADirectoryError(21, "is a directory")
            with open(target, "wb") as device:
                device.writelines(chunks)
            return
        handle, temporary = tempfile.mkstemp(prefix=f".{target.name}.", suffix=".part", dir=target.parent)
    except OSError as error:
        raise _cannot_write(name, error) from error
    try:
        with os.fdopen(handle, "wb") as file:
            _fill(file, chunks, name)
        from gcs.exports import umask

        # mkstemp makes files private; a result gets the mode any new file would, or keeps the one it replaces.
        os.chmod(temporary, target.stat().st_mode & 0o7777 if target.exists() else 0o666 & ~umask())
        os.replace(temporary, target)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(temporary)
        raise


def _fill(file: BinaryIO, chunks: Iterable[bytes], name: str) -> None:
    # Only the writes are watched: an OSError out of the chunks' producer is not about the output.
    for chunk in chunks:
        try:
            file.write(chunk)
        except OSError as error:
            raise FaultError("the output could not be written", {"where": name, "what": error.strerror}) from error
    try:
        file.flush()
        os.fsync(file.fileno())
    except OSError as error:
        raise FaultError("the output could not be written", {"where": name, "what": error.strerror}) from error


def _cannot_write(name: str, error: OSError) -> BadInputError:
    return BadInputError(
        "the output cannot be written there",
        {"where": name, "what": error.strerror or str(error), "fix": "name a file in a directory you can write to"},
    )


def write_text(text: str, name: str | None) -> None:
    """`write_chunks` for one piece of text."""
    write_chunks([text.encode("utf-8")], name)
