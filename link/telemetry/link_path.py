"""The link paths between a station and the vehicle, each measured: loss, latency, jitter; and which of them sends.

A station's C2 link may have several paths (two radios, a radio and a satellite terminal). All are listened to, and
every probe goes out over each, so that the one in reserve is proved before it is needed. One alone carries everything
else; when its proof falls behind another's, that one takes over. What comes twice is taken once: messages carry the
vehicle's clock, answers the number of what they answer.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Any

PROBE_MEMORY = 64
PROBE_LOST_S = 1.0
"""A probe unanswered for so long counts as lost."""
PROBES_ENOUGH = 8
FAILOVER_S = 0.4
"""Another path of a station takes over when its latest proof is so much newer: before the autopilot, or a neighbour,
acts."""
IDLE_FAILOVER_S = 2.5
"""The same while the station is probed once a second."""
_SEQUENCE_WINDOW = 100
_FORGET_FRAMES = 1000
_TRIP_MEMORY = 50


@dataclass
class _Probe:
    nonce: int
    sent_s: float
    answered: bool = False


class LinkPath:
    """One path to the vehicle. Times are the flight's clock, minus infinity where nothing came yet."""

    def __init__(self, url: str = "") -> None:
        self.url = url
        self.heard_s = -math.inf
        self.proven_s = -math.inf
        """When the latest frame of ours left that the vehicle has answered over this path: both directions work."""
        self.round_trip_s: float | None = None
        self.jitter_s = 0.0
        """Mean change from one round trip to the next, as RFC 3550 counts it."""
        self.messages = 0
        self._probes: deque[_Probe] = deque(maxlen=PROBE_MEMORY)
        self._trips: deque[float] = deque(maxlen=_TRIP_MEMORY)
        self._last_trip_s: float | None = None
        self._sequence: int | None = None
        self._window = 0
        self._expected = 0.0
        self._received = 0.0

    def heard(self, now_s: float, sequence: int) -> None:
        """The autopilot spoke over this path; ``sequence`` is its frame's number, 0 to 255."""
        self.heard_s = max(self.heard_s, now_s)
        self.messages += 1
        if self._sequence is None:
            self._sequence, self._window, self._expected, self._received = sequence, 1, 1.0, 1.0
            return
        ahead = (sequence - self._sequence) % 256
        behind = 256 - ahead
        if 0 < ahead <= 256 - _SEQUENCE_WINDOW:
            self._sequence = sequence
            self._window = ((self._window << ahead) | 1) & ((1 << _SEQUENCE_WINDOW) - 1)
            self._expected += ahead
            self._received += 1.0
        elif ahead and not self._window >> behind & 1:
            # Late, not lost; what is already marked came twice.
            self._window |= 1 << behind
            self._received += 1.0
        if self._expected > _FORGET_FRAMES:
            self._expected, self._received = 0.5 * self._expected, 0.5 * self._received

    def probed(self, now_s: float, nonce: int) -> None:
        """A probe went out."""
        self._probes.append(_Probe(nonce, now_s))

    def probe_sent_s(self, nonce: int) -> float | None:
        """When the probe of a number went out; None for one this path did not send lately."""
        return next((probe.sent_s for probe in reversed(self._probes) if probe.nonce == nonce), None)

    def answered(self, nonce: int, now_s: float) -> bool:
        """A probe's answer came back over this path; False for one this path did not send, or that was answered."""
        for probe in reversed(self._probes):
            if probe.nonce == nonce:
                if probe.answered:
                    return False
                probe.answered = True
                self.proven_s = max(self.proven_s, probe.sent_s)
                self._note_trip(now_s - probe.sent_s)
                return True
        return False

    def _note_trip(self, trip_s: float) -> None:
        self._trips.append(trip_s)
        self.round_trip_s = trip_s if self.round_trip_s is None else 0.8 * self.round_trip_s + 0.2 * trip_s
        if self._last_trip_s is not None:
            self.jitter_s += (abs(trip_s - self._last_trip_s) - self.jitter_s) / 16.0
        self._last_trip_s = trip_s

    @property
    def latency_s(self) -> float | None:
        """One way, as half of the round trip; None before the first answer."""
        return None if self.round_trip_s is None else 0.5 * self.round_trip_s

    @property
    def least_latency_s(self) -> float:
        """Half of the shortest round trip lately; 0 before the first answer."""
        return 0.5 * min(self._trips, default=0.0)

    @property
    def loss(self) -> float | None:
        """Share of the vehicle's frames that did not come, by their numbers; None before any. Outages of more than 150
        frames are not seen: `round_loss` and ``heard_s`` tell of those."""
        if self._expected <= 0.0:
            return None
        return max(0.0, 1.0 - self._received / self._expected)

    def round_loss(self, now_s: float) -> float | None:
        """Share of the probes of late never answered, lost on the way there or back. None before any."""
        due = [probe for probe in self._probes if probe.answered or now_s - probe.sent_s >= PROBE_LOST_S]
        if not due:
            return None
        return sum(not probe.answered for probe in due) / len(due)

    def quality(self, now_s: float) -> LinkQuality | None:
        """What the last probes say, both directions together; None before enough of them are over."""
        over = sum(now_s - probe.sent_s >= PROBE_LOST_S for probe in self._probes)
        lost = self.round_loss(now_s)
        if over < PROBES_ENOUGH or lost is None or not self._trips:
            return None
        return LinkQuality(lost, sum(self._trips) / len(self._trips), self.jitter_s)

    def to_document(self, now_s: float) -> dict[str, Any]:
        """As JSON."""

        def ms(seconds: float | None) -> float | None:
            return None if seconds is None else round(seconds * 1e3, 1)

        def share(value: float | None) -> float | None:
            return None if value is None else round(value, 4)

        return {
            "url": self.url,
            "heard_s_ago": None if math.isinf(self.heard_s) else round(now_s - self.heard_s, 2),
            "proven_s_ago": None if math.isinf(self.proven_s) else round(now_s - self.proven_s, 2),
            "round_trip_ms": ms(self.round_trip_s),
            "latency_ms": ms(self.latency_s),
            "jitter_ms": ms(None if self.round_trip_s is None else self.jitter_s),
            "loss": share(self.loss),
            "round_loss": share(self.round_loss(now_s)),
        }


@dataclass(frozen=True, slots=True)
class LinkQuality:
    """A link by its probes: share lost (there or back), mean round trip, mean change of it from one to the next."""

    loss: float
    round_trip_s: float
    jitter_s: float
