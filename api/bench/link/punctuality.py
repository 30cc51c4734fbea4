"""How punctual the streamer process is, idle and under full load, beside a bare sender in the same run.

A flight is flown in real time: the streamer as it is, a simulated PX4, signed links. What is late is read off kernel
stamps at the receiving end of the links (`api.bench.link.wiretap`). Beside it, over the same seconds, a process of the
same priority that does nothing but send (`api.bench.link.sender`) shows what the machine itself is late by: the
streamer's figures mean something against those alone.
"""

from __future__ import annotations

import contextlib
import math
import os
import platform
import secrets
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from api.bench.link.wiretap import Heard, Wiretap, lateness_ms, missed
from api.processes import Child, ChildError, Children, python_module, start_simulator
from gcs.mission import read_mission
from gcs.planning import plan_mission
from link.session import FlightRequest
from link.streamer import RunningFlight, start_flight
from link.wire import Signing, SigningKey, SigningStore, StationCodec

if TYPE_CHECKING:
    from gcs.flight import FlightEvent
    from gcs.plan import Plan

AUTOPILOT = "px4"
_SPACING_M, _SPEED_M_S, _MOST_STATIONS = 420.0, 15.0, 30
_START_S, _CLIMB_S = 30.0, 120.0
_SETTLE_S = 1.0
_RECEIVER_PRIORITY = 6
_AROUND_S = 3.0


@dataclass(frozen=True)
class Lateness:
    """How late a sender was: milliseconds behind the first deadline it owed."""

    scheduling: str
    sent: int
    missed: int
    p50_ms: float
    p99_ms: float
    max_ms: float
    longest_gap_ms: float

    @classmethod
    def of(cls, heard: Heard, rate_hz: float, scheduling: str, from_s: float, to_s: float) -> Lateness:
        """From what was heard in a span."""
        times = _within(heard, from_s, to_s)[0]
        if len(times) < 10:
            raise ChildError(f"only {len(times)} datagrams were heard from a sender ({scheduling}) at {rate_hz:g} Hz")
        late = lateness_ms(times, rate_hz)
        return cls(
            scheduling,
            len(times),
            missed(times, rate_hz),
            round(float(np.quantile(late, 0.5)), 3),
            round(float(np.quantile(late, 0.99)), 3),
            round(float(late.max()), 3),
            round(float(np.diff(times).max()) * 1e3, 3),
        )


@dataclass(frozen=True)
class HandoverFigures:
    """The handovers of a run: the longest step between setpoints around them, and the error there and elsewhere."""

    count: int
    longest_gap_ms: float
    period_ms: float
    tracking_around_m: float | None
    tracking_elsewhere_m: float | None


@dataclass(frozen=True)
class Run:
    """One flight's figures."""

    rate_hz: float
    loaded: bool
    signed: bool
    measured_s: float
    streamer: Lateness
    reference: Lateness
    core_share: float
    """Of one core, that the streamer process used."""
    handovers: HandoverFigures

    @property
    def vehicles_per_core(self) -> float:
        """How many flights of this kind one core could serve, by the processor time used."""
        return 1.0 / self.core_share

    def to_document(self) -> dict[str, Any]:
        """As JSON."""
        from dataclasses import asdict

        ours, bare = self.streamer, self.reference
        return {
            "rate_hz": self.rate_hz,
            "load": "api and planner" if self.loaded else "idle",
            "signed": self.signed,
            "measured_s": round(self.measured_s, 1),
            "streamer": asdict(ours),
            "reference": asdict(bare),
            "p99_over_reference_ms": round(ours.p99_ms - bare.p99_ms, 3),
            "p99_ratio": round(ours.p99_ms / bare.p99_ms, 3) if bare.p99_ms > 0.0 else None,
            "core_share": round(self.core_share, 4),
            "vehicles_per_core": round(self.vehicles_per_core, 1),
            "handover": asdict(self.handovers),
        }


def machine() -> dict[str, Any]:
    """Where the figures are from."""
    return {"processors": os.cpu_count(), "machine": platform.machine(), "python": platform.python_version()}


def bench_plan(seconds: float) -> Plan:
    """Stations in a row, handed over every half minute (less often in a long flight), for at least so long."""
    spacing_m = max(_SPACING_M, seconds * _SPEED_M_S / (_MOST_STATIONS - 2))
    count = 2 + math.ceil(seconds * _SPEED_M_S / spacing_m)
    return plan_mission(
        read_mission(
            {
                "name": "In a row",
                "origin": {"lat_deg": 52.95, "lon_deg": 4.79, "alt_amsl_m": 0.0},
                "start": {"east_m": 0.0, "north_m": 0.0, "up_m": 40.0},
                "destination": {"east_m": spacing_m * (count - 1), "north_m": 20.0, "up_m": 40.0},
                "stations": [
                    {
                        "id": f"s{k + 1}",
                        "east_m": spacing_m * k,
                        "north_m": 60.0 * (-1) ** k,
                        "up_m": 0.0,
                        "range_m": 0.95 * spacing_m,
                    }
                    for k in range(count)
                ],
                "limits": {
                    "min_alt_amsl_m": 30.0,
                    "max_alt_amsl_m": 60.0,
                    "max_speed_m_s": _SPEED_M_S,
                    "max_accel_m_s2": 2.5,
                },
            }
        ),
        fast=True,
    )


@contextlib.contextmanager
def full_load(children: Children, folder: Path) -> Iterator[None]:
    """The service asked without pause by two clients, its own planners at work, and a planner more for every core."""
    environment = {**os.environ, "SKYRELAY_DATA": str(folder)}
    service = children.start(
        "service", python_module("api.cli", "serve", "--port", "0", "--data", str(folder)), env=environment
    )
    deadline_s = time.monotonic() + _START_S
    while "skyrelay serves at " not in service.output():
        service.check()
        if time.monotonic() > deadline_s:
            raise ChildError("the service did not get ready", {"said": service.output()[-2000:]})
        time.sleep(0.05)
    url = service.output().split("skyrelay serves at ", 1)[1].split()[0].rstrip("/")
    started = [service]
    started += [children.start("asker", python_module("api.bench.link.load", "api", url)) for _ in range(2)]
    planners = range(os.cpu_count() or 1)
    started += [children.start("planner", python_module("api.bench.link.load", "planner")) for _ in planners]
    try:
        yield
    finally:
        for child in reversed(started):
            children.forget(child)
            child.stop()


@contextlib.contextmanager
def _receiver_priority() -> Iterator[None]:
    """The receiving end and the simulated vehicle stand for other machines: the load must not starve them either."""
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    with contextlib.suppress(OSError):
        policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
        os.sched_setscheduler(0, policy, os.sched_param(_RECEIVER_PRIORITY))
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, before[0] & ~os.SCHED_RESET_ON_FORK, before[1])


def measure(plan: Plan, *, rate_hz: float, seconds: float, loaded: bool, signed: bool = True) -> Run:
    """Fly ``plan`` in real time and measure from T+0 on. Raises `ChildError` when the flight does not get there."""
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(TemporaryDirectory(prefix="skyrelay-bench-")))
        children = stack.enter_context(Children())
        if loaded:
            stack.enter_context(full_load(children, folder / "data"))
        stack.enter_context(_receiver_priority())
        return _Measurement(plan, folder, children, stack, rate_hz, signed).run(seconds, loaded)


class _Measurement:
    def __init__(
        self,
        plan: Plan,
        folder: Path,
        children: Children,
        stack: contextlib.ExitStack,
        rate_hz: float,
        signed: bool,
    ) -> None:
        self._folder, self._children, self._stack = folder, children, stack
        self._rate_hz, self._signed = rate_hz, signed
        self._events: list[tuple[float, FlightEvent]] = []
        _, links = start_simulator(children, plan, autopilot=AUTOPILOT, speedup=1.0)
        ports = {station: int(url.rsplit(":", 1)[1]) for station, url in links.items()}
        key = secrets.token_bytes(32)
        vehicle = None
        if signed:
            vehicle_id = plan.mission.options.vehicle_system_id
            signing = Signing(SigningKey(key), 0, SigningStore.in_memory())
            vehicle = StationCodec(vehicle_id, 1, signing=signing)
            path = folder / "key"
            path.touch(0o600)
            path.write_bytes(key)
        self._tap = Wiretap(ports, vehicle)
        stack.callback(self._tap.close)
        request = FlightRequest(
            plan=plan.to_document(),
            autopilot=AUTOPILOT,
            links=self._tap.links,
            rate_hz=rate_hz,
            climb_m_s=5.0,
            signing_key=f"file:{folder / 'key'}" if signed else None,
            signing_state=str(folder / "stamps") if signed else None,
        )
        self._flight: RunningFlight = start_flight(request, on_event=self._hear, run_dir=folder / "run")
        stack.callback(self._flight.kill)

    def _hear(self, event: FlightEvent) -> None:
        self._events.append((time.monotonic(), event))

    def _reached(self, state: str) -> bool:
        if self._flight.result is not None:
            raise ChildError("the flight ended before it was measured", {"said": self._flight.result.reason})
        return any(e.kind.value == "state" and e.data.get("to") == state for _, e in self._events)

    def run(self, seconds: float, loaded: bool) -> Run:
        tap = self._tap
        if not tap.run(lambda: self._reached("cruise"), _CLIMB_S):
            raise ChildError("the flight did not get under way", {"state": str(self._events[-1:])})
        sender = self._reference(seconds + 2.0 * _SETTLE_S)
        if not tap.run(lambda: bool(sender.output()), _START_S):
            raise ChildError("the reference sender did not start")
        tap.run(lambda: False, 0.5 * _SETTLE_S)
        from_s, used_s = time.monotonic(), _processor_s(self._flight.pid)
        tap.run(lambda: self._flight.result is not None, seconds)
        to_s, used_s = time.monotonic(), _processor_s(self._flight.pid) - used_s
        bare = next((line for line in sender.output().splitlines()), "unknown")
        log = (self._folder / "run" / "streamer.log").read_text(errors="replace")
        ours = next((line.split(": ", 1)[1] for line in log.splitlines() if line.startswith("priority: ")), "unknown")
        return Run(
            self._rate_hz,
            loaded,
            self._signed,
            to_s - from_s,
            Lateness.of(tap.setpoints, self._rate_hz, ours, from_s, to_s),
            Lateness.of(tap.reference, self._rate_hz, bare, from_s, to_s),
            max(used_s / (to_s - from_s), 1e-6),
            self._handovers(from_s, to_s),
        )

    def _reference(self, seconds: float) -> Child:
        arguments = ("127.0.0.1", str(self._tap.reference_port), f"{self._rate_hz:g}", f"{seconds:g}")
        return self._children.start("reference sender", python_module("api.bench.link.sender", *arguments))

    def _handovers(self, from_s: float, to_s: float) -> HandoverFigures:
        times, ids = _within(self._tap.setpoints, from_s, to_s)
        moved = times[1:][np.diff(ids) != 0]
        gaps = [float(np.diff(times[abs(times - at) <= _AROUND_S]).max()) for at in moved]
        around: list[float] = []
        elsewhere: list[float] = []
        for heard_s, event in self._events:
            error = event.data.get("error_m")
            if event.kind.value == "progress" and from_s <= heard_s <= to_s and error is not None:
                near = bool((abs(moved - heard_s) <= _AROUND_S).any())
                (around if near else elsewhere).append(float(error))
        return HandoverFigures(
            len(moved),
            round(max(gaps, default=0.0) * 1e3, 3),
            round(1e3 / self._rate_hz, 3),
            max(around, default=None),
            max(elsewhere, default=None),
        )


def _within(heard: Heard, from_s: float, to_s: float) -> tuple[Any, Any]:
    times, ids = np.array(heard.time_s), np.array(heard.system_id)
    inside = (times >= from_s) & (times <= to_s)
    order = np.argsort(times[inside], kind="stable")
    return times[inside][order], ids[inside][order]


def _processor_s(pid: int) -> float:
    """Processor time of a process so far, its threads included."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
