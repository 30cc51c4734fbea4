"""Planning processes under guard: a hard time limit, crashes and hangs survived, no process left behind.

::

    submit -> waiting --> running --> planned, infeasible, malformed, failed
                 ^           |
                 |           | longer than the limit, or the process died: it is killed and replaced
                 +-----------+ once more with the fallback method, then failed

One thread (the dispatcher) owns all processes and sockets. Processes are started fresh (no fork of a threaded
program), import the planner and plan once before they are given work, so that a warm service plans at once.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import logging
import os
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from typing import Any

from gcs.errors import InputFault, MissionError, PlanningCancelled, PlanningFailed, infeasible_from_document
from gcs.jobs.worker import MAX_MESSAGE_BYTES
from gcs.planning.replanning import ReplanOrder

log = logging.getLogger(__name__)

Progress = Callable[[str, float], None]
FALLBACK = "paper"
# A process that is not ready by then is taken for hung.
START_LIMIT_S = 120.0
_MOST_BAD_STARTS = 5
_MESSAGE_LIMIT_S = 5
_BOOT = "import json, sys; sys.path[:] = json.loads(sys.argv[1]); from gcs.jobs.worker import main; main()"


@dataclass(eq=False)
class Job:
    """A mission, or a flight to replan, handed to the pool; ``future`` gets the plan document or the error."""

    number: int
    task: Mapping[str, Any]
    method: str | None
    limit_s: float
    on_progress: Progress | None
    future: Future[dict[str, Any]] = field(default_factory=Future)
    notes: list[str] = field(default_factory=list)
    attempts: int = 0
    cancelled: bool = False


@dataclass(eq=False)
class _Worker:
    process: subprocess.Popen[bytes]
    channel: Connection[Any, Any]
    started_s: float
    ready: bool = False
    job: Job | None = None
    deadline_s: float = float("inf")


class WorkerPool:
    """Up to ``processes`` planning processes.

    ``limit_s`` is how long one attempt may take before its process is killed. ``clock`` is monotonic seconds.
    """

    def __init__(self, processes: int, *, limit_s: float = 60.0, clock: Callable[[], float] = time.monotonic) -> None:
        if processes < 1 or not limit_s > 0:
            raise ValueError(f"processes and limit_s must be positive, not {processes} and {limit_s}")
        self._count = processes
        self._limit_s = limit_s
        self._clock = clock
        self._lock = threading.Lock()
        self._waiting: deque[Job] = deque()
        self._workers: list[_Worker] = []
        self._numbers = itertools.count(1)
        self._wake_r, self._wake_w = os.pipe()
        os.set_blocking(self._wake_w, False)
        self._stopping = False
        self._grace_s = 0.0
        self._thread: threading.Thread | None = None
        self._bad_starts = 0
        self._next_start_s = 0.0
        self.restarts = 0
        self.timeouts = 0

    # --- for callers ----------------------------------------------------------------------------------------

    def start(self) -> None:
        """Start the processes; returns before they are ready."""
        if self._thread is None:
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
        """Queue a mission document. ``on_progress`` is called from the dispatcher and must be quick.

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
        return sum(worker.ready for worker in list(self._workers))

    @property
    def busy(self) -> int:
        """Processes at work."""
        return sum(worker.job is not None for worker in list(self._workers))

    @property
    def waiting(self) -> int:
        """Jobs no process has taken yet."""
        return len(self._waiting)

    @property
    def pids(self) -> list[int]:
        """Process ids of the planning processes."""
        return [worker.process.pid for worker in list(self._workers)]

    def stop(self, *, grace_s: float = 0.0) -> None:
        """End every process, ``grace_s`` after being told; what is not done is cancelled. Returns when all are gone."""
        with self._lock:
            self._stopping = True
            self._grace_s = grace_s
        self._wake()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        for descriptor in (self._wake_r, self._wake_w):
            with contextlib.suppress(OSError):
                os.close(descriptor)

    def _wake(self) -> None:
        with contextlib.suppress(OSError):  # full: it will wake anyway; closed: it has ended
            os.write(self._wake_w, b"x")

    # --- the dispatcher -------------------------------------------------------------------------------------

    def _run(self) -> None:
        try:
            while not self._stopping:
                self._fill()
                self._drop_cancelled()
                self._assign()
                self._listen(self._next_event_s())
                self._enforce_limits()
            end = self._clock() + self._grace_s
            while any(w.job for w in self._workers) and self._clock() < end:
                self._listen(end)
                self._drop_cancelled()
                self._enforce_limits(replace=False)
        except BaseException:
            log.exception("the planning dispatcher failed")
            raise
        finally:
            for worker in list(self._workers):
                if worker.job is not None:
                    self._settle(worker.job, error=PlanningCancelled("the planners are shutting down"))
                self._end(worker)
            with self._lock:
                self._stopping = True
                left, self._waiting = list(self._waiting), deque()
            for job in left:
                self._settle(job, error=PlanningCancelled("the planners are shutting down"))

    def _fill(self) -> None:
        if self._bad_starts >= _MOST_BAD_STARTS:
            self._fail_waiting()
        while len(self._workers) < self._count and self._clock() >= self._next_start_s:
            try:
                self._workers.append(self._spawn())
            except OSError as error:
                log.error("cannot start a planning process: %s", error)
                self._bad_start()

    def _bad_start(self) -> None:
        self._bad_starts += 1
        self._next_start_s = self._clock() + min(30.0, 0.2 * 2.0**self._bad_starts)

    def _fail_waiting(self) -> None:
        """No process came up several times in a row: waiting would be for ever."""
        with self._lock:
            left, self._waiting = list(self._waiting), deque()
        for job in left:
            self._settle(job, error=PlanningFailed("planning processes cannot be started; see the log"))

    def _spawn(self) -> _Worker:
        ours, theirs = socket.socketpair()
        with ours, theirs:
            # A hung process must not hold up the dispatcher half-way through a message.
            for option in (socket.SO_SNDTIMEO, socket.SO_RCVTIMEO):
                ours.setsockopt(socket.SOL_SOCKET, option, struct.pack("ll", _MESSAGE_LIMIT_S, 0))
            environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
            process = subprocess.Popen(
                [sys.executable, "-c", _BOOT, json.dumps(sys.path), str(theirs.fileno()), str(os.getpid())],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                env=environment,
                start_new_session=True,
            )
            return _Worker(process, Connection(ours.detach()), self._clock())

    def _assign(self) -> None:
        for worker in self._workers:
            if not worker.ready or worker.job is not None:
                continue
            with self._lock:
                if not self._waiting:
                    return
                job = self._waiting.popleft()
            task = {"task": job.number, **job.task, "method": job.method, "notes": job.notes}
            worker.job, worker.deadline_s = job, self._clock() + job.limit_s
            job.attempts += 1
            try:
                worker.channel.send_bytes(json.dumps(task, allow_nan=False).encode())
            except OSError:
                self._died(worker)
                return

    def _next_event_s(self) -> float:
        times = [w.deadline_s for w in self._workers if w.job is not None]
        times += [w.started_s + START_LIMIT_S for w in self._workers if not w.ready]
        if len(self._workers) < self._count:
            times.append(self._next_start_s)
        return min(times, default=self._clock() + 3600.0)

    def _listen(self, until_s: float) -> None:
        channels = {worker.channel: worker for worker in self._workers}
        timeout = min(max(0.0, until_s - self._clock()), 3600.0)
        for source in wait([self._wake_r, *channels], timeout):
            if isinstance(source, int):
                os.read(source, 65_536)
                continue
            worker = channels[source]  # type: ignore[index]
            try:
                message = json.loads(worker.channel.recv_bytes(MAX_MESSAGE_BYTES))
            except (EOFError, OSError, ValueError):
                self._died(worker)
                continue
            self._heard(worker, message)

    def _heard(self, worker: _Worker, message: dict[str, Any]) -> None:
        if message.get("ready"):
            worker.ready, self._bad_starts = True, 0
            return
        job = worker.job
        if job is None or message.get("task") != job.number:
            return
        if "phase" in message:
            if job.on_progress is not None and not job.cancelled:
                try:
                    job.on_progress(str(message["phase"]), float(message["fraction"]))
                except Exception:
                    log.exception("telling the progress of a planning failed")
            return
        worker.job, worker.deadline_s = None, float("inf")
        if "plan" in message:
            self._settle(job, plan=message["plan"])
        elif "infeasible" in message:
            self._settle(job, error=infeasible_from_document(message["infeasible"]))
        elif "malformed" in message:
            self._settle(job, error=MissionError([InputFault(**fault) for fault in message["malformed"]]))
        elif job.method != FALLBACK and job.attempts == 1:
            self._again(job, f"the {job.method or 'joint'} method failed ({message.get('failed')})")
        else:
            self._settle(job, error=PlanningFailed(str(message.get("failed"))))

    def _died(self, worker: _Worker) -> None:
        """The process is gone, or its socket is: it makes room for another, and its job is tried once more."""
        self._end(worker)
        job = worker.job
        code = worker.process.returncode
        log.warning("planning process %d ended (%s)", worker.process.pid, code)
        self.restarts += 1
        if not worker.ready:
            self._bad_start()
        if job is not None:
            self._again(job, f"the process planning by the {job.method or 'joint'} method ended ({_exit_text(code)})")

    def _enforce_limits(self, *, replace: bool = True) -> None:
        now = self._clock()
        for worker in list(self._workers):
            job = worker.job
            if job is not None and now >= worker.deadline_s:
                log.warning("planning process %d took longer than %.1f s", worker.process.pid, job.limit_s)
                self._end(worker)
                self.timeouts += 1
                self.restarts += 1
                what = f"the {job.method or 'joint'} method took longer than {job.limit_s:g} s"
                if replace:
                    self._again(job, what)
                else:
                    self._settle(job, error=PlanningCancelled("the planners are shutting down"))
            elif not worker.ready and now >= worker.started_s + START_LIMIT_S:
                log.error("planning process %d did not get ready", worker.process.pid)
                self._end(worker)
                self._bad_start()

    def _again(self, job: Job, why: str) -> None:
        if job.cancelled or job.attempts >= 2:
            error = PlanningCancelled("cancelled") if job.cancelled else PlanningFailed(f"{why}, the second attempt")
            self._settle(job, error=error)
            return
        job.method = FALLBACK
        job.notes.append(f"{why}; this plan was made by the fallback method")
        with self._lock:
            self._waiting.appendleft(job)

    def _drop_cancelled(self) -> None:
        with self._lock:
            gone = [job for job in self._waiting if job.cancelled]
            self._waiting = deque(job for job in self._waiting if not job.cancelled)
        for job in gone:
            self._settle(job, error=PlanningCancelled("cancelled"))
        for worker in list(self._workers):
            if worker.job is not None and worker.job.cancelled:
                self._end(worker)
                self.restarts += 1
                self._settle(worker.job, error=PlanningCancelled("cancelled"))

    def _end(self, worker: _Worker) -> None:
        """Kill a process and reap it. A stopped or hung one dies of SIGKILL too."""
        if worker in self._workers:
            self._workers.remove(worker)
        worker.channel.close()
        with contextlib.suppress(ProcessLookupError):
            worker.process.send_signal(signal.SIGKILL)
        worker.process.wait()

    @staticmethod
    def _settle(job: Job, *, plan: dict[str, Any] | None = None, error: Exception | None = None) -> None:
        if job.future.done():
            return
        if error is not None:
            job.future.set_exception(error)
        else:
            job.future.set_result(plan or {})


def _exit_text(code: int | None) -> str:
    if code is not None and code < 0:
        return f"signal {-code}"
    return f"exit code {code}"
