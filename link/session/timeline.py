"""When and what: the clock of this step, the flight's state, and the events that tell people of it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from gcs.flight import EventKind, FlightEvent, FlightState, advance
from link.clock import UtcScale


def plain(value: Any) -> Any:
    """The same with None for every number that is not finite: events are JSON, and a vehicle may say NaN."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [plain(inner) for inner in value]
    return value


@dataclass
class Timeline:
    """One flight's time and history. ``now_s`` is the flight's clock at this step, ``utc`` what it is for people."""

    utc: UtcScale
    now_s: float = 0.0
    state: FlightState = FlightState.CONNECTING
    launched_s: float | None = None
    """The flight's clock at T+0."""
    events: list[FlightEvent] = field(default_factory=list)
    """Those not yet taken by `take_events`."""
    _sequence: int = 0

    @property
    def t_plus_s(self) -> float | None:
        """Seconds since T+0; None before it."""
        return None if self.launched_s is None else self.now_s - self.launched_s

    def emit(self, kind: EventKind, **data: Any) -> None:
        """Write an event."""
        self._sequence += 1
        t_plus_s = None if self.t_plus_s is None else round(self.t_plus_s, 6)
        utc = self.utc.text(self.now_s)
        self.events.append(
            FlightEvent(self._sequence, kind, round(self.now_s, 6), t_plus_s, utc, self.state, plain(data))
        )

    def alarm(self, what: str, **data: Any) -> None:
        """Something a person must know at once."""
        self.emit(EventKind.ALARM, what=what, **data)

    def become(self, state: FlightState, reason: str = "") -> None:
        """Change the flight's state. Raises `gcs.flight.TransitionError` where that cannot follow."""
        before, self.state = self.state, advance(self.state, state)
        self.emit(EventKind.STATE, **{"from": before.value, "to": state.value, "reason": reason})

    def take_events(self) -> list[FlightEvent]:
        """Events since the last call."""
        events, self.events = self.events, []
        return events
