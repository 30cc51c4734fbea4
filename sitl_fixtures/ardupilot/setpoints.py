"""What ArduCopter makes of a set-point, and the target it keeps in GUIDED.

Bit set in ``type_mask`` means ignore. One ignored axis drops its whole triple. What is left decides: position with
velocity (and acceleration), position alone, velocity (and acceleration), acceleration; anything else is an order to
stop, as are a wrong frame and a latitude that does not exist. Nothing is refused.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from sitl_fixtures.autopilot.setpoint_fields import turn, wanted_yaw_rad
from sitl_fixtures.dynamics.estimator import Estimator
from sitl_fixtures.dynamics.guidance import ZERO, Vector
from sitl_fixtures.mavlink.wire import Message

POSITION, POSITION_VELOCITY, VELOCITY, ACCELERATION, TAKEOFF = (
    "position",
    "position-velocity",
    "velocity",
    "accel",
    "takeoff",
)
MASKS = {POSITION: 0x0DF8, POSITION_VELOCITY: 0x0C00, VELOCITY: 0x0C07, ACCELERATION: 0x0C3F, TAKEOFF: 0x0DF8}

LOCAL_NED, LOCAL_OFFSET_NED, BODY_NED, BODY_OFFSET_NED = 1, 7, 8, 9
AMSL, RELATIVE, TERRAIN = (0, 5), (3, 6), (10, 11)
GLOBAL_FRAMES = (*AMSL, *RELATIVE, *TERRAIN)
IGNORE_POSITION, IGNORE_VELOCITY, IGNORE_ACCEL = 0x007, 0x038, 0x1C0


@dataclass(frozen=True, slots=True)
class Order:
    """A set-point understood; ``kind`` VELOCITY with everything zero is the order to stop."""

    kind: str = VELOCITY
    position: Vector = ZERO
    velocity: Vector = ZERO
    accel: Vector = ZERO
    yaw_rad: float | None = None


STOP = Order()


def _order(mask: int, position: Vector, velocity: Vector, accel: Vector, yaw_rad: float | None) -> Order:
    has_position, has_velocity, has_accel = (
        not mask & IGNORE_POSITION,
        not mask & IGNORE_VELOCITY,
        not mask & IGNORE_ACCEL,
    )
    if has_velocity and not all(map(math.isfinite, velocity)):
        return STOP
    feed = accel if has_accel else ZERO
    if has_position and has_velocity:
        return Order(POSITION_VELOCITY, position, velocity, feed, yaw_rad)
    if has_velocity:
        return Order(VELOCITY, ZERO, velocity, feed, yaw_rad)
    if has_position:
        return STOP if has_accel else Order(POSITION, position, ZERO, ZERO, yaw_rad)
    return Order(ACCELERATION, ZERO, ZERO, accel, yaw_rad) if has_accel else STOP


def local(message: Message, here: Vector, heading_rad: float) -> Order:
    """SET_POSITION_TARGET_LOCAL_NED: frames 1, 7, 8 and 9; the last three are relative to where the vehicle is."""
    frame = message.coordinate_frame
    if frame not in (LOCAL_NED, LOCAL_OFFSET_NED, BODY_NED, BODY_OFFSET_NED):
        return STOP
    position: Vector = (message.x, message.y, message.z)
    velocity: Vector = (message.vx, message.vy, message.vz)
    accel: Vector = (message.afx, message.afy, message.afz)
    if frame in (BODY_NED, BODY_OFFSET_NED):
        position, velocity, accel = (turn(v, heading_rad) for v in (position, velocity, accel))
    if frame != LOCAL_NED:
        position = (position[0] + here[0], position[1] + here[1], position[2] + here[2])
    return _order(message.type_mask, position, velocity, accel, wanted_yaw_rad(message))


def global_int(message: Message, estimate: Estimator, home_alt_m: float) -> Order:
    """SET_POSITION_TARGET_GLOBAL_INT; the acceleration is dropped, terrain with velocity means stop."""
    frame, mask = message.coordinate_frame, message.type_mask
    if frame not in GLOBAL_FRAMES or estimate.projection is None or estimate.origin is None:
        return STOP
    position = ZERO
    if not mask & IGNORE_POSITION:
        lat, lon = message.lat_int / 1e7, message.lon_int / 1e7
        if abs(lat) > 90.0 or abs(lon) > 180.0:
            return STOP
        if frame in TERRAIN and not mask & IGNORE_VELOCITY:
            return STOP
        alt = message.alt if frame in AMSL else message.alt + home_alt_m
        north, east = estimate.projection.to_local(math.radians(lat), math.radians(lon))
        position = (north, east, estimate.origin[2] - alt)
    return _order(mask, position, (message.vx, message.vy, message.vz), ZERO, wanted_yaw_rad(message))


def geodetic(
    lat_deg: float,
    lon_deg: float,
    alt_m: float,
    frame: int | None,
    estimate: Estimator,
    home: tuple[float, float, float] | None,
) -> Vector | None:
    """A place of a command in the local frame; None when it is none."""
    if estimate.projection is None or estimate.origin is None or abs(lat_deg) > 90.0 or abs(lon_deg) > 180.0:
        return None
    base = 0.0 if frame in (None, *AMSL) else (home[2] if home else estimate.origin[2])
    north, east = estimate.projection.to_local(math.radians(lat_deg), math.radians(lon_deg))
    return north, east, estimate.origin[2] - (alt_m + base)


@dataclass(slots=True)
class GuidedTarget:
    """The target of GUIDED and when it was last renewed."""

    kind: str = VELOCITY
    position: Vector = ZERO
    velocity: Vector = ZERO
    accel: Vector = ZERO
    yaw_rad: float | None = None
    renewed_s: float = 0.0
    spoilt: bool = field(default=False)

    def stop(self, now_s: float) -> None:
        """Zero velocity."""
        self.take(STOP, now_s)

    def take_off(self) -> None:
        """While NAV_TAKEOFF climbs the echo says position, all zero."""
        self.kind, self.position, self.velocity, self.accel = TAKEOFF, ZERO, ZERO, ZERO

    def hold_position(self, position: Vector, now_s: float) -> None:
        """A place to be at."""
        self.take(Order(POSITION, position), now_s)

    def take(self, order: Order, now_s: float) -> None:
        """A new order. A NaN or an infinity is taken too, and spoils the controller for good."""
        self.kind, self.position, self.velocity, self.accel = order.kind, order.position, order.velocity, order.accel
        self.yaw_rad = order.yaw_rad
        self.renewed_s = now_s
        if not all(map(math.isfinite, (*self.position, *self.accel))):
            self.spoilt = True

    def run(self, now_s: float, dt: float, timeout_s: float) -> None:
        """Moves the target on with its velocity and acceleration; after the timeout both are zero."""
        if self.kind in (POSITION, TAKEOFF):
            return
        if now_s - self.renewed_s > timeout_s:
            self.velocity = self.accel = ZERO
        if self.kind == POSITION_VELOCITY:
            half = 0.5 * dt * dt
            p, v, a = self.position, self.velocity, self.accel
            self.position = (
                p[0] + v[0] * dt + a[0] * half,
                p[1] + v[1] * dt + a[1] * half,
                p[2] + v[2] * dt + a[2] * half,
            )
            self.velocity = (v[0] + a[0] * dt, v[1] + a[1] * dt, v[2] + a[2] * dt)

    def echo(self) -> tuple[int, Vector, Vector, Vector]:
        """Mask, position, velocity and acceleration of POSITION_TARGET_LOCAL_NED."""
        return MASKS[self.kind], self.position, self.velocity, self.accel

    def describe(self) -> dict[str, object]:
        """For the log of accepted set-points."""
        return {"kind": self.kind, "position": self.position, "velocity": self.velocity, "accel": self.accel}
