"""A whole flight in virtual time: the flight core and the simulated autopilot on one clock, a lossy proxy between them.

Nothing here waits: the clock jumps to the next thing that happens (a tick of the core, an event of the vehicle, a frame
arriving), so an hour's flight takes seconds and is the same every time for the same seed.
"""

from __future__ import annotations

import heapq
import math
import random
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gcs.flight import EventKind, FlightEvent, FlightState
from gcs.plan.model import Plan
from link.director.core import FlightCore
from link.session.changes import ChangeJournal
from link.session.request import FlightRequest
from link.wire.codec import StationCodec
from sitl_fixtures.vehicle import SimulatedAutopilot, SimulatorConfig

EPOCH_UNIX_S = 1_795_000_000.0


@dataclass
class Proxy:
    """What the links do to frames: loses ``loss`` of them, delays each by ``latency_s`` plus up to ``jitter_s`` (which
    reorders them), repeats ``duplicates`` of them. ``cuts`` are (link, from_s, to_s), both directions; ``later_s`` is
    more latency of single links. A link is named by its station, a station's second one ``station/2``."""

    seed: int = 0
    loss: float = 0.0
    latency_s: float = 0.0
    jitter_s: float = 0.0
    duplicates: float = 0.0
    cuts: list[tuple[str, float, float]] = field(default_factory=list)
    later_s: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._random = random.Random(self.seed)

    def deliveries(self, link: str, now_s: float) -> list[float]:
        """When a frame sent now arrives: no time, one, or several."""
        latency_s = self.latency_s + self.later_s.get(link, 0.0)
        if any(name == link and low <= now_s < high for name, low, high in self.cuts):
            return []
        copies = 2 if self.duplicates and self._random.random() < self.duplicates else 1
        return [
            now_s + latency_s + (self._random.random() * self.jitter_s if self.jitter_s else 0.0)
            for _ in range(copies)
            if not (self.loss and self._random.random() < self.loss)
        ]


@dataclass(frozen=True)
class Accepted:
    """A setpoint the vehicle obeyed: when it came, when it was sent, from whom, by whose grant."""

    time_s: float
    sent_s: float
    station: str
    holder_when_sent: str | None
    system_id: int
    link: int


@dataclass(frozen=True)
class Truth:
    """Where the aircraft truly was, and what the plan asked for then."""

    time_s: float
    lat_deg: float
    lon_deg: float
    alt_amsl_m: float
    plan_s: float | None
    state: FlightState


def plan_home(plan: Plan, below_m: float = 5.0) -> tuple[float, float, float]:
    """The place under a plan's start, and the height of flat ground ``below_m`` under the plan's lowest point.

    The simulated ground is level everywhere: a plan that descends below its start must not meet it.
    """
    start = plan.trajectory.evaluate(0.0)
    lat, lon = plan.plane.to_geodetic(float(start[0]), float(start[1]))
    lowest_m = float(plan.trajectory.evaluate(np.linspace(0.0, plan.mission_time_s, 1000))[:, 2].min())
    return float(lat), float(lon), lowest_m + plan.plane.alt_amsl_m - below_m


def one_station_at_a_time(flight: VirtualFlight) -> None:
    """Every setpoint obeyed was sent by the station that held the gate then, with that station's own system id.

    And no two stations sent at one tick.
    """
    ids = {s.id: s.system_id for s in flight.core.context.plan.mission.stations}
    assert flight.accepted
    for setpoint in flight.accepted:
        assert setpoint.station == setpoint.holder_when_sent
        assert setpoint.system_id == ids[setpoint.station]
    sent = [a.sent_s for a in flight.accepted]
    assert len(set(sent)) == len({(a.sent_s, a.station) for a in flight.accepted}), "two stations sent at one tick"


def handover_gaps_s(flight: VirtualFlight, around_s: float = 2.0) -> list[float]:
    """The longest time between setpoints obeyed about each handover, in the vehicle's time."""
    return [
        flight.longest_gap_s(e.time_s - around_s, e.time_s + around_s)
        for e in flight.said("handover", state="requested")
    ]


class VirtualFlight:
    """One flight of a plan by an autopilot model. `run` until it ends, or some condition holds."""

    def __init__(
        self,
        plan: Plan,
        autopilot: str,
        *,
        proxy: Proxy | None = None,
        config: dict[str, object] | None = None,
        request: dict[str, object] | None = None,
        truth_every_s: float = 0.5,
        frugal: bool = False,
        ways: int = 1,
        reserve: tuple[str, ...] = (),
        journal: ChangeJournal | None = None,
    ) -> None:
        self.plan = plan
        stations = list(dict.fromkeys([*plan.station_ids, *reserve]))
        self.proxy = proxy or Proxy()
        # A link is a station's way to the vehicle, and a link of the vehicle's own.
        self.links = [s if way == 1 else f"{s}/{way}" for way in range(1, ways + 1) for s in stations]
        self._urls = {link: f"udpout:127.0.0.1:{20000 + k}" for k, link in enumerate(self.links)}
        self._link_of = {url: link for link, url in self._urls.items()}
        self.request = FlightRequest(
            plan=plan.to_document(),
            autopilot=autopilot,
            links={s: [self._urls[link] for link in self.links if link.split("/")[0] == s] for s in stations},
            **(request or {}),  # type: ignore[arg-type]
        )
        self.core = FlightCore(self.request, epoch_unix_s=EPOCH_UNIX_S, journal=journal)
        self.sent: list[tuple[float, str, str | None, bytes]] = []
        """Every frame the core let out: when, from which station, who was in control, the frame."""
        settings = {"home": plan_home(plan), "links": len(self.links), **(config or {})}
        self.vehicle = SimulatedAutopilot(
            SimulatorConfig(autopilot=autopilot, **settings),  # type: ignore[arg-type]
            self._on_setpoint,
        )
        if frugal:
            # What every link sends by itself, cut down as over a slow radio: the flight asks for what it needs.
            for link in range(len(self.links)):
                for number in list(self.vehicle.telemetry.builders):
                    if number != 0:
                        self.vehicle.telemetry.set_interval(link, number, None)
        self.stations = stations
        self.now_s = 0.0
        self.events: list[FlightEvent] = []
        self.accepted: list[Accepted] = []
        self.truth: list[Truth] = []
        self.frozen = False
        """While set, the core is not stepped: a hung process."""
        self._truth_every_s = truth_every_s
        self._truth_s = 0.0
        self._queue: list[tuple[float, int, str, bool, bytes, float, str | None]] = []
        self._count = 0
        self._delivering: tuple[float, str, str | None] | None = None
        self._core_s = 0.0

    # -- running ------------------------------------------------------------------------------------------------------

    def run(self, until: Callable[[], bool] | None = None, *, limit_s: float = 20_000.0) -> FlightState:
        """Run until the flight is finished, or ``until`` holds, or so much virtual time has passed."""
        end_s = self.now_s + limit_s
        while not self.core.finished and self.now_s < end_s and not (until is not None and until()):
            self.step()
        return self.core.state

    def run_for(self, duration_s: float) -> None:
        """Run so long, finished or not."""
        end_s = self.now_s + duration_s
        while self.now_s < end_s:
            self.step()

    def next_flight(self, journal: ChangeJournal | None, plan: Plan | None = None, **request: object) -> None:
        """The flight so far is dead, killed at this moment; another begins on the same vehicle and links."""
        plan = plan or self.plan
        links = dict(zip(dict.fromkeys(plan.station_ids), self.request.links.values(), strict=True))
        autopilot = self.request.autopilot
        given = {"auto_launch": False, **request}
        self.plan = plan
        document = {"plan": plan.to_document(), "autopilot": autopilot, "links": links}
        self.request = FlightRequest.from_document({**document, **given})
        self.core = FlightCore(self.request, now_s=self.now_s, epoch_unix_s=EPOCH_UNIX_S, journal=journal)
        self.core.start(self.now_s)
        self._core_s, self._queue, self.events = self.now_s, [], []

    def step(self) -> None:
        """On to the next thing that happens."""
        next_s = min(self._core_s if not self.frozen else math.inf, self.vehicle.next_event_s())
        if self._queue:
            next_s = min(next_s, self._queue[0][0])
        self.now_s = max(self.now_s, next_s)
        now_s = self.now_s
        while self._queue and self._queue[0][0] <= now_s:
            _, _, link, up, data, sent_s, holder = heapq.heappop(self._queue)
            station = link.split("/")[0]
            if up:
                self._delivering = (sent_s, station, holder)
                self.vehicle.receive(self.links.index(link), data, now_s)
                self._delivering = None
            elif not self.frozen:
                self.core.receive(station, data, now_s, self._urls[link])
        self.vehicle.step(now_s)
        if not self.frozen and self._core_s <= now_s:
            self._core_s = self.core.step(now_s)
            holder = self.core.context.control.gate.holder
            for station, data in self.core.take_outgoing():
                self.sent.append((now_s, station, holder, data))
                for url in self.core.routes(station, data):
                    self._put(self._link_of[url], True, data, holder)
            self.core.tell()
            self.events += self.core.take_events()
        for number, data in self.vehicle.take_outgoing():
            self._put(self.links[number], False, data, None)
        if now_s >= self._truth_s:
            self._truth_s = now_s + self._truth_every_s
            self._note_truth()

    def _put(self, link: str, up: bool, data: bytes, holder: str | None) -> None:
        for time_s in self.proxy.deliveries(link, self.now_s):
            self._count += 1
            heapq.heappush(self._queue, (time_s, self._count, link, up, data, self.now_s, holder))

    def _on_setpoint(self, now_s: float, link: int, system_id: int, name: str, target: dict[str, object]) -> None:
        sent_s, station, holder = self._delivering or (math.nan, "?", None)
        self.accepted.append(Accepted(self.now_s, sent_s, station, holder, system_id, link))

    def _note_truth(self) -> None:
        body, air = self.vehicle.body, self.core.airborne
        on_plan = self.core.context.timeline.launched_s is not None and air.guidance.on_plan
        self.truth.append(
            Truth(
                self.now_s,
                body.lat_deg,
                body.lon_deg,
                body.height_m,
                air.guidance.reference.time_s if on_plan else None,
                self.core.state,
            )
        )

    # -- looking ------------------------------------------------------------------------------------------------------

    def said(self, kind: EventKind | str, **data: object) -> list[FlightEvent]:
        """Events of a kind whose data hold these values."""
        kind = EventKind(kind)
        return [e for e in self.events if e.kind is kind and all(e.data.get(k) == v for k, v in data.items())]

    def sent_messages(self, *kinds: str) -> list[tuple[float, str, str | None, Any]]:
        """(time, station, who was in control, message) of the frames sent, of some kinds."""
        decoder = StationCodec(99)
        found = [(t, s, h, m) for t, s, h, frame in self.sent for m in decoder.decode(frame)]
        return [entry for entry in found if not kinds or entry[3].get_type() in kinds]

    @property
    def states(self) -> list[str]:
        """The states passed through, in order."""
        return [str(e.data["to"]) for e in self.said("state") if e.data["to"] != e.data["from"]]

    @property
    def plan_s(self) -> float:
        """Where on the plan the reference is; minus infinity before T+0."""
        guidance = self.core.airborne.guidance
        if self.core.context.timeline.launched_s is None or not guidance.on_plan:
            return -math.inf
        return guidance.reference.time_s

    def longest_gap_s(self, from_s: float, to_s: float) -> float:
        """Longest time between setpoints obeyed in a span."""
        times = [a.time_s for a in self.accepted if from_s <= a.time_s <= to_s]
        return float(np.diff([from_s, *times, to_s]).max())

    def behind_m(self) -> np.ndarray:
        """Distances of the true positions in cruise from where the reference was at that very moment."""
        cruise = [t for t in self.truth if t.state is FlightState.CRUISE and t.plan_s is not None]
        east, north = self.plan.plane.to_plane([t.lat_deg for t in cruise], [t.lon_deg for t in cruise])
        up = [t.alt_amsl_m - self.plan.plane.alt_amsl_m for t in cruise]
        asked = self.core.context.plan.trajectory.evaluate(np.array([float(t.plan_s or 0.0) for t in cruise]))
        return np.asarray(np.linalg.norm(np.column_stack([east, north, up]) - asked, axis=-1))

    def cross_track_m(self, every: int = 1) -> np.ndarray:
        """Distances of the true positions in cruise from the planned path near the reference's place on it.

        "Time-matched cross-track": the nearest point of the path within 5 s of the reference, so a vehicle that is late
        is not charged for it, and one that cuts a corner is.
        """
        result = []
        for truth in self.truth[::every]:
            if truth.state is not FlightState.CRUISE or truth.plan_s is None:
                continue
            east, north = self.plan.plane.to_plane(truth.lat_deg, truth.lon_deg)
            here = np.array([float(east), float(north), truth.alt_amsl_m - self.plan.plane.alt_amsl_m])
            times = np.linspace(truth.plan_s - 5.0, truth.plan_s + 5.0, 2001)
            result.append(np.linalg.norm(self.plan.trajectory.evaluate(times) - here, axis=-1).min())
        return np.array(result)
