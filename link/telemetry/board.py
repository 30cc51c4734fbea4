"""Which autopilot board speaks under the vehicle's system id; and whether it is one board, or two.

A system id is a setting, and two vehicles on one field may have the same. What tells boards apart:

- their unique id: uid2, else uid, of AUTOPILOT_VERSION (148), the same in every answer over every link;
- their boot clock: an answer to TIMESYNC (111) shows it exactly within its round trip, messages with a stamp roughly;
  one clock restarts, two go on side by side;
- their sequence numbers: one board sends each of the 256 once before any comes again.

One frame proves nothing but for the unique id, which no other board has: the rest needs both to go on.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import Any

CLOCK_SPLIT_S = 0.5
"""Boot clocks read by TIMESYNC that are further apart than this and their round trips are two."""
LATE_S = 10.0
"""A stamp says when a message left; it may have been on its way for so long."""
CLOCK_MEMORY_S = 6.0
"""A clock that was not heard for so long is over: the board has restarted."""
CLOCK_RUNS_S = 1.0
"""Both clocks must have gone on by so much, and have taken turns `CLOCK_TURNS` times."""
CLOCK_TURNS = 4
SAME_NUMBER_S = 0.5
"""No board sends 256 frames over one link in so short a time, so the same number comes once."""
SAME_WITHIN = 64
"""Nor are fewer frames than this between, even where many come at once after a pause of ours."""
SAME_NUMBERS = 8
"""So many numbers taken twice by different frames within `SEQUENCE_MEMORY_S` are two boards."""
SEQUENCE_MEMORY_S = 3.0
STAMPED = frozenset({"GLOBAL_POSITION_INT", "LOCAL_POSITION_NED", "ATTITUDE", "SYSTEM_TIME"})
"""Messages stamped by the boot clock of the autopilot itself; others carry stamps of sensors and companions."""


def board_id(version: Any) -> str | None:
    """The unique id in an AUTOPILOT_VERSION, as text; None where it tells none."""
    uid2 = bytes(getattr(version, "uid2", ()) or ())
    if any(uid2):
        return "uid2:" + uid2.hex()
    uid = int(version.uid)
    return f"uid:{uid:016x}" if uid else None


@dataclass
class _Clock:
    """A boot clock: where our clock stood at its zero, as bounds, and how far it was seen to go."""

    low_s: float
    high_s: float
    first_s: float
    newest_s: float
    heard_s: float


@dataclass
class _ClockWatch:
    """The boot clocks shown by one kind of message."""

    split_s: float
    clocks: list[_Clock] = field(default_factory=list)
    turns: deque[float] = field(default_factory=lambda: deque(maxlen=CLOCK_TURNS))
    last: _Clock | None = None

    def note(self, now_s: float, boot_s: float, low_s: float, high_s: float) -> bool:
        """Take a reading: zero of the clock was between two times of ours. Whether two clocks go on side by side."""
        self.clocks = [clock for clock in self.clocks if now_s - clock.heard_s <= CLOCK_MEMORY_S]
        found = next(
            (c for c in self.clocks if low_s - self.split_s <= c.high_s and c.low_s <= high_s + self.split_s), None
        )
        if found is None:
            found = _Clock(low_s, high_s, boot_s, boot_s, now_s)
            self.clocks.append(found)
        # The newest bounds: clocks drift apart over an hour.
        found.low_s, found.high_s, found.heard_s = low_s, high_s, now_s
        found.newest_s = max(found.newest_s, boot_s)
        if self.last is not None and found is not self.last:
            self.turns.append(now_s)
        self.last = found
        going = [clock for clock in self.clocks if clock.newest_s - clock.first_s >= CLOCK_RUNS_S]
        often = len(self.turns) == CLOCK_TURNS and now_s - self.turns[0] <= CLOCK_MEMORY_S
        return len(going) >= 2 and often


class BoardWatch:
    """What tells one board from two, in all that is heard of the vehicle's autopilot over all links.

    ``tolerance`` widens the bounds of clocks where a simulation runs faster than the wall's clock.
    """

    def __init__(self, tolerance: float = 1.0) -> None:
        self.answers: dict[str, set[str | None]] = {}
        """Unique ids told, by the URL of the link they came over; None where an answer told none."""
        self.answered_s: dict[str, float] = {}
        """When the last answer came over each link."""
        self.two_boards = ""
        """Why there are two; empty while nothing says so. Once said it stays."""
        self._tolerance = max(1.0, tolerance)
        self._clocks: dict[str, _ClockWatch] = {}
        self._numbers: dict[str, dict[int, tuple[float, int, bytes]]] = {}
        self._counts: dict[str, int] = {}
        self._taken_twice: dict[str, deque[float]] = {}

    @property
    def unique_id(self) -> str | None:
        """The board's unique id; None while none was told, or several were."""
        told = self._told()
        return next(iter(told)) if len(told) == 1 else None

    def _told(self) -> set[str]:
        return {one for answers in self.answers.values() for one in answers if one is not None}

    def on_version(self, now_s: float, url: str, message: Any) -> None:
        """An AUTOPILOT_VERSION over a link."""
        self.answered_s[url] = now_s
        self.answers.setdefault(url, set()).add(board_id(message))
        told = self._told()
        if len(told) > 1:
            self._say(f"unique ids {' and '.join(sorted(told))} answer")

    def on_timesync(self, now_s: float, sent_s: float, vehicle_ns: int) -> None:
        """An answer to a probe of ours that left at ``sent_s``: the vehicle's clock showed ``vehicle_ns`` meanwhile."""
        boot_s = vehicle_ns * 1e-9
        if boot_s <= 0.0 or sent_s > now_s:
            return
        watch = self._clocks.setdefault("TIMESYNC", _ClockWatch(CLOCK_SPLIT_S * self._tolerance))
        if watch.note(now_s, boot_s, sent_s - boot_s, now_s - boot_s):
            self._say("two boot clocks answer in turn")

    def on_frame(self, now_s: float, url: str, message: Any) -> None:
        """Any frame of the autopilot's."""
        self._note_number(now_s, url, message)
        kind = message.get_type()
        boot_ms = getattr(message, "time_boot_ms", None)
        if kind not in STAMPED or not boot_ms:
            return
        boot_s = boot_ms * 1e-3
        watch = self._clocks.setdefault(kind, _ClockWatch(CLOCK_SPLIT_S * self._tolerance))
        if watch.note(now_s, boot_s, now_s - boot_s - LATE_S, now_s - boot_s):
            self._say(f"{kind} carries two boot clocks")

    def _note_number(self, now_s: float, url: str, message: Any) -> None:
        number, frame = message.get_seq(), bytes(message.get_msgbuf() or b"")
        if not frame:
            return
        numbers = self._numbers.setdefault(url, {})
        count = self._counts[url] = self._counts.get(url, 0) + 1
        before = numbers.get(number)
        numbers[number] = (now_s, count, frame)
        if before is None or before[2] == frame or now_s - before[0] > SAME_NUMBER_S or count - before[1] > SAME_WITHIN:
            return
        twice = self._taken_twice.setdefault(url, deque(maxlen=SAME_NUMBERS))
        twice.append(now_s)
        if len(twice) == SAME_NUMBERS and now_s - twice[0] <= SEQUENCE_MEMORY_S:
            self._say("two senders count their frames")

    def _say(self, why: str) -> None:
        if not self.two_boards:
            self.two_boards = why


class SentFrames:
    """Frames that left, so that one that comes back is known as ours.

    A vehicle forwards what it hears to its other links, and a radio may send its own back.
    """

    MEMORY_S = 15.0
    MOST = 8192

    def __init__(self) -> None:
        self._left: dict[bytes, float] = {}

    def sent(self, now_s: float, frame: bytes) -> None:
        """A frame left."""
        self._left[frame] = now_s
        while len(self._left) > self.MOST or now_s - next(iter(self._left.values()), math.inf) > self.MEMORY_S:
            del self._left[next(iter(self._left))]

    def ours(self, frame: bytes) -> bool:
        """Whether this frame left here lately."""
        return frame in self._left
