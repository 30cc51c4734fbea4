"""A setpoint, and a block of them: position, velocity, acceleration at one instant."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from planner.arrays import Array, Indices

if TYPE_CHECKING:
    pass


Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Setpoint:
    """One sample of the planned flight.

    ``time_s`` counts from launch. ``station_id`` and ``system_id`` are the station in control, ``leg`` counts the
    stations flown (0 first). ``handover`` is the handover's index at the first sample of a new station.
    ``*_enu_*`` are (east, north, up) in the plan's plane, metres from its origin; ``*_ned_*`` are along true
    north, east and down at the vehicle. ``yaw_deg`` is the true course, 0 to 360, held where slower than
    `SLOW_M_S`.
    """

    time_s: float
    station_id: str
    system_id: int
    leg: int
    handover: int | None
    position_enu_m: Vector
    velocity_enu_m_s: Vector
    acceleration_enu_m_s2: Vector
    lat_deg: float
    lon_deg: float
    alt_amsl_m: float
    velocity_ned_m_s: Vector
    acceleration_ned_m_s2: Vector
    yaw_deg: float

    def hold(self) -> Setpoint:
        """The same place at rest: what a hold streams (never a hold mode: some sink without a pilot's radio)."""
        zero = (0.0, 0.0, 0.0)
        return replace(
            self,
            velocity_enu_m_s=zero,
            acceleration_enu_m_s2=zero,
            velocity_ned_m_s=zero,
            acceleration_ned_m_s2=zero,
        )

    def retimed(self, rate: float, rate_change_per_s: float = 0.0) -> Setpoint:
        """The same place flown at ``rate`` seconds of plan per second of clock, ``rate`` itself changing.

        Chain rule: v' = r v, a' = r^2 a + (dr/dt) v. ``rate`` 0 is not a hold while the rate changes.
        """

        def velocity(v: Vector) -> Vector:
            return (rate * v[0], rate * v[1], rate * v[2])

        def acceleration(a: Vector, v: Vector) -> Vector:
            square = rate * rate
            return (
                square * a[0] + rate_change_per_s * v[0],
                square * a[1] + rate_change_per_s * v[1],
                square * a[2] + rate_change_per_s * v[2],
            )

        return replace(
            self,
            velocity_enu_m_s=velocity(self.velocity_enu_m_s),
            acceleration_enu_m_s2=acceleration(self.acceleration_enu_m_s2, self.velocity_enu_m_s),
            velocity_ned_m_s=velocity(self.velocity_ned_m_s),
            acceleration_ned_m_s2=acceleration(self.acceleration_ned_m_s2, self.velocity_ned_m_s),
        )


@dataclass(frozen=True, eq=False)
class SetpointBlock:
    """Consecutive samples as arrays of length N; columns as in `Setpoint`, vectors ``(N, 3)``.

    ``handover`` is 0 where there is none (handovers count from 1).
    """

    time_s: Array
    leg: Indices
    handover: Indices
    position_enu_m: Array
    velocity_enu_m_s: Array
    acceleration_enu_m_s2: Array
    lat_deg: Array
    lon_deg: Array
    velocity_ned_m_s: Array
    acceleration_ned_m_s2: Array
    alt_amsl_m: Array
    yaw_deg: Array

    def __len__(self) -> int:
        return len(self.time_s)
