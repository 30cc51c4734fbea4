"""Plans for the wire's tests: real `gcs.plan.model.Plan` objects with curves drawn by hand, no planner involved."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gcs.geodesy.plane import Plane
from gcs.layout.mission_geometry import MissionGeometry
from gcs.mission import read_mission
from gcs.plan.handover_schedule import schedule
from gcs.plan.model import Plan
from planner import Certificate, Trajectory

ORIGIN = {"lat_deg": 53.0, "lon_deg": 4.8, "alt_amsl_m": 10.0}


def rest_to_rest(*corners_m: Sequence[float], duration_s: float) -> Trajectory:
    """One curve that starts and ends at rest and is drawn towards the corners between."""
    points = np.array([corners_m[0]] * 2 + list(corners_m) + [corners_m[-1]] * 2, dtype=float)
    return Trajectory(points[None], np.array([duration_s]), np.array([0]))


def with_handovers(curve: Trajectory, times_s: Sequence[float]) -> Trajectory:
    """The same curve with the next station in control from each of these times on."""
    split = curve.split(times_s)
    station = np.searchsorted(np.asarray(times_s), split.knots_s[:-1] + 1e-9, side="right")
    return Trajectory(split.control_points_m, split.durations_s, station)


def make_plan(
    trajectory: Trajectory,
    *,
    origin: dict[str, float] = ORIGIN,
    station_ids: Sequence[str] = ("den-helder", "texel", "vlieland", "terschelling"),
    first_system_id: int = 241,
) -> Plan:
    """A plan that flies a curve. Stations stand at the origin and hear everything; ids count up from the first."""
    start, end = trajectory.evaluate(0.0), trajectory.evaluate(trajectory.duration_s)

    def local(point: np.ndarray) -> dict[str, float]:  # type: ignore[type-arg]
        return dict(zip(("east_m", "north_m", "up_m"), point.tolist(), strict=True))

    mission = read_mission(
        {
            "name": "Drawn by hand",
            "origin": dict(origin),
            "start": local(start),
            "destination": local(end),
            "stations": [
                {
                    "id": name,
                    "east_m": 0.0,
                    "north_m": 0.0,
                    "up_m": 0.0,
                    "range_m": 450_000.0,
                    "system_id": first_system_id + k,
                }
                for k, name in enumerate(station_ids)
            ],
            "limits": {
                "min_alt_amsl_m": -500.0,
                "max_alt_amsl_m": 5000.0,
                "max_speed_m_s": 100.0,
                "max_accel_m_s2": 20.0,
            },
        }
    )
    plane = Plane(origin["lat_deg"], origin["lon_deg"], origin["alt_amsl_m"])
    return Plan(
        mission=mission,
        trajectory=trajectory,
        plane=plane,
        handovers=schedule(MissionGeometry(mission, plane), trajectory),
        contingencies=(),
        certificate=Certificate({}),
        lower_bound_s=0.0,
        path_length_m=trajectory.path_length_m(),
        solve_time_s=0.0,
        created_utc="2026-11-22T09:00:00Z",
        method="by hand",
        planner_version="0",
    )


def drawn_relay_plan(duration_s: float = 300.0, handovers_s: Sequence[float] = (100.0, 200.5)) -> Plan:
    """Three stations, an S of about 6 km to the north-east at up to 40 m/s, climbing 40 m."""
    curve = rest_to_rest(
        (0, 0, 90), (2500, 200, 95), (1500, 2500, 110), (4500, 3500, 120), (4500, 4500, 130), duration_s=duration_s
    )
    return make_plan(with_handovers(curve, handovers_s))
