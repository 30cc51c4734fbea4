"""How far each planning process is, told over one pipe without locks: none of them can hold up another, dead or alive."""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Callable
from multiprocessing.context import SpawnContext


class ProgressPipe:
    """Calls ``heard`` with a job's number, phase and fraction, from a thread of its own, for each line that comes in.

    ``writer`` is given to the processes; they write lines no longer than a pipe takes whole.
    """

    def __init__(self, context: SpawnContext, heard: Callable[[int, str, float], None]) -> None:
        self._reader, self.writer = context.Pipe(duplex=False)
        self._heard = heard
        self._thread = threading.Thread(target=self._listen, name="planning progress", daemon=True)

    def start(self) -> None:
        """Start listening."""
        self._thread.start()

    def close(self) -> None:
        """Hear what was written so far, and end."""
        # A process that is killed may have filled the pipe, never for long: somebody reads.
        os.set_blocking(self.writer.fileno(), True)
        os.write(self.writer.fileno(), b"[]\n")
        self._thread.join()
        self.writer.close()
        self._reader.close()

    def _listen(self) -> None:
        with os.fdopen(os.dup(self._reader.fileno()), "rb") as lines:
            for line in lines:
                told = json.loads(line)
                if not told:
                    return
                self._heard(*told)
