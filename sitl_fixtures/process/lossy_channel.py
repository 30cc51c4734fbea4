"""One direction of a lossy link, without any clock or socket of its own, for virtual time and for the proxy.

Every datagram draws its fate from the seed in the order of arrival, so the same traffic meets the same fate.
"""

from __future__ import annotations

import heapq
import math
import random
from dataclasses import dataclass

from sitl_fixtures.errors import ConfigurationError


@dataclass(frozen=True, slots=True)
class Impairment:
    """What a channel does to datagrams.

    Attributes:
        loss: share lost, 0 to 1.
        burst: mean length of a run of losses; 1 means each is lost by itself.
        latency_s: delay of every datagram, s.
        jitter_s: more delay, uniform from 0, s. Datagrams overtake each other.
        duplication: share sent twice.
        reordering: share held back by 50 ms more.
        cuts: (start_s, end_s) spans on the channel's clock when nothing passes.
    """

    loss: float = 0.0
    burst: float = 1.0
    latency_s: float = 0.0
    jitter_s: float = 0.0
    duplication: float = 0.0
    reordering: float = 0.0
    cuts: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        for name, value, high in (
            ("loss", self.loss, 1.0),
            ("duplication", self.duplication, 1.0),
            ("reordering", self.reordering, 1.0),
            ("latency_s", self.latency_s, 60.0),
            ("jitter_s", self.jitter_s, 60.0),
        ):
            if not (math.isfinite(value) and 0.0 <= value <= high):
                raise ConfigurationError(
                    f"--{name.removesuffix('_s')}", value, f"0 to {high:g}", "choose one in that range"
                )
        if not (math.isfinite(self.burst) and self.burst >= 1.0):
            raise ConfigurationError("--burst", self.burst, "1 or more", "choose 1 for single losses")
        for start, end in self.cuts:
            if not start < end:
                raise ConfigurationError("--cut", f"{start:g}-{end:g}", "START-END with START before END", "swap them")


HELD_BACK_S = 0.05


class LossyChannel:
    """One direction of a link.

    ``send`` takes a datagram at a time; ``receive`` gives what has arrived by a time, in order of arrival.
    """

    def __init__(self, impairment: Impairment, seed: int = 0) -> None:
        self.impairment = impairment
        self._random = random.Random(seed)
        self._queue: list[tuple[float, int, bytes]] = []
        self._count = 0
        self._losing = False
        self.sent = self.lost = self.delivered = self.repeated = 0

    def cut(self, now_s: float) -> bool:
        """Whether the channel is cut at a time."""
        return any(start <= now_s < end for start, end in self.impairment.cuts)

    def send(self, data: bytes, now_s: float) -> None:
        """Takes a datagram."""
        self.sent += 1
        # Always the same number of draws, so that a cut does not change the fate of what comes after it.
        fate, again, late, jitter = (self._random.random() for _ in range(4))
        if self._lose(fate) or self.cut(now_s):
            self.lost += 1
            return
        impairment = self.impairment
        at = now_s + impairment.latency_s + jitter * impairment.jitter_s
        if late < impairment.reordering:
            at += HELD_BACK_S
        self._put(at, data)
        if again < impairment.duplication:
            self.repeated += 1
            self._put(at + 0.5 * HELD_BACK_S, data)

    def _lose(self, fate: float) -> bool:
        """A two-state chain: the share lost is as asked, runs are ``burst`` long on average."""
        loss, burst = self.impairment.loss, self.impairment.burst
        if loss <= 0.0 or loss >= 1.0:
            return loss >= 1.0
        stop = 1.0 / burst
        start = min(1.0, loss * stop / (1.0 - loss))
        if burst == 1.0:
            return fate < loss
        self._losing = fate >= stop if self._losing else fate < start
        return self._losing

    def _put(self, at_s: float, data: bytes) -> None:
        self._count += 1
        heapq.heappush(self._queue, (at_s, self._count, data))

    def receive(self, now_s: float) -> list[bytes]:
        """Datagrams that have arrived by now; those on their way into a cut are lost."""
        found = []
        while self._queue and self._queue[0][0] <= now_s:
            at, _, data = heapq.heappop(self._queue)
            if self.cut(at):
                self.lost += 1
                continue
            self.delivered += 1
            found.append(data)
        return found

    def next_event_s(self) -> float:
        """When the next datagram arrives; infinity when none is under way."""
        return self._queue[0][0] if self._queue else math.inf
