"""Planning as jobs: missions queued in the store are planned by guarded processes, and what comes of it is stored.

The mission's row is the record of its planning, so nothing is lost when a process dies; each attempt has a name of its
own, so nothing is done twice with effect (`gcs.store.planning`). Who gets to plan what, and what happens to what the
dead were planning, is said in two ways: `gcs.jobs.local_jobs` and `gcs.jobs.shared_jobs`.

Replans of flights under way have a lane of their own, processes that plan nothing else: they wait for no mission.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
import uuid
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from typing import Any

from gcs.errors import GcsError, MissionError, MissionInfeasible, NotFoundError, PlanningCancelled, StoreError
from gcs.jobs.job import Job
from gcs.jobs.planners import Planners
from gcs.planning.replanning import ReplanOrder
from gcs.store.missions import MissionRecord
from gcs.store.planning import Claim
from gcs.store.store import Store

log = logging.getLogger(__name__)

OnChange = Callable[[MissionRecord], None]
# How often, and at least how many times, a result is offered to a store that cannot take it.
_OFFER_S = 0.1
_LAST_OFFERS = 20


class PlanningJobs(ABC):
    """Plans what the store has queued.

    ``processes`` 0 plans nothing (other programs do) but still answers; ``replan_processes`` is the lane of replans.
    ``limit_s`` is the hard limit of one attempt. ``on_change`` is told of every change this program makes to a mission's
    status or progress, one at a time, from threads of the jobs; it must be quick.
    """

    def __init__(
        self,
        store: Store,
        *,
        processes: int = 1,
        replan_processes: int = 1,
        limit_s: float = 60.0,
        on_change: OnChange | None = None,
    ) -> None:
        self._store = store
        self._processes = processes
        self._on_change = on_change
        self._telling = threading.Lock()
        self._stopping = threading.Event()
        # Flights go before missions on a busy machine, and missions are warm before the lane starts.
        self._replanners = Planners(replan_processes, limit_s=limit_s, niceness=0) if replan_processes else None
        self.planners = (
            Planners(processes, limit_s=limit_s, on_ready=self._open_lane) if processes else None
        )
        self._at_work: dict[tuple[str, int], Job] = {}

    # --- what differs ---------------------------------------------------------------------------------------

    @abstractmethod
    def _begin(self) -> None:
        """Start taking what is queued; what the dead were planning is queued again. Raises `StoreUnavailable`."""

    @abstractmethod
    def _end(self, grace_s: float) -> None:
        """Take nothing more; called before the processes end."""

    @abstractmethod
    def _join(self) -> None:
        """Wait for what was taken; called when the processes have ended."""

    @abstractmethod
    def wake(self) -> None:
        """Look at the queue now: a mission was added."""

    # --- for callers ----------------------------------------------------------------------------------------

    def start(self) -> None:
        """Start planning. Raises `StoreUnavailable`."""
        if self.planners is not None:
            self.planners.start()
        else:
            self._open_lane()
        self._begin()

    def stop(self, *, grace_s: float = 0.0) -> None:
        """End every process; what is not done within ``grace_s`` is queued again. Returns when all is over."""
        self._stopping.set()
        self._end(grace_s)
        for planners in (self.planners, self._replanners):
            if planners is not None:
                planners.stop(grace_s=grace_s)
        self._join()

    @property
    def ready(self) -> bool:
        """Whether a process is warm and can plan at once; true where planning is other programs' business."""
        return self.planners is None or self.planners.ready > 0

    def stats(self) -> dict[str, int]:
        """Figures for metrics."""
        names = ("ready", "busy", "restarts", "timeouts")
        figures = {"processes": self._processes, **dict.fromkeys(names, 0)}
        if self.planners is not None:
            figures |= {name: getattr(self.planners, name) for name in names}
        return figures

    def cancel(self, mission_id: str, version: int | None = None) -> bool:
        """Give up a planning, wherever it is; whether there was one. Raises `NotFoundError`, `StoreUnavailable`."""
        record = self._store.missions.get(mission_id, version)
        done = self._store.missions.cancel(mission_id, record.version)
        self._abandon(mission_id, record.version)
        if done:
            self._tell(mission_id, record.version)
        return done

    def plan(self, mission: Mapping[str, Any], **options: Any) -> Future[dict[str, Any]]:
        """Plan a document that is not stored (a what-if): see `Planners.submit`."""
        if self.planners is None:
            raise PlanningCancelled("this service has no planning processes of its own")
        return self.planners.submit(mission, **options).future

    def replan(self, order: ReplanOrder, *, limit_s: float | None = None) -> Future[dict[str, Any]]:
        """Plan a flight under way anew, in a lane of its own: see `Planners.submit_replan`."""
        if self._replanners is None:
            raise PlanningCancelled("this program replans no flights")
        self._replanners.start()
        return self._replanners.submit_replan(order, limit_s=limit_s).future

    def _open_lane(self) -> None:
        if self._replanners is not None:
            self._replanners.start()

    # --- one attempt, in a thread of its own ----------------------------------------------------------------

    def _abandon(self, mission_id: str, version: int) -> None:
        """End an attempt of this program, if it has one."""
        job = self._at_work.get((mission_id, version))
        if job is not None and self.planners is not None:
            self.planners.cancel(job)

    def _attempt(self, claim: Claim) -> None:
        """Plan a version and store what comes of it; returns when it is stored, queued again or not ours any more."""
        assert self.planners is not None
        key = (claim.mission_id, claim.version)
        news: queue.SimpleQueue[tuple[str, float] | None] = queue.SimpleQueue()
        job = self.planners.submit(claim.document, on_progress=lambda *told: news.put(told))
        self._at_work[key] = job
        try:
            job.future.add_done_callback(lambda _: news.put(None))
            self._tell(*key)
            while (told := news.get()) is not None:
                self._progress(claim, job, *told)
            self._offer(claim, job.future)
        finally:
            if self._at_work.get(key) is job:
                del self._at_work[key]
        self._tell(*key)

    def _progress(self, claim: Claim, job: Job, phase: str, fraction: float) -> None:
        assert self.planners is not None
        try:
            ours = self._store.planning.set_progress(claim, phase, fraction)
        except StoreError as error:
            log.warning("progress of mission %s is not stored: %s", claim.mission_id, error)
            return
        if ours:
            self._tell(claim.mission_id, claim.version)
        else:
            self.planners.cancel(job)  # given up by somebody else, or taken over

    def _offer(self, claim: Claim, future: Future[dict[str, Any]]) -> None:
        """Store the result as soon as the store can be used: it must not be lost to a locked database."""
        left = _LAST_OFFERS
        while True:
            try:
                self._finish(claim, future)
                return
            except StoreError as error:
                log.warning("what became of mission %s waits for the store: %s", claim.mission_id, error)
            left -= self._stopping.is_set()
            if left <= 0:
                return
            time.sleep(_OFFER_S)

    def _finish(self, claim: Claim, future: Future[dict[str, Any]]) -> None:
        planning = self._store.planning
        error = future.exception()
        if error is None:
            planning.finish(claim, future.result())
        elif isinstance(error, MissionInfeasible):
            planning.finish_infeasible(claim, error)
        elif isinstance(error, PlanningCancelled):
            planning.release(claim)  # without effect where somebody cancelled it
        elif isinstance(error, MissionError):
            planning.finish_failed(claim, str(error))
        else:
            log.error("planning mission %s failed: %s", claim.mission_id, error)
            planning.finish_failed(claim, str(error) if isinstance(error, GcsError) else repr(error))

    def _tell(self, mission_id: str, version: int) -> None:
        if self._on_change is None:
            return
        try:
            with self._telling:
                self._on_change(self._store.missions.get(mission_id, version))
        except NotFoundError:
            return
        except Exception:
            log.exception("telling of a mission's change failed")


def new_attempt() -> str:
    """A name for an attempt."""
    return uuid.uuid4().hex
