"""The vehicle's clock by the stamps of its messages: one kind of message with a clock of its own decides nothing.

Every kind that is stamped is a witness of its own: a sensor's driver, or a damaged frame, may stamp by another clock,
once or for ever. So a restart, or a clock set forward, is believed when two witnesses agree and nobody contradicts (or
three do, and fewer contradict): two kinds on one new clock, or one beside a silence of everything, a HEARTBEAT that
boots, or streams that all stopped.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

REBOOT_BACK_S = 3.0
"""A stamp this far behind is no reordering, one this far ahead no jitter."""
AGREE_S = 1.5
"""Two kinds on one clock are this near to each other."""
CONTRADICTED_S = 1.0
"""Whoever was heard on the old clock this lately contradicts a new one, unless a majority has left it:"""
LEAST_MAJORITY = 3
WITNESS_S = 3.0
"""A witness counts for so long."""
SILENCE_S = 1.0
"""Nothing heard for so long before the new clock speaks for a restart."""
KNOWN_S = 30.0
OFFSET_WINDOW_S = 20.0


@dataclass(slots=True)
class _Stray:
    """A kind that is off the clock: its last stamp, when that came, how many came so in a row, since when."""

    boot_s: float
    heard_s: float
    count: int
    since_s: float


class BootClock:
    """Seconds since boot by the kinds of messages that carry them. Times are the flight's clock but for ``boot_s``."""

    def __init__(self) -> None:
        self.reboots = 0
        self.rebooted_s: float | None = None
        """When the last restart was believed."""
        self._newest: tuple[float, float] | None = None
        """The newest stamp on the clock, and when it came."""
        self._kinds: dict[str, tuple[float, float]] = {}
        """The kinds on the clock: each one's newest stamp, and when it came."""
        self._strays: dict[str, _Stray] = {}
        self._confirmed = False
        self._offsets: list[tuple[float, float]] = []
        self._heard: deque[float] = deque(maxlen=2)
        self._gap_s: float | None = None
        self._booting_s: float | None = None

    def heard(self, now_s: float, *, booting: bool = False) -> None:
        """The autopilot spoke, stamped or not; ``booting``: its HEARTBEAT said that it starts up."""
        if self._heard and now_s - self._heard[-1] >= SILENCE_S:
            self._gap_s = now_s
        self._heard.append(now_s)
        if booting:
            self._booting_s = now_s

    def stamp(self, now_s: float, kind: str, boot_s: float) -> bool:
        """Take a stamp; whether it is on the clock and as new as any of its kind."""
        if self._newest is None:
            self._lay(now_s, boot_s)
        if not self._fits(now_s, boot_s):
            self._strays[kind] = self._stray(now_s, kind, boot_s)
            self._judge(now_s, kind)
            return kind in self._kinds and self._kinds[kind] == (boot_s, now_s)
        self._strays.pop(kind, None)
        before = self._kinds.get(kind)
        late = before is not None and boot_s < before[0]
        self._kinds[kind] = (before[0] if before is not None and late else boot_s, now_s)
        self._confirmed = self._confirmed or len(self._kinds) >= 2
        assert self._newest is not None
        if boot_s >= self._newest[0]:
            self._newest = (boot_s, now_s)
            self._note_offset(now_s - boot_s, now_s)
        return not late

    def our_time_s(self, boot_s: float) -> float | None:
        """Our clock when the vehicle's showed ``boot_s``, by the fastest message lately; None before any."""
        return None if not self._offsets else boot_s + min(offset for _, offset in self._offsets)

    def _fits(self, now_s: float, boot_s: float) -> bool:
        assert self._newest is not None
        newest_s, heard_s = self._newest
        gap_s = max(0.0, now_s - heard_s)
        return newest_s + 0.5 * gap_s - REBOOT_BACK_S < boot_s <= newest_s + 1.5 * gap_s + REBOOT_BACK_S

    def _stray(self, now_s: float, kind: str, boot_s: float) -> _Stray:
        before = self._strays.get(kind)
        if before is None or abs((boot_s - before.boot_s) - (now_s - before.heard_s)) > AGREE_S:
            return _Stray(boot_s, now_s, 1, now_s)
        return _Stray(boot_s, now_s, before.count + 1, before.since_s)

    def _judge(self, now_s: float, kind: str) -> None:
        """Whether the vehicle has another clock now."""
        assert self._newest is not None
        one = self._strays[kind]
        agreeing = [
            other
            for other in self._strays.values()
            if other.count >= 2
            and now_s - other.heard_s <= WITNESS_S
            and abs((one.boot_s - other.boot_s) - (one.heard_s - other.heard_s)) <= AGREE_S
        ]
        if not agreeing or one.count < 2:
            return
        # A majority goes: a kind with a clock of its own may stay behind as well as run ahead.
        old = sum(1 for _, heard_s in self._kinds.values() if now_s - heard_s <= CONTRADICTED_S)
        if old and self._confirmed and len(agreeing) <= max(old, LEAST_MAJORITY - 1):
            return
        back = one.boot_s < self._newest[0] + 0.5 * (now_s - self._newest[1])
        if len(agreeing) < 2 and not self._second_witness(now_s, one, back=back):
            return
        if back:
            self.reboots += 1
            self.rebooted_s = now_s
        self._lay(now_s, one.boot_s)
        for name, stray in self._strays.items():
            if self._fits(stray.heard_s, stray.boot_s) or stray in agreeing:
                self._kinds[name] = (stray.boot_s, stray.heard_s)
        self._strays.clear()

    def _second_witness(self, now_s: float, one: _Stray, *, back: bool) -> bool:
        """What speaks for a new clock beside the one kind that shows it."""
        since_s = one.since_s - WITNESS_S
        silence = self._gap_s is not None and self._gap_s >= since_s
        booting = back and self._booting_s is not None and self._booting_s >= since_s
        heard = [heard_s for _, heard_s in self._kinds.values() if now_s - heard_s <= KNOWN_S]
        stopped = len(heard) >= 2 and now_s - max(heard) > WITNESS_S
        return silence or booting or stopped

    def _lay(self, now_s: float, boot_s: float) -> None:
        self._newest = (boot_s, now_s)
        self._kinds.clear()
        self._confirmed = False
        self._offsets = [(now_s, now_s - boot_s)]

    def _note_offset(self, offset: float, now_s: float) -> None:
        if not self._offsets or now_s - self._offsets[-1][0] > OFFSET_WINDOW_S:
            self._offsets = [*self._offsets[-1:], (now_s, offset)]
        elif offset < self._offsets[-1][1]:
            self._offsets[-1] = (self._offsets[-1][0], offset)
