"""Clocks and deadlines of a flight.

A flight knows one clock: seconds since it was set up, monotonic, scaled by the speed-up in a simulation. It is passed
in everywhere, so that virtual time is just another clock. UTC is for people and files: read once, at the start, it
follows the flight's clock from then on, so that a jump of the wall clock moves nothing.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta

from gcs.timestamps import utc_text

# Counts through a suspended machine (Linux), unlike CLOCK_MONOTONIC: after a suspend the C2 link is lost, and the
# flight must notice.
_BOOTTIME = getattr(time, "CLOCK_BOOTTIME", None)


def _since_boot_s() -> float:
    return time.monotonic() if _BOOTTIME is None else time.clock_gettime(_BOOTTIME)


class FlightClock:
    """The flight's clock over a real one: ``now_s`` is 0 when made and runs ``speedup`` times as fast.

    Raises `ValueError` for a speed-up outside 0.1 to 1000.
    """

    def __init__(self, speedup: float = 1.0, source: Callable[[], float] = _since_boot_s) -> None:
        if not 0.1 <= speedup <= 1000.0:
            raise ValueError(f"speedup is {speedup}, allowed is 0.1 to 1000")
        self.speedup = speedup
        self._source = source
        self._start = source()

    def now_s(self) -> float:
        """Seconds of the flight's clock."""
        return (self._source() - self._start) * self.speedup

    def wait_s(self, deadline_s: float) -> float:
        """Real seconds from now until ``deadline_s`` of the flight's clock; 0 when it has passed."""
        return max(0.0, (deadline_s - self.now_s()) / self.speedup)


class PacedClock(FlightClock):
    """The clock of a sped-up flight, which keeps pace with a simulator on the same machine.

    A stall of 50 ms that nobody notices in real time is 2.5 s of a flight at fifty times the speed. So this clock
    slips where a real one would jump (`MAX_STEP_S` at a time), and waits for the vehicle's: it runs no more than
    `LEAD_S` past where that should be by what was heard of it (carried on for `CARRY_S`, longer than telemetry pauses),
    for at most `PATIENCE_REAL_S` of silence, after which the silence is the vehicle's. The simulator does the same
    towards its ground stations. A busy machine then makes a simulated flight slower, not worse. Never used with a real
    vehicle: at speed-up 1 there is nothing to pace.
    """

    MAX_STEP_S = 0.25
    LEAD_S = 0.15
    CARRY_S = 0.6
    PATIENCE_REAL_S = 1.0

    def __init__(self, speedup: float, source: Callable[[], float] = _since_boot_s) -> None:
        super().__init__(speedup, source)
        self._real = self._start
        self._now = 0.0
        self._vehicle_s = 0.0
        self._boot_s = -math.inf
        self._offset_s = math.inf
        self._heard_real = self._start - self.PATIENCE_REAL_S
        self._held = False

    def heard(self, boot_s: float | None) -> None:
        """The vehicle has been heard; ``boot_s`` is its own clock, None while it has not told it."""
        self._heard_real = self._source()
        if boot_s is None:
            self._vehicle_s = self._now
            return
        if boot_s < self._boot_s:
            # It has started anew, and so does the comparison.
            self._offset_s = math.inf
        self._boot_s = boot_s
        self._offset_s = min(self._offset_s, self._now - boot_s)
        self._vehicle_s = boot_s + self._offset_s

    def now_s(self) -> float:
        """Seconds of the flight's clock."""
        real = self._source()
        wanted = self._now + min((real - self._real) * self.speedup, self.MAX_STEP_S)
        self._real = real
        silence = real - self._heard_real
        limit = self._vehicle_s + min(silence * self.speedup, self.CARRY_S) + self.LEAD_S
        self._held = wanted > limit and silence < self.PATIENCE_REAL_S
        self._now = max(self._now, limit) if self._held else wanted
        return self._now

    def wait_s(self, deadline_s: float) -> float:
        """Real seconds from now until ``deadline_s``; a moment at least while the vehicle is waited for."""
        wait_s = max(0.0, (deadline_s - self.now_s()) / self.speedup)
        return max(wait_s, 0.0005) if self._held else wait_s


@dataclass(frozen=True)
class UtcScale:
    """What the flight's clock is in UTC: ``epoch_unix_s`` at ``now_s`` = 0."""

    epoch_unix_s: float

    def unix_s(self, now_s: float) -> float:
        """Unix time."""
        return self.epoch_unix_s + now_s

    def text(self, now_s: float) -> str:
        """RFC 3339 in UTC, to the millisecond."""
        instant = datetime.fromtimestamp(0, UTC) + timedelta(seconds=self.unix_s(now_s))
        return utc_text(instant, "milliseconds")


@dataclass(frozen=True)
class Tick:
    """One due tick. ``skipped`` are the ticks before it that were missed and are not caught up.

    ``lateness_s`` is how long after its own deadline the earliest due tick was served.
    """

    index: int
    time_s: float
    skipped: int
    lateness_s: float


class TickGrid:
    """Absolute deadlines ``start_s + k / rate_hz``: no drift, and nothing is ever caught up.

    A served tick is the newest one due, so what is sent for it is less than one period old.
    """

    def __init__(self, rate_hz: float, start_s: float) -> None:
        self.rate_hz = rate_hz
        self.period_s = 1.0 / rate_hz
        self.start_s = start_s
        self._next = 0

    @property
    def deadline_s(self) -> float:
        """When the next tick is due."""
        return self.start_s + self._next / self.rate_hz

    def due(self, now_s: float) -> Tick | None:
        """The newest tick due at ``now_s``; None before the next deadline."""
        first = self.deadline_s
        if now_s < first:
            return None
        index = max(self._next, math.floor((now_s - self.start_s) * self.rate_hz + 1e-9))
        skipped = index - self._next
        self._next = index + 1
        return Tick(index, self.start_s + index / self.rate_hz, skipped, now_s - first)


LATENESS_EDGES_MS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0)


@dataclass
class TickLateness:
    """Histogram of how late ticks were served after their deadlines, in real milliseconds; the last bin is everything
    above."""

    counts: list[int] = field(default_factory=lambda: [0] * (len(LATENESS_EDGES_MS) + 1))
    worst_ms: float = 0.0
    skipped: int = 0

    def add(self, lateness_s: float, skipped: int = 0) -> None:
        """Count one tick."""
        late_ms = lateness_s * 1e3
        index = 0
        while index < len(LATENESS_EDGES_MS) and late_ms > LATENESS_EDGES_MS[index]:
            index += 1
        self.counts[index] += 1
        self.worst_ms = max(self.worst_ms, late_ms)
        self.skipped += skipped

    def quantile_ms(self, q: float) -> float:
        """Upper edge of the bin that holds the ``q`` quantile (the worst value in the last bin); 0 when empty."""
        total = sum(self.counts)
        if not total:
            return 0.0
        seen = 0
        for index, count in enumerate(self.counts):
            seen += count
            if seen >= q * total:
                return min(LATENESS_EDGES_MS[index], self.worst_ms) if index < len(LATENESS_EDGES_MS) else self.worst_ms
        return self.worst_ms

    def to_document(self) -> dict[str, object]:
        """Counts by upper edge in ms, the worst, and the ticks skipped."""
        edges = [*(f"{edge:g}" for edge in LATENESS_EDGES_MS), "more"]
        return {
            "counts_by_ms": {edge: count for edge, count in zip(edges, self.counts, strict=True) if count},
            "p50_ms": self.quantile_ms(0.5),
            "p99_ms": self.quantile_ms(0.99),
            "worst_ms": self.worst_ms,
            "skipped_ticks": self.skipped,
        }
