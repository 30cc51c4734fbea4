"""Mission documents drawn from a seed, as hostile as the door lets through, and what a plan of each must be."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from scipy.sparse.csgraph import connected_components

from gcs.errors import MissionError, MissionInfeasible
from gcs.mission import read_mission
from gcs.planning.mission_planning import plan_mission
from planner import Problem
from tests.support.checker import check_plan
from tests.support.missions.problems import random_chain

Document = dict[str, Any]
# Metres per degree of latitude, near enough to scatter stations.
DEGREE_M = 111_200.0
NO_OPTIONS = {"min_overlap_s": 0.0, "range_margin_m": 0.0, "min_tenure_s": 0.0}


def random_mission(seed: int, number: int) -> Document:
    """Mission ``number`` of ``seed``: half of them hostile chains (`random_chain`), half maps; all pass the door."""
    rng = np.random.default_rng([seed, number])
    while True:
        document = _chain(rng) if rng.random() < 0.5 else _map(rng)
        if document is None:
            continue
        try:
            read_mission(document)
        except MissionError:
            continue  # more than the door lets through
        return document


def outcome(document: Document, *, fast: bool) -> tuple[str, list[str]]:
    """``"planned"`` or the reason why not, and complaints: what the judge says of a plan, or of a refusal."""
    try:
        plan = plan_mission(read_mission(document), fast=fast)
    except MissionInfeasible as reason:
        said = reason.to_document()
        complaints = [] if said["reason"] and said["message"] else ["infeasible without an explanation"]
        if has_a_way(document):
            complaints.append(f"called infeasible, but there is a way: {said['message']}")
        return str(said["reason"]), complaints
    return "planned", check_plan(json.loads(json.dumps(plan.to_document())), document)


def has_a_way(document: Document) -> bool:
    """True where it is plain that there is a plan: ranges less margin chain together, and nothing else is asked.

    Only for local missions with antennas no higher than the band, where every range is widest on the band's floor.
    """
    options, limits = {"range_margin_m": 25.0} | document["options"], document["limits"]
    asked = {"max_handovers", "start_state", "arrival_s"} & options.keys() or "endurance_s" in limits
    masked = any("min_elevation_deg" in s for s in document["stations"])
    if "origin" not in document or asked or masked or "wind" in limits:
        return False
    at = np.array([[s["east_m"], s["north_m"], s["up_m"]] for s in document["stations"]])
    ranges = np.array([s["range_m"] for s in document["stations"]]) - options["range_margin_m"]
    floor = limits["min_alt_amsl_m"] - document["origin"]["alt_amsl_m"]
    if (at[:, 2] > floor).any():
        return False
    radius = np.sqrt(np.maximum(ranges**2 - (floor - at[:, 2]) ** 2, 0.0)) * (ranges > floor - at[:, 2])
    apart = np.linalg.norm(at[:, None, :2] - at[None, :, :2], axis=-1)
    met = (radius[:, None] + radius[None] - apart > 0.01) & (np.minimum(radius[:, None], radius[None]) > 0.01)
    _, group = connected_components(met, directed=False)
    covering = []
    for end in (document["start"], document["destination"]):
        away = np.linalg.norm(at - [end["east_m"], end["north_m"], end["up_m"]], axis=1)
        covering.append(set(group[(away < ranges - 1e-6) & (ranges > 0)].tolist()))
    return bool(covering[0] & covering[1])


def _chain(rng: np.random.Generator) -> Document | None:
    problem = random_chain(int(rng.integers(0, 2**31)))
    return None if problem is None else _document(problem)


def _document(problem: Problem) -> Document:
    """A problem as a local mission; its ranges are those to plan with."""

    def place(at: Any) -> dict[str, float]:
        return {"east_m": float(at[0]), "north_m": float(at[1]), "up_m": float(at[2])}

    limits, elevation = problem.limits, problem.min_elevation_deg
    stations = []
    for k, (at, reach) in enumerate(zip(problem.station_positions_m, problem.ranges_m, strict=True)):
        station: Document = {"id": f"s{k}", **place(at), "range_m": float(reach)}
        if elevation is not None and elevation[k] >= 0.0:
            station["min_elevation_deg"] = float(elevation[k])
        stations.append(station)
    given: Document = {
        "min_alt_amsl_m": limits.min_alt_m,
        "max_alt_amsl_m": limits.max_alt_m,
        "max_speed_m_s": limits.max_speed_m_s,
        "max_accel_m_s2": limits.max_accel_m_s2,
    }
    for name in ("max_jerk_m_s3", "max_climb_m_s", "max_descent_m_s"):
        if getattr(limits, name) is not None:
            given[name] = getattr(limits, name)
    if limits.max_airspeed_m_s is not None:
        given["max_airspeed_m_s"] = limits.max_airspeed_m_s
        given["wind"] = {"east_m_s": limits.wind_m_s[0], "north_m_s": limits.wind_m_s[1]}
    options = {
        "min_overlap_s": problem.min_overlap_s,
        "min_tenure_s": problem.min_tenure_s,
        "range_margin_m": 0.0,
    }
    return {
        "origin": {"lat_deg": 47.0, "lon_deg": 11.0, "alt_amsl_m": 0.0},
        "start": place(problem.start_m),
        "destination": place(problem.destination_m),
        "stations": stations,
        "limits": given,
        "options": options,
    }


def _map(rng: np.random.Generator) -> Document:
    """Stations scattered, in line or in clusters, on the plane or anywhere on the earth, dense enough more often."""
    count = int(rng.choice([1, 2, 5, 12, 30, 60]))
    scale = 10.0 ** rng.uniform(2.5, 4.5)
    ranges = scale * rng.uniform(0.5, 1.5, count)
    if rng.random() < 0.1:
        ranges[rng.integers(count)] *= 50.0
    side = scale * np.sqrt(count / rng.choice([0.5, 1.0, 2.0]))
    at = rng.uniform(-side, side, (count, 2)) / 2.0
    shape = rng.random()
    if shape < 0.15:
        at = np.stack([np.linspace(-side, side, count), np.zeros(count)], axis=1)
    elif shape < 0.3:
        at = at[rng.integers(0, max(1, count // 3), count)] + rng.normal(scale=0.02 * scale, size=(count, 2))
    low = float(rng.uniform(20.0, 300.0))
    high = low + float(rng.choice([0.0, 1.0, 20.0, 300.0]))
    hills = rng.uniform(0.0, low, count) if rng.random() < 0.5 else rng.uniform(0.0, high + 50.0, count)
    heights = np.zeros(count) if rng.random() < 0.4 else hills
    first, last = rng.integers(0, count, 2)
    ends = []
    for k in (first, last):
        up = float(rng.uniform(low, high))
        reach = np.sqrt(max(ranges[k] ** 2 - (up - heights[k]) ** 2, 0.0)) * rng.uniform(0.0, 0.95)
        angle = rng.uniform(0.0, 2.0 * np.pi)
        ends.append([*(at[k] + reach * np.array([np.cos(angle), np.sin(angle)])), up])
    speed, accel = 10.0 ** rng.uniform(0.3, 2.0), 10.0 ** rng.uniform(-1.0, 1.3)
    limits: Document = {
        "min_alt_amsl_m": low,
        "max_alt_amsl_m": high,
        "max_speed_m_s": float(speed),
        "max_accel_m_s2": float(accel),
    }
    optional = {
        "max_jerk_m_s3": 10.0 ** rng.uniform(-0.5, 1.5),
        "max_climb_m_s": speed * rng.uniform(0.05, 1.0),
        "max_descent_m_s": speed * rng.uniform(0.05, 1.0),
        "endurance_s": 10.0 ** rng.uniform(2.0, 4.0),
        "max_airspeed_m_s": speed * rng.uniform(0.6, 1.3),
    }
    limits |= {name: float(value) for name, value in optional.items() if rng.random() < 0.15}
    if "max_airspeed_m_s" in limits:
        limits["wind"] = dict(zip(("east_m_s", "north_m_s"), (speed * rng.uniform(-0.4, 0.4, 2)).tolist(), strict=True))
    options: Document = {} if rng.random() < 0.5 else dict(NO_OPTIONS)
    if rng.random() < 0.15:
        options["max_handovers"] = int(rng.integers(0, 10))
    if rng.random() < 0.1:
        moving = rng.normal(size=3) * speed * 0.3 * np.array([1.0, 1.0, 0.0])
        options["start_state"] = {"velocity_m_s": moving.tolist(), "acceleration_m_s2": [0.0, 0.0, 0.0]}
    local = rng.random() < 0.5
    lat, lon = float(rng.uniform(-80.0, 80.0)), float(rng.uniform(-180.0, 180.0))

    def place(flat: Any, up: float) -> dict[str, float]:
        east, north = float(flat[0]), float(flat[1])
        if local:
            return {"east_m": east, "north_m": north, "up_m": float(up)}
        further = lon + east / DEGREE_M / np.cos(np.radians(lat))
        return {
            "lat_deg": lat + north / DEGREE_M,
            "lon_deg": float((further + 180.0) % 360.0 - 180.0),
            "alt_amsl_m": float(up),
        }

    stations = [{"id": f"s{k}", **place(at[k], heights[k]), "range_m": float(ranges[k])} for k in range(count)]
    if rng.random() < 0.1:
        for station in stations:
            station["min_elevation_deg"] = float(rng.choice([0.0, 1.0, 5.0]))
    document: Document = {
        "start": place(ends[0][:2], ends[0][2]),
        "destination": place(ends[1][:2], ends[1][2]),
        "stations": stations,
        "limits": limits,
        "options": options,
    }
    return document | ({"origin": {"lat_deg": lat, "lon_deg": lon, "alt_amsl_m": 0.0}} if local else {})
