"""A lossy link: a seeded UDP proxy that loses, delays, repeats and reorders datagrams, and cuts out.

``LossyChannel`` is one direction without any clock or socket of its own, for virtual time. ``python -m
sitl_fixtures.process.proxy`` is the process: it listens for the ground station at one address and speaks to the vehicle
at another, with one channel each way.

Every datagram draws its fate from the seed in the order of arrival, so the same traffic meets the same fate.
"""

from __future__ import annotations

import argparse
import contextlib
import heapq
import math
import random
import select
import signal
import sys
import time
from dataclasses import dataclass

from sitl_fixtures.errors import ConfigurationError, SimulatorError
from sitl_fixtures.process.host import Address, UdpLink


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


class Proxy:
    """The process: two sockets, two channels."""

    def __init__(self, listen: Address, target: Address, up: LossyChannel, down: LossyChannel) -> None:
        self._ground = UdpLink(listen)
        try:
            self._vehicle = UdpLink(target)
        except ConfigurationError:
            self._ground.socket.close()
            raise
        self._up, self._down = up, down
        self._stop = False

    def stop(self, *_: object) -> None:
        """Ends ``run`` at the next round; fit for a signal handler."""
        self._stop = True

    def close(self) -> None:
        """Closes the sockets."""
        self._ground.socket.close()
        self._vehicle.socket.close()

    def run(self, duration_s: float | None = None) -> None:
        """Relays until stopped, or for a number of seconds; the channels' clocks start now."""
        start = time.monotonic()
        sockets = [self._ground.socket, self._vehicle.socket]
        while not self._stop:
            now = time.monotonic() - start
            if duration_s is not None and now >= duration_s:
                return
            for _, data in self._ground.receive():
                self._up.send(data, now)
            for _, data in self._vehicle.receive():
                self._down.send(data, now)
            for data in self._up.receive(now):
                self._vehicle.send(data)
            for data in self._down.receive(now):
                self._ground.send(data)
            wait = min(self._up.next_event_s(), self._down.next_event_s(), now + 0.1) - now
            if wait > 0.0:
                with contextlib.suppress(InterruptedError):
                    select.select(sockets, [], [], wait)


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = argparse.ArgumentParser(prog="sitl_fixtures.process.proxy", description="A lossy UDP link, seeded.")
    made.add_argument("--listen", required=True, metavar="udpin:HOST:PORT", help="where the ground station speaks to")
    made.add_argument("--target", required=True, metavar="udpout:HOST:PORT", help="where the vehicle listens")
    made.add_argument("--loss", type=float, default=0.0, help="share of datagrams lost, each way")
    made.add_argument("--burst", type=float, default=1.0, help="mean length of a run of losses")
    made.add_argument("--latency", type=float, default=0.0, metavar="S")
    made.add_argument("--jitter", type=float, default=0.0, metavar="S")
    made.add_argument("--duplication", type=float, default=0.0, help="share sent twice")
    made.add_argument("--reordering", type=float, default=0.0, help="share held back")
    made.add_argument("--cut", action="append", default=[], metavar="START-END", help="seconds when nothing passes")
    made.add_argument("--seed", type=int, default=0)
    made.add_argument("--duration", type=float, metavar="S")
    return made


def _cut(text: str) -> tuple[float, float]:
    start, _, end = text.partition("-")
    try:
        return float(start), float(end)
    except ValueError:
        raise ConfigurationError("--cut", text, "START-END in seconds", "write it like 10-12.5") from None


def main(arguments: list[str] | None = None) -> int:
    """Runs the proxy; the exit code is 2 for options that cannot be used."""
    options = parser().parse_args(arguments)
    try:
        impairment = Impairment(
            options.loss,
            options.burst,
            options.latency,
            options.jitter,
            options.duplication,
            options.reordering,
            tuple(_cut(text) for text in options.cut),
        )
        up, down = LossyChannel(impairment, 2 * options.seed), LossyChannel(impairment, 2 * options.seed + 1)
        proxy = Proxy(Address.parse(options.listen), Address.parse(options.target), up, down)
    except SimulatorError as error:
        sys.stderr.write(f"error: {error}\n")
        return 2
    signal.signal(signal.SIGINT, proxy.stop)
    signal.signal(signal.SIGTERM, proxy.stop)
    sys.stdout.write(f"ready proxy {options.listen} {options.target}\n")
    sys.stdout.flush()
    try:
        proxy.run(options.duration)
    finally:
        proxy.close()
    sys.stdout.write(
        f"up: {up.delivered} of {up.sent} delivered, {up.repeated} twice; "
        f"down: {down.delivered} of {down.sent} delivered, {down.repeated} twice\n"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
