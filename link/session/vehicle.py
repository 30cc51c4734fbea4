"""The vehicle of a flight, as it was heard: its autopilot, its mode, its origin, its place in the plan's plane."""

from __future__ import annotations

import math
from dataclasses import dataclass

from gcs.geodesy import Plane
from link.autopilot.local_frame import EkfOrigin
from link.autopilot.profile import AutopilotProfile
from link.dialect import mavlink
from link.setpoints.local_projection import LocalProjection
from link.telemetry.vehicle_monitor import VehicleMonitor


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
        """Whether it said that it had landed."""
        return bool(self.monitor.landed_state == mavlink.MAV_LANDED_STATE_ON_GROUND)

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

    def adopt_origin(self, station_id: str) -> bool:
        """Take the EKF origin a station was told; whether it is another than before."""
        link = self.monitor.links[station_id]
        if link.origin is None or link.origin_s <= self.origin_s:
            return False
        changed = self.origin is not None and link.origin != self.origin
        self.origin, self.origin_s = link.origin, link.origin_s
        return changed

    def position_enu_m(self) -> tuple[float, float, float] | None:
        """Where it last said it was, in the plan's plane: metres east, north, and up of the plane's altitude."""
        position = self.monitor.position
        if position is None:
            return None
        east, north = self._local.to_plane(position.lat_deg, position.lon_deg)
        return east, north, position.alt_amsl_m - self.plane.alt_amsl_m
