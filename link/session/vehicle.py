"""The vehicle of a flight, as it was heard: its autopilot, its mode, its origin, its place in the plan's plane.

What is old is unknown: a place heard longer ago than `POSITION_FRESH_S` is none (`Vehicle.position`,
`Vehicle.position_enu_m`). A verdict that ends a flight needs two witnesses that agree (`Vehicle.down_since`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from gcs.geodesy import Plane
from link.autopilot.local_frame import EkfOrigin
from link.autopilot.profile import AutopilotProfile
from link.dialect import mavlink
from link.setpoints.local_projection import LocalProjection
from link.telemetry.plausibility import Position, same_origin
from link.telemetry.vehicle_monitor import VehicleMonitor

POSITION_FRESH_S = 1.0
STATE_FRESH_S = 5.0
"""What comes a few times a second, or once, is known for so long."""
PATIENT_SPEEDUP = 5.0
"""Sped up beyond this, ages are judged as long on the wall's clock as at that: there it counts how this machine keeps
up."""
MOVES_M_S = 2.0
"""Over the ground faster than this a vehicle flies, or falls."""
FALLS_M_S = 4.0
STILL_S = 3.0
LANDED_S = 0.8
"""A landed state is a witness when it was told again so much later, and nothing else in between."""
RESTARTED_S = 30.0


@dataclass
class Vehicle:
    """What is known of the vehicle. ``plane`` is the plan's; a flight keeps its plane when it takes another plan."""

    profile: AutopilotProfile
    monitor: VehicleMonitor
    plane: Plane
    origin: EkfOrigin | None = None
    """Its EKF origin as the station in control was told it."""
    origin_s: float = -math.inf
    loss_timeout_s: float = 1.0
    """How long its autopilot goes without setpoints, as read of its parameters before launch."""
    now_s: float = 0.0
    """The flight's clock, by which ages are judged."""
    patience: float = 1.0
    """How many times as old as usual what is known may be."""
    doubt: str = ""
    """Why its estimate of its place is not to be relied on now (`link.monitors.evidence`); empty while it is."""

    def __post_init__(self) -> None:
        self._local = LocalProjection(self.plane)

    @property
    def system_id(self) -> int:
        """Its MAVLink system id."""
        return self.monitor.vehicle_system_id

    @property
    def armed(self) -> bool:
        """Whether the last HEARTBEAT showed armed motors."""
        return self.monitor.heartbeat is not None and self.monitor.heartbeat.armed

    @property
    def on_ground(self) -> bool:
        """Whether it said lately that it had landed."""
        return bool(self.landed_state == mavlink.MAV_LANDED_STATE_ON_GROUND)

    @property
    def landed_state(self) -> int:
        """Its MAV_LANDED_STATE as told lately; 0, undefined, where none was."""
        fresh = self.now_s - self.monitor.landed_s <= STATE_FRESH_S * self.patience
        return int(self.monitor.landed_state) if fresh else 0

    @property
    def mode(self) -> str | None:
        """Mode of the last HEARTBEAT, by name."""
        return None if self.monitor.heartbeat is None else self.profile.mode_of(self.monitor.heartbeat)

    @property
    def follows(self) -> bool:
        """Whether it follows setpoints, by its HEARTBEAT."""
        heartbeat = self.monitor.heartbeat
        return heartbeat is not None and self.profile.is_offboard(heartbeat)

    def disarmed_since(self, time_s: float) -> bool:
        """Whether a HEARTBEAT heard after ``time_s`` of the flight's clock shows motors that are off."""
        heartbeat = self.monitor.heartbeat
        return heartbeat is not None and not heartbeat.armed and heartbeat.heard_s > time_s

    def down_since(self, time_s: float) -> str:
        """What agrees with a HEARTBEAT heard after ``time_s`` that shows motors off; empty while nothing does.

        The armed bit alone ends no flight: the landed state, the place and its speed, or a restart must say the same.
        """
        if not self.disarmed_since(time_s):
            return ""
        monitor, position = self.monitor, self.position
        if monitor.clock.rebooted_s is not None and self.now_s - monitor.clock.rebooted_s <= RESTARTED_S:
            return "it restarted"
        # A speed told with a place that never changes is a figure that got stuck, no witness.
        if position is not None and self.now_s - monitor.places.same_since_s <= STILL_S:
            if position.velocity_ned_m_s[2] >= FALLS_M_S:
                return "it falls"
            if math.hypot(*position.velocity_ned_m_s[:2]) > MOVES_M_S:
                return ""
        if self.on_ground and monitor.landed_s > time_s and monitor.landed_s - monitor.landed_since_s >= LANDED_S:
            return "it says that it has landed"
        if self.landed_state == 0 and position is not None and self.now_s - monitor.places.still_since_s >= STILL_S:
            return "it stands still"
        return ""

    def adopt_origin(self, station_id: str) -> bool:
        """Take the EKF origin a station was told; whether it is another than before.

        Another one than before is taken when it was told twice: setpoints are laid from it.
        """
        link = self.monitor.links[station_id]
        if link.origin is None or link.origin_s <= self.origin_s:
            return False
        changed = self.origin is not None and not same_origin(link.origin, self.origin)
        if changed and link.origin_told < 2:
            return False
        if self.origin is None or changed:
            self.origin = link.origin
        self.origin_s = link.origin_s
        return changed

    @property
    def position(self) -> Position | None:
        """Where it is, by what was heard within `POSITION_FRESH_S`; None where that is unknown."""
        position = self.monitor.position
        if position is None or self.now_s - position.heard_s > POSITION_FRESH_S * self.patience:
            return None
        return position

    def position_enu_m(self) -> tuple[float, float, float] | None:
        """Where it is, in the plan's plane: metres east, north, and up of the plane's altitude; None where unknown."""
        position = self.position
        if position is None:
            return None
        east, north = self._local.to_plane(position.lat_deg, position.lon_deg)
        return east, north, position.alt_amsl_m - self.plane.alt_amsl_m
