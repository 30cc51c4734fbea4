"""The plan resampled: typed samples at any rate, in the plane and on the earth.

A stream starts at T+0, steps by ``1 / rate_hz`` and ends with a sample exactly at the mission time. Positions come from
the plan's one curve; latitude, longitude and the true axes from the plan's own plane. Velocities and accelerations are
given twice: along the plane's axes (files, checks) and along true north and east at the vehicle (what goes on
the wire: the meridian's convergence turns them by 1.5 degrees 130 km east of the origin).

Accelerations are turned and scaled by the same matrix as velocities; the change of that matrix along the way is
left out (v^2 / R, under 2e-4 m/s^2 at 30 m/s).
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gcs.geodesy import WGS84_A_M, WGS84_E2
from gcs.plan import Plan
from link.setpoints.setpoint import Setpoint, SetpointBlock
from planner import bezier
from planner.arrays import Array

RATE_LIMITS_HZ = (0.1, 200.0)
GRID_TOLERANCE_S = 1e-9
"""A grid time this close before the mission time is the mission time: no second sample."""
SLOW_M_S = 0.5
"""Below this horizontal speed there is no course to speak of, and the yaw is held."""
CHUNK = 4096
"""Samples computed at once; bounds the memory of a stream."""
NODE_STEP_S = 0.5
"""Spacing of the places `SetpointSampler.at` works from."""
_POLAR_COSINE = 2e-3


@dataclass(frozen=True)
class _Slow:
    """A span in which the vehicle is too slow to have a course, and the yaw held there."""

    start_s: float
    end_s: float
    yaw_deg: float


class SetpointSampler:
    """A plan's samples at ``rate_hz``; ``len()``, iteration, `blocks` and `at` for any time between.

    Raises `ValueError` for a rate outside 0.1 to 200 Hz.
    """

    def __init__(self, plan: Plan, rate_hz: float = 20.0) -> None:
        low, high = RATE_LIMITS_HZ
        if not low <= rate_hz <= high:
            raise ValueError(f"rate_hz is {rate_hz}, allowed is {low} to {high} Hz")
        self.plan = plan
        self.rate_hz = float(rate_hz)
        trajectory = plan.trajectory
        self.duration_s = float(trajectory.duration_s)
        self._curve = trajectory
        self._knots_s: list[float] = trajectory.knots_s.tolist()
        self._durations_s: list[float] = trajectory.durations_s.tolist()
        self._legs: list[int] = trajectory.leg_index.tolist()
        # Position, velocity and acceleration as one curve of nine columns: one evaluation gives all.
        degree = trajectory.degree
        orders = [trajectory.derivative_control_points(order) for order in (1, 2)]
        self._nine = np.concatenate(
            [trajectory.control_points_m, *(bezier.elevate(points, degree) for points in orders)], axis=-1
        )
        stations = [plan.mission.stations[index] for index in trajectory.sequence]
        self._station_of_leg: list[tuple[str, int]] = []
        for station in stations:
            if station.system_id is None:
                raise ValueError(f"station {station.id} has no system id; a plan gives one to every station it uses")
            self._station_of_leg.append((station.id, station.system_id))
        self._handover_of_leg = [0, *(int(h.index) for h in plan.handovers)]
        if len(self._handover_of_leg) != len(self._station_of_leg):
            raise ValueError(
                f"the plan has {len(stations)} legs but {len(plan.handovers)} handovers; it was altered or built wrong"
            )
        self._origin_alt_amsl_m = float(plan.plane.alt_amsl_m)
        # Index of the last grid sample that is truly before the end.
        before_end = math.ceil((self.duration_s - GRID_TOLERANCE_S) * self.rate_hz) - 1
        while before_end >= 0 and before_end / self.rate_hz >= self.duration_s - GRID_TOLERANCE_S:
            before_end -= 1
        self._count = before_end + 2
        self._slow = self._slow_spans()
        self._slow_starts_s = [span.start_s for span in self._slow]

    def __len__(self) -> int:
        return self._count

    @cached_property
    def times_s(self) -> Array:
        """Every sample time ``(len,)``, ascending, the last one exactly the mission time."""
        return self._times(0, self._count)

    def _times(self, start: int, stop: int) -> Array:
        times: Array = np.arange(start, stop, dtype=float) / self.rate_hz
        if stop == self._count:
            times[-1] = self.duration_s
        return times

    def blocks(self) -> Iterator[SetpointBlock]:
        """All samples, up to `CHUNK` at a time."""
        leg_before = 0
        for start in range(0, self._count, CHUNK):
            block = self._evaluate(self._times(start, min(start + CHUNK, self._count)))
            legs_before = np.concatenate([[leg_before], block.leg[:-1]])
            changed = block.leg != legs_before
            block.handover[changed] = np.asarray(self._handover_of_leg)[block.leg[changed]]
            leg_before = int(block.leg[-1])
            yield block

    def __iter__(self) -> Iterator[Setpoint]:
        for block in self.blocks():
            columns = (
                block.time_s,
                block.leg,
                block.handover,
                block.position_enu_m,
                block.velocity_enu_m_s,
                block.acceleration_enu_m_s2,
                block.lat_deg,
                block.lon_deg,
                block.alt_amsl_m,
                block.velocity_ned_m_s,
                block.acceleration_ned_m_s2,
                block.yaw_deg,
            )
            for t, leg, handover, p, v, a, lat, lon, alt, vt, at, yaw in zip(
                *(column.tolist() for column in columns), strict=True
            ):
                station_id, system_id = self._station_of_leg[leg]
                yield Setpoint(
                    t,
                    station_id,
                    system_id,
                    leg,
                    handover or None,
                    tuple(p),
                    tuple(v),
                    tuple(a),
                    lat,
                    lon,
                    alt,
                    tuple(vt),
                    tuple(at),
                    yaw,
                )

    def station_of_leg(self, leg: int) -> tuple[str, int]:
        """(id, system id) of the station in control on a leg."""
        return self._station_of_leg[leg]

    def leg_at(self, time_s: float) -> int:
        """Leg in force at a time: the later one at a joint; clamped to the flight."""
        return self._legs[self._segment_at(time_s)]

    def _segment_at(self, time_s: float) -> int:
        return min(max(bisect_right(self._knots_s, time_s) - 1, 0), len(self._durations_s) - 1)

    def at(self, time_s: float) -> Setpoint:
        """The sample at any time, clamped to the flight; ``handover`` is always None here, compare ``leg``.

        Some tens of microseconds; the first call prepares the table of places and takes longer, so make it before
        the flight. Raises `ValueError` for a time that is not finite.
        """
        if not math.isfinite(time_s):
            raise ValueError(f"time_s is {time_s}, allowed is any finite time")
        time_s = min(max(time_s, 0.0), self.duration_s)
        k = self._segment_at(time_s)
        u = min(max((time_s - self._knots_s[k]) / self._durations_s[k], 0.0), 1.0)
        pe, pn, pu, ve, vn, vu, ae, an, au = bezier.evaluate(self._nine[k], np.asarray(u)).tolist()
        alt_amsl_m = self._origin_alt_amsl_m + pu
        lat, lon, ee, en, ne, nn = self._place(time_s, pe, pn, alt_amsl_m)
        true_ve, true_vn = ee * ve + en * vn, ne * ve + nn * vn
        leg = self._legs[k]
        station_id, system_id = self._station_of_leg[leg]
        yaw_deg = self._held_yaw(time_s)
        if yaw_deg is None:
            yaw_deg = math.degrees(math.atan2(true_ve, true_vn)) % 360.0
        return Setpoint(
            time_s,
            station_id,
            system_id,
            leg,
            None,
            (pe, pn, pu),
            (ve, vn, vu),
            (ae, an, au),
            lat,
            lon,
            alt_amsl_m,
            (true_vn, true_ve, 0.0 - vu),
            (ne * ae + nn * an, ee * ae + en * an, 0.0 - au),
            yaw_deg,
        )

    @cached_property
    def _nodes(self) -> list[list[float]]:
        """Every `NODE_STEP_S` along the flight: east, north, latitude, longitude and the true axes' four numbers."""
        count = math.ceil(self.duration_s / NODE_STEP_S) + 1
        position = self._curve.evaluate(NODE_STEP_S * np.arange(count, dtype=np.float64))[:, :2]
        lat, lon, axes = self.plan.plane.geodetic_and_axes(position[:, 0], position[:, 1])
        table: list[list[float]] = np.column_stack([position, lat, lon, axes.reshape(-1, 4)]).tolist()
        return table

    def _place(self, time_s: float, east_m: float, north_m: float, alt_amsl_m: float) -> tuple[float, ...]:
        """Latitude, longitude and the true axes at that altitude, from the nearest node.

        An exact conversion takes a millisecond, a whole table of them little more. From a node d metres away the first
        order is off by d^2 tan(lat) / 2R: a hundredth of a millimetre.
        """
        node = self._nodes[round(time_s / NODE_STEP_S)]
        east0, north0, lat0, lon0, ee, en, ne, nn = node
        de, dn = east_m - east0, north_m - north0
        sine, cosine = math.sin(math.radians(lat0)), math.cos(math.radians(lat0))
        if cosine < _POLAR_COSINE:
            lat, lon, axes = self.plan.plane.geodetic_and_axes(east_m, north_m, alt_amsl_m)
            return (float(lat), float(lon), *axes.ravel().tolist())
        flat = 1.0 - WGS84_E2 * sine * sine
        normal_m = WGS84_A_M / math.sqrt(flat)
        meridian_m = normal_m * (1.0 - WGS84_E2) / flat
        lat_deg = lat0 + math.degrees((ne * de + nn * dn) / meridian_m)
        lon_deg = lon0 + math.degrees((ee * de + en * dn) / (normal_m * cosine))
        up_east, up_north = 1.0 + alt_amsl_m / normal_m, 1.0 + alt_amsl_m / meridian_m
        return (
            lat_deg,
            (lon_deg + 180.0) % 360.0 - 180.0,
            ee * up_east,
            en * up_east,
            ne * up_north,
            nn * up_north,
        )

    def _held_yaw(self, time_s: float) -> float | None:
        index = bisect_right(self._slow_starts_s, time_s) - 1
        if index >= 0 and time_s < self._slow[index].end_s:
            return self._slow[index].yaw_deg
        # The end of the flight belongs to the span that reaches it.
        if self._slow and time_s >= self.duration_s and self._slow[-1].end_s >= self.duration_s:
            return self._slow[-1].yaw_deg
        return None

    def _evaluate(self, times_s: Array) -> SetpointBlock:
        segment = self._curve.segment_at(times_s)
        u = np.clip((times_s - self._curve.knots_s[segment]) / self._curve.durations_s[segment], 0.0, 1.0)
        nine = bezier.evaluate(self._nine[segment], u)
        position, velocity, acceleration = nine[:, 0:3], nine[:, 3:6], nine[:, 6:9]
        alt_amsl = self._origin_alt_amsl_m + position[:, 2]
        lat, lon, axes = self.plan.plane.geodetic_and_axes(position[:, 0], position[:, 1], alt_amsl)
        velocity_true = _true_ned(axes, velocity)
        yaw = np.degrees(np.arctan2(velocity_true[:, 1], velocity_true[:, 0])) % 360.0
        for span in self._slow:
            inside = (times_s >= span.start_s) & ((times_s < span.end_s) | (span.end_s >= self.duration_s))
            yaw[inside] = span.yaw_deg
        return SetpointBlock(
            time_s=times_s,
            leg=self._curve.leg_index[segment],
            handover=np.zeros(len(times_s), dtype=np.int64),
            position_enu_m=position,
            velocity_enu_m_s=velocity,
            acceleration_enu_m_s2=acceleration,
            lat_deg=lat,
            lon_deg=lon,
            alt_amsl_m=alt_amsl,
            velocity_ned_m_s=velocity_true,
            acceleration_ned_m_s2=_true_ned(axes, acceleration),
            yaw_deg=yaw,
        )

    def _course_deg(self, time_s: float) -> float:
        """True course at a time at which the vehicle moves."""
        east, north, _ = self._curve.evaluate(time_s).tolist()
        velocity = self._curve.evaluate(time_s, 1)[None, :]
        axes = self.plan.plane.true_axes(east, north)
        ned = _true_ned(axes[None], velocity)[0]
        return math.degrees(math.atan2(ned[1], ned[0])) % 360.0

    def _slow_spans(self) -> list[_Slow]:
        """Where the horizontal speed is below `SLOW_M_S`: between the roots of a polynomial, not between samples."""
        velocity = self._curve.derivative_control_points(1)
        edges = {0.0, self.duration_s}
        for k, (start, duration) in enumerate(zip(self._knots_s, self._durations_s, strict=False)):
            east, north = velocity[k, :, 0], velocity[k, :, 1]
            excess = bezier.product(east, east) + bezier.product(north, north) - SLOW_M_S**2
            edges.update(start + duration * u for u in bezier.roots(excess))
        bounds = sorted(edges)
        edge: Array = np.array(bounds)
        middles = 0.5 * (edge[:-1] + edge[1:])
        speed = np.hypot(*self._curve.evaluate(middles, 1)[:, :2].T)
        spans: list[tuple[float, float]] = []
        for low, high, middle_speed in zip(bounds[:-1], bounds[1:], speed.tolist(), strict=True):
            if middle_speed >= SLOW_M_S:
                continue
            if spans and spans[-1][1] == low:
                spans[-1] = (spans[-1][0], high)
            else:
                spans.append((low, high))
        return [_Slow(low, high, self._yaw_of(low, high)) for low, high in spans]

    def _yaw_of(self, low_s: float, high_s: float) -> float:
        """The course last flown before a slow span, the next one where there is none before, else that of the whole."""
        if low_s > 0.0:
            return self._course_deg(low_s)
        if high_s < self.duration_s:
            return self._course_deg(high_s)
        east, north, _ = (self._curve.evaluate(self.duration_s) - self._curve.evaluate(0.0)).tolist()
        return math.degrees(math.atan2(east, north)) % 360.0 if math.hypot(east, north) > 1.0 else 0.0


def _true_ned(axes: Array, enu: Array) -> Array:
    """Plane-axis (east, north, up) vectors ``(N, 3)`` as true (north, east, down), by ``axes`` ``(N, 2, 2)``."""
    true_en = np.einsum("nij,nj->ni", axes, enu[:, :2])
    return np.column_stack([true_en[:, 1], true_en[:, 0], 0.0 - enu[:, 2]])
