"""Starting, watching and ending streamers: the same for the command line and the service.

A streamer is a process of its own in a session of its own; it outlives whoever started it, and whoever comes later can
attach to it by its run folder. A streamer that dies is not restarted: its vehicle's failsafe has the aircraft, and only
a person may take it back.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gcs.errors import InputFault
from gcs.flight import EventKind, FlightEvent, FlightState, Journal, TransitionError
from gcs.timestamps import utc_now_text
from link.errors import FlightRequestError, SupervisorError
from link.files.change_journal import FileJournal, runs_in
from link.session.request import FlightRequest
from link.streamer.control_socket import SOCKET_FILE, connect
from link.streamer.flight_register import register_flight

START_TIMEOUT_S = 30.0
REPLY_TIMEOUT_S = 10.0
OnEvent = Callable[[FlightEvent], None]


@dataclass(frozen=True)
class FlightResult:
    """How a flight ended. ``exit_code`` 0 completed, 4 any other end of the flight, 1 a fault of ours."""

    state: FlightState
    exit_code: int
    reason: str = ""
    summary: dict[str, Any] = field(default_factory=dict)


def start_flight(
    request: FlightRequest,
    journal: Journal | None = None,
    on_event: OnEvent | None = None,
    *,
    run_dir: Path | None = None,
) -> RunningFlight:
    """Start a streamer for ``request`` and connect to it.

    Events go to ``journal`` and ``on_event`` from a thread, in order. ``run_dir`` is made where not given; it stays
    after the flight. Raises `FlightRequestError` when the streamer refuses the request (a link taken, unsigned and so
    on), `SupervisorError` when it cannot be started.
    """
    folder = run_dir.absolute() if run_dir is not None else Path(tempfile.mkdtemp(prefix="skyrelay-flight-"))
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    if (folder / "request.json").exists():
        raise SupervisorError(f"run folder {folder} has been flown from; choose another")
    document = json.dumps(request.to_document()).encode()
    descriptor = os.open(folder / "request.json", os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(descriptor, "wb") as stream:
        stream.write(document)
    with open(folder / "streamer.log", "wb") as log:
        process = subprocess.Popen(
            # -P: no module of that name in somebody's working folder may be run instead.
            [sys.executable, "-P", "-m", "link.streamer", str(folder)],
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            start_new_session=True,
        )
    (folder / "pid").write_text(str(process.pid))
    try:
        connection = _connect(folder, process)
    except BaseException:
        process.kill()
        process.wait()
        raise
    register_flight(request, folder, process.pid)
    return RunningFlight(folder, connection, process.pid, process, journal, on_event, after=0)


def attach(
    run_dir: Path, journal: Journal | None = None, on_event: OnEvent | None = None, *, after: int = 0
) -> RunningFlight:
    """Connect to a streamer that runs already; events after sequence number ``after`` are delivered.

    Raises `SupervisorError` when none runs there.
    """
    try:
        pid = int((run_dir / "pid").read_text())
        connection = connect(run_dir / SOCKET_FILE)
    except (OSError, ValueError) as error:
        raise SupervisorError(f"no streamer runs in {run_dir}: {error}") from None
    return RunningFlight(run_dir, connection, pid, None, journal, on_event, after=after)


def _connect(folder: Path, process: subprocess.Popen[bytes]) -> socket.socket:
    deadline = time.monotonic() + START_TIMEOUT_S
    while time.monotonic() < deadline:
        if process.poll() is not None:
            refusal = folder / "refusal.json"
            if refusal.exists():
                said = json.loads(refusal.read_bytes())
                raise FlightRequestError([InputFault("links", said["error"])])
            tail = (folder / "streamer.log").read_text(errors="replace")[-2000:]
            raise SupervisorError(f"the streamer ended at once (exit code {process.returncode}): {tail}")
        try:
            return connect(folder / SOCKET_FILE)
        except OSError:
            time.sleep(0.02)
    raise SupervisorError(f"the streamer did not come up in {START_TIMEOUT_S:g} s; see {folder / 'streamer.log'}")


class RunningFlight:
    """A flight under way. Made by `start_flight` and `attach`."""

    def __init__(
        self,
        run_dir: Path,
        connection: socket.socket,
        pid: int,
        process: subprocess.Popen[bytes] | None,
        journal: Journal | None,
        on_event: OnEvent | None,
        *,
        after: int,
    ) -> None:
        self.run_dir = run_dir
        self.pid = pid
        self.last_event: FlightEvent | None = None
        self._process = process
        self._connection = connection
        self._journal = journal
        self._on_event = on_event
        self._lock = threading.Lock()
        self._replies: dict[int, dict[str, Any]] = {}
        self._arrived = threading.Condition()
        self._count = 0
        self._result: FlightResult | None = None
        self._gone = threading.Event()
        self._detached = False
        self._sequence = after
        connection.sendall(json.dumps({"attach": after}).encode() + b"\n")
        self._reader = threading.Thread(target=self._read, name=f"flight-{pid}", daemon=True)
        self._reader.start()

    # -- speaking -----------------------------------------------------------------------------------------------------

    def command(self, command: str, **fields: Any) -> None:
        """Give the flight an operator command; fields as in `link.director.core.FlightCore.command`.

        Raises `TransitionError` when the flight refuses it, `SupervisorError` when it cannot be reached.
        """
        reply = self._ask({"word": str(command), **fields})
        if "error" in reply:
            raise TransitionError(str(reply["error"]))

    def replan(
        self, document: Mapping[str, Any], *, join_s: float | None = None, leave_s: float | None = None, **fields: Any
    ) -> None:
        """The operator command `replan`: fly another plan from here on (`gcs.planning.replanning.Replanned`).

        ``join_s`` and ``leave_s`` are for a flight that stands. The plan's document stays in the run folder. Raises as
        `command` does, and ``OSError``.
        """
        name = str(document["plan_sha256"])
        partial = self.run_dir / f"plan-{name}.json.partial"
        partial.write_text(json.dumps(document, allow_nan=False), encoding="utf-8")
        partial.replace(self.run_dir / f"plan-{name}.json")
        self.command("replan", new_plan_sha256=name, join_s=join_s, leave_s=leave_s, **fields)

    def status(self) -> dict[str, Any]:
        """The flight now; see `link.director.core.FlightCore.status`. Raises `SupervisorError` when it cannot be
        reached.
        """
        status = self._ask({"status": True})["status"]
        assert isinstance(status, dict)
        return status

    def _ask(self, question: dict[str, Any]) -> dict[str, Any]:
        with self._lock:
            self._count += 1
            number = self._count
            try:
                self._connection.sendall(json.dumps({"id": number, **question}).encode() + b"\n")
            except OSError as error:
                raise SupervisorError(f"the streamer (process {self.pid}) cannot be reached: {error}") from None
        with self._arrived:
            there = self._arrived.wait_for(lambda: number in self._replies or self._gone.is_set(), REPLY_TIMEOUT_S)
            if number in self._replies:
                return self._replies.pop(number)
        what = "has ended" if there else f"did not answer in {REPLY_TIMEOUT_S:g} s"
        raise SupervisorError(f"the streamer (process {self.pid}) {what}")

    # -- waiting ------------------------------------------------------------------------------------------------------

    @property
    def result(self) -> FlightResult | None:
        """How it ended; None while it has not."""
        return self._result

    def wait(self, timeout_s: float | None = None) -> FlightResult:
        """Wait for the flight's end. Raises `TimeoutError` after ``timeout_s``."""
        if not self._gone.wait(timeout_s):
            raise TimeoutError(f"the flight goes on after {timeout_s} s")
        self._reader.join()
        if self._result is None:
            raise SupervisorError("detached from the flight, which goes on")
        return self._result

    def detach(self) -> None:
        """Let go of the flight without ending it: it goes on as far as authorised."""
        self._detached = True
        with contextlib.suppress(OSError):
            self._connection.shutdown(socket.SHUT_RDWR)
        self._reader.join()
        self._connection.close()

    def kill(self) -> None:
        """End the streamer at once (SIGKILL): silence, and the vehicle's failsafe acts. For one that hangs."""
        with contextlib.suppress(ProcessLookupError):
            if self._process is not None or runs_in(self.pid, self.run_dir):
                os.kill(self.pid, signal.SIGKILL)
        self._gone.wait(REPLY_TIMEOUT_S)

    # -- hearing ------------------------------------------------------------------------------------------------------

    def _read(self) -> None:
        buffer = bytearray()
        while True:
            try:
                data = self._connection.recv(1 << 16)
            except OSError:
                data = b""
            if not data:
                break
            buffer += data
            while (end := buffer.find(b"\n")) >= 0:
                line, buffer = bytes(buffer[:end]), buffer[end + 1 :]
                self._hear(json.loads(line))
        if not self._detached:
            self._result = self._how_it_ended()
            self._connection.close()
        self._gone.set()
        with self._arrived:
            self._arrived.notify_all()

    def _hear(self, line: dict[str, Any]) -> None:
        if "event" in line:
            self._deliver(FlightEvent.from_document(line["event"]))
        else:
            with self._arrived:
                self._replies[line["reply"]] = line
                self._arrived.notify_all()

    def _deliver(self, event: FlightEvent) -> None:
        self.last_event, self._sequence = event, event.sequence
        if self._journal is not None:
            self._journal.append(event)
        if self._on_event is not None:
            self._on_event(event)

    def _how_it_ended(self) -> FlightResult:
        code = self._exit_code()
        with contextlib.suppress(OSError, ValueError):
            result = json.loads((self.run_dir / "result.json").read_bytes())
            reason = "" if self.last_event is None else str(self.last_event.data.get("reason", ""))
            return FlightResult(FlightState(result["state"]), int(result["exit_code"]), reason, result)
        # It died without a result: a fault of ours on the ground, a lost flight in the air.
        self._take_rest()
        last = self.last_event
        airborne = last is not None and (last.state.airborne or last.state is FlightState.ARMING)
        state = FlightState.LOST if airborne else FlightState.REFUSED
        reason = f"the streamer died (exit code {code}); see {self.run_dir / 'streamer.log'}"
        if last is None or not last.state.ended:
            at = (0.0, None) if last is None else (last.time_s, last.t_plus_s)
            data = {"what": "streamer died", "exit_code": code, **epitaph(self.run_dir, airborne=airborne)}
            self._deliver(FlightEvent(self._sequence + 1, EventKind.ALARM, *at, utc_now_text(), state, data))
        return FlightResult(FlightState.LOST, 4 if airborne else 1, reason)

    def _take_rest(self) -> None:
        """Deliver what the streamer wrote and could not say any more."""
        for event in events_of(self.run_dir):
            if event.sequence > self._sequence:
                self._deliver(event)

    def _exit_code(self) -> int | None:
        if self._process is not None:
            try:
                return self._process.wait(REPLY_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                return self._process.wait()
        deadline = time.monotonic() + REPLY_TIMEOUT_S
        while time.monotonic() < deadline and runs_in(self.pid, self.run_dir):
            time.sleep(0.02)
        return None


def events_of(run_dir: Path) -> Iterator[FlightEvent]:
    """Every whole event of a run folder, in order; a line torn by a full disk costs itself alone."""
    try:
        lines = (run_dir / "events.jsonl").read_bytes().splitlines()
    except OSError:
        return
    for line in lines:
        with contextlib.suppress(ValueError, KeyError, TypeError, AttributeError):
            yield FlightEvent.from_document(json.loads(line))


def epitaph(run_dir: Path, *, airborne: bool) -> dict[str, Any]:
    """What a person must know when a streamer died: what the vehicle does now, what it keeps, how to give that back."""
    does = (
        "nobody commands it: its own failsafe returns or lands it, as judged at preflight" if airborne else "disarmed"
    )
    notes = [one for one in FileJournal().pending() if one.run_dir == str(run_dir)]
    kept = [text for one in notes for text in one.texts]
    told: dict[str, Any] = {"vehicle": does, "keeps": kept}
    if any(one.gcs_ids for one in notes):
        ids = sorted({station for one in notes for station in one.stations})
        told["hears"] = f"stations {ids[0]} to {ids[-1]} alone: any other ground station gets no answer"
    if notes:
        armed = " --ids-while-armed" if airborne else ""
        told["fix"] = f"{notes[0].remedy}{armed}" + ("; on the ground again without that option" if armed else "")
    return told
