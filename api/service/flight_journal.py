"""A flight's events on their way to the store: queued, so that who hears the streamer never waits for the database."""

from __future__ import annotations

import threading
import time
from collections import deque

from gcs.flight import EventKind, FlightEvent
from gcs.store import Store

# Where the vehicle is comes once a second; the history keeps one so often (wall seconds).
_KEEP_PROGRESS_S = 5.0
_AGAIN_S = 0.5
_KEEP = 100_000


class QueuedJournal:
    """A `gcs.flight.Journal`: `append` queues, a thread writes, in order, and goes on trying while the store is away.

    The stream of positions is thinned.
    """

    def __init__(self, store: Store, flight_id: str) -> None:
        self._journal = store.flights.journal(flight_id)
        self._queue: deque[FlightEvent] = deque(maxlen=_KEEP)
        self._there = threading.Condition()
        self._writing = False
        self._kept_s = -float("inf")
        self._thread: threading.Thread | None = None
        self._name = f"journal-{flight_id}"

    def append(self, event: FlightEvent) -> None:
        """Keep ``event``; returns at once."""
        if event.kind is EventKind.PROGRESS:
            now_s = time.monotonic()
            if now_s - self._kept_s < _KEEP_PROGRESS_S:
                return
            self._kept_s = now_s
        with self._there:
            self._queue.append(event)
            if not self._writing:
                # A thread while there is something to write: a flight that has ended keeps none.
                self._writing = True
                threading.Thread(target=self._run, name=self._name, daemon=True).start()

    def wait(self, timeout_s: float) -> bool:
        """Wait until all is written; whether it is."""
        with self._there:
            return self._there.wait_for(lambda: not self._writing, timeout_s)

    def _run(self) -> None:
        while True:
            with self._there:
                if not self._queue:
                    self._writing = False
                    self._there.notify_all()
                    return
                event = self._queue.popleft()
            self._journal.append(event)
            while not self._journal.flush():
                time.sleep(_AGAIN_S)
