"""One flight a link, and one flight a vehicle: locks held for as long as a streamer lives.

Two streamers on one link would both be obeyed (PX4 does not look at the sender), and no gate spans two processes. A
link is locked by where it leads, not by how its URL is spelt; a vehicle by what its autopilot says it is. All programs
of this machine meet at these locks (`link.transport.machine_lock`).
"""

from __future__ import annotations

import os
import socket
from collections.abc import Iterable

from link.errors import EndpointError
from link.transport.machine_lock import Holder, MachineLock
from link.transport.url import parse_url

PLACES = 16
"""So many vehicles with one system id, each with a unique id, are flown by one machine at once."""


class LinkLocks:
    """Locks on links. Raises `EndpointError` when another flight holds one, and holds none then."""

    def __init__(self, urls: Iterable[str]) -> None:
        self._locks: dict[str, MachineLock] = {}
        for url in dict.fromkeys(urls):
            for place in places(url):
                if place in self._locks:
                    continue
                taken = MachineLock.take(f"link {place}")
                if isinstance(taken, Holder):
                    self.release()
                    raise EndpointError(
                        f"{url}: another flight on this machine uses this link ({taken.text}); end it first"
                    )
                self._locks[place] = taken

    def release(self) -> None:
        """Let go."""
        for lock in self._locks.values():
            lock.release()
        self._locks.clear()


class VehicleLock:
    """The vehicle of a flight, held against every other program of this machine.

    ``realm`` sets flights apart that are none of this world's: those of tests.
    """

    def __init__(self, realm: str = "") -> None:
        self._realm = realm
        self._held: dict[str, MachineLock] = {}

    def claim(self, system_id: int, unique_id: str | None) -> str:
        """Hold the vehicle that says it is this; who has it, or empty: it is ours.

        One that tells a unique id is held by that, and takes a place under its system id. One that tells none may be
        any with its system id, so it needs all places.
        """
        names = [f"vehicle of system {system_id}, place {k}" for k in range(PLACES)]
        try:
            if unique_id is not None:
                taken_by = self._take([f"vehicle {unique_id} as system {system_id}"])
                if taken_by or any(name in self._held for name in names):
                    return taken_by
                others = ""
                for name in names:
                    others = self._take([name])
                    if not others:
                        return ""
                self.release()
                return others
            taken_by = self._take(names)
        except OSError as error:
            taken_by = f"no lock can be had on this machine ({error})"
        if taken_by:
            self.release()
        return taken_by

    def _take(self, names: list[str]) -> str:
        """All of some locks; who has one of them."""
        for name in names:
            if name in self._held:
                continue
            taken = MachineLock.take(self._realm + name)
            if isinstance(taken, Holder):
                return taken.text
            self._held[name] = taken
        return ""

    def release(self) -> None:
        """Let go."""
        for lock in self._held.values():
            lock.release()
        self._held.clear()


def places(url: str) -> tuple[str, ...]:
    """Where a link leads, the same for every spelling of it; several for a name with several addresses.

    Raises `EndpointUrlError`. A host that is not known stands for itself.
    """
    parsed = parse_url(url)
    if parsed.scheme == "serial":
        return (f"serial {os.path.realpath(parsed.host)}",)
    if parsed.scheme == "udpin" and parsed.number == 0:
        return ()
    scheme = parsed.scheme
    try:
        found = socket.getaddrinfo(parsed.host, parsed.number, type=socket.SOCK_DGRAM)
        addresses = sorted({str(one[4][0]).removeprefix("::ffff:") for one in found})
    except OSError:
        addresses = [parsed.host.lower()]
    local = [one for one in addresses if one in ("::1", "0.0.0.0", "::") or one.startswith("127.")]
    if local:
        # `localhost` is 127.0.0.1 and ::1, and a socket bound to any address has them all.
        return (f"{scheme} this machine {parsed.number}",)
    return tuple(f"{scheme} {one} {parsed.number}" for one in addresses)
