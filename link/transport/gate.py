"""The transmitter gate: the only door to a link, open for one station at a time.

No stock autopilot enforces who is in control (PX4 does not look at the sender of a setpoint at all), so we are the
arbiter. Every grant of control has a fencing number, one higher than the last; whoever sends shows the fence it was
given, and an old one opens nothing, however late its holder wakes up. Control traffic is everything but two
things that command nothing and have doors of their own:

- heartbeats, from the station in control, and from the next one while control is being moved (ownership and
  heartbeats move together: ArduPilot's ground-station failsafe counts the owner's heartbeats alone);
- TIMESYNC probes, from any station, which prove a link both ways before it is needed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from link.errors import GateClosed

Encode = Callable[[Any], bytes]

VEHICLE_SPEAKER = "!"
"""Suffix of a station's second encoder, which speaks with the vehicle's own id over that station's link."""
_HEARTBEAT = 0
_TIMESYNC = 111


@dataclass(frozen=True)
class Fence:
    """Proof of a grant: its number and the station it was given to."""

    number: int
    station_id: str


@dataclass
class GateStats:
    """Frames let through by door, and those turned away."""

    control: int = 0
    heartbeats: int = 0
    probes: int = 0
    blocked: int = 0


class TransmitterGate:
    """Who may send. ``encoders`` maps each station id to what turns a message into its frame (its codec).

    Raises `KeyError` for a station it was not given.
    """

    def __init__(self, encoders: Mapping[str, Encode]) -> None:
        self._encoders = dict(encoders)
        self._fence: Fence | None = None
        self._number = 0
        self._incoming: str | None = None
        self._outgoing: list[tuple[str, bytes]] = []
        self.stats = GateStats()

    @property
    def holder(self) -> str | None:
        """The station in control, None while nobody is."""
        return None if self._fence is None else self._fence.station_id

    @property
    def fence(self) -> Fence | None:
        """The grant in force."""
        return self._fence

    @property
    def incoming(self) -> str | None:
        """The station control is being moved to or from, which may send heartbeats beside the holder."""
        return self._incoming

    def grant(self, station_id: str) -> Fence:
        """Give control to ``station_id`` and take it from everybody else, at once."""
        if station_id not in self._encoders:
            raise KeyError(f"no such station: {station_id!r}")
        self._number += 1
        self._fence = Fence(self._number, station_id)
        return self._fence

    def revoke(self) -> None:
        """Nobody is in control: silence."""
        self._number += 1
        self._fence = None
        self._incoming = None

    def accompany(self, station_id: str | None) -> None:
        """Let ``station_id`` send heartbeats beside the holder while control moves; None ends it."""
        if station_id is not None and station_id not in self._encoders:
            raise KeyError(f"no such station: {station_id!r}")
        self._incoming = station_id

    def admits(self, fence: Fence | None) -> bool:
        """Whether ``fence`` is the grant in force."""
        return fence is not None and fence == self._fence

    def send(self, fence: Fence | None, message: Any, *, speaker: str | None = None) -> bytes:
        """Send control traffic under ``fence``; the frame that went out. Raises `GateClosed` for an old fence.

        ``speaker``: the other encoder of the same station's link (its id with `VEHICLE_SPEAKER`), where the frame is to
        carry the vehicle's own id; anybody else's is no door.
        """
        if fence is None or not self.admits(fence):
            self.stats.blocked += 1
            shown = "no fence" if fence is None else f"fence {fence.number} of {fence.station_id}"
            held = "nobody is" if self._fence is None else f"{self._fence.station_id} ({self._fence.number}) is"
            raise GateClosed(f"{message.get_type()} under {shown} was not sent: {held} in control")
        station = fence.station_id.removesuffix(VEHICLE_SPEAKER)
        if speaker is not None and speaker.removesuffix(VEHICLE_SPEAKER) != station:
            self.stats.blocked += 1
            raise GateClosed(f"{message.get_type()} of {speaker} was not sent: {station} is in control")
        self.stats.control += 1
        return self._put(fence.station_id if speaker is None else speaker, message)

    def heartbeat(self, station_id: str, message: Any) -> bool:
        """Send a heartbeat of ``station_id``; False, and nothing sent, when it is neither in control nor coming."""
        if message.get_msgId() != _HEARTBEAT:
            raise GateClosed(f"{message.get_type()} is not a heartbeat and was not sent")
        if station_id not in (self.holder, self._incoming) or self._fence is None:
            self.stats.blocked += 1
            return False
        self.stats.heartbeats += 1
        self._put(station_id, message)
        return True

    def probe(self, station_id: str, message: Any) -> None:
        """Send a TIMESYNC of any station."""
        if message.get_msgId() != _TIMESYNC:
            raise GateClosed(f"{message.get_type()} is not a probe and was not sent")
        self.stats.probes += 1
        self._put(station_id, message)

    def take_outgoing(self) -> list[tuple[str, bytes]]:
        """The frames let through since the last call, in order, each with its station."""
        outgoing, self._outgoing = self._outgoing, []
        return outgoing

    def _put(self, station_id: str, message: Any) -> bytes:
        frame = self._encoders[station_id](message)
        self._outgoing.append((station_id, frame))
        return frame
