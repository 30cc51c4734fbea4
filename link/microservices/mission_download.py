"""MAVLink's mission microservice: reading a mission, fence or rally list, and what all transfers share.

`link.microservices.mission_upload` writes them. State machines without I/O: feed them messages and the time, send what
they give back.
"""

from __future__ import annotations

import abc
import enum
from dataclasses import dataclass
from typing import Any, Literal

from link.dialect import mavlink
from link.microservices.mission_item import MISSION, TYPE_NAMES, MissionItem


class TransferState(enum.Enum):
    """Where a transfer stands."""

    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"


Holds = Literal["unchanged", "unknown"]


@dataclass(frozen=True)
class TransferFailure:
    """Why a transfer ended without success. ``vehicle_holds``: its old list, or nobody knows what."""

    reason: Literal["silent", "refused", "busy", "different", "unreadable", "cancelled"]
    message: str
    vehicle_holds: Holds


@dataclass(frozen=True)
class Timing:
    """Patience of a transfer. The defaults follow the MAVLink guide, with more tries for what a bad link needs."""

    start_s: float = 1.5
    """Between tries of the message that opens an exchange."""
    start_tries: int = 6
    item_s: float = 0.25
    stalled_s: float = 10.0
    """Without any progress for so long an exchange is given up; longer than any vehicle's own patience."""
    attempts: int = 4
    """Whole uploads tried before it counts as failed."""
    settle_s: float = 1.0
    """Silence between exchanges."""
    busy_s: float = 3.0
    """Pause before asking a vehicle again that was busy with another transfer."""


class MissionTransfer(abc.ABC):
    """What uploads, downloads and clears have in common.

    ``target`` is the vehicle's (system, component), ``station`` our own: messages for other stations are not ours.
    """

    def __init__(
        self,
        *,
        target: tuple[int, int],
        station: tuple[int, int],
        mission_type: int = MISSION,
        timing: Timing | None = None,
    ) -> None:
        self.target = target
        self.station = station
        self.mission_type = mission_type
        self.timing = timing if timing is not None else Timing()
        self.state = TransferState.RUNNING
        self.failure: TransferFailure | None = None
        self.deadline_s = float("inf")
        self._outgoing: list[Any] = []

    @property
    def what(self) -> str:
        """What is transferred, in words."""
        return TYPE_NAMES.get(self.mission_type, f"list {self.mission_type}")

    @property
    def running(self) -> bool:
        """Whether it still needs messages and time."""
        return self.state is TransferState.RUNNING

    def take_outgoing(self) -> list[Any]:
        """Messages to send now, in order; each is handed out once."""
        outgoing, self._outgoing = self._outgoing, []
        return outgoing

    def receive(self, message: Any, now_s: float) -> None:
        """Any message from the link; those that do not concern this transfer are ignored."""
        if not self.running or not message.get_type().startswith("MISSION_"):
            return
        source = (message.get_srcSystem(), message.get_srcComponent())
        if source != self.target or getattr(message, "mission_type", None) != self.mission_type:
            return
        if getattr(message, "target_system", 0) not in (0, self.station[0]):
            return
        if getattr(message, "target_component", 0) not in (0, self.station[1]):
            return
        self._receive(message, now_s)

    def step(self, now_s: float) -> None:
        """Let time pass; due at ``deadline_s``, harmless before."""
        if self.running and now_s >= self.deadline_s:
            self._timeout(now_s)

    def cancel(self) -> None:
        """Give up: tells the vehicle (ArduPilot ignores it and waits out its 8 s) and fails as ``cancelled``."""
        if self.running:
            self._send(mavlink.MAVLink_mission_ack_message, mavlink.MAV_MISSION_OPERATION_CANCELLED)
            self._fail("cancelled", f"{self.what}: cancelled")

    def start(self, now_s: float) -> None:
        """Begin. Call once."""
        self._start(now_s)

    @property
    def progress(self) -> float:
        """From 0 to 1, for people."""
        return 1.0 if self.state is TransferState.DONE else self._progress()

    @abc.abstractmethod
    def _start(self, now_s: float) -> None: ...

    @abc.abstractmethod
    def _progress(self) -> float: ...

    @abc.abstractmethod
    def _receive(self, message: Any, now_s: float) -> None: ...

    @abc.abstractmethod
    def _timeout(self, now_s: float) -> None: ...

    def _holds(self) -> Holds:
        return "unchanged"

    def _send(self, kind: Any, *fields: Any) -> None:
        self._outgoing.append(kind(*self.target, *fields, mission_type=self.mission_type))

    def _fail(self, reason: Any, message: str, holds: Holds | None = None) -> None:
        self.failure = TransferFailure(reason, message, holds if holds is not None else self._holds())
        self.state = TransferState.FAILED
        self.deadline_s = float("inf")

    def _done(self) -> None:
        self.state = TransferState.DONE
        self.deadline_s = float("inf")


class MissionDownload(MissionTransfer):
    """Reads a list; when done, ``items`` are the vehicle's (``messages`` as they came)."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.messages: list[Any] = []
        self._count: int | None = None
        self._tries = 0
        self._stalled_at_s = float("inf")

    @property
    def items(self) -> list[MissionItem]:
        """The items read. Raises `MissionItemError` when the vehicle holds one that is none."""
        return [MissionItem.from_message(message) for message in self.messages]

    def _progress(self) -> float:
        return len(self.messages) / self._count if self._count else 0.0

    def _start(self, now_s: float) -> None:
        self._tries = 1
        self._send(mavlink.MAVLink_mission_request_list_message)
        self.deadline_s = now_s + self.timing.start_s

    def _request(self, now_s: float) -> None:
        self._send(mavlink.MAVLink_mission_request_int_message, len(self.messages))
        self.deadline_s = now_s + self.timing.item_s

    def _receive(self, message: Any, now_s: float) -> None:
        kind = message.get_type()
        if kind == "MISSION_COUNT" and self._count is None:
            self._count = int(message.count)
            self._progressed(now_s)
        elif kind == "MISSION_ITEM_INT" and self._count is not None and message.seq == len(self.messages):
            self.messages.append(message)
            self._progressed(now_s)
        elif kind == "MISSION_ACK" and self._count is None and message.type == mavlink.MAV_MISSION_DENIED:
            # Busy with another transfer; it may be over by the next try.
            self.deadline_s = now_s + self.timing.busy_s
        elif kind == "MISSION_ACK" and self._count is None and message.type == mavlink.MAV_MISSION_UNSUPPORTED:
            self._fail("refused", f"{self.what}: the vehicle does not know such lists")

    def _progressed(self, now_s: float) -> None:
        self._stalled_at_s = now_s + self.timing.stalled_s
        if len(self.messages) == self._count:
            self._send(mavlink.MAVLink_mission_ack_message, mavlink.MAV_MISSION_ACCEPTED)
            self._done()
        else:
            self._request(now_s)

    def _timeout(self, now_s: float) -> None:
        if self._count is None:
            if self._tries >= self.timing.start_tries:
                self._fail("silent", f"{self.what}: the vehicle did not answer {self._tries} requests for its list")
                return
            self._tries += 1
            self._send(mavlink.MAVLink_mission_request_list_message)
            self.deadline_s = now_s + self.timing.start_s
        elif now_s >= self._stalled_at_s:
            self._fail("silent", f"{self.what}: no answer to requests for item {len(self.messages)}")
        else:
            self._request(now_s)


@dataclass(frozen=True)
class MissionTraits:
    """How an autopilot takes a mission upload. All measured; see the recordings."""

    keeps_old_after_failure: bool
    """False: items already received have overwritten the old mission; upload again or clear."""
    first_item_is_home: bool
    """Item 0 is the home position, not the first waypoint."""
    keeps_parameters: bool
    """Whether all four parameters of an item come back as sent; ArduPilot keeps those a command uses, narrowed."""
