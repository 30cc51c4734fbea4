"""A fault of ours is contained: the tick it happens in holds, an alarm says so, the flight goes on by what is sound.

Three ticks in a row that fail are no accident: the fault goes on to the caller, and silence is the answer.
"""

from __future__ import annotations

import math
import traceback
from collections.abc import Iterator
from contextlib import contextmanager

from link.session.timeline import Timeline

MOST_IN_A_ROW = 3
"""So many ticks in a row with a fault, and it is passed on."""
AGAIN_S = 10.0
FAULT = "a fault of ours"


class Containment:
    """Counts faults and tells them, each place in the code at most every `AGAIN_S`."""

    def __init__(self, timeline: Timeline) -> None:
        self._timeline = timeline
        self._in_a_row = 0
        self._told_s: dict[str, float] = {}
        self.faults = 0
        """All so far."""
        self.held = False
        """Whether the last tick failed."""

    @contextmanager
    def tick(self) -> Iterator[None]:
        """Around one tick's work. Raises what was raised in it, the third time in a row."""
        self.held = False
        try:
            yield
        except Exception as fault:
            self._in_a_row += 1
            self._tell("a tick", fault)
            if self._in_a_row >= MOST_IN_A_ROW:
                raise
            self.held = True
        else:
            self._in_a_row = 0

    @contextmanager
    def of(self, what: str) -> Iterator[None]:
        """Around work beside the tick: what it raises is told, and that is all."""
        try:
            yield
        except Exception as fault:
            self._tell(what, fault)

    def _tell(self, what: str, fault: Exception) -> None:
        self.faults += 1
        last = traceback.extract_tb(fault.__traceback__)[-1]
        where = f"{last.filename.rpartition('/')[2]}:{last.lineno}"
        if self._timeline.now_s - self._told_s.get(where, -math.inf) >= AGAIN_S:
            self._told_s[where] = self._timeline.now_s
            self._timeline.alarm(FAULT, doing=what, fault=repr(fault), where=where, in_a_row=self._in_a_row)
