"""What PX4 makes of a set-point.

A number is used when its ignore bit is clear and it is finite; otherwise it is absent. Position, velocity and
acceleration are each taken while anything of them is there, so one absent axis reaches the controller, which cannot
fly it: it stops, stays in OFFBOARD and says nothing. Wrong frames, nothing left at all, and a force with an
acceleration are refused with a text; what is addressed elsewhere is dropped in silence. Only what is taken holds
OFFBOARD.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from sitl_fixtures.autopilot.setpoint_fields import turn, wanted_yaw_rad
from sitl_fixtures.dynamics.estimator import Estimator
from sitl_fixtures.dynamics.guidance import Vector
from sitl_fixtures.mavlink.wire import Message

LOCAL_NED, BODY_NED = 1, 8
GLOBAL_INT, GLOBAL_RELATIVE_ALT_INT, GLOBAL_TERRAIN_ALT_INT = 5, 6, 11
FORCE = 0x200
NAN: Vector = (math.nan, math.nan, math.nan)


@dataclass(frozen=True, slots=True)
class Target:
    """A set-point as taken: absent numbers are NaN, an absent part is all NaN.

    ``parts`` are position, velocity and acceleration with None for an absent one; ``complete`` says that no NaN is left
    in them.
    """

    position: Vector = NAN
    velocity: Vector = NAN
    accel: Vector = NAN
    yaw_rad: float | None = None
    flyable: bool = True
    parts: tuple[Vector | None, Vector | None, Vector | None] = (None, None, None)
    complete: bool = True

    def describe(self) -> dict[str, object]:
        """For the log of accepted set-points."""
        return {"position": self.position, "velocity": self.velocity, "accel": self.accel, "flyable": self.flyable}


class RefusedError(Exception):
    """A set-point refused with a text."""


def absent(vector: Vector) -> bool:
    """Whether nothing of a part is there."""
    return vector[0] != vector[0] and vector[1] != vector[1] and vector[2] != vector[2]


def _pick(mask: int, shift: int, values: Vector) -> Vector:
    bits = mask >> shift
    return (
        math.nan if bits & 1 else values[0],
        math.nan if bits & 2 else values[1],
        math.nan if bits & 4 else values[2],
    )


def _flyable(position: Vector, velocity: Vector, accel: Vector) -> bool:
    """PX4's own check: north and east of each part together or not at all, every axis driven by something, finite."""
    for part in (position, velocity, accel):
        if math.isnan(part[0]) != math.isnan(part[1]) or any(map(math.isinf, part)):
            return False
    return all(
        not (math.isnan(p) and math.isnan(v) and math.isnan(a))
        for p, v, a in zip(position, velocity, accel, strict=True)
    )


def _target(name: str, message: Message, position: Vector, velocity: Vector, accel: Vector) -> Target:
    if message.type_mask & FORCE and not absent(accel):
        raise RefusedError(f"{name} force not supported")
    if absent(position) and absent(velocity) and absent(accel):
        raise RefusedError(f"{name} invalid")
    parts = tuple(None if absent(part) else part for part in (position, velocity, accel))
    complete = all(part is None or not any(map(math.isnan, part)) for part in parts)
    return Target(
        position,
        velocity,
        accel,
        wanted_yaw_rad(message),
        _flyable(position, velocity, accel),
        (parts[0], parts[1], parts[2]),
        complete,
    )


def local(message: Message, heading_rad: float) -> Target:
    """SET_POSITION_TARGET_LOCAL_NED.

    Raises:
        RefusedError: with the text to send.
    """
    name, mask, frame = "SET_POSITION_TARGET_LOCAL_NED", message.type_mask, message.coordinate_frame
    position = _pick(mask, 0, (message.x, message.y, message.z))
    velocity = _pick(mask, 3, (message.vx, message.vy, message.vz))
    accel = _pick(mask, 6, (message.afx, message.afy, message.afz))
    if frame == BODY_NED:
        position = NAN
        velocity, accel = turn(velocity, heading_rad), turn(accel, heading_rad)
    elif frame != LOCAL_NED:
        raise RefusedError(f"{name} coordinate frame {frame} unsupported")
    return _target(name, message, position, velocity, accel)


def global_int(message: Message, estimate: Estimator, home_alt_m: float) -> Target | None:
    """SET_POSITION_TARGET_GLOBAL_INT; None while there is no origin to project from.

    Raises:
        RefusedError: with the text to send.
    """
    name, mask, frame = "SET_POSITION_TARGET_GLOBAL_INT", message.type_mask, message.coordinate_frame
    if estimate.projection is None or estimate.origin is None:
        return None
    position = NAN
    if mask & 7 != 7:
        if frame == GLOBAL_INT:
            alt = message.alt
        elif frame in (GLOBAL_RELATIVE_ALT_INT, GLOBAL_TERRAIN_ALT_INT):
            alt = message.alt + home_alt_m
        else:
            raise RefusedError(f"{name} invalid coordinate frame {frame}")
        # A latitude that does not exist is projected like any other.
        north, east = estimate.projection.to_local(
            math.radians(message.lat_int / 1e7), math.radians(message.lon_int / 1e7)
        )
        position = _pick(mask, 0, (north, east, estimate.origin[2] - alt))
    velocity = _pick(mask, 3, (message.vx, message.vy, message.vz))
    accel = _pick(mask, 6, (message.afx, message.afy, message.afz))
    return _target(name, message, position, velocity, accel)
