"""The streamer's own loop around a core that does as told: order, deadlines, words, faults; sockets are real."""

from __future__ import annotations

import ctypes
import errno
import gc
import json
import os
import runpy
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import link.streamer.process as streamer_module
import link.streamer.recorder as recorder_module
from gcs.flight import EventKind, FlightEvent, FlightState, OperatorCommand, TransitionError
from link.clock import FlightClock, PacedClock
from link.errors import EndpointError, FlightRequestError
from link.files.tlog import read_tlog
from link.session.request import FlightRequest
from link.streamer.process import EXIT_FAULT, EXIT_REFUSED_REQUEST, Streamer, main, make_codecs, open_links
from link.streamer.recorder import Recorder
from link.streamer.scheduling import lock_memory, raise_priority
from link.wire.signing import SigningKey
from link.wire.signing_timestamps import SigningStore
from tests.support.flights.processes import free_ports, open_files
from tests.support.plans.planned import relay_plan

TICK_S = 0.02


class Core:
    """Stands for the flight: a frame of each station a tick, an event too; notes what is done to it; ends when told."""

    def __init__(self, request: FlightRequest, **options: Any) -> None:
        self.request, self.options = request, options
        self.on_frame = options["on_frame"]
        self.calls: list[str] = []
        self.words: list[tuple[OperatorCommand, dict[str, Any]]] = []
        self.heard: list[tuple[str, bytes, float]] = []
        self.ticks: list[float] = []
        self.last = 5
        self.fails_at: int | None = None
        self.started_s: float | None = None
        self.state = FlightState.CONNECTING
        self.events: list[FlightEvent] = []
        self.attended: list[bool] = []

    @property
    def finished(self) -> bool:
        return len(self.ticks) >= self.last

    def start(self, now_s: float) -> None:
        self.started_s = now_s

    def step(self, now_s: float) -> float:
        self.calls.append("step")
        self.ticks.append(now_s)
        if self.fails_at == len(self.ticks):
            raise ZeroDivisionError("as told")
        self.event(what=f"tick {len(self.ticks)}")
        if self.finished:
            self.state = FlightState.CONTINGENCY
        return now_s + TICK_S

    def event(self, **data: Any) -> None:
        number = len(self.ticks)
        self.events.append(FlightEvent(number, EventKind.ALARM, 0.0, None, "2026-11-22T09:00:00Z", self.state, data))

    def take_outgoing(self) -> list[tuple[str, bytes]]:
        self.calls.append("take_outgoing")
        return [(s, f"{s} {len(self.ticks)}".encode()) for s in dict.fromkeys(self.request.links)]

    def routes(self, station: str, frame: bytes) -> tuple[str, ...]:
        assert frame.startswith(station.encode())
        return tuple(self.request.urls[station])

    def tell(self) -> None:
        self.calls.append("tell")

    def take_events(self) -> list[FlightEvent]:
        self.calls.append("take_events")
        events, self.events = self.events, []
        return events

    def receive(self, station: str, data: bytes, now_s: float, url: str) -> None:
        assert url in self.request.urls[station]
        self.heard.append((station, data, now_s))

    def command(self, word: OperatorCommand, **fields: Any) -> None:
        if word is OperatorCommand.LAND:
            raise TransitionError("not now")
        if word is OperatorCommand.RESUME:
            raise TypeError("until_s")
        self.words.append((word, fields))

    def status(self) -> dict[str, Any]:
        return {"state": self.state.value, "ticks": len(self.ticks)}

    def summary(self) -> dict[str, Any]:
        return {"setpoints": len(self.ticks)}

    def parent_gone(self) -> None:
        self.attended.append(False)

    def parent_back(self) -> None:
        self.attended.append(True)


@pytest.fixture
def quiet_process(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """What a streamer does to its process is undone: signals, the collector, priority, memory."""
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    threshold, interval_s = gc.get_threshold(), sys.getswitchinterval()
    monkeypatch.setattr(streamer_module, "FlightCore", Core)
    monkeypatch.setattr(streamer_module, "raise_priority", lambda *_: "as it was")
    monkeypatch.setattr(streamer_module, "lock_memory", lambda: "as ever")
    yield
    for number, handler in handlers.items():
        signal.signal(number, handler)
    gc.set_threshold(*threshold)
    gc.unfreeze()
    sys.setswitchinterval(interval_s)


class Bench:
    """A streamer on loopback links, and the vehicle's ends of them."""

    def __init__(self, run_dir: Path, *, shared: bool = False, **changes: Any) -> None:
        stations = list(dict.fromkeys(relay_plan(2).station_ids))
        self.ports = free_ports(1 if shared else 2)
        self.vehicle = {}
        for port in self.ports:
            one = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            one.bind(("127.0.0.1", port))
            one.settimeout(5.0)
            self.vehicle[port] = one
        links = {s: f"udpout:127.0.0.1:{self.ports[0 if shared else k]}" for k, s in enumerate(stations)}
        self.request = FlightRequest(plan=relay_plan(2).to_document(), autopilot="px4", links=links, **changes)
        self.run_dir = run_dir
        self.streamer = Streamer(self.request, run_dir)
        self.core: Core = self.streamer.core  # type: ignore[assignment]

    def heard(self, port: int) -> list[bytes]:
        """What came in at the vehicle's end."""
        one, found = self.vehicle[port], []
        one.settimeout(0.05)
        try:
            while True:
                found.append(one.recv(2048))
        except TimeoutError:
            return found

    def client(self) -> socket.socket:
        """Somebody who speaks to it."""
        one = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        one.settimeout(10.0)
        one.connect(str(self.run_dir / "control.sock"))
        return one

    def close(self) -> None:
        for one in self.vehicle.values():
            one.close()


@pytest.fixture
def bench(tmp_path: Path, quiet_process: None) -> Iterator[Bench]:
    one = Bench(tmp_path)
    yield one
    one.close()


def wait_for(condition: Callable[[], bool]) -> None:
    """Wait for it, a while."""
    deadline = time.monotonic() + 20.0
    while not condition() and time.monotonic() < deadline:
        time.sleep(0.002)


class Lines:
    """JSON lines of a socket."""

    def __init__(self, client: socket.socket) -> None:
        self._stream = client.makefile("rb")

    def next(self) -> dict[str, Any]:
        line: dict[str, Any] = json.loads(self._stream.readline())
        return line


# -- flying -----------------------------------------------------------------------------------------------------------


def test_it_serves_ticks_when_due_sends_each_frame_over_its_link_and_then_tells(bench: Bench) -> None:
    began = time.monotonic()
    assert bench.streamer.run() == FlightState.CONTINGENCY.exit_code == 4
    assert time.monotonic() - began >= 4 * TICK_S
    core = bench.core
    assert len(core.ticks) == 5
    assert core.started_s is not None
    assert 0.0 <= core.started_s <= core.ticks[0]
    assert all(b - a >= TICK_S for a, b in zip(core.ticks, core.ticks[1:], strict=False))
    assert core.calls[:4] == ["step", "take_outgoing", "tell", "take_events"]
    for station, port in zip(("s1", "s2"), bench.ports, strict=True):
        assert bench.heard(port) == [f"{station} {k}".encode() for k in range(1, 6)]
    result = json.loads((bench.run_dir / "result.json").read_text())
    assert result == {"state": "contingency", "exit_code": 4, "setpoints": 5}
    events = [json.loads(line) for line in (bench.run_dir / "events.jsonl").read_text().splitlines()]
    assert [e["data"]["what"] for e in events] == [f"tick {k}" for k in range(1, 6)]
    assert bench.streamer.events == events
    assert not (bench.run_dir / "control.sock").exists()
    # Everything is let go of: the links can be flown again.
    assert all(endpoint.fileno() < 0 for endpoint in bench.streamer.endpoints.values())
    assert not [name for name in open_files() if name.startswith(str(bench.run_dir))]
    again = Streamer(bench.request, bench.run_dir)
    again.close()


def test_the_first_tick_is_not_waited_for(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    waits: list[float] = []
    select = streamer_module.select.select

    def noted(*arguments: Any) -> Any:
        waits.append(arguments[3])
        return select(*arguments)

    bench.core.last = 1
    monkeypatch.setattr(streamer_module.select, "select", noted)
    bench.streamer.run()
    assert waits == [0.0]


def test_the_process_is_prepared_for_punctuality(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    looked: list[int] = []
    monkeypatch.setattr(streamer_module.gc, "collect", lambda: looked.append(len(bench.core.ticks)))
    assert bench.streamer.recorder._thread.daemon  # a fault must be able to end the process
    bench.streamer.run()
    assert looked == [0]  # the collector's full look is taken before the first tick
    assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    assert gc.get_threshold() == (20_000, 20, 100_000)
    assert gc.get_freeze_count() > 0
    assert sys.getswitchinterval() == pytest.approx(0.0005)


def test_the_core_gets_the_request_the_clock_and_the_recorder(bench: Bench) -> None:
    options = bench.core.options
    assert bench.core.request is bench.request
    assert set(options["codecs"]) == {"s1", "s2"}
    assert 0.0 <= options["now_s"] < 5.0
    assert abs(options["epoch_unix_s"] - time.time()) < 60.0
    assert options["on_frame"] == bench.streamer.recorder.frame
    assert type(bench.streamer.clock) is FlightClock
    bench.streamer.close()


def test_what_is_heard_is_handed_on_under_its_station_between_ticks(bench: Bench) -> None:
    bench.core.last = 15

    def speak() -> None:
        _, address = bench.vehicle[bench.ports[1]].recvfrom(2048)
        bench.vehicle[bench.ports[1]].sendto(b"from the vehicle", address)

    thread = threading.Thread(target=speak)
    thread.start()
    bench.streamer.run()
    thread.join()
    ((station, data, now_s),) = bench.core.heard
    assert (station, data) == ("s2", b"from the vehicle")
    assert bench.core.ticks[0] <= now_s <= bench.core.ticks[-1]


def test_a_link_that_stations_share_is_opened_once_and_heard_under_the_first(
    tmp_path: Path, quiet_process: None
) -> None:
    bench = Bench(tmp_path, shared=True)
    bench.core.last = 8
    (port,) = bench.ports

    def speak() -> None:
        _, address = bench.vehicle[port].recvfrom(2048)
        bench.vehicle[port].sendto(b"hello", address)

    thread = threading.Thread(target=speak)
    thread.start()
    bench.streamer.run()
    thread.join()
    assert [(s, d) for s, d, _ in bench.core.heard] == [("s1", b"hello")]
    assert len(bench.streamer.endpoints) == 1
    bench.close()


def test_a_sped_up_flight_is_paced_by_the_vehicles_clock(tmp_path: Path, quiet_process: None) -> None:
    bench = Bench(tmp_path, speedup=2.0)
    clock = bench.streamer.clock
    assert isinstance(clock, PacedClock)
    assert clock.speedup == 2.0
    told: list[float | None] = []
    clock.heard = told.append  # type: ignore[method-assign]

    class Context:
        class vehicle:  # noqa: N801
            class monitor:  # noqa: N801
                position: Any = None

    bench.core.context = Context  # type: ignore[attr-defined]
    bench.core.last = 60

    def speak() -> None:
        one = bench.vehicle[bench.ports[0]]
        _, address = one.recvfrom(2048)
        one.sendto(b"1", address)
        wait_for(lambda: bool(told))
        Context.vehicle.monitor.position = type("Position", (), {"boot_s": 12.5})
        one.sendto(b"2", address)

    thread = threading.Thread(target=speak)
    thread.start()
    bench.streamer.run()
    thread.join()
    assert told == [None, 12.5]
    bench.close()


def test_it_waits_for_the_deadline_and_never_longer_than_the_upkeep_of_the_links(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    waits: list[float] = []
    asked: list[list[int]] = []

    def select(reading: list[int], writing: list[int], errors: list[int], wait_s: float) -> Any:
        waits.append(wait_s)
        asked.append(reading)
        return [], [], []

    monkeypatch.setattr(streamer_module.select, "select", select)
    one = bench.streamer
    one._deadline_s = one.clock.now_s() + 0.125
    one._wait()
    one._deadline_s = one.clock.now_s() + 100.0
    one._wait()
    one._deadline_s = one.clock.now_s() - 1.0
    one._wait()
    assert 0.0 < waits[0] <= 0.125
    assert waits[1:] == [0.25, 0.0]
    links = [endpoint.fileno() for endpoint in one.endpoints.values()]
    assert asked[0] == [*links, *one.control.filenos()]
    # A link that is down has no descriptor to wait on.
    down = next(iter(one.endpoints.values()))
    monkeypatch.setattr(down, "fileno", lambda: -1)
    one._wait()
    assert asked[-1] == [*links[1:], *one.control.filenos()]
    # A process started without a standard input has a link in its place.
    monkeypatch.setattr(down, "fileno", lambda: 0)
    one._wait()
    assert asked[-1] == [0, *links[1:], *one.control.filenos()]
    monkeypatch.undo()
    one.close()


def test_a_descriptor_closed_while_it_waits_costs_a_moment_and_no_flight(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    slept: list[float] = []
    monkeypatch.setattr(streamer_module.time, "sleep", slept.append)
    one = bench.streamer
    for error in (OSError, ValueError):

        def select(*_: object, error: type[Exception] = error) -> None:
            raise error("bad descriptor")

        monkeypatch.setattr(streamer_module.select, "select", select)
        one._deadline_s = one.clock.now_s() + 10.0
        one._wait()
    assert slept == [0.001, 0.001]
    one._deadline_s = 0.0
    one._wait()
    assert slept[-1] == 0.0
    monkeypatch.undo()
    one.close()


# -- people -----------------------------------------------------------------------------------------------------------


def talk(bench: Bench, *lines: dict[str, Any], ticks: int = 20) -> list[dict[str, Any]]:
    """Say lines to a flight under way; everything said back until it ends."""
    bench.core.last = ticks
    client = bench.client()
    client.sendall(b"".join(json.dumps(line).encode() + b"\n" for line in lines))
    bench.streamer.run()
    answers = [json.loads(line) for line in client.makefile("rb").read().splitlines()]
    client.close()
    return answers


def test_words_and_questions_are_answered_by_their_number(bench: Bench) -> None:
    answers = talk(
        bench,
        {"id": 1, "word": "hold", "by": "pilot", "reason": "birds", "until_s": None, "shoe_size": 44},
        {"id": 2, "status": True},
        {"id": 3, "word": "land"},
        {"id": 4, "word": "sing"},
        {"id": 5, "word": "resume"},
        {"id": 6, "word": "authorise", "until_s": 12.0, "handover": 1, "plan_sha256": "ab"},
        {"id": 7},
    )
    assert bench.core.words == [
        (OperatorCommand.HOLD, {"by": "pilot", "reason": "birds"}),
        (OperatorCommand.AUTHORISE, {"until_s": 12.0, "handover": 1, "plan_sha256": "ab"}),
    ]
    replies = {line["reply"]: line for line in answers if "reply" in line}
    assert replies[1] == {"reply": 1, "ok": True}
    assert replies[2]["status"]["state"] == "connecting"
    assert "ok" not in replies[2]
    assert replies[3] == {"reply": 3, "error": "not now"}
    assert "sing" in replies[4]["error"]
    assert replies[5]["error"] == "until_s"
    assert replies[6] == {"reply": 6, "ok": True}
    assert "error" in replies[7]
    # Who did not attach gets no events.
    assert not [line for line in answers if "event" in line]


def test_who_attaches_gets_what_was_missed_and_all_that_comes(bench: Bench) -> None:
    bench.core.last = 4
    for k in range(3):
        bench.streamer.events.append({"sequence": k + 1, "data": {"what": f"before {k + 1}"}})
    client = bench.client()
    client.sendall(b'{"attach": 2}\n')
    bench.streamer.run()
    lines = [json.loads(line) for line in client.makefile("rb").read().splitlines()]
    assert [line["event"]["data"]["what"] for line in lines] == ["before 3", "tick 1", "tick 2", "tick 3", "tick 4"]
    client.close()


def test_the_core_is_told_when_the_last_one_leaves_and_when_one_is_back(bench: Bench) -> None:
    bench.core.last = 400
    first = bench.client()

    def come_and_go() -> None:
        lines = Lines(first)
        first.sendall(b'{"attach": 0}\n{"id": 1, "status": true}\n')
        lines.next()
        first.close()
        lines._stream.close()
        wait_for(lambda: bool(bench.core.attended))
        second = bench.client()
        second.sendall(b'{"attach": 0}\n{"id": 2, "status": true}\n')
        Lines(second).next()
        wait_for(lambda: len(bench.core.attended) > 1)
        bench.core.state, bench.core.last = FlightState.CONTINGENCY, 0
        second.close()

    other = threading.Thread(target=come_and_go)
    other.start()
    bench.streamer.run()
    other.join()
    assert bench.core.attended[:2] == [False, True]


def test_a_lost_c2_link_empties_every_link_once(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """No setpoint of before arrives after it."""
    told: list[str] = []
    for endpoint in bench.streamer.endpoints.values():
        monkeypatch.setattr(endpoint, "discard", told.append)
    bench.core.state, bench.core.last = FlightState.LAPSED, 6
    bench.streamer.run()
    assert told == ["reset: the C2 link was lost"] * len(bench.streamer.endpoints)


def test_told_to_stop_it_asks_for_the_way_out_once(bench: Bench) -> None:
    bench.core.last = 10
    threading.Timer(0.05, os.kill, [os.getpid(), signal.SIGTERM]).start()
    bench.streamer.run()
    assert bench.core.words == [
        (OperatorCommand.ABORT, {"by": "SIGTERM", "reason": "the streamer was told to stop"}),
    ]


def test_what_a_word_at_the_last_tick_brings_about_is_still_told(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench.core, "command", lambda word, **_: bench.core.event(what=f"word {word}"))
    bench.core.last = 1
    bench.streamer._stop = True
    bench.streamer.run()
    events = [json.loads(line) for line in (bench.run_dir / "events.jsonl").read_text().splitlines()]
    assert [e["data"]["what"] for e in events] == ["tick 1", "word abort"]
    assert bench.streamer.events == events


def test_a_client_that_reads_slowly_gets_its_last_events_within_half_a_second(bench: Bench) -> None:
    bench.core.last = 2
    client = bench.client()
    client.sendall(b'{"attach": 0}\n')
    filler = "x" * 3_000_000
    bench.streamer.events.append({"filler": filler})
    received = bytearray()

    def read() -> None:
        time.sleep(0.2)
        while data := client.recv(1 << 20):
            received.extend(data)

    thread = threading.Thread(target=read)
    thread.start()
    bench.streamer.run()
    thread.join()
    lines = [json.loads(line) for line in bytes(received).splitlines()]
    assert lines[0]["event"]["filler"] == filler
    assert lines[-1]["event"]["data"]["what"] == "tick 2"
    client.close()


def test_a_client_that_does_not_read_holds_the_end_up_for_half_a_second_at_most(bench: Bench) -> None:
    client = bench.client()
    client.sendall(b'{"attach": 0}\n')
    bench.core.last = 1
    bench.streamer.events.append({"filler": "x" * 3_000_000})
    waits: list[float] = []
    select = streamer_module.select.select

    def counted(*arguments: Any) -> Any:
        waits.append(arguments[3])
        return select(*arguments)

    streamer_module.select.select = counted
    began = time.monotonic()
    try:
        bench.streamer.run()
    finally:
        streamer_module.select.select = select
    assert time.monotonic() - began >= 0.5
    # Each of these lasts its 50 ms, so that there is room for ten and the one begun last.
    assert 2 <= waits.count(0.05) <= 11
    client.close()


class Planned(Core):
    """A flight that judges new plans: by what their files say of themselves."""

    def make_ready(self, document: dict[str, Any]) -> Any:
        if "refusal" in document:
            raise TransitionError(document["refusal"])
        if "fault" in document:
            raise ZeroDivisionError(document["fault"])
        if "slow" in document:
            # The flight goes on meanwhile.
            count = len(self.ticks)
            wait_for(lambda: len(self.ticks) > count + 2)
            (self.judging,) = [t for t in threading.enumerate() if t is threading.current_thread()]
        return SimpleNamespace(plan=SimpleNamespace(plan_sha256=document["plan_sha256"]))

    def command(self, word: OperatorCommand, **fields: Any) -> None:
        if fields.get("by") == "nobody":
            raise TransitionError("who says so?")
        super().command(word, **fields)


def test_a_new_plan_is_judged_beside_the_flight_and_taken_over_by_it(
    tmp_path: Path, quiet_process: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(streamer_module, "FlightCore", Planned)
    bench = Bench(tmp_path)
    bench.core.last = 10_000
    names = {what: f"{number}{number}" * 32 for number, what in enumerate(("good", "other", "late", "wild", "gone"))}
    contents: dict[str, dict[str, Any]] = {
        "good": {"slow": 1},
        "other": {"plan_sha256": "ff"},
        "late": {"refusal": "too late"},
        "wild": {"fault": "x"},
    }
    for what, content in contents.items():
        (tmp_path / f"plan-{names[what]}.json").write_text(json.dumps({"plan_sha256": names[what]} | content))
    asked: list[dict[str, Any]] = [
        {"new_plan_sha256": names["good"], "by": "pilot", "join_s": 30.0, "leave_s": 28.0, "reason": None},
        {"new_plan_sha256": names["good"], "by": "nobody"},
        *({"new_plan_sha256": names[what]} for what in ("other", "late", "wild", "gone")),
        {"new_plan_sha256": "../" + names["good"]},
        {},
    ]
    client = bench.client()
    replies: dict[int, dict[str, Any]] = {}

    def ask() -> None:
        lines = Lines(client)
        for number, line in enumerate(asked):
            client.sendall(json.dumps({"id": number, "word": "replan"} | line).encode() + b"\n")
            answer = lines.next()
            replies[answer["reply"]] = answer
        bench.core.state, bench.core.last = FlightState.CONTINGENCY, 0

    other = threading.Thread(target=ask)
    other.start()
    bench.streamer.run()
    other.join()
    client.close()
    bench.close()
    assert replies[0] == {"reply": 0, "ok": True}
    assert bench.core.judging.daemon  # type: ignore[attr-defined] # no plan, however long, keeps the process
    ((word, fields),) = bench.core.words
    assert (word, fields.pop("upcoming").plan.plan_sha256) == (OperatorCommand.REPLAN, names["good"])
    assert fields == {"by": "pilot", "join_s": 30.0, "leave_s": 28.0}
    errors = [replies[k]["error"] for k in range(1, len(asked))]
    assert errors[:3] == ["who says so?", "the file holds another plan (ff)", "too late"]
    assert errors[3] == "the plan cannot be judged: ZeroDivisionError('x')"
    assert "No such file" in errors[4]
    assert all("the hash of a plan in the run folder" in error for error in errors[5:])


# -- faults -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("tick", [1, 3])
def test_a_fault_of_ours_is_silence_and_an_exit_code(
    tick: int, tmp_path: Path, quiet_process: None, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    bench = Bench(tmp_path)
    bench.streamer.close()
    made: list[Streamer] = []

    def make(request: FlightRequest, run_dir: Path) -> Streamer:
        made.append(Streamer(request, run_dir))
        made[0].core.fails_at = tick  # type: ignore[attr-defined]
        return made[0]

    monkeypatch.setattr(streamer_module, "Streamer", make)
    (tmp_path / "request.json").write_text(json.dumps(bench.request.to_document()))
    assert main([str(tmp_path)]) == EXIT_FAULT == 1
    assert "ZeroDivisionError: as told" in capfd.readouterr().err
    # Nothing of the tick that failed goes out, nothing after it, and everything is let go of.
    for port in bench.ports:
        assert len(bench.heard(port)) == tick - 1
    assert not (tmp_path / "result.json").exists()
    assert not (tmp_path / "control.sock").exists()
    Streamer(bench.request, tmp_path).close()
    bench.close()


def test_a_flight_from_its_folder_ends_with_the_flights_own_code(
    tmp_path: Path, quiet_process: None, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    bench = Bench(tmp_path)
    bench.streamer.close()
    (tmp_path / "request.json").write_text(json.dumps(bench.request.to_document()))
    monkeypatch.setattr(sys, "argv", ["link.streamer", str(tmp_path)])
    assert main() == 4
    assert "priority: as it was\nmemory: as ever\n" in capfd.readouterr().err
    bench.close()


def test_it_is_a_program_whose_argument_is_the_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["link.streamer", str(tmp_path)])
    with pytest.raises(SystemExit) as ended:
        runpy.run_module("link.streamer", run_name="__main__")
    assert ended.value.code == EXIT_REFUSED_REQUEST
    assert "No such file" in json.loads((tmp_path / "refusal.json").read_text())["error"]


@pytest.mark.parametrize("content", [None, "not json", '{"autopilot": "px4"}'])
def test_a_folder_that_cannot_be_flown_from_is_refused_in_writing(content: str | None, tmp_path: Path) -> None:
    if content is not None:
        (tmp_path / "request.json").write_text(content)
    assert main([str(tmp_path)]) == EXIT_REFUSED_REQUEST == 2
    refusal = json.loads((tmp_path / "refusal.json").read_text())
    assert set(refusal) == {"error", "kind"}
    assert refusal["error"]
    assert sorted(p.name for p in tmp_path.iterdir() if p.suffix == ".partial") == []


def test_links_of_a_refused_flight_are_closed_again(tmp_path: Path) -> None:
    (port,) = free_ports(1)
    stations = list(dict.fromkeys(relay_plan(2).station_ids))
    links = dict(zip(stations, [f"udpin:127.0.0.1:{port}", "udpout:no-such-host.invalid:1"], strict=True))
    request = FlightRequest(plan=relay_plan(2).to_document(), autopilot="px4", links=links)
    with pytest.raises(EndpointError) as refusal:
        open_links(request)
    assert refusal.tb  # what the refusal still knows of keeps no link open
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", port))  # free again


def test_every_link_that_must_not_be_used_is_named(tmp_path: Path) -> None:
    stations = list(dict.fromkeys(relay_plan(2).station_ids))
    (port,) = free_ports(1)
    links = dict(zip(stations, [f"udpout:127.0.0.1:{port}", "udpout:192.0.2.1:14550"], strict=True))
    plan = relay_plan(2).to_document()
    with pytest.raises(FlightRequestError) as refusal:
        open_links(FlightRequest(plan=plan, autopilot="px4", links=links, speedup=2.0))
    assert str(refusal.value).count("links.s2") == 2
    assert "links.s1" not in str(refusal.value)
    # A key makes it a signed link; a word that unsigned is meant will do too.
    for allowed in ({"signing_key": "env:RELAY"}, {"allow_unsigned": True}):
        for endpoint in open_links(FlightRequest(plan=plan, autopilot="px4", links=links, **allowed)).values():  # type: ignore[arg-type]
            endpoint.close()


def test_keys_come_from_a_file_or_the_environment_whatever_the_file_is_called(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "key:of:the:relay"
    path.touch(0o600)
    path.write_bytes(bytes(range(1, 33)))
    monkeypatch.setenv("RELAY", bytes(range(1, 33)).hex())
    links = {s: f"udpout:127.0.0.1:{20000 + k}" for k, s in enumerate(dict.fromkeys(relay_plan(2).station_ids))}
    run_dir = tmp_path / "run"
    for key in (f"file:{path}", "env:RELAY"):
        plan = relay_plan(2).to_document()
        made = make_codecs(FlightRequest(plan=plan, autopilot="px4", links=links, signing_key=key), run_dir)
        assert [codec.system_id for codec in made.values()] == [241, 242]
        for codec in made.values():
            assert codec.signing is not None
            assert codec.signing.key == SigningKey(bytes(range(1, 33)))
            assert codec.signing.link_id == codec.system_id
            assert codec.signing.allow_unsigned == {109}
            codec.signing.store.close()
        # Without a folder of their own, stamps are kept with the flight.
        assert sorted(p.name for p in run_dir.iterdir()) == ["station-241.stamps", "station-242.stamps"]


# -- priority and the record ------------------------------------------------------------------------------------------


def test_real_time_where_permitted_a_better_nice_value_else_and_otherwise_as_it_is(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[tuple[int, int, int]] = []
    monkeypatch.setattr(
        os, "sched_setscheduler", lambda pid, policy, param: asked.append((pid, policy, param.sched_priority))
    )
    assert raise_priority() == "SCHED_FIFO 10"
    assert asked == [(0, os.SCHED_FIFO, 10)]

    def refuse(*_: object) -> None:
        raise PermissionError

    nice: list[int] = []
    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    monkeypatch.setattr(os, "nice", nice.append)
    assert raise_priority() == "nice -10"
    assert nice == [-10]
    monkeypatch.setattr(os, "nice", refuse)
    assert raise_priority() == "ordinary"


def test_memory_is_locked_as_far_as_it_is_used_where_permitted(monkeypatch: pytest.MonkeyPatch) -> None:
    class Libc:
        def __init__(self, *answers: int) -> None:
            self.answers, self.asked = list(answers), []  # type: ignore[var-annotated]

        def mlockall(self, flags: int) -> int:
            self.asked.append(flags)
            ctypes.set_errno(errno.EPERM)
            return self.answers.pop()

    libc = Libc(-1, 0)
    monkeypatch.setattr(ctypes, "CDLL", lambda name, *, use_errno: libc if use_errno and name is None else None)
    assert lock_memory() == "locked"
    assert lock_memory() == "not locked (Operation not permitted)"
    assert libc.asked == [1 | 4] * 2  # MCL_CURRENT, MCL_ONFAULT: what is there, not all that might be
    monkeypatch.setattr(ctypes, "CDLL", lambda *_, **__: object())
    assert lock_memory().startswith("not locked (")


def test_stamps_are_saved_beside_the_flight_and_let_go_of_at_its_end(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """By the thread that may wait for a disk; one that cannot be written neither stops it nor the others."""
    assert recorder_module.SAVE_EVERY_S == 1.0
    monkeypatch.setattr(recorder_module, "SAVE_EVERY_S", 0.02)
    stores = [SigningStore.open(tmp_path / name) for name in ("a", "b")]
    saved_by: list[int] = []

    def broken() -> None:
        saved_by.append(threading.get_ident())
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(stores[0], "save", broken)
    recorder = Recorder(tmp_path, None, 0.0, stores)
    stores[1].own_stamp = 7
    until = time.monotonic() + 20.0
    while len(saved_by) < 3 and time.monotonic() < until:
        recorder.event(FlightEvent(1, EventKind.ALARM, 2.0, None, "2026-11-22T09:00:00Z", FlightState.CRUISE, {}))
        time.sleep(0.01)
    recorder.close()
    assert len(saved_by) >= 3
    assert threading.get_ident() not in saved_by
    assert (tmp_path / "b").read_bytes()[8] == 7
    assert recorder.dropped == 0
    for store in stores:
        store.close()


@pytest.mark.parametrize("busy", [False, True])
def test_stamps_are_saved_at_their_own_pace_whatever_else_is_written(
    busy: bool, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(recorder_module, "SAVE_EVERY_S", 0.05)
    store = SigningStore.in_memory()
    saves: list[float] = []
    monkeypatch.setattr(store, "save", lambda: saves.append(time.monotonic()))
    began_s = time.monotonic()
    recorder = Recorder(tmp_path, None, 0.0, [store])
    while len(saves) < 5 and time.monotonic() < began_s + 20.0:
        if busy:
            recorder.event(FlightEvent(1, EventKind.ALARM, 2.0, None, "2026-11-22T09:00:00Z", FlightState.CRUISE, {}))
        time.sleep(0.001)
    recorder.close()
    assert len(saves) >= 5
    assert all(later - earlier >= 0.05 for earlier, later in pairwise([began_s, *saves]))


def test_a_streamer_lets_go_of_its_stamps(tmp_path: Path, quiet_process: None) -> None:
    key = tmp_path / "key"
    key.write_bytes(bytes(range(32)))
    key.chmod(0o600)
    bench = Bench(tmp_path, signing_key=f"file:{key}", signing_state=str(tmp_path / "stamps"))
    for store in bench.streamer.stores:
        store.own_stamp = 7
    bench.streamer.close()
    bench.close()
    stamps = sorted((tmp_path / "stamps").iterdir())
    assert [path.name for path in stamps] == ["station-241.stamps", "station-242.stamps"]
    assert [path.read_bytes()[8] for path in stamps] == [7, 7]
    again = [SigningStore.open(path) for path in stamps]
    assert [store.own_stamp for store in again] == [7, 7]
    for store in again:
        store.close()


def test_who_writes_the_logs_is_as_urgent_as_the_flight_or_would_hold_it_up(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    asked: list[tuple[int, int]] = []
    monkeypatch.setattr(
        os, "sched_setscheduler", lambda pid, policy, param: asked.append((threading.get_ident(), param.sched_priority))
    )
    Recorder(tmp_path, None, 0.0).close()
    assert [priority for _, priority in asked] == [9]
    assert asked[0][0] != threading.get_ident()


def test_frames_and_events_are_written_in_order_with_the_time_in_utc(tmp_path: Path) -> None:
    from link.dialect import mavlink
    from link.wire.codec import StationCodec

    frame = StationCodec(241).encode(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
    recorder = Recorder(tmp_path, str(tmp_path / "flight.tlog"), 1_795_320_000.0)
    recorder.frame(1.5, frame)
    recorder.event(
        FlightEvent(1, EventKind.ALARM, 2.0, None, "2026-11-22T09:00:00Z", FlightState.CRUISE, {"what": "x"})
    )
    recorder.frame(2.25, frame)
    recorder.close()
    assert recorder.dropped == 0
    assert not [name for name in open_files() if name.startswith(str(tmp_path))]
    entries = list(read_tlog(tmp_path / "flight.tlog"))
    assert len(entries) == 2
    lines = (tmp_path / "events.jsonl").read_bytes().splitlines()
    assert [json.loads(line)["data"]["what"] for line in lines] == ["x"]
    assert (tmp_path / "events.jsonl").stat().st_mode & 0o777 == 0o600
    content = (tmp_path / "flight.tlog").read_bytes()
    assert int.from_bytes(content[:8], "big") == 1_795_320_001_500_000


def test_without_a_log_only_events_are_kept_and_what_cannot_be_written_is_counted(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, None, 0.0)
    recorder.frame(1.0, b"frame")
    event = FlightEvent(1, EventKind.ALARM, 2.0, None, "2026-11-22T09:00:00Z", FlightState.CRUISE, {})
    os.dup2(os.open("/dev/full", os.O_WRONLY), recorder._events)
    recorder.event(event)
    recorder.event(event)
    recorder.close()
    assert recorder.dropped == 2
    assert [p.name for p in tmp_path.iterdir()] == ["events.jsonl"]


def test_a_log_on_a_full_disk_costs_its_frames_and_no_event(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, "/dev/full", 0.0)
    recorder.frame(1.0, b"frame")
    recorder.event(FlightEvent(1, EventKind.ALARM, 2.0, None, "2026-11-22T09:00:00Z", FlightState.CRUISE, {}))
    recorder.close()
    assert len((tmp_path / "events.jsonl").read_bytes().splitlines()) == 1
