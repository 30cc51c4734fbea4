"""Where commands print: rich on a terminal, plain text elsewhere; results on stdout, the rest on stderr."""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Callable
from types import TracebackType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console


def out() -> Console:
    """A console on standard output; wide enough off a terminal that tables are not folded."""
    from rich.console import Console

    return Console(highlight=False, soft_wrap=True, width=None if sys.stdout.isatty() else 200)


class Progress:
    """One line that is rewritten on a terminal, and a plain line every ``every_s`` seconds elsewhere.

    Used as a context: leaving it finishes the line. Goes to standard error unless told otherwise.
    """

    def __init__(self, *, every_s: float = 5.0, to_stdout: bool = False, clock: Callable[[], float] = time.monotonic):
        self._stream = sys.stdout if to_stdout else sys.stderr
        self._tty = self._stream.isatty()
        self._every_s = 0.1 if self._tty else every_s
        self._clock = clock
        self._last_s = -float("inf")
        self._shown = ""
        self._pending: str | None = None

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, tb: TracebackType | None) -> None:
        if self._pending is not None and kind is None:
            self._write(self._pending)
        if self._tty and self._shown:
            self._stream.write("\n")
            self._stream.flush()

    def note(self, text: str) -> None:
        """A line that stays, above the progress line."""
        self._pending = None
        self._stream.write(("\r\x1b[2K" if self._tty else "") + text + "\n")
        if self._tty and self._shown:
            self._stream.write(self._shown)
        self._stream.flush()

    def show(self, text: str, *, now: bool = False) -> None:
        """Show ``text`` when it is time to, or at once with ``now``."""
        if now or self._clock() - self._last_s >= self._every_s:
            self._write(text)
        else:
            self._pending = text

    def _write(self, text: str) -> None:
        self._last_s, self._pending = self._clock(), None
        if self._tty:
            # A line longer than the screen would wrap and could not be rewritten.
            text = text[: max(20, shutil.get_terminal_size().columns - 1)]
            self._stream.write("\r\x1b[2K" + text)
        else:
            self._stream.write(text + "\n")
        self._stream.flush()
        self._shown = text
