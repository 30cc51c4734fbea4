"""Planning processes under guard: a hard time limit, crashes and hangs survived, no process left behind.

::

    submit -> waiting --> running --> planned, infeasible, malformed, failed
                 ^           |
                 |           | longer than the limit, or the process died: it is killed and replaced
                 +-----------+ once more with the fallback method, then failed

Each process is a pebble pool of its own: one that dies in the middle of a message takes no other along. Processes
are started fresh (no fork of a threaded program), import the planner and plan once before they are given work, so that a
warm service plans at once. One thread (the dispatcher) owns them all.
"""

from __future__ import annotations

import contextlib
import functools
import itertools
import logging
import multiprocessing
import os
import queue
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import CancelledError, Future
from concurrent.futures import TimeoutError as FutureTimeoutError
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import Any

from pebble import ProcessExpired, ProcessFuture, ProcessPool

from gcs.errors import PlanningCancelled, PlanningFailed
from gcs.jobs import planning_process
from gcs.jobs.job import Job, Progress
from gcs.jobs.progress_pipe import ProgressPipe
from gcs.planning.replanning import ReplanOrder

log = logging.getLogger(__name__)

FALLBACK = "paper"
# A process that is not ready by then is taken for hung.
START_LIMIT_S = 120.0
# One that pebble has not ended so long after the limit never took its task, and is killed by us.
_OVERTIME_S = 1.0
_MOST_BAD_STARTS = 5
# One thread a process: they share the cores as it is.
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(eq=False)
class _Slot:
    """A process: starting (``pid`` 0), idle, or at work on ``job``."""

    pool: ProcessPool
    started_s: float
    pid: int = 0
    job: Job | None = None
    work: ProcessFuture[dict[str, Any]] | None = None
    deadline_s: float = float("inf")


class Planners:
    """Up to ``processes`` planning processes.

    ``limit_s`` is how long one attempt may take before its process is killed; ``niceness`` is added to theirs;
    ``on_ready`` is called, once, when the first is warm.
    """

    def __init__(
        self,
        processes: int,
        *,
        limit_s: float = 60.0,
        niceness: int = 5,
        on_ready: Callable[[], None] | None = None,
    ) -> None:
        if processes < 1 or not limit_s > 0:
            raise ValueError(f"processes and limit_s must be positive, not {processes} and {limit_s}")
        self._count = processes
        self._limit_s = limit_s
        self._niceness = niceness
        self._on_ready = on_ready
        self._lock = threading.Lock()
        self._waiting: deque[Job] = deque()
        self._slots: list[_Slot] = []
        self._numbers = itertools.count(1)
        self._events: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._context = multiprocessing.get_context("spawn")
        self._progress = ProgressPipe(self._context, self._heard)
        self._stopping = False
        self._grace_s = 0.0
        self._thread: threading.Thread | None = None
        self._bad_starts = 0
        self._next_start_s = 0.0
        self.restarts = 0
        self.timeouts = 0

    # --- for callers ----------------------------------------------------------------------------------------

    def start(self) -> None:
        """Start the processes; returns before they are ready. Twice does no harm."""
        with self._lock:
            if self._thread is not None or self._stopping:
                return
            self._thread = threading.Thread(target=self._run, name="planning dispatcher", daemon=True)
        self._thread.start()

    def submit(
        self,
        mission: Mapping[str, Any],
        *,
        method: str | None = None,
        limit_s: float | None = None,
        on_progress: Progress | None = None,
    ) -> Job:
        """Queue a mission document. ``on_progress`` is called from a thread of the planners and must be quick.

        The job's future raises `MissionInfeasible`, `MissionError`, `PlanningFailed` or `PlanningCancelled`.
        """
        return self._submit({"mission": mission}, method, limit_s, on_progress)

    def submit_replan(self, order: ReplanOrder, *, method: str | None = None, limit_s: float | None = None) -> Job:
        """Queue a replan; the job's future gets the document of a `gcs.planning.replanning.Replanned`, or raises as for
        `submit`.
        """
        return self._submit({"replan": order.to_document()}, method, limit_s, None)

    def _submit(
        self, task: Mapping[str, Any], method: str | None, limit_s: float | None, on_progress: Progress | None
    ) -> Job:
        job = Job(next(self._numbers), task, method, limit_s or self._limit_s, on_progress)
        with self._lock:
            stopping = self._stopping
            if not stopping:
                self._waiting.append(job)
        if stopping:
            job.future.set_exception(PlanningCancelled("the planners are shutting down"))
        self._wake()
        return job

    def cancel(self, job: Job) -> None:
        """Give a job up; a process that works on it is killed and replaced."""
        job.cancelled = True
        self._wake()

    @property
    def ready(self) -> int:
        """Processes that can take a mission, or work on one."""
        return sum(slot.pid > 0 for slot in list(self._slots))

    @property
    def busy(self) -> int:
        """Processes at work."""
        return sum(slot.job is not None for slot in list(self._slots))

    @property
    def waiting(self) -> int:
        """Jobs no process has taken yet."""
        return len(self._waiting)

    @property
    def pids(self) -> list[int]:
        """Process ids of the planning processes that are ready."""
        return [slot.pid for slot in list(self._slots) if slot.pid]

    def stop(self, *, grace_s: float = 0.0) -> None:
        """End every process, ``grace_s`` after being told; what is not done is cancelled. Returns when all are gone."""
        with self._lock:
            self._stopping = True
            self._grace_s = grace_s
            thread, self._thread = self._thread, None
        self._wake()
        if thread is not None:
            thread.join()

    def _wake(self) -> None:
        self._events.put(_nothing)

    # --- the dispatcher -------------------------------------------------------------------------------------

    def _run(self) -> None:
        for name in _ONE_THREAD:
            os.environ.setdefault(name, "1")
        self._progress.start()
        try:
            while not self._stopping:
                self._fill()
                self._drop_cancelled()
                self._assign()
                self._handle(self._next_event_s())
                self._enforce_limits()
            end = time.monotonic() + self._grace_s
            while any(slot.job for slot in self._slots) and time.monotonic() < end:
                self._handle(end)
                self._drop_cancelled()
        except BaseException:
            log.exception("the planning dispatcher failed")
            raise
        finally:
            with self._lock:
                self._stopping = True
                left, self._waiting = list(self._waiting), deque()
            for slot in list(self._slots):
                if slot.job is not None:
                    left.append(slot.job)
                self._discard(slot)
            for job in left:
                job.fail(PlanningCancelled("the planners are shutting down"))
            self._progress.close()

    def _heard(self, number: int, phase: str, fraction: float) -> None:
        for slot in list(self._slots):
            job = slot.job
            if job is not None and job.number == number and job.on_progress is not None and not job.cancelled:
                try:
                    job.on_progress(phase, fraction)
                except Exception:
                    log.exception("telling the progress of a planning failed")

    def _fill(self) -> None:
        if self._bad_starts >= _MOST_BAD_STARTS:
            self._fail_waiting()
        while len(self._slots) < self._count and time.monotonic() >= self._next_start_s:
            start = (os.getpid(), self._niceness, self._progress.writer)
            slot = _Slot(
                ProcessPool(1, initializer=planning_process.prepare, initargs=start, context=self._context),
                time.monotonic(),
            )
            self._slots.append(slot)
            self._await_ready(slot)

    def _await_ready(self, slot: _Slot) -> None:
        slot.pid, slot.started_s = 0, time.monotonic()
        try:
            future = slot.pool.schedule(planning_process.process_id)
        except (OSError, RuntimeError) as error:
            log.error("cannot start a planning process: %s", error)
            self._discard(slot)
            self._bad_start()
            return
        future.add_done_callback(lambda done: self._events.put(functools.partial(self._up, slot, done)))

    def _up(self, slot: _Slot, done: Future[int]) -> None:
        if slot not in self._slots:
            return
        if done.cancelled() or done.exception() is not None:
            log.error("a planning process did not get ready: %s", "cancelled" if done.cancelled() else done.exception())
            self._discard(slot)
            self._bad_start()
            return
        slot.pid, self._bad_starts = done.result(), 0
        if self._on_ready is not None:
            tell, self._on_ready = self._on_ready, None
            tell()

    def _bad_start(self) -> None:
        self._bad_starts += 1
        self._next_start_s = time.monotonic() + min(30.0, 0.2 * 2.0**self._bad_starts)

    def _fail_waiting(self) -> None:
        """No process came up several times in a row: waiting would be for ever."""
        with self._lock:
            left, self._waiting = list(self._waiting), deque()
        for job in left:
            job.fail(PlanningFailed("planning processes cannot be started; see the log"))

    def _assign(self) -> None:
        for slot in list(self._slots):
            if not slot.pid or slot.job is not None:
                continue
            with self._lock:
                if not self._waiting:
                    return
                job = self._waiting.popleft()
            slot.job, slot.deadline_s = job, time.monotonic() + job.limit_s + _OVERTIME_S
            job.attempts += 1
            try:
                work = slot.pool.schedule(planning_process.plan, args=(job.message,), timeout=job.limit_s)
            except RuntimeError as error:
                self._died(slot, str(error))
                continue
            slot.work = work
            work.add_done_callback(lambda done, slot=slot: self._events.put(functools.partial(self._done, slot, done)))

    def _next_event_s(self) -> float:
        times = [slot.deadline_s for slot in self._slots if slot.job is not None]
        times += [slot.started_s + START_LIMIT_S for slot in self._slots if not slot.pid]
        if len(self._slots) < self._count:
            times.append(self._next_start_s)
        return min(times, default=time.monotonic() + 3600.0)

    def _handle(self, until_s: float) -> None:
        """Wait for something to happen, and take in all that has."""
        with contextlib.suppress(queue.Empty):
            event = self._events.get(timeout=max(0.0, min(until_s - time.monotonic(), 3600.0)))
            while True:
                event()
                event = self._events.get_nowait()

    def _done(self, slot: _Slot, done: Future[dict[str, Any]]) -> None:
        job = slot.job
        if job is None or slot.work is not done:
            return
        # Cancelled ones are taken off in `_drop_cancelled`.
        error = CancelledError() if done.cancelled() else done.exception()
        if isinstance(error, FutureTimeoutError):
            self._timed_out(slot, job)
        elif isinstance(error, ProcessExpired | BrokenProcessPool):
            self._died(slot, _exit_text(getattr(error, "exitcode", None)))
        else:
            slot.job, slot.work, slot.deadline_s = None, None, float("inf")
            answer = done.result() if error is None else {"failed": f"{type(error).__name__}: {error}"}
            self._failed(job, str(answer["failed"])) if "failed" in answer else job.settle(answer)

    def _failed(self, job: Job, why: str) -> None:
        if job.method != FALLBACK and job.attempts == 1:
            self._again(job, f"the {job.method or 'joint'} method failed ({why})")
        else:
            job.fail(PlanningFailed(why))

    def _died(self, slot: _Slot, how: str) -> None:
        """The process is gone: it makes room for another, and its job is tried once more."""
        job = slot.job
        log.warning("planning process %d ended (%s)", slot.pid, how)
        slot.pid = 0
        self._discard(slot)
        self.restarts += 1
        if job is not None:
            self._again(job, f"the process planning by the {job.method or 'joint'} method ended ({how})")

    def _timed_out(self, slot: _Slot, job: Job) -> None:
        """Pebble has killed the process, and started another in its place."""
        log.warning("planning process %d took longer than %.1f s", slot.pid, job.limit_s)
        slot.job, slot.work, slot.deadline_s = None, None, float("inf")
        self.timeouts += 1
        self.restarts += 1
        self._await_ready(slot)
        self._again(job, f"the {job.method or 'joint'} method took longer than {job.limit_s:g} s")

    def _enforce_limits(self) -> None:
        now = time.monotonic()
        for slot in list(self._slots):
            job = slot.job
            if job is not None and now >= slot.deadline_s:
                self._discard(slot)
                log.warning("planning process %d hung", slot.pid)
                self.timeouts += 1
                self.restarts += 1
                self._again(job, f"the {job.method or 'joint'} method took longer than {job.limit_s:g} s")
            elif not slot.pid and now >= slot.started_s + START_LIMIT_S:
                log.error("a planning process did not get ready in %.0f s", START_LIMIT_S)
                self._discard(slot)
                self._bad_start()

    def _again(self, job: Job, why: str) -> None:
        if job.cancelled or job.attempts >= 2:
            error = PlanningCancelled("cancelled") if job.cancelled else PlanningFailed(f"{why}, the second attempt")
            job.fail(error)
            return
        job.method = FALLBACK
        job.notes.append(f"{why}; this plan was made by the fallback method")
        with self._lock:
            self._waiting.appendleft(job)

    def _drop_cancelled(self) -> None:
        with self._lock:
            gone = [job for job in self._waiting if job.cancelled]
            self._waiting = deque(job for job in self._waiting if not job.cancelled)
        for slot in list(self._slots):
            if slot.job is not None and slot.job.cancelled:
                gone.append(slot.job)
                self._discard(slot)
                self.restarts += 1
        for job in gone:
            job.fail(PlanningCancelled("cancelled"))

    def _discard(self, slot: _Slot) -> None:
        """Kill a process and reap it. A stopped or hung one dies of SIGKILL too."""
        if slot in self._slots:
            self._slots.remove(slot)
        slot.job = slot.work = None
        slot.pool.stop()
        if slot.pid:
            with contextlib.suppress(ProcessLookupError):
                os.kill(slot.pid, signal.SIGKILL)
        slot.pool.join()


def _nothing() -> None:
    """What is put among the events only to wake their reader."""


def _exit_text(code: int | None) -> str:
    if code is None:
        return "killed"
    return f"signal {-code}" if code < 0 else f"exit code {code}"
