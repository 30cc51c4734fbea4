"""The wind turns with true north along the path: kept everywhere, used nearly whole, refused only if too strong.

Along a plane's axes the same wind turns by the convergence of the meridians: far north by a degree each 24 km.
"""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest

from gcs.errors import MissionInfeasible
from gcs.layout.planning_problem import lay_out
from gcs.mission import read_mission
from gcs.plan import Plan
from gcs.planning.mission_planning import plan_mission
from tests.support.checker import check_plan
from tests.support.field_missions import field_mission

METRES_A_DEGREE = 111_200.0


def airspeeds_m_s(plan: Plan, document: dict[str, Any]) -> np.ndarray:
    """True airspeeds along a plan, sampled: velocities turned to true axes less the wind."""
    wind = document["limits"]["wind"]
    times = np.linspace(0.0, plan.mission_time_s, 4_000)
    at, velocity = plan.trajectory.evaluate(times), np.asarray(plan.trajectory.evaluate(times, 1)).copy()
    axes = plan.plane.true_axes(at[:, 0], at[:, 1], at[:, 2])
    velocity[:, :2] = np.einsum("kij,kj->ki", axes, velocity[:, :2])
    return np.asarray(np.linalg.norm(velocity - np.array([wind["east_m_s"], wind["north_m_s"], 0.0]), axis=1))


def planned(document: dict[str, Any], *, fast: bool = False) -> Plan:
    plan = plan_mission(read_mission(document), fast=fast)
    assert check_plan(json.loads(json.dumps(plan.to_document())), document) == []
    assert airspeeds_m_s(plan, document).max() <= document["limits"]["max_airspeed_m_s"] + 1e-6
    return plan


def test_a_head_wind_far_north_is_flown_at_the_airspeed_there_is() -> None:
    """13 of 16 m/s against it: with one worst case over the whole map the flight took 95,590 s."""
    document = field_mission("svalbard_head")
    plan = planned(document)
    assert plan.mission_time_s < 62_500.0
    used = airspeeds_m_s(plan, document)
    assert np.median(used) > 0.995 * document["limits"]["max_airspeed_m_s"]


def test_a_wind_below_the_airspeed_is_no_reason_to_refuse() -> None:
    planned(field_mission("svalbard_false_infeasible"))


@pytest.mark.parametrize(("name", "before_s"), [("headwind", 36_811.5), ("fix_applied_16_days", 1_384_739.5)])
@pytest.mark.slow
def test_nearly_calm_against_the_wind_every_tenth_counts(name: str, before_s: float) -> None:
    document = field_mission(name)
    plan = planned(document)
    assert plan.mission_time_s < 0.96 * before_s
    assert any("check the wind" in note for note in plan.notes) is (name == "fix_applied_16_days")


def arctic(lat: float, lon: float, course_deg: float, from_deg: float) -> dict[str, Any]:
    """A chain of three stations of 60 km 80 km apart along a course, in a wind of 12 m/s from a direction."""
    stations = []
    for k in range(3):
        north = k * 80_000.0 * math.cos(math.radians(course_deg)) / METRES_A_DEGREE
        east = k * 80_000.0 * math.sin(math.radians(course_deg)) / METRES_A_DEGREE / math.cos(math.radians(lat + north))
        away = (lon + east + 180.0) % 360.0 - 180.0
        stations.append({"id": f"s{k}", "lat_deg": lat + north, "lon_deg": away, "alt_amsl_m": 20, "range_m": 60_000.0})
    ends = [{"lat_deg": s["lat_deg"], "lon_deg": s["lon_deg"], "alt_amsl_m": 150.0} for s in (stations[0], stations[2])]
    wind = (-12.0 * math.sin(math.radians(from_deg)), -12.0 * math.cos(math.radians(from_deg)))
    return {
        "start": ends[0],
        "destination": ends[1],
        "stations": stations,
        "limits": {
            "min_alt_amsl_m": 100.0,
            "max_alt_amsl_m": 200.0,
            "max_speed_m_s": 30.0,
            "max_accel_m_s2": 2.0,
            "max_airspeed_m_s": 18.0,
            "wind": {"east_m_s": wind[0], "north_m_s": wind[1]},
        },
    }


@pytest.mark.parametrize("lat", [-82.0, -65.0, 0.0, 52.0, 80.0])
@pytest.mark.parametrize(("course_deg", "from_deg"), [(90.0, 90.0), (90.0, 270.0), (0.0, 45.0), (225.0, 10.0)])
def test_wind_is_kept_and_used_on_every_course(lat: float, course_deg: float, from_deg: float) -> None:
    document = arctic(lat, 179.0, course_deg, from_deg)
    used = airspeeds_m_s(planned(document, fast=True), document)
    speed = 18.0 if from_deg != 270.0 else 17.0  # down the wind it is the ground speed that limits
    assert np.median(used) > 0.97 * speed


def test_a_start_in_motion_keeps_the_wind_too() -> None:
    document = arctic(78.0, 20.0, 60.0, 60.0)
    document["options"] = {"start_state": {"velocity_m_s": [4.0, 2.0, 0.0]}}
    planned(document, fast=True)


def test_a_wind_above_the_airspeed_is_still_refused() -> None:
    document = arctic(78.0, 20.0, 60.0, 60.0)
    document["limits"]["max_airspeed_m_s"] = 11.99
    with pytest.raises(MissionInfeasible, match="wind"):
        plan_mission(read_mission(document), fast=True)


def test_nothing_changes_without_wind_or_on_a_plane() -> None:
    document = arctic(52.0, 5.0, 60.0, 60.0)
    del document["limits"]["wind"]
    assert lay_out(read_mission(document)).problem.wind is None
