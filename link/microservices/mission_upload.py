"""MAVLink's mission microservice: mission, fence and rally lists to and from a vehicle over a bad link.

State machines without I/O. Feed them messages and the time; they give back messages to send and when they want to be
called next::

    transfer.start(now_s)
    loop: send transfer.take_outgoing(); transfer.receive(message, now_s) for each that came;
          transfer.step(now_s) at transfer.deadline_s; until transfer.state is not RUNNING

Every upload and every clear ends with reading the list back and comparing, because acknowledgements prove little:
one that is lost makes a finished upload look failed, an old one makes a failed upload look finished, and ArduPilot
keeps a mixture of old and new after a failure. So `DONE` means that the vehicle holds exactly the list, and `FAILED`
says what it may hold.

What is done about losses: the vehicle asks again for an item it misses (PX4 every 0.25 s; ArduPilot every 1.0 s, and it
gives up after 8 s), which alone would lose two uploads of 200 items in three at 30 % loss. So the station does not
wait to be asked: after 250 ms without a request it repeats the last item and sends the next one as well, whichever
the vehicle misses. An item out of order is harmless to both (ArduPilot answers 13, PX4 asks again).
Between attempts there is silence, so that late copies of an old transfer cannot enter the next.

Source: MAVLink guide, "Mission Protocol"; the recordings for what autopilots make of it.
"""

from __future__ import annotations

import abc
from collections.abc import Sequence
from typing import Any, Literal

from link.dialect import mavlink
from link.errors import MissionItemError
from link.microservices.mission_download import (
    Holds,
    MissionDownload,
    MissionTraits,
    MissionTransfer,
    Timing,
    TransferFailure,
    TransferState,
)
from link.microservices.mission_item import ALTITUDE_TOLERANCE_M, MISSION, RALLY, MissionItem

__all__ = [
    "MissionClear",
    "MissionDownload",
    "MissionItem",
    "MissionTransfer",
    "MissionUpload",
    "Timing",
    "TransferFailure",
    "TransferState",
]

_REQUESTS = ("MISSION_REQUEST", "MISSION_REQUEST_INT")
_RESULTS = {
    mavlink.MAV_MISSION_ERROR: "an error it does not name",
    mavlink.MAV_MISSION_UNSUPPORTED_FRAME: "a coordinate frame it does not support",
    mavlink.MAV_MISSION_UNSUPPORTED: "a command it does not support",
    mavlink.MAV_MISSION_NO_SPACE: "more items than it has room for",
    mavlink.MAV_MISSION_INVALID: "a value that is not valid",
}
_RETRY = (mavlink.MAV_MISSION_ERROR, mavlink.MAV_MISSION_OPERATION_CANCELLED)


def difference(
    expected: Sequence[MissionItem], held: Sequence[MissionItem], traits: MissionTraits, mission_type: int
) -> str:
    """How a vehicle's list differs from the one meant; empty when it does not."""
    first = 0
    if traits.first_item_is_home and mission_type == MISSION:
        # Item 0 is home: the vehicle puts its own there, and keeps it when the list is cleared.
        first = 1
        if not expected and len(held) <= 1:
            return ""
    if len(held) != len(expected):
        return f"the vehicle holds {len(held)} items instead of {len(expected)}"
    strict = traits.keeps_parameters
    # ArduPilot keeps a rally point's altitude in whole metres.
    altitude_m = 1.0 if mission_type == RALLY and not strict else ALTITUDE_TOLERANCE_M
    for index in range(first, len(held)):
        if not expected[index].same_as(held[index], parameters=strict, altitude_tolerance_m=altitude_m):
            return f"item {index} is {held[index]} instead of {expected[index]}"
    return ""


class _Verified(MissionTransfer):
    """A transfer that ends with reading the list back."""

    def __init__(self, expected: Sequence[MissionItem], traits: MissionTraits, **options: Any) -> None:
        super().__init__(**options)
        self.expected = tuple(expected)
        self.traits = traits
        self._attempt = 0
        self._check: MissionDownload | None = None
        self._pause: Literal["attempt", "check", None] = None

    def _start(self, now_s: float) -> None:
        self._begin(now_s)

    @abc.abstractmethod
    def _begin(self, now_s: float) -> None:
        """Start the next attempt."""

    def _settle(self, what: Literal["attempt", "check"], now_s: float, pause_s: float | None = None) -> None:
        self._pause = what
        self._check = None
        self.deadline_s = now_s + (self.timing.settle_s if pause_s is None else pause_s)

    def _again(self, now_s: float, reason: Any, message: str, pause_s: float | None = None) -> None:
        """One attempt is over without success: another, or the end."""
        if self._attempt >= self.timing.attempts:
            self._fail(reason, f"{message} ({self._attempt} attempts)")
        else:
            self._settle("attempt", now_s, pause_s)

    def _checked(self, now_s: float) -> None:
        assert self._check is not None
        try:
            held = self._check.items
        except MissionItemError as error:
            self._again(now_s, "different", f"{self.what}: the vehicle holds something that is no item: {error}")
            return
        difference = self._difference(held)
        if difference:
            self._again(now_s, "different", f"{self.what}: read back, {difference}")
        else:
            self._done()

    def _difference(self, held: list[MissionItem]) -> str:
        return difference(self.expected, held, self.traits, self.mission_type)

    def _receive(self, message: Any, now_s: float) -> None:
        if self._check is not None:
            self._check.receive(message, now_s)
            self._follow_check(now_s)
        elif self._pause is None or (self._pause == "check" and self._goes_on(message)):
            self._pause = None
            self._exchange(message, now_s)

    def _goes_on(self, message: Any) -> bool:
        """Whether the vehicle shows that the exchange taken for finished is not."""
        return False

    @abc.abstractmethod
    def _exchange(self, message: Any, now_s: float) -> None: ...

    @abc.abstractmethod
    def _exchange_timeout(self, now_s: float) -> None: ...

    def _timeout(self, now_s: float) -> None:
        if self._check is not None:
            self._check.step(now_s)
            self._follow_check(now_s)
        elif self._pause == "attempt":
            self._pause = None
            self._begin(now_s)
        elif self._pause == "check":
            self._pause = None
            self._check = MissionDownload(
                target=self.target, station=self.station, mission_type=self.mission_type, timing=self.timing
            )
            self._check.start(now_s)
            self._follow_check(now_s)
        else:
            self._exchange_timeout(now_s)

    def _follow_check(self, now_s: float) -> None:
        check = self._check
        assert check is not None
        self._outgoing += check.take_outgoing()
        self.deadline_s = check.deadline_s
        if check.state is TransferState.DONE:
            self._checked(now_s)
        elif check.failure is not None:
            self._again(now_s, check.failure.reason, f"reading back: {check.failure.message}")


class MissionUpload(_Verified):
    """Writes a list and proves it. For ArduPilot's missions, item 0 stands for home and is not compared.

    Raises `MissionItemError` for a list too long to be counted.
    """

    def __init__(self, items: Sequence[MissionItem], *, traits: MissionTraits, **options: Any) -> None:
        super().__init__(items, traits, **options)
        if len(items) > 0xFFFF:
            raise MissionItemError(f"{len(items)} items, allowed are up to 65535")
        self._reached = -1
        self._count_tries = 0
        self._stalled_at_s = float("inf")
        self._changed = False

    def _progress(self) -> float:
        if self._check is not None:
            return 0.5 + 0.5 * self._check.progress
        return 0.5 * (self._reached + 1) / max(1, len(self.expected))

    def _holds(self) -> Holds:
        return "unknown" if self._changed else "unchanged"

    def _begin(self, now_s: float) -> None:
        self._attempt += 1
        self._reached = -1
        self._count_tries = 0
        self._stalled_at_s = float("inf")
        self._count(now_s)

    def _count(self, now_s: float) -> None:
        self._count_tries += 1
        self._send(mavlink.MAVLink_mission_count_message, len(self.expected))
        self.deadline_s = now_s + self.timing.start_s

    def _item(self, sequence: int) -> None:
        self._outgoing.append(self.expected[sequence].message(sequence, self.mission_type, *self.target))

    def _goes_on(self, message: Any) -> bool:
        return message.get_type() in _REQUESTS

    def _exchange(self, message: Any, now_s: float) -> None:
        kind = message.get_type()
        if kind in _REQUESTS:
            self._requested(int(message.seq), now_s)
        elif kind == "MISSION_ACK":
            self._acknowledged(int(message.type), now_s)

    def _requested(self, sequence: int, now_s: float) -> None:
        if not 0 <= sequence < len(self.expected):
            return
        # From the last item on the list may be in force without our hearing of it; in ArduPilot every item is at once.
        if sequence == len(self.expected) - 1 or not self.traits.keeps_old_after_failure:
            self._changed = True
        if sequence > self._reached:
            self._reached = sequence
            self._stalled_at_s = now_s + self.timing.stalled_s
        elif sequence == 0:
            # It begins anew, or this is a late copy; answering is right for the one and harmless for the other.
            self._reached = 0
        self._item(sequence)
        self.deadline_s = now_s + self.timing.item_s

    def _acknowledged(self, result: int, now_s: float) -> None:
        last = len(self.expected) - 1
        if result == mavlink.MAV_MISSION_ACCEPTED:
            if self._reached >= last:
                self._settle("check", now_s)
        elif result == mavlink.MAV_MISSION_INVALID_SEQUENCE:
            return
        elif result == mavlink.MAV_MISSION_DENIED:
            self._again(now_s, "busy", f"{self.what}: the vehicle is busy with another transfer", self.timing.busy_s)
        elif result in _RETRY:
            if self._reached >= last:
                # No upload is running: it is over, and the answer to the last item was lost.
                self._settle("check", now_s)
            elif self._reached >= 0:
                self._again(now_s, "silent", f"{self.what}: the vehicle gave up waiting for item {self._reached}")
        else:
            why = _RESULTS.get(result, f"result {result}")
            item = f" in item {self._reached}" if self._reached >= 0 else ""
            self._fail("refused", f"{self.what} refused: {why}{item}")

    def _exchange_timeout(self, now_s: float) -> None:
        if self._reached < 0:
            # An unanswered count may have been taken: it empties a list, and ArduPilot cuts its own to that length.
            if not self.expected or not self.traits.keeps_old_after_failure:
                self._changed = True
            if self._count_tries < self.timing.start_tries:
                self._count(now_s)
            elif not self.expected:
                self._settle("check", now_s)
            else:
                self._again(now_s, "silent", f"{self.what}: the vehicle does not ask for the first item")
            return
        last = len(self.expected) - 1
        if now_s >= self._stalled_at_s:
            if self._reached >= last:
                self._settle("check", now_s)
            else:
                self._again(now_s, "silent", f"{self.what}: the vehicle stopped asking at item {self._reached}")
            return
        self._item(self._reached)
        if self._reached < last:
            self._item(self._reached + 1)
            if self._reached + 1 == last:
                self._changed = True
        self.deadline_s = now_s + self.timing.item_s


class MissionClear(_Verified):
    """Empties a list and proves it."""

    def __init__(self, *, traits: MissionTraits, **options: Any) -> None:
        super().__init__((), traits, **options)
        self._tries = 0

    def _progress(self) -> float:
        return 0.5 if self._check is not None else 0.0

    def _holds(self) -> Holds:
        return "unknown"

    def _begin(self, now_s: float) -> None:
        self._attempt += 1
        self._tries = 0
        self._clear(now_s)

    def _clear(self, now_s: float) -> None:
        self._tries += 1
        self._send(mavlink.MAVLink_mission_clear_all_message)
        self.deadline_s = now_s + self.timing.start_s

    def _exchange(self, message: Any, now_s: float) -> None:
        if message.get_type() != "MISSION_ACK":
            return
        if message.type in (mavlink.MAV_MISSION_ACCEPTED, *_RETRY):
            self._settle("check", now_s)
        elif message.type == mavlink.MAV_MISSION_DENIED:
            self._again(now_s, "busy", f"{self.what}: the vehicle is busy with another transfer", self.timing.busy_s)
        else:
            self._fail("refused", f"{self.what}: clearing refused: {_RESULTS.get(message.type, message.type)}")

    def _exchange_timeout(self, now_s: float) -> None:
        if self._tries < self.timing.start_tries:
            self._clear(now_s)
        else:
            # Every answer may have been lost; the list itself tells.
            self._settle("check", now_s)
