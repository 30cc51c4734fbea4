"""Reading and setting a vehicle's parameters over lossy links.

The parameter protocol had no negative answer for long: an unknown name and a set of the wrong type are both met with
silence, and a set is confirmed only by the PARAM_VALUE that comes back. So everything is asked several times, and
nothing is believed that has not been read back. Silence may be the link's: `Asking` tells how likely that is. Where a
vehicle does say that it has no such parameter (PARAM_ERROR, 345), it is not asked again.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from link.dialect import mavlink
from link.errors import GateClosed, ParameterError
from link.microservices.parameter_value import Encoding, Parameter, read_parameter, write_parameter
from link.transport.gate import ControlGrant

ASK_AGAIN_S = 0.5
ATTEMPTS = 8
MOST_A_STEP = 12
"""Questions in one step."""
UNSURE = 1e-4
"""Where the link alone may have swallowed every answer with more than this probability, silence says nothing."""
MOST_ATTEMPTS = 24


@dataclass
class Asked:
    """A name asked for: ``answer`` once it came; ``denied``: the vehicle says it has no such parameter; ``finished``
    with neither means silence (see `Asking`)."""

    name: str
    grant: ControlGrant
    attempts: int = 0
    next_s: float = -math.inf
    answer: Parameter | None = None
    denied: bool = False
    finished: bool = False


@dataclass(frozen=True)
class Asking:
    """How parameters were asked for: ``attempts`` times each at least, over a link that loses the share ``loss`` of
    questions or answers (None: not measured); ``denied`` are the names the vehicle says it does not have."""

    attempts: int = ATTEMPTS
    loss: float | None = None
    denied: frozenset[str] = frozenset()

    @property
    def unsure(self) -> bool:
        """Whether a parameter without an answer may well be one whose answers were all lost."""
        return self.loss is not None and self.loss**self.attempts > UNSURE


@dataclass
class Setting:
    """A value being set. ``confirmed`` once it was read back; ``finished`` without that means it was not taken."""

    name: str
    value: int | float
    kind: int
    grant: ControlGrant
    attempts: int = 0
    next_s: float = -math.inf
    confirmed: bool = False
    finished: bool = False


class ParameterClient:
    """Parameters of one vehicle. ``send`` is the gate's; ``known`` holds the last value read of each name."""

    def __init__(self, send: Callable[[ControlGrant, Any], object], target_system: int, encoding: Encoding) -> None:
        self._send = send
        self._target = target_system
        self.encoding = encoding
        self.known: dict[str, Parameter] = {}
        self._asked: dict[str, Asked] = {}
        self._settings: dict[str, Setting] = {}

    def read(self, names: Iterable[str], grant: ControlGrant, *, attempts: int = ATTEMPTS) -> list[Asked]:
        """Ask for parameters by name."""
        asked = [Asked(name, grant, attempts=attempts) for name in names]
        self._asked.update({one.name: one for one in asked})
        return asked

    def set(self, name: str, value: int | float, grant: ControlGrant, *, attempts: int = ATTEMPTS) -> Setting:
        """Set a parameter that was read before. Raises `ParameterError` for a name never read, or an unfit value."""
        if name not in self.known:
            raise ParameterError(f"{name} was not read, so its type is not known")
        kind = self.known[name].kind
        write_parameter(name, value, kind, self.encoding, target_system=self._target)
        setting = Setting(name, value, kind, grant, attempts=attempts)
        self._settings[name] = setting
        return setting

    def on_value(self, message: Any) -> Parameter | None:
        """Take a PARAM_VALUE of the vehicle; what it says, None where it cannot be read."""
        try:
            parameter = read_parameter(message, self.encoding)
        except ParameterError:
            return None
        self.known[parameter.name] = parameter
        asked = self._asked.pop(parameter.name, None)
        if asked is not None:
            asked.answer, asked.finished = parameter, True
        setting = self._settings.get(parameter.name)
        if setting is not None and same_value(parameter.value, setting.value):
            setting.confirmed = setting.finished = True
            del self._settings[parameter.name]
        return parameter

    def on_error(self, message: Any) -> None:
        """Take a PARAM_ERROR of the vehicle: a name it does not have is not asked for again."""
        if message.error == mavlink.MAV_PARAM_ERROR_DOES_NOT_EXIST:
            asked = self._asked.pop(str(message.param_id), None)
            if asked is not None:
                asked.denied = asked.finished = True

    def step(self, now_s: float) -> None:
        """Ask again what is due, a few at a time, and give up what was asked often enough."""
        # A burst of fifty questions would overrun a radio's buffer, and be asked again and again.
        due = [asked for asked in self._asked.values() if now_s >= asked.next_s]
        for asked in due[:MOST_A_STEP]:
            if not self._again(now_s, asked, self._asked, self._read_message(asked.name)):
                asked.finished = True
        for setting in list(self._settings.values()):
            if now_s < setting.next_s:
                continue
            message = write_parameter(
                setting.name, setting.value, setting.kind, self.encoding, target_system=self._target
            )
            if not self._again(now_s, setting, self._settings, message):
                setting.finished = True

    def _again(self, now_s: float, one: Asked | Setting, table: Any, message: Any) -> bool:
        if one.attempts > 0:
            try:
                self._send(one.grant, message)
            except GateClosed:
                one.attempts = 0
        if one.attempts <= 0:
            del table[one.name]
            return False
        one.attempts -= 1
        one.next_s = now_s + ASK_AGAIN_S
        return True

    def _read_message(self, name: str) -> Any:
        return mavlink.MAVLink_param_request_read_message(self._target, 1, name.encode(), -1)


def same_value(read: int | float, wanted: int | float) -> bool:
    """Whether a value read back is the one set: equal, or equal as 32-bit floats go."""
    return read == wanted or math.isclose(read, wanted, rel_tol=1e-6, abs_tol=1e-9)
