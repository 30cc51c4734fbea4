"""Parameter values on the wire: PX4 sends integers as their bits inside the float, ArduPilot as their value.

PARAM_VALUE (22) and PARAM_SET (23) have one float32 for every type. A vehicle says which it means in its
capabilities (AUTOPILOT_VERSION): PARAM_ENCODE_BYTEWISE or PARAM_ENCODE_C_CAST. Bits are read from the frame itself,
since a float32 that is a signalling NaN (INT32 -5,000,000, say) changes when Python widens it.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from typing import Any, Literal

from link.dialect import mavlink
from link.errors import ParameterError

Encoding = Literal["bytewise", "c_cast"]

_INTEGERS: dict[int, tuple[str, str]] = {
    mavlink.MAV_PARAM_TYPE_UINT8: ("<B3x", "UINT8"),
    mavlink.MAV_PARAM_TYPE_INT8: ("<b3x", "INT8"),
    mavlink.MAV_PARAM_TYPE_UINT16: ("<H2x", "UINT16"),
    mavlink.MAV_PARAM_TYPE_INT16: ("<h2x", "INT16"),
    mavlink.MAV_PARAM_TYPE_UINT32: ("<I", "UINT32"),
    mavlink.MAV_PARAM_TYPE_INT32: ("<i", "INT32"),
}
_REAL32 = mavlink.MAV_PARAM_TYPE_REAL32


@dataclass(frozen=True)
class Parameter:
    """One parameter as the vehicle knows it. ``kind`` is its MAV_PARAM_TYPE; integers come as ``int``."""

    name: str
    value: int | float
    kind: int
    index: int = -1
    count: int = 0


def encoding_of(capabilities: int, default: Encoding) -> Encoding:
    """How a vehicle with these capability bits writes integers; ``default`` (its profile's) where it says neither."""
    if capabilities & mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE:
        return "bytewise"
    if capabilities & mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST:
        return "c_cast"
    return default


def read_parameter(message: Any, encoding: Encoding) -> Parameter:
    """The parameter in a PARAM_VALUE.

    Raises `ParameterError` for a type that is not carried in 32 bits, or an integer that is not one.
    """
    kind = int(message.param_type)
    name = str(message.param_id)
    value: int | float = float(message.param_value)
    if kind in _INTEGERS:
        if encoding == "bytewise":
            value = int(struct.unpack(_INTEGERS[kind][0], _value_bytes(message))[0])
        elif not math.isfinite(value) or value != int(value):
            raise ParameterError(f"{name} is {value}, but its type {_INTEGERS[kind][1]} is an integer")
        else:
            value = int(value)
    elif kind != _REAL32:
        raise ParameterError(f"{name} has type {kind}, which PARAM_VALUE cannot carry")
    return Parameter(name, value, kind, int(message.param_index), int(message.param_count))


def write_parameter(
    name: str, value: int | float, kind: int, encoding: Encoding, *, target_system: int, target_component: int = 1
) -> Any:
    """The PARAM_SET that gives a parameter this value; ``kind`` must be the one the vehicle reported.

    PX4 ignores a set of the wrong type without a word, and takes NaN and values out of range: both are refused
    here. Raises `ParameterError`.
    """
    if not 1 <= len(name) <= 16 or not name.isascii():
        raise ParameterError(f"parameter name {name!r} must be 1 to 16 ASCII characters")
    if not math.isfinite(value):
        raise ParameterError(f"{name} = {value}: allowed is a finite number")
    if kind == _REAL32:
        wire = _as_float32(float(value))
        if not math.isfinite(wire):
            raise ParameterError(f"{name} = {value} is beyond float32")
    elif kind in _INTEGERS:
        wire = _integer_on_wire(name, value, kind, encoding)
    else:
        raise ParameterError(f"{name}: type {kind} cannot be set with PARAM_SET")
    return mavlink.MAVLink_param_set_message(target_system, target_component, name.encode(), wire, kind)


def _integer_on_wire(name: str, value: int | float, kind: int, encoding: Encoding) -> float:
    layout, word = _INTEGERS[kind]
    if value != int(value):
        raise ParameterError(f"{name} = {value}: its type {word} takes whole numbers")
    try:
        bits = struct.pack(layout, int(value))
    except struct.error:
        raise ParameterError(f"{name} = {value} does not fit {word}") from None
    if encoding == "c_cast":
        wire = _as_float32(float(value))
        if wire != value:
            raise ParameterError(f"{name} = {value} cannot be told apart from {wire:.0f} in float32")
        return wire
    wire = struct.unpack("<f", bits)[0]
    if struct.pack("<f", wire) != bits:
        raise ParameterError(f"{name} = {value}: its bits are a signalling NaN, which cannot be sent")
    return float(wire)


def _as_float32(value: float) -> float:
    try:
        return float(struct.unpack("<f", struct.pack("<f", value))[0])
    except OverflowError:
        return math.inf


def _value_bytes(message: Any) -> bytes:
    """The four bytes of ``param_value``, the first of the payload, as they came."""
    frame = bytes(message.get_msgbuf())
    if not frame:
        return struct.pack("<f", message.param_value)
    header = 10 if frame[0] == mavlink.PROTOCOL_MARKER_V2 else 6
    return frame[header : header + 4]
