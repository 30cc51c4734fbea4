"""A lossy link: a seeded UDP proxy that loses, delays, repeats and reorders datagrams, and cuts out.

It listens for the ground station at one address and speaks to the vehicle at another, with one ``LossyChannel`` each
way.
"""

from __future__ import annotations

import argparse
import contextlib
import select
import signal
import sys
import time

from sitl_fixtures.errors import ConfigurationError, SimulatorError
from sitl_fixtures.process.host import Address, UdpLink
from sitl_fixtures.process.lossy_channel import Impairment, LossyChannel


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
