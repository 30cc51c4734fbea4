"""Planning as jobs: missions queued in the store are planned by guarded processes, and what comes of it is stored.

The store is the queue, so nothing is lost when this process dies: what it was planning is queued again, at once when
it can be seen to be dead, else when its lease runs out. Several of these, on one machine or (with PostgreSQL) many,
share a queue.
"""

from __future__ import annotations

import functools
import logging
import os
import platform
import queue
import threading
import time
import uuid
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from pathlib import Path
from typing import Any

from gcs.errors import GcsError, MissionError, MissionInfeasible, NotFoundError, PlanningCancelled, StoreError
from gcs.jobs.worker_pool import Job, WorkerPool
from gcs.planning.replanning import ReplanOrder
from gcs.store.missions import MissionRecord
from gcs.store.planning_queue import Claim
from gcs.store.store import Store

log = logging.getLogger(__name__)

OnChange = Callable[[MissionRecord], None]
_Key = tuple[str, int]


class PlanningPool:
    """Plans what the store has queued.

    ``processes`` 0 plans nothing (another program does) but still answers. ``limit_s`` is the hard limit of one
    attempt. ``on_change`` is told of every change of a mission's status or progress, from one thread of this pool; it
    must be quick. ``poll_s``: how often the queue is looked at for what others put there; `wake` looks at once.
    """

    def __init__(
        self,
        store: Store,
        *,
        processes: int = 1,
        limit_s: float = 60.0,
        lease_s: float = 30.0,
        poll_s: float = 1.0,
        on_change: OnChange | None = None,
    ) -> None:
        self._store = store
        self._processes = processes
        self._lease_s = lease_s
        self._poll_s = poll_s
        self._on_change = on_change
        self.owner = this_owner()
        self.workers = WorkerPool(processes, limit_s=limit_s) if processes else None
        self._todo: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        # Stored as soon as the store can be used: results must not be lost to a locked database.
        self._unsaved: deque[Callable[[], None]] = deque()
        self._jobs: dict[_Key, tuple[Claim, Job]] = {}
        self._stopping = False
        self._next_care_s = 0.0
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Start planning; what dead planners left is queued again first. Raises `StoreUnavailable`."""
        release_dead(self._store)
        if self.workers is None:
            return
        self.workers.start()
        self.wake()
        self._thread = threading.Thread(target=self._run, name="planning jobs", daemon=True)
        self._thread.start()

    def stop(self, *, grace_s: float = 0.0) -> None:
        """End every process; what is not done within ``grace_s`` is queued again. Returns when all is over."""
        self._stopping = True
        if self.workers is None or self._thread is None:
            return
        self.workers.stop(grace_s=grace_s)
        self._todo.put(None)
        self._thread.join()
        self._thread = None
        try:
            self._store.queue.release(owner=self.owner)
        except StoreError as error:
            log.warning("what was being planned stays leased for now: %s", error)

    def wake(self) -> None:
        """Look at the queue now: a mission was added."""
        self._todo.put(_nothing)

    @property
    def ready(self) -> bool:
        """Whether a process is warm and can plan at once; true where planning is another program's business."""
        return self.workers is None or self.workers.ready > 0

    def stats(self) -> dict[str, int]:
        """Figures for metrics."""
        workers = self.workers
        if workers is None:
            return dict.fromkeys(("processes", "ready", "busy", "restarts", "timeouts"), 0)
        return {
            "processes": self._processes,
            "ready": workers.ready,
            "busy": workers.busy,
            "restarts": workers.restarts,
            "timeouts": workers.timeouts,
        }

    def cancel(self, mission_id: str, version: int | None = None) -> bool:
        """Give up a planning, wherever it is; whether there was one. Raises `NotFoundError`, `StoreUnavailable`."""
        record = self._store.missions.get(mission_id, version)
        done = self._store.missions.cancel(mission_id, record.version)
        job = self._jobs.get((mission_id, record.version))
        if job is not None and self.workers is not None:
            self.workers.cancel(job[1])
        if done:
            self._todo.put(functools.partial(self._tell, mission_id, record.version))
        return done

    def plan(self, mission: Mapping[str, Any], **options: Any) -> Future[dict[str, Any]]:
        """Plan a document that is not stored (a what-if): see `WorkerPool.submit`."""
        if self.workers is None:
            raise PlanningCancelled("this service has no planning processes of its own")
        return self.workers.submit(mission, **options).future

    def replan(self, order: ReplanOrder, *, limit_s: float | None = None) -> Future[dict[str, Any]]:
        """Plan a flight under way anew: see `WorkerPool.submit_replan`."""
        if self.workers is None:
            raise PlanningCancelled("this service has no planning processes of its own")
        return self.workers.submit_replan(order, limit_s=limit_s).future

    # --- the thread that talks to the store -----------------------------------------------------------------

    def _run(self) -> None:
        over = False
        while not over:
            over = self._collect()
            try:
                self._save()
                if not self._stopping:
                    self._care()
                    self._take()
            except StoreError as error:
                log.warning("the planning queue waits for the store: %s", error)
        # The workers are gone, and every result they gave is collected: a few last tries to store what is left.
        for _ in range(20):
            try:
                self._save()
                return
            except StoreError:
                time.sleep(0.1)

    def _collect(self) -> bool:
        """Wait for something to do, at most `poll_s`, and take over all there is; whether this was the end."""
        try:
            todo = self._todo.get(timeout=self._poll_s)
            while todo is not None:
                self._unsaved.append(todo)
                todo = self._todo.get_nowait()
        except queue.Empty:
            return False
        return True

    def _save(self) -> None:
        """Do what was collected, in order. What the store cannot take now stays, and `StoreError` is passed on."""
        while self._unsaved:
            try:
                self._unsaved[0]()
            except StoreError:
                raise
            except Exception:
                log.exception("planning jobs")
            self._unsaved.popleft()

    def _care(self) -> None:
        """Renew leases, and queue again what others let go of."""
        now = time.monotonic()
        if now < self._next_care_s:
            return
        self._next_care_s = now + self._lease_s / 3.0
        if self._jobs:
            self._store.queue.renew(self.owner, self._lease_s)
        self._store.queue.release()

    def _take(self) -> None:
        assert self.workers is not None
        while len(self._jobs) < self._processes:
            claim = self._store.queue.claim(self.owner, self._lease_s)
            if claim is None:
                return
            key = (claim.mission_id, claim.version)
            job = self.workers.submit(claim.document, on_progress=functools.partial(self._heard, claim))
            self._jobs[key] = (claim, job)
            job.future.add_done_callback(functools.partial(self._settled, claim))
            self._tell(*key)

    def _heard(self, claim: Claim, phase: str, fraction: float) -> None:
        self._todo.put(functools.partial(self._progress, claim, phase, fraction))

    def _settled(self, claim: Claim, future: Future[dict[str, Any]]) -> None:
        self._todo.put(functools.partial(self._finish, claim, future))

    def _progress(self, claim: Claim, phase: str, fraction: float) -> None:
        key = (claim.mission_id, claim.version)
        if key not in self._jobs:
            return
        if self._store.queue.set_progress(claim, self.owner, phase, fraction):
            self._tell(*key)
        elif self.workers is not None:
            self.workers.cancel(self._jobs[key][1])  # given up by somebody else, or taken over

    def _finish(self, claim: Claim, future: Future[dict[str, Any]]) -> None:
        key = (claim.mission_id, claim.version)
        store = self._store.queue
        error = future.exception()
        if error is None:
            store.finish(claim, self.owner, future.result())
        elif isinstance(error, MissionInfeasible):
            store.finish_infeasible(claim, self.owner, error)
        elif isinstance(error, PlanningCancelled):
            pass  # its status was set by whoever cancelled it, or it goes back to the queue when the pool stops
        elif isinstance(error, MissionError):
            store.finish_failed(claim, self.owner, str(error))
        else:
            log.error("planning mission %s failed: %s", claim.mission_id, error)
            store.finish_failed(claim, self.owner, str(error) if isinstance(error, GcsError) else repr(error))
        self._jobs.pop(key, None)
        self._tell(*key)

    def _tell(self, mission_id: str, version: int) -> None:
        if self._on_change is None:
            return
        try:
            record = self._store.missions.get(mission_id, version)
        except NotFoundError:
            return
        try:
            self._on_change(record)
        except Exception:
            log.exception("telling of a mission's change failed")


def _nothing() -> None:
    """What is put into the queue only to wake its reader."""


def this_owner() -> str:
    """A name for this process that says which it is: host, process id, its start, and a random part."""
    return f"{platform.node()[:20]}/{os.getpid()}/{_started(os.getpid())}/{uuid.uuid4().hex[:8]}"


def _started(pid: int) -> str:
    """When a process started, in the kernel's ticks; empty when there is none, or no way to tell."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace")
    except OSError:
        return ""
    return text.rpartition(")")[2].split()[19]


def release_dead(store: Store) -> int:
    """Queue again what was being planned by processes of this machine that are dead, or by any whose lease ran out."""
    released = store.queue.release()
    for owner in store.queue.owners():
        parts = owner.split("/")
        if len(parts) != 4 or parts[0] != platform.node()[:20] or not parts[1].isdigit() or not parts[2]:
            continue
        if _started(int(parts[1])) != parts[2]:
            released += store.queue.release(owner=owner)
    return released
