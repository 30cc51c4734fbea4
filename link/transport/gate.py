"""The transmitter gate: the only door to a link, open for one station at a time.

No stock autopilot enforces who is in control (PX4 does not look at the sender of a setpoint at all), so we are the
arbiter. Every grant of control has a number, one higher than the last; whoever sends shows the grant it was given,
and an old one opens nothing, however late its holder wakes up. Control traffic is everything but two
things that command nothing and have doors of their own:

- heartbeats, from the station in control, and from the next one while control is being moved (control and
  heartbeats move together: ArduPilot's ground-station failsafe counts the heartbeats of the station it obeys alone);
- TIMESYNC probes, from any station, which prove a link both ways before it is needed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from link.errors import GateClosed

Encode = Callable[[Any], bytes]

_AS_VEHICLE = "!"
_HEARTBEAT = 0
_TIMESYNC = 111


@dataclass(frozen=True, slots=True)
class Sender:
    """Who speaks over a station's link: the station, or we with the vehicle's own system id (``as_vehicle``).

    As text, in events and messages, the second is the station's id with an exclamation mark behind it.
    """

    station_id: str
    as_vehicle: bool = False

    def __str__(self) -> str:
        return self.station_id + (_AS_VEHICLE if self.as_vehicle else "")

    @classmethod
    def from_text(cls, text: str) -> Sender:
        """From ``str`` of it."""
        return cls(text.removesuffix(_AS_VEHICLE), text.endswith(_AS_VEHICLE))


@dataclass(frozen=True)
class ControlGrant:
    """Proof that control was given: the grant's number, and who may send under it."""

    number: int
    sender: Sender

    @property
    def station_id(self) -> str:
        """The station whose link it is for."""
        return self.sender.station_id


@dataclass
class GateStats:
    """Frames let through by door, and those turned away."""

    control: int = 0
    heartbeats: int = 0
    probes: int = 0
    blocked: int = 0


class TransmitterGate:
    """Who may send. ``encoders`` maps each station id to what turns a message into its frame (its codec).

    ``as_vehicle`` does so for frames that carry the vehicle's own id over that station's link. Raises `KeyError` for a
    sender it was given no encoder for.
    """

    def __init__(self, encoders: Mapping[str, Encode], as_vehicle: Mapping[str, Encode] | None = None) -> None:
        self._encoders = {Sender(station_id): encode for station_id, encode in encoders.items()}
        for station_id, encode in (as_vehicle or {}).items():
            self._encoders[Sender(station_id, as_vehicle=True)] = encode
        self._grant: ControlGrant | None = None
        self._number = 0
        self._incoming: str | None = None
        self._outgoing: list[tuple[Sender, bytes]] = []
        self.stats = GateStats()

    @property
    def in_force(self) -> ControlGrant | None:
        """The grant in force, None while nobody is in control."""
        return self._grant

    @property
    def holder(self) -> str | None:
        """The station in control, under its own id or the vehicle's; None while nobody is."""
        return None if self._grant is None else self._grant.station_id

    @property
    def incoming(self) -> str | None:
        """The station control is being moved to or from, which may send heartbeats beside the holder."""
        return self._incoming

    def grant(self, station_id: str, *, as_vehicle: bool = False) -> ControlGrant:
        """Give control to ``station_id`` and take it from everybody else, at once."""
        sender = Sender(station_id, as_vehicle)
        if sender not in self._encoders:
            raise KeyError(f"no such station: {str(sender)!r}")
        self._number += 1
        self._grant = ControlGrant(self._number, sender)
        return self._grant

    def revoke(self) -> None:
        """Nobody is in control: silence."""
        self._number += 1
        self._grant = None
        self._incoming = None

    def accompany(self, station_id: str | None) -> None:
        """Let ``station_id`` send heartbeats beside the holder while control moves; None ends it."""
        if station_id is not None and Sender(station_id) not in self._encoders:
            raise KeyError(f"no such station: {station_id!r}")
        self._incoming = station_id

    def admits(self, grant: ControlGrant | None) -> bool:
        """Whether ``grant`` is the one in force."""
        return grant is not None and grant == self._grant

    def send(self, grant: ControlGrant | None, message: Any, *, sender: Sender | None = None) -> bytes:
        """Send control traffic under ``grant``; the frame that went out. Raises `GateClosed` for an old grant.

        ``sender``: the other voice of the same station's link, where the frame is to carry another id than the grant's;
        anybody else's is no door.
        """
        if grant is None or not self.admits(grant):
            self.stats.blocked += 1
            shown = "no grant" if grant is None else f"grant {grant.number} of {grant.sender}"
            held = "nobody is" if self._grant is None else f"{self._grant.sender} ({self._grant.number}) is"
            raise GateClosed(f"{message.get_type()} under {shown} was not sent: {held} in control")
        if sender is not None and sender.station_id != grant.station_id:
            self.stats.blocked += 1
            raise GateClosed(f"{message.get_type()} of {sender} was not sent: {grant.station_id} is in control")
        self.stats.control += 1
        return self._put(grant.sender if sender is None else sender, message)

    def heartbeat(self, station_id: str, message: Any) -> bool:
        """Send a heartbeat of ``station_id``; False, and nothing sent, when it is neither in control nor coming.

        Nor is one sent of a station whose link carries the vehicle's own id: the vehicle is no ground station.
        """
        if message.get_msgId() != _HEARTBEAT:
            raise GateClosed(f"{message.get_type()} is not a heartbeat and was not sent")
        sender = Sender(station_id)
        if self._grant is None or (sender != self._grant.sender and station_id != self._incoming):
            self.stats.blocked += 1
            return False
        self.stats.heartbeats += 1
        self._put(sender, message)
        return True

    def probe(self, station_id: str, message: Any, *, as_vehicle: bool = False) -> None:
        """Send a TIMESYNC of any station, under its own id or the vehicle's."""
        if message.get_msgId() != _TIMESYNC:
            raise GateClosed(f"{message.get_type()} is not a probe and was not sent")
        self.stats.probes += 1
        self._put(Sender(station_id, as_vehicle), message)

    def take_outgoing(self) -> list[tuple[Sender, bytes]]:
        """The frames let through since the last call, in order, each with its sender."""
        outgoing, self._outgoing = self._outgoing, []
        return outgoing

    def _put(self, sender: Sender, message: Any) -> bytes:
        frame = self._encoders[sender](message)
        self._outgoing.append((sender, frame))
        return frame
