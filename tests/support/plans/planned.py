"""Small missions for flights in tests: a few stations in a row over flat ground, planned once a process."""

from __future__ import annotations

from functools import cache
from typing import Any

from gcs.mission import read_mission
from gcs.plan.model import Plan
from gcs.planning.mission_planning import plan_mission

START_M = 40.0
"""Height of the start above the origin's level; tests put the ground ten metres below it."""


def relay_document(
    stations: int = 3, *, spacing_m: float = 420.0, range_m: float = 400.0, **options: object
) -> dict[str, object]:
    """Stations ``s1``, ``s2``, ... due east of one another, each reaching about half way beyond the next border."""
    return {
        "name": f"Relay over {stations} stations",
        "origin": {"lat_deg": 52.95, "lon_deg": 4.79, "alt_amsl_m": 0.0},
        "start": {"east_m": 0.0, "north_m": 0.0, "up_m": START_M},
        "destination": {"east_m": spacing_m * (stations - 1), "north_m": 20.0, "up_m": START_M + 5.0},
        "stations": [
            {"id": f"s{k + 1}", "east_m": spacing_m * k, "north_m": 60.0 * (-1) ** k, "up_m": 0.0, "range_m": range_m}
            for k in range(stations)
        ],
        "limits": {
            "min_alt_amsl_m": START_M - 10.0,
            "max_alt_amsl_m": START_M + 30.0,
            "max_speed_m_s": 15.0,
            "max_accel_m_s2": 2.5,
            "max_climb_m_s": 2.0,
            "max_descent_m_s": 1.0,
        },
        "options": options,
    }


def wide_document() -> dict[str, Any]:
    """A row of four stations and ``beside``, near the second and left out at first: two ways round. All with ids."""
    document: dict[str, Any] = relay_document(4)
    document["stations"].append({"id": "beside", "east_m": 630.0, "north_m": 240.0, "up_m": 0.0, "range_m": 500.0})
    for k, station in enumerate(document["stations"]):
        station["system_id"] = 241 + k
    document["options"] = {"excluded_stations": ["beside"]}
    document["safe_points"] = [{"id": "field", "east_m": 0.0, "north_m": 0.0, "up_m": 5.0}]
    return document


@cache
def wide_plan() -> Plan:
    """The plan of `wide_document`."""
    return plan_mission(read_mission(wide_document()), fast=True)


FIRST_JOIN_S = 7.4
"""On `wide_plan` surely before its first handover: s2 covers no sooner than 5 s, and half the overlap comes first."""


@cache
def relay_plan(stations: int = 3, **options: object) -> Plan:
    """The plan of `relay_document`; options are the mission's."""
    return plan_mission(read_mission(relay_document(stations, **options)), fast=True)
