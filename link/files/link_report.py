"""The C2 links of a flight, from its log: each station's probes (TIMESYNC, 111) and what the vehicle answered.

A probe's number comes back in its answer, so every answer is known by the station that asked. A log does not say which
of a station's link paths brought a frame: the figures are of its paths together, each answer taken as it first came.
Times are the flight's seconds, from the whole log, ground time included.

What a log cannot tell is told by the flight's events (`History`): which path sent, and the streamer's own count of
lateness.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gcs.flight import EventKind, FlightEvent
from gcs.plan import Plan
from link.errors import ReportError
from link.telemetry.link_path import PROBE_LOST_S
from planner.arrays import Array


@dataclass(frozen=True)
class LinkReport:
    """A station's C2 link. None where the log does not tell.

    ``loss`` is the share of probes never answered, whichever path lost them; ``latency_ms`` half of the median round
    trip; ``round_trip_worst_ms`` the longest; ``jitter_ms`` the mean change from one round trip to the next;
    ``failovers`` how often another of its paths came to send.
    """

    station: str
    probes: int
    loss: float | None
    latency_ms: float | None
    round_trip_worst_ms: float | None
    jitter_ms: float | None
    failovers: int | None = None

    def to_text(self) -> str:
        """In one line, for people."""
        if self.loss is None:
            return f"{self.station}: no probes"
        told = f"{self.station}: {self.loss:.1%} of {self.probes} probes lost"
        if self.latency_ms is not None and self.jitter_ms is not None:
            told += (
                f", latency {self.latency_ms:.0f} ms, jitter {self.jitter_ms:.0f} ms, "
                f"there and back {self.round_trip_worst_ms:.0f} ms at worst"
            )
        if self.failovers:
            told += f", another link path sent {self.failovers} time{'s' if self.failovers > 1 else ''}"
        return told


class ProbeCount:
    """Probes and answers of a log, in its order. ``stations`` maps system ids to station ids."""

    def __init__(self, stations: Mapping[int, str]) -> None:
        self._stations = dict(stations)
        self._sent: dict[int, tuple[str, float]] = {}
        self._trips: dict[int, float] = {}

    def note(self, time_s: float, system_id: int, message: Any, *, vehicle: bool) -> None:
        """A TIMESYNC of ``system_id``; ``vehicle``: of the vehicle's autopilot."""
        station = self._stations.get(system_id)
        if message.tc1 == 0 and station is not None:
            self._sent[message.ts1] = (station, time_s)
        elif message.tc1 != 0 and vehicle and message.ts1 in self._sent:
            self._trips.setdefault(message.ts1, time_s - self._sent[message.ts1][1])

    @property
    def least_latency_s(self) -> float:
        """Half of the shortest round trip: what every frame takes at least. 0 where nothing was answered."""
        return 0.5 * min(self._trips.values(), default=0.0)

    def trips(self) -> dict[str, tuple[Array, Array]]:
        """Of each station: when its probes were sent, and their round trips in ms, NaN where never answered."""
        result = {}
        for station in dict.fromkeys(self._stations.values()):
            sent = [
                (sent_s, 1e3 * self._trips.get(n, np.nan))
                for n, (asked, sent_s) in self._sent.items()
                if asked == station
            ]
            table = np.array(sent, dtype=float).reshape(-1, 2)
            result[station] = (table[:, 0], table[:, 1])
        return result

    def links(self, end_s: float, failovers: Mapping[str, int] | None) -> tuple[LinkReport, ...]:
        """The figures at the log's end; probes under way then are not counted."""
        return tuple(
            self._link(station, end_s, None if failovers is None else failovers.get(station, 0))
            for station in dict.fromkeys(self._stations.values())
        )

    def _link(self, station: str, end_s: float, failovers: int | None) -> LinkReport:
        due = [
            nonce
            for nonce, (asked, sent_s) in self._sent.items()
            if asked == station and (nonce in self._trips or end_s - sent_s >= PROBE_LOST_S)
        ]
        trips_ms = 1e3 * np.array([self._trips[nonce] for nonce in due if nonce in self._trips])
        return LinkReport(
            station=station,
            probes=len(due),
            loss=None if not due else 1.0 - len(trips_ms) / len(due),
            latency_ms=None if not len(trips_ms) else 0.5 * float(np.median(trips_ms)),
            round_trip_worst_ms=None if not len(trips_ms) else float(trips_ms.max()),
            jitter_ms=None if len(trips_ms) < 2 else float(np.abs(np.diff(trips_ms)).mean()),
            failovers=failovers,
        )


@dataclass(frozen=True)
class History:
    """What a flight's events say beside its log: failovers by station, and the streamer's lateness (None unless the
    flight has ended): ``p50_ms``, ``p99_ms``, ``worst_ms`` and ``skipped_ticks``, real time."""

    failovers: Mapping[str, int]
    lateness: Mapping[str, float] | None
    not_planned: tuple[str, ...] = ()
    """What a flight as planned does not have: its end, where it was another, and commands that break it off."""

    @classmethod
    def read(cls, path: str | Path, plan: Plan) -> History:
        """From a file of events, a JSON object a line (``events.jsonl`` of a run folder, or ``fly --json``).

        Raises `ReportError` when it cannot be read or is of another plan's flight.
        """
        failovers: dict[str, int] = {}
        result: Mapping[str, Any] | None = None
        flown: set[str] = set()
        told: list[str] = []
        for event in _events(path):
            if event.kind is EventKind.LINK:
                station = str(event.data.get("station"))
                failovers[station] = failovers.get(station, 0) + 1
            elif event.kind is EventKind.OPERATOR_COMMAND and event.data.get("word") in ("abort", "land"):
                told.append(f"'{event.data['word']}' was commanded")
            elif event.kind is EventKind.REPLANNED:
                flown.add(str(event.data.get("before")))
            elif event.kind is EventKind.RESULT:
                result = event.data
                flown.add(str(event.data.get("plan_sha256")))
        if flown and plan.plan_sha256 not in flown:
            raise ReportError(f"events {path} are of a flight of another plan ({min(flown)[:16]})")
        if result is not None and result.get("outcome") not in (None, "completed"):
            told.append(f"it ended as {result['outcome']}")
        return cls(failovers, None if result is None else result.get("lateness"), tuple(dict.fromkeys(told)))


def _events(path: str | Path) -> Iterator[FlightEvent]:
    """The events of a file in order. A last line cut short, by a full disk or a killed process, is left out."""
    try:
        lines = Path(path).read_bytes().split(b"\n")[:-1]
    except OSError as error:
        raise ReportError(f"events {path}: {error.strerror}") from None
    for number, line in enumerate(lines, 1):
        try:
            yield FlightEvent.from_document(json.loads(line))
        except (ValueError, KeyError, TypeError) as error:
            raise ReportError(f"events {path}, line {number}: not an event of a flight ({error!r})") from None
