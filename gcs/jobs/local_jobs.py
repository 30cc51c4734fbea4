"""The jobs of the only service on a database: the rows are the queue, and what was under way is queued again at start."""

from __future__ import annotations

import logging
import threading
from typing import Any

from gcs.errors import StoreError
from gcs.jobs.planning_jobs import PlanningJobs, new_attempt
from gcs.store.planning import Claim

log = logging.getLogger(__name__)

# How soon the queue is looked at again where nobody said that a mission was added, and after the store failed.
_POLL_S = 1.0


class LocalJobs(PlanningJobs):
    """A thread for each process: takes the version that has waited longest, has it planned, stores what comes of it."""

    def __init__(self, *given: Any, poll_s: float = _POLL_S, **more: Any) -> None:
        super().__init__(*given, **more)
        self._poll_s = poll_s
        self._news = threading.Condition()
        self._calls = 0
        self._threads: list[threading.Thread] = []

    def wake(self) -> None:
        """Look at the queue now: a mission was added."""
        with self._news:
            self._calls += 1
            self._news.notify_all()

    def _begin(self) -> None:
        # Whoever was planning is dead: there is one service, and this is it.
        self._store.planning.queue_again()
        for number in range(self._processes):
            self._threads.append(threading.Thread(target=self._run, name=f"planning job {number}", daemon=True))
            self._threads[-1].start()

    def _end(self, grace_s: float) -> None:
        self.wake()

    def _join(self) -> None:
        for thread in self._threads:
            thread.join()
        self._threads = []

    def _run(self) -> None:
        while not self._stopping.is_set():
            calls = self._calls
            claim = self._take()
            if claim is None:
                with self._news:
                    self._news.wait_for(lambda: self._calls != calls or self._stopping.is_set(), self._poll_s)
                continue
            try:
                self._attempt(claim)
            except Exception:
                log.exception("planning mission %s", claim.mission_id)

    def _take(self) -> Claim | None:
        try:
            return self._store.planning.take(new_attempt())
        except StoreError as error:
            log.warning("the planning queue waits for the store: %s", error)
            return None
