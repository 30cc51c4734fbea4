"""One injected fault: what it is, and one at work.

A fault takes hold in up to five places: messages on their way in, messages on their way out, frames on their way out,
the moment it begins or ends, and every step while it acts. The faults themselves are rows of ``table.py`` and
``table_flight.py``, made of the actions of ``actions.py``; ``injection.py`` lets them act.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

from sitl_fixtures.faults.faulty_vehicle import FaultyVehicle
from sitl_fixtures.mavlink.wire import Message

Incoming = Callable[["Acting", int, Message], Iterable[Message]]
Outgoing = Callable[["Acting", Message], Iterable[tuple[Message, float]]]
Frames = Callable[["Acting", int, bytes], Iterable[bytes]]
Hook = Callable[["Acting"], None]
Step = Callable[["Acting", float], None]


@dataclass(frozen=True, slots=True)
class Fault:
    """A fault that can be injected on purpose, not an error of input or program: a row of the table.

    Attributes:
        name: as on the command line.
        group: what it concerns.
        effect: in one line.
        argument: what the argument means; empty when there is none.
        default: the argument when none is given.
        start: when it begins unless told otherwise, like ``T10``.
        duration_s: for how long unless told otherwise.
        incoming, outgoing, frames, begin, end, step: where it takes hold.
        arming_text: a reason not to arm while it acts.
    """

    name: str
    group: str
    effect: str
    argument: str = ""
    default: float | str = 0.0
    start: str = "0"
    duration_s: float = math.inf
    incoming: Incoming | None = None
    outgoing: Outgoing | None = None
    frames: Frames | None = None
    begin: Hook | None = None
    end: Hook | None = None
    step: Step | None = None
    arming_text: str = ""


@dataclass(slots=True)
class Acting:
    """A fault asked for: its argument, its time, and what it remembers."""

    fault: Fault
    vehicle: FaultyVehicle
    text: str
    since: str
    start_s: float
    duration_s: float
    on: bool = False
    over: bool = False
    began_s: float = 0.0
    memory: dict[str, Any] = field(default_factory=dict)

    @property
    def value(self) -> float:
        """The argument as a number."""
        return float(self.text)

    def chance(self, share: float) -> bool:
        """True in a share of the cases, by the run's seed."""
        return self.vehicle.random.random() < share
