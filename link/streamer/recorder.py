"""The streamer's log of frames, written without making a tick wait."""

from __future__ import annotations

import contextlib
import json
import os
import queue
import threading
import time
from collections.abc import Iterable, Sequence
from pathlib import Path

from gcs.flight import FlightEvent
from link.files.kept_once import KeptOnce
from link.files.tlog import MOST_LINKS, TlogWriter
from link.streamer.scheduling import REAL_TIME_PRIORITY, raise_priority
from link.wire.signing_timestamps import SigningStore

SAVE_EVERY_S = 1.0
"""How often signing stamps are copied from memory to their files."""


class Recorder:
    """Writes frames, events and stamps from a thread of its own; never blocks and never raises into the flight."""

    def __init__(
        self,
        run_dir: Path,
        log_path: str | None,
        epoch_unix_s: float,
        stores: Iterable[SigningStore] = (),
        *,
        urls: Sequence[str] = (),
        vehicle_system_id: int = 1,
    ) -> None:
        self._queue: queue.SimpleQueue[tuple[str, float, bytes, str] | None] = queue.SimpleQueue()
        self._links = {url: min(number, MOST_LINKS - 1) for number, url in enumerate(urls)}
        self._once = KeptOnce(vehicle_system_id)
        self._epoch_unix_s = epoch_unix_s
        self._stores = tuple(stores)
        self._log = None if log_path is None else TlogWriter(log_path, tolerant=True)
        self._events = os.open(run_dir / "events.jsonl", os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o600)
        self.dropped = 0
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    @property
    def log_path(self) -> str | None:
        """The log's own file: another name than the one asked for where that was taken."""
        return None if self._log is None else str(self._log.path)

    def frame(self, now_s: float, frame: bytes, url: str = "") -> None:
        """Keep a frame sent, or heard over a link; a message of the vehicle once, over whichever came first."""
        if self._log is not None:
            self._queue.put(("frame", now_s, frame, url))

    def event(self, event: FlightEvent) -> None:
        """Keep an event."""
        self._queue.put(("event", 0.0, json.dumps(event.to_document()).encode() + b"\n", ""))

    def close(self) -> None:
        """Write out what is queued, for a few seconds at most."""
        self._queue.put(None)
        self._thread.join(5.0)

    def _run(self) -> None:
        # Kept waiting for a processor while it holds the interpreter's lock, it would keep the flight waiting.
        raise_priority(REAL_TIME_PRIORITY - 1)
        save_at_s = time.monotonic() + SAVE_EVERY_S
        while True:
            with contextlib.suppress(queue.Empty):
                item = self._queue.get(timeout=max(0.0, save_at_s - time.monotonic()))
                if item is None:
                    break
                self._write(*item)
            if time.monotonic() >= save_at_s:
                self._save()
                save_at_s = time.monotonic() + SAVE_EVERY_S
        if self._log is not None:
            self._log.close()
        os.close(self._events)

    def _write(self, kind: str, now_s: float, data: bytes, url: str) -> None:
        try:
            if kind == "event":
                os.write(self._events, data)
            elif self._log is not None and (not self._links or self._once.fresh(now_s, url, data)):
                time_us = int((self._epoch_unix_s + now_s) * 1e6)
                self._log.write(data, time_us // MOST_LINKS * MOST_LINKS + self._links.get(url, 0))
        except OSError:
            self.dropped += 1

    def _save(self) -> None:
        for store in self._stores:
            with contextlib.suppress(OSError):  # they are in memory, and it is tried again
                store.save()
