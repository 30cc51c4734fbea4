"""What both autopilots read from a set-point in the same way. Bit set in ``type_mask`` means ignore."""

from __future__ import annotations

import math

from sitl_fixtures.dynamics.guidance import Vector
from sitl_fixtures.mavlink.wire import Message

IGNORE_YAW = 0x400


def wanted_yaw_rad(message: Message) -> float | None:
    """The yaw asked for, rad; None when there is none."""
    if message.type_mask & IGNORE_YAW or not math.isfinite(message.yaw):
        return None
    return float(message.yaw)


def turn(vector: Vector, yaw_rad: float) -> Vector:
    """Forward, right, down to north, east, down."""
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    return vector[0] * cos - vector[1] * sin, vector[0] * sin + vector[1] * cos, vector[2]
