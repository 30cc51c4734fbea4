"""Fault injection: the faults asked for, when they act, and what becomes of a message under them.

A fault is asked for as ``NAME[:ARGUMENT][@START[+DURATION]]``. START is in vehicle seconds: ``30`` since boot, ``A30``
since arming, ``T30`` since the first set-point obeyed. Without one the fault's own default holds.
``python -m sitl_fixtures --list-faults`` prints the table.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator

from sitl_fixtures.errors import ConfigurationError
from sitl_fixtures.faults.fault import Acting
from sitl_fixtures.faults.faulty_vehicle import FaultyVehicle
from sitl_fixtures.faults.table import FAULTS
from sitl_fixtures.mavlink.wire import Message

SPECIFICATION = re.compile(
    r"^(?P<name>[a-z0-9-]+)(:(?P<argument>[^@]+))?(@(?P<since>[AT]?)(?P<start>[0-9.]+)(\+(?P<duration>[0-9.]+))?)?$"
)


def parse(specification: str, vehicle: FaultyVehicle) -> Acting:
    """Reads a specification.

    Raises:
        ConfigurationError: an unknown name, a bad argument or a bad time.
    """
    grammar = "NAME[:ARGUMENT][@START[+DURATION]] with a name from --list-faults"
    match = SPECIFICATION.match(specification)
    if match is None:
        raise ConfigurationError("--fault", specification, grammar, "see --list-faults")
    # What scripts call it since the first release.
    name = re.sub(r"^stranger-", "foreign-station-", match["name"])
    fault = FAULTS.get(name)
    if fault is None:
        close = [name for name in FAULTS if name.split("-")[0] == match["name"].split("-")[0]]
        raise ConfigurationError("--fault", specification, grammar, f"did you mean {', '.join(close) or 'another'}?")
    text = match["argument"]
    if text is not None and not fault.argument:
        raise ConfigurationError("--fault", specification, f"{fault.name} without an argument", "leave it out")
    if text is None:
        text = str(fault.default)
    if isinstance(fault.default, float):
        try:
            if not math.isfinite(float(text)):
                raise ValueError
        except ValueError:
            raise ConfigurationError("--fault", specification, f"a number: {fault.argument}", "give one") from None
    since, start_s, duration_s = match["since"], match["start"], match["duration"]
    if start_s is None:
        own = fault.start
        since, start_s = (own[0], own[1:]) if own[0] in "AT" else ("", own)
    try:
        start, duration = float(start_s), fault.duration_s if duration_s is None else float(duration_s)
    except ValueError:
        raise ConfigurationError("--fault", specification, "START and DURATION in seconds", "correct them") from None
    return Acting(fault, vehicle, text, since or "", start, duration)


class FaultSet:
    """The faults of one run; without any, every call is a pass-through."""

    def __init__(self, specifications: tuple[str, ...], vehicle: FaultyVehicle) -> None:
        self._vehicle = vehicle
        self.acting = [parse(text, vehicle) for text in specifications]
        self._incoming: list[Acting] = []
        self._outgoing: list[Acting] = []
        self._frames: list[Acting] = []
        self._steps: list[Acting] = []
        self.first_setpoint_s: float | None = None

    def tick(self, now_s: float, dt: float) -> None:
        """Begins and ends faults, and lets those that act take their step."""
        if not self.acting:
            return
        for acting in self.acting:
            if not acting.over and acting.on != self._due(acting, now_s):
                self._switch(acting, now_s)
        for acting in self._steps:
            assert acting.fault.step is not None
            acting.fault.step(acting, dt)

    def _due(self, acting: Acting, now_s: float) -> bool:
        autopilot = self._vehicle.autopilot
        if acting.on:
            return now_s < acting.began_s + acting.duration_s
        if acting.since == "A":
            return autopilot.armed and now_s >= autopilot.armed_at_s + acting.start_s
        if acting.since == "T":
            return self.first_setpoint_s is not None and now_s >= self.first_setpoint_s + acting.start_s
        return now_s >= acting.start_s

    def _switch(self, acting: Acting, now_s: float) -> None:
        acting.on = not acting.on
        hook = acting.fault.begin if acting.on else acting.fault.end
        if acting.on:
            acting.began_s = now_s
        else:
            acting.over = True
        on = [a for a in self.acting if a.on]
        self._incoming = [a for a in on if a.fault.incoming]
        self._outgoing = [a for a in on if a.fault.outgoing]
        self._frames = [a for a in on if a.fault.frames]
        self._steps = [a for a in on if a.fault.step]
        if hook is not None:
            hook(acting)

    def rebooted(self) -> None:
        """The autopilot starts anew: times since boot begin again, what is over stays over."""
        for acting in self.acting:
            if acting.on:
                acting.began_s -= self._vehicle.time_s
        self.first_setpoint_s = None

    def incoming(self, link: int, message: Message) -> Iterable[Message]:
        """What becomes of a message that came in."""
        if not self._incoming:
            return (message,)
        found = [message]
        for acting in self._incoming:
            assert acting.fault.incoming is not None
            found = [after for before in found for after in acting.fault.incoming(acting, link, before)]
        return found

    def outgoing(self, message: Message) -> Iterable[tuple[Message, float]]:
        """What becomes of a message on its way out: copies, each with a delay in vehicle seconds."""
        if not self._outgoing:
            return ((message, 0.0),)
        found = [(message, 0.0)]
        for acting in self._outgoing:
            assert acting.fault.outgoing is not None
            found = [
                (after, delay + more)
                for before, delay in found
                for after, more in acting.fault.outgoing(acting, before)
            ]
        return found

    @property
    def on_frames(self) -> bool:
        """Whether any fault takes hold of frames now."""
        return bool(self._frames)

    def frames(self, link: int, frame: bytes) -> Iterator[bytes]:
        """What becomes of a frame on a link."""
        found = [frame]
        for acting in self._frames:
            assert acting.fault.frames is not None
            found = [after for before in found for after in acting.fault.frames(acting, link, before)]
        yield from found

    def setpoint_obeyed(self, now_s: float) -> None:
        """The clock of ``T`` times starts with the first one."""
        if self.first_setpoint_s is None:
            self.first_setpoint_s = now_s

    def arming_refusals(self) -> list[str]:
        """Reasons not to arm."""
        return [acting.fault.arming_text for acting in self.acting if acting.on and acting.fault.arming_text]


def listing() -> str:
    """The table of faults as text."""
    lines = [
        "NAME[:ARGUMENT][@START[+DURATION]]; START in vehicle seconds since boot, A since arming, T since launch",
        "",
    ]
    group = ""
    for fault in FAULTS.values():
        if fault.group != group:
            group = fault.group
            lines.append(f"{group}:")
        head = fault.name + (f":{fault.argument}" if fault.argument else "")
        when = f"from {fault.start}" + (f" for {fault.duration_s:g} s" if math.isfinite(fault.duration_s) else "")
        default = f" (default {fault.default:g})" if fault.argument and isinstance(fault.default, float) else ""
        lines.append(f"  {head:34s} {fault.effect}{default}; {when}")
    return "\n".join(lines)
