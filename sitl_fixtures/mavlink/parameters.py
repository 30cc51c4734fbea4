"""The parameter store, with what each autopilot does in its own way.

ArduPilot: every value travels as a float; a set of any type is taken and rounded to the stored type; an answer by name
carries index 65535. PX4: an INT32 travels as its bits inside the float; a set of the wrong type is dropped in silence;
a value out of range, even NaN, is taken; a changed value is broadcast again a little later.
Both: an unknown name gets silence, and a PARAM_VALUE goes to every link.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass

from sitl_fixtures.errors import ConfigurationError

INT8, INT16, INT32, REAL32 = 2, 4, 6, 9
INTEGER_RANGE = {INT8: (-128, 127), INT16: (-32768, 32767), INT32: (-(2**31), 2**31 - 1)}


@dataclass(slots=True)
class Parameter:
    """A value, its MAV_PARAM_TYPE, and its place in the list."""

    name: str
    value: float
    kind: int
    index: int


def float32(value: float) -> float:
    """A number as a 32-bit float holds it."""
    if math.isnan(value) or math.isinf(value):
        return value
    return float(struct.unpack("<f", struct.pack("<f", max(-3.4e38, min(3.4e38, value))))[0])


def bits_of_int(value: int) -> float:
    """The float whose bits are a 32-bit integer."""
    return float(struct.unpack("<f", struct.pack("<i", value))[0])


def int_of_bits(value: float) -> int:
    """The 32-bit integer in the bits of a float."""
    return int(struct.unpack("<i", struct.pack("<f", value))[0])


class ParameterSet:
    """Parameters by name, in order.

    Args:
        table: ``(name, value, kind)`` rows.
        bitwise: integers travel as bits and types are strict (PX4).
    """

    def __init__(self, table: list[tuple[str, float, int]], *, bitwise: bool) -> None:
        self.bitwise = bitwise
        self._by_name = {
            name: Parameter(name, float(value), kind, index) for index, (name, value, kind) in enumerate(sorted(table))
        }
        self._by_index = list(self._by_name.values())
        self._remembered: dict[str, float] = {}

    def __len__(self) -> int:
        return len(self._by_index)

    def __contains__(self, name: str) -> bool:
        return name in self._by_name

    def __getitem__(self, name: str) -> float:
        return self._by_name[name].value

    def find(self, name: str, index: int) -> Parameter | None:
        """A parameter by index when that is not negative, else by name; None when there is none."""
        if index >= 0:
            return self._by_index[index] if index < len(self._by_index) else None
        return self._by_name.get(name)

    def at(self, index: int) -> Parameter:
        """The parameter at a place in the list."""
        return self._by_index[index]

    def wire_value(self, parameter: Parameter) -> float:
        """The value as it travels in PARAM_VALUE."""
        return self.wire_of(parameter, parameter.value)

    def wire_of(self, parameter: Parameter, value: float) -> float:
        """Any value as it would travel for a parameter."""
        return bits_of_int(int(value)) if self.bitwise and parameter.kind == INT32 else float32(value)

    def remember(self) -> None:
        """Keeps the values of now for ``restore``."""
        self._remembered = {parameter.name: parameter.value for parameter in self._by_index}

    def restore(self) -> None:
        """Puts the remembered values back."""
        for name, value in self._remembered.items():
            self._by_name[name].value = value

    def set_from_wire(self, name: str, wire: float, kind: int) -> Parameter | None:
        """Takes a PARAM_SET; the parameter as it now stands, or None when it is to be met with silence."""
        parameter = self._by_name.get(name)
        if parameter is None:
            return None
        if self.bitwise:
            if kind != parameter.kind:
                return None
            parameter.value = float(int_of_bits(wire)) if kind == INT32 else wire
        else:
            if math.isnan(wire) or math.isinf(wire):
                return None
            self._store(parameter, wire)
        return parameter

    def put(self, name: str, value: float) -> None:
        """Sets a value from inside (no broadcast)."""
        self._store(self._by_name[name], value)

    def override(self, text: str) -> None:
        """Takes ``NAME=VALUE`` from the command line.

        Raises:
            ConfigurationError: unknown name or no number.
        """
        name, _, value = text.partition("=")
        if name not in self._by_name:
            close = [known for known in self._by_name if known.startswith(name[:4])][:6]
            raise ConfigurationError(
                "--param",
                text,
                f"NAME=VALUE with a known name ({', '.join(close) or 'none like it'})",
                "check the name",
            )
        try:
            number = float(value)
        except ValueError:
            raise ConfigurationError("--param", text, "NAME=VALUE with a number", "give a number") from None
        if not math.isfinite(number):
            raise ConfigurationError("--param", text, "NAME=VALUE with a finite number", "give a finite number")
        self._store(self._by_name[name], number)

    @staticmethod
    def _store(parameter: Parameter, value: float) -> None:
        if parameter.kind in INTEGER_RANGE:
            low, high = INTEGER_RANGE[parameter.kind]
            parameter.value = float(max(low, min(high, round(value))))
        else:
            parameter.value = float32(value)


Row = tuple[str, float, int]
