"""The streamer: the one process that talks to the vehicle during a flight. ``python -m link.streamer RUN_DIR``.

It owns every socket, drives `link.director.core.FlightCore` on the real clock and does nothing else, so that nothing
else can delay a setpoint: as a thread beside a web service the same loop stalled for a second. It outlives whoever
started it. Whoever wants to speak to it connects to the Unix socket in its run folder; when nobody is connected any
more the flight goes on as far as it was authorised.

The run folder holds ``request.json`` (what to fly), ``control.sock``, ``events.jsonl`` (every event, appended as it
happens), ``result.json`` (at the end), ``pid`` and ``streamer.log``.

Lines on the socket are JSON objects. In: ``{"attach": SEQUENCE}`` (events after that one are sent, then all new ones),
``{"id": N, "word": ..., ...}``, ``{"id": N, "status": true}``. Out: ``{"event": {...}}``, ``{"reply": N, "ok": true}``,
``{"reply": N, "error": "..."}``, ``{"reply": N, "status": {...}}``. The command ``replan`` names a plan by
``new_plan_sha256`` that has been put into the run folder as ``plan-SHA256.json``; it is read and judged in a thread
beside the flight.

Timing: absolute deadlines, missed ticks skipped and counted, real-time priority and locked memory where the system
grants them, and the garbage collector's first full look taken before the flight. Logs and signing stamps are written by
a thread of their own: a full or slow disk costs log lines, not setpoints.
"""

from __future__ import annotations

import contextlib
import gc
import json
import queue
import re
import select
import signal
import sys
import threading
import time
import traceback
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gcs.errors import InputFault
from gcs.flight import FlightState, OperatorCommand, TransitionError
from link.clock import FlightClock, PacedClock
from link.director.core import FlightCore
from link.director.plan_exchange import NextPlan
from link.errors import FlightRequestError, LinkError
from link.files.change_journal import FileJournal
from link.session.request import FlightRequest
from link.streamer.control_socket import SOCKET_FILE, ControlServer
from link.streamer.recorder import Recorder
from link.streamer.scheduling import lock_memory, raise_priority
from link.transport.endpoint import Endpoint
from link.transport.opening import open_endpoint
from link.transport.port_lock import LinkLocks, VehicleLock
from link.wire.codec import StationCodec
from link.wire.signing import Signing, SigningKey
from link.wire.signing_timestamps import SigningStore

EXIT_FAULT, EXIT_REFUSED_REQUEST = 1, 2
UPKEEP_S = 0.25
"""Endpoints are looked after at least this often, heard or not."""
LINGER_S = 0.5
"""How long a finished streamer stays to deliver its last events."""


def make_codecs(request: FlightRequest, run_dir: Path) -> dict[str, StationCodec]:
    """A codec for each station of the plan, signing where the request names a key.

    Raises `link.errors.SigningError` when the key or the stamps cannot be used.
    """
    key = None
    if request.signing_key is not None:
        kind, name = request.signing_key.split(":", 1)
        key = SigningKey.from_file(name) if kind == "file" else SigningKey.from_environment(name)
    folder = Path(request.signing_state) if request.signing_state is not None else run_dir
    codecs = {}
    for station_id, system_id in request.system_ids.items():
        signing = None
        if key is not None:
            # A distinct link id for each station; RADIO_STATUS comes from the modem, which has no key.
            store = SigningStore.open(folder / f"station-{system_id}.stamps")
            signing = Signing(key, system_id, store, allow_unsigned=(109,))
        codecs[station_id] = StationCodec(system_id, signing=signing)
    return codecs


def open_links(request: FlightRequest) -> dict[str, Endpoint]:
    """An endpoint for each URL of the request.

    Raises `EndpointError`, or `FlightRequestError` for links this flight must not use: not loopback with a speed-up, or
    unsigned.
    """
    endpoints: dict[str, Endpoint] = {}
    try:
        named = [(station, url) for station, urls in request.urls.items() for url in urls]
        for url in dict.fromkeys(url for _, url in named):
            endpoints[url] = open_endpoint(url)
        problems = []
        for station, url in named:
            if endpoints[url].is_loopback:
                continue
            if request.speedup != 1.0:
                problems.append(
                    InputFault(
                        f"links.{station}", "a speed-up is for simulations", url, "loopback links", "fly at speed-up 1"
                    )
                )
            if request.signing_key is None and not request.allow_unsigned:
                problems.append(
                    InputFault(
                        f"links.{station}",
                        "the link leaves this machine and nothing on it is signed",
                        url,
                        "a signing key, or the word that unsigned is meant",
                        "name a signing key, or allow unsigned links",
                    )
                )
        if problems:
            raise FlightRequestError(problems)
    except Exception:
        for endpoint in endpoints.values():
            endpoint.close()
        raise
    return endpoints


class Streamer:
    """The core, its sockets and its clock."""

    def __init__(self, request: FlightRequest, run_dir: Path) -> None:
        self.run_dir = run_dir
        self.endpoints = open_links(request)
        self.locks = LinkLocks(self.endpoints)
        self.vehicle_lock = VehicleLock()
        self.clock = FlightClock() if request.speedup == 1.0 else PacedClock(request.speedup)
        epoch_unix_s = time.time()
        codecs = make_codecs(request, run_dir)
        self.stores = [codec.signing.store for codec in codecs.values() if codec.signing is not None]
        self.recorder = Recorder(
            run_dir,
            request.log_path,
            epoch_unix_s,
            self.stores,
            urls=tuple(self.endpoints),
            vehicle_system_id=request.flown_plan.mission.options.vehicle_system_id,
        )
        self.core = FlightCore(
            request,
            codecs=codecs,
            now_s=self.clock.now_s(),
            epoch_unix_s=epoch_unix_s,
            on_frame=self.recorder.frame,
            journal=FileJournal(run_dir=run_dir),
            claim=self.vehicle_lock.claim,
        )
        self.control = ControlServer(run_dir / SOCKET_FILE)
        self.events: list[dict[str, Any]] = []
        self._stop = False
        self._deadline_s = 0.0
        # A shared link's bytes go in once, under the first station that has it.
        self._first = {url: next(s for s, urls in request.urls.items() if url in urls) for url in self.endpoints}
        self._lapsed = False
        self._ready: queue.SimpleQueue[tuple[int, Mapping[str, Any], NextPlan | str]] = queue.SimpleQueue()

    def run(self) -> int:
        """Fly; the exit code."""
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, lambda *_: setattr(self, "_stop", True))
        gc.collect()
        gc.freeze()
        # Young garbage alone: a full look may take longer than a tick.
        gc.set_threshold(20_000, 20, 100_000)
        sys.setswitchinterval(0.0005)
        self._log(f"priority: {raise_priority()}")
        self._log(f"memory: {lock_memory()}")
        self.core.start(self.clock.now_s())
        while not self.core.finished:
            self._wait()
            self._listen()
            now_s = self.clock.now_s()
            if now_s >= self._deadline_s:
                self._tick(now_s)
        self._deliver_rest()
        return self.core.state.exit_code

    def _tick(self, now_s: float) -> None:
        self._deadline_s = self.core.step(now_s)
        lapsed = self.core.state is FlightState.LAPSED
        if lapsed and not self._lapsed:
            # After it no setpoint of before may arrive.
            for endpoint in self.endpoints.values():
                endpoint.discard("reset: the C2 link was lost")
        self._lapsed = lapsed
        for station, frame in self.core.take_outgoing():
            for url in self.core.routes(station, frame):
                self.endpoints[url].send(frame)
        self.core.tell()
        self._publish()
        if self._stop:
            self._stop = False
            self._obey({"word": "abort", "by": "SIGTERM", "reason": "the streamer was told to stop"})

    def _wait(self) -> None:
        descriptors = [e.fileno() for e in self.endpoints.values() if e.fileno() >= 0]
        wait_s = min(self.clock.wait_s(self._deadline_s), UPKEEP_S)
        try:
            select.select([*descriptors, *self.control.filenos()], self.control.writers(), [], wait_s)
        except (OSError, ValueError):
            # A descriptor closed between the asking and the waiting: the next look has the new ones.
            time.sleep(min(wait_s, 0.001))

    def _listen(self) -> None:
        for url, endpoint in self.endpoints.items():
            for data in endpoint.receive():
                self.core.receive(self._first[url], data, self.clock.now_s(), url)
                if isinstance(self.clock, PacedClock):
                    position = self.core.context.vehicle.monitor.position
                    self.clock.heard(None if position is None else position.boot_s)
        for client, line in self.control.receive():
            self._answer(client, line)
        with contextlib.suppress(queue.Empty):
            while True:
                self._replan(*self._ready.get_nowait())
        attended = self.control.attended
        if attended is not None:
            (self.core.parent_back if attended else self.core.parent_gone)()

    # -- control ------------------------------------------------------------------------------------------------------

    def _answer(self, client: int, line: Mapping[str, Any]) -> None:
        if "attach" in line:
            after = int(line["attach"])
            for event in self.events[after:]:
                self.control.send(client, {"event": event})
            self.control.subscribe(client)
            return
        reply: dict[str, Any] = {"reply": line.get("id")}
        if line.get("word") == OperatorCommand.REPLAN:
            threading.Thread(target=self._make_ready, args=(client, line), name="replan", daemon=True).start()
            return
        if line.get("status"):
            reply["status"] = self.core.status()
        else:
            error = self._obey(line)
            reply |= {"ok": True} if error is None else {"error": error}
        self.control.send(client, reply)

    def _make_ready(self, client: int, line: Mapping[str, Any]) -> None:
        """In a thread of its own: read and judge the plan; the tick that follows takes it over."""
        name = str(line.get("new_plan_sha256", ""))
        upcoming: NextPlan | str
        try:
            if not re.fullmatch("[0-9a-f]{64}", name):
                raise TransitionError("'replan' needs new_plan_sha256, the hash of a plan in the run folder")
            document = json.loads((self.run_dir / f"plan-{name}.json").read_bytes())
            upcoming = self.core.make_ready(document)
            if upcoming.plan.plan_sha256 != name:
                raise TransitionError(f"the file holds another plan ({upcoming.plan.plan_sha256})")
        except (TransitionError, OSError, ValueError) as error:
            upcoming = str(error)
        except Exception as error:  # a fault in judging a plan must not become one of the flight
            upcoming = f"the plan cannot be judged: {error!r}"
        self._ready.put((client, line, upcoming))

    def _replan(self, client: int, line: Mapping[str, Any], upcoming: NextPlan | str) -> None:
        error = upcoming if isinstance(upcoming, str) else self._obey(line, upcoming=upcoming)
        reply: dict[str, Any] = {"reply": line.get("id")}
        self.control.send(client, reply | ({"ok": True} if error is None else {"error": error}))

    def _obey(self, line: Mapping[str, Any], **more: Any) -> str | None:
        """Pass an operator command on; why it was refused, None when it was not."""
        known = {"by", "handover", "until_s", "reason", "plan_sha256", "join_s", "leave_s"}
        try:
            given = {k: v for k, v in line.items() if k in known and v is not None}
            self.core.command(OperatorCommand(line.get("word", "")), **given, **more)
        except (TransitionError, ValueError, TypeError) as error:
            return str(error)
        return None

    def _publish(self) -> None:
        for event in self.core.take_events():
            self.recorder.event(event)
            document = event.to_document()
            self.events.append(document)
            self.control.broadcast({"event": document})

    def _deliver_rest(self) -> None:
        self._publish()
        result = {"state": self.core.state.value, "exit_code": self.core.state.exit_code, **self.core.summary()}
        if self.recorder.log_path is not None:
            result["log"] = self.recorder.log_path
        write_whole(self.run_dir / "result.json", json.dumps(result).encode())
        until = time.monotonic() + LINGER_S
        while time.monotonic() < until and self.control.pending():
            select.select([], self.control.writers(), [], 0.05)
            for _ in self.control.receive():
                pass
        self.close()

    def _log(self, text: str) -> None:
        print(text, file=sys.stderr)  # noqa: T201 - the process's own log

    def close(self) -> None:
        """Let go of everything."""
        self.control.close()
        for endpoint in self.endpoints.values():
            endpoint.close()
        self.recorder.close()
        for store in self.stores:
            with contextlib.suppress(OSError):  # as a killed process leaves them: in memory
                store.close()
        self.locks.release()
        self.vehicle_lock.release()


def write_whole(path: Path, data: bytes) -> None:
    """Write a file so that it is there in full or not at all."""
    partial = path.with_suffix(path.suffix + ".partial")
    partial.write_bytes(data)
    partial.replace(path)


def main(arguments: list[str] | None = None) -> int:
    """Run a flight from its folder; the exit code: the flight's own, 1 for a fault of ours, 2 for a bad request."""
    run_dir = Path((sys.argv[1:] if arguments is None else arguments)[0])
    try:
        request = FlightRequest.from_document(json.loads((run_dir / "request.json").read_bytes()))
        streamer = Streamer(request, run_dir)
    except (LinkError, OSError, ValueError) as error:
        write_whole(run_dir / "refusal.json", json.dumps({"error": str(error), "kind": type(error).__name__}).encode())
        return EXIT_REFUSED_REQUEST
    try:
        return streamer.run()
    except Exception:  # silence is the answer to any fault of ours: the autopilot's failsafe understands it
        traceback.print_exc()
        return EXIT_FAULT
    finally:
        with contextlib.suppress(Exception):
            streamer.close()
