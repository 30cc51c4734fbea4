"""Several flights, several vehicles, one clock: who hears whom is up to the test.

A link is an ether: every frame a program sends over it reaches every vehicle on it, every frame of a vehicle every
program. All in virtual time.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Sequence
from typing import Any

from gcs.flight import EventKind, FlightEvent, FlightState
from gcs.plan.model import Plan
from link.director.core import FlightCore
from link.monitors.one_vehicle import Claim
from link.session.request import FlightRequest
from sitl_fixtures.vehicle import SimulatedAutopilot, SimulatorConfig
from tests.support.flights.virtual import EPOCH_UNIX_S, Proxy, plan_home


class Program:
    """A flight's core on some links, begun at ``start_s``; ``number`` tells its URLs from another program's."""

    def __init__(
        self, number: int, plan: Plan, autopilot: str, start_s: float, claim: Claim | None, **request: Any
    ) -> None:
        self.stations = list(dict.fromkeys(plan.station_ids))
        host = ("127.0.0.1", "localhost", "127.0.1.1")[number % 3]
        urls = {s: f"udpout:{host}:{20000 + 100 * number + k}" for k, s in enumerate(self.stations)}
        self.request = FlightRequest(plan=plan.to_document(), autopilot=autopilot, links=urls, **request)
        self.start_s, self.claim = start_s, claim
        self.core: FlightCore | None = None
        self.next_s = start_s
        self.events: list[FlightEvent] = []
        self.killed = False

    @property
    def state(self) -> FlightState:
        """Where its flight stands."""
        return FlightState.CONNECTING if self.core is None else self.core.state

    @property
    def over(self) -> bool:
        """Whether it does nothing any more."""
        return self.killed or (self.core is not None and self.core.finished)

    def said(self, kind: str, **data: object) -> list[FlightEvent]:
        """Events of a kind whose data hold these values."""
        wanted = EventKind(kind)
        return [e for e in self.events if e.kind is wanted and all(e.data.get(k) == v for k, v in data.items())]

    @property
    def reasons(self) -> str:
        """Why its states changed."""
        return "; ".join(str(e.data["reason"]) for e in self.said("state") if e.data["reason"])


class SharedSky:
    """Programs and vehicles. A vehicle is on every link of its `SimulatorConfig`, from ``on_s`` on."""

    def __init__(self, plan: Plan, autopilot: str, proxy: Proxy | None = None) -> None:
        self.plan, self.autopilot, self.proxy = plan, autopilot, proxy or Proxy()
        self.links = list(dict.fromkeys(plan.station_ids))
        self.programs: list[Program] = []
        self.vehicles: list[tuple[SimulatedAutopilot, float, tuple[int, ...]]] = []
        self.obeyed: list[list[tuple[float, int]]] = []
        """Setpoints obeyed by each vehicle: when, of which program."""
        self.armed_by: list[set[int]] = []
        """Programs whose arming command reached each vehicle."""
        self.now_s = 0.0
        self._queue: list[tuple[float, int, Callable[[], None]]] = []
        self._count = 0
        self._speaking = -1

    def program(self, *, start_s: float = 0.0, claim: Claim | None = None, **request: Any) -> Program:
        """Another program, with the same plan."""
        made = Program(len(self.programs), self.plan, self.autopilot, start_s, claim, **request)
        self.programs.append(made)
        return made

    def vehicle(
        self, *, on_s: float = 0.0, links: Sequence[int] | None = None, east_m: float = 0.0, **config: Any
    ) -> SimulatedAutopilot:
        """Another vehicle, ``east_m`` beside the plan's start, heard on some of the links (all)."""
        lat, lon, alt = plan_home(self.plan)
        home = (lat, lon + math.degrees(east_m / 6371000.0 / math.cos(math.radians(lat))), alt)
        number = len(self.vehicles)
        self.obeyed.append([])
        self.armed_by.append(set())
        settings = {"home": home, "links": len(self.links), **config}
        made = SimulatedAutopilot(
            SimulatorConfig(autopilot=self.autopilot, **settings),
            lambda *_: self.obeyed[number].append((self.now_s, self._speaking)),
        )
        self.vehicles.append((made, on_s, tuple(links if links is not None else range(len(self.links)))))
        return made

    def run(self, until: Callable[[], bool] | None = None, *, limit_s: float = 600.0) -> None:
        """Until all programs are over, or ``until`` holds, or so much virtual time has passed."""
        end_s = self.now_s + limit_s
        while self.now_s < end_s and not all(p.over for p in self.programs) and not (until is not None and until()):
            self._step()

    def _step(self) -> None:
        times = [program.next_s for program in self.programs if not program.over]
        times += [max(on_s, vehicle.next_event_s()) for vehicle, on_s, _ in self.vehicles]
        times += [self._queue[0][0]] if self._queue else []
        self.now_s = max(self.now_s, min(times))
        while self._queue and self._queue[0][0] <= self.now_s:
            heapq.heappop(self._queue)[2]()
        for vehicle, on_s, links in self.vehicles:
            if self.now_s >= on_s:
                vehicle.step(self.now_s)
                for link, data in vehicle.take_outgoing():
                    if link in links:
                        self._down(link, data)
        for number, program in enumerate(self.programs):
            if not program.over and program.next_s <= self.now_s:
                self._tick(number, program)

    def _tick(self, number: int, program: Program) -> None:
        if program.core is None:
            program.core = FlightCore(program.request, now_s=self.now_s, epoch_unix_s=EPOCH_UNIX_S, claim=program.claim)
        program.next_s = program.core.step(self.now_s)
        for station, data in program.core.take_outgoing():
            for time_s in self.proxy.deliveries(station, self.now_s):
                self._put(time_s, lambda s=station, d=data: self._up(number, s, d))
        program.core.tell()
        program.events += program.core.take_events()

    def _put(self, time_s: float, action: Callable[[], None]) -> None:
        self._count += 1
        heapq.heappush(self._queue, (time_s, self._count, action))

    def _up(self, number: int, station: str, data: bytes) -> None:
        link = self.links.index(station)
        self._speaking = number
        for k, (vehicle, on_s, links) in enumerate(self.vehicles):
            if self.now_s >= on_s and link in links:
                if _arms(data):
                    self.armed_by[k].add(number)
                vehicle.receive(link, data, self.now_s)
        self._speaking = -1

    def _down(self, link: int, data: bytes) -> None:
        for program in self.programs:
            for time_s in self.proxy.deliveries(self.links[link], self.now_s):
                self._put(time_s, lambda p=program: self._hear(p, link, data))

    def _hear(self, program: Program, link: int, data: bytes) -> None:
        if program.core is not None and not program.over:
            program.core.receive(self.links[link], data, self.now_s)

    def inject(self, link: int, data: bytes) -> None:
        """Bytes of nobody in particular, heard by all programs on a link."""
        self._down(link, data)


def _arms(frame: bytes) -> bool:
    """Whether a frame is COMMAND_LONG (76) with MAV_CMD_COMPONENT_ARM_DISARM (400)."""
    return frame[7:10] == b"\x4c\0\0" and frame[10 + 28 : 10 + 30] == (400).to_bytes(2, "little")
