"""A straight line flown from rest to rest."""

from __future__ import annotations

import math

import numpy as np

from gcs.plan import Plan
from link.setpoints.local_projection import LocalProjection
from link.setpoints.setpoint import Setpoint, Vector
from planner.arrays import Array


class StraightLine:
    """A straight way between two points of the plan's plane, from rest to rest, as a quintic in time.

    Peak speed is 15/8 of the mean, peak acceleration 10 / sqrt(3) of length / duration^2; the duration is the shortest
    that keeps ``speed_m_s``, ``climb_m_s`` and ``accel_m_s2``. A way of no length is a hover of no duration.
    """

    def __init__(
        self,
        plan: Plan,
        leg: int,
        start_enu_m: Vector,
        end_enu_m: Vector,
        *,
        speed_m_s: float,
        climb_m_s: float,
        accel_m_s2: float,
        yaw_deg: float = 0.0,
    ) -> None:
        self._plan = plan
        self._map = LocalProjection(plan.plane)
        self._leg = leg
        station = plan.mission.stations[plan.trajectory.sequence[leg]]
        self._station = (station.id, station.system_id or 0)
        self._start = np.array(start_enu_m, dtype=float)
        self._way = np.array(end_enu_m, dtype=float) - self._start
        self._yaw_deg = yaw_deg
        length, rise = float(np.linalg.norm(self._way)), abs(float(self._way[2]))
        self.duration_s = max(
            1.875 * length / speed_m_s, 1.875 * rise / climb_m_s, math.sqrt(10.0 / math.sqrt(3.0) * length / accel_m_s2)
        )

    def at(self, time_s: float) -> Setpoint:
        """The setpoint at a time since the start, clamped."""
        total = self.duration_s
        u = min(max(time_s / total, 0.0), 1.0) if total > 0.0 else 1.0
        share = u**3 * (10.0 + u * (-15.0 + 6.0 * u))
        speed = 30.0 * u**2 * (1.0 - u) ** 2 / total if total > 0.0 else 0.0
        change = 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) / total**2 if total > 0.0 else 0.0
        return state_setpoint(
            self._plan,
            self._map,
            self._leg,
            self._station,
            time_s,
            self._start + share * self._way,
            speed * self._way,
            change * self._way,
            self._yaw_deg,
        )


def state_setpoint(
    plan: Plan,
    local: LocalProjection,
    leg: int,
    station: tuple[str, int],
    time_s: float,
    position_enu_m: Array,
    velocity_enu_m_s: Array,
    acceleration_enu_m_s2: Array,
    yaw_deg: float,
) -> Setpoint:
    """A `Setpoint` for any state in the plan's plane (east, north, up), on the plan's curve or not."""
    lat, lon, axes = local.to_geodetic(float(position_enu_m[0]), float(position_enu_m[1]))
    velocity = axes @ velocity_enu_m_s[:2]
    acceleration = axes @ acceleration_enu_m_s2[:2]
    return Setpoint(
        time_s=max(time_s, 0.0),
        station_id=station[0],
        system_id=station[1],
        leg=leg,
        handover=None,
        position_enu_m=_vector(position_enu_m),
        velocity_enu_m_s=_vector(velocity_enu_m_s),
        acceleration_enu_m_s2=_vector(acceleration_enu_m_s2),
        lat_deg=lat,
        lon_deg=lon,
        alt_amsl_m=plan.plane.alt_amsl_m + float(position_enu_m[2]),
        velocity_ned_m_s=(float(velocity[1]), float(velocity[0]), -float(velocity_enu_m_s[2])),
        acceleration_ned_m_s2=(float(acceleration[1]), float(acceleration[0]), -float(acceleration_enu_m_s2[2])),
        yaw_deg=yaw_deg,
    )


def _vector(values: Array) -> Vector:
    return (float(values[0]), float(values[1]), float(values[2]))
