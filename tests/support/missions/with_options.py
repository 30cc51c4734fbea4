"""A mission that every option can bend, and random missions with any mixture of options, as documents.

::

          north   B (1500, 900)           A, B, C reach 1000 m, their overlaps are 240 m deep;
                 *     *                  F reaches 3000 m from (3000, -2500): with it one handover
      A *                   * C           less will do, on a longer way.
      start 0              destination 3000 m east
                    F
"""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
from pyproj import Transformer

Document = dict[str, Any]

ORIGIN = {"lat_deg": 53.2, "lon_deg": 5.3, "alt_amsl_m": 0.0}
PAPER = {"min_overlap_s": 0.0, "range_margin_m": 0.0, "min_tenure_s": 0.0}

BASE: Document = {
    "name": "Three masts and a far one",
    "origin": ORIGIN,
    "start": {"east_m": 0.0, "north_m": 0.0, "up_m": 110.0},
    "destination": {"east_m": 3000.0, "north_m": 0.0, "up_m": 110.0},
    "stations": [
        {"id": "A", "east_m": 0.0, "north_m": 0.0, "up_m": 0.0, "range_m": 1000.0},
        {"id": "B", "east_m": 1500.0, "north_m": 900.0, "up_m": 0.0, "range_m": 1000.0},
        {"id": "C", "east_m": 3000.0, "north_m": 0.0, "up_m": 0.0, "range_m": 1000.0},
        {"id": "F", "east_m": 3000.0, "north_m": -2500.0, "up_m": 0.0, "range_m": 3000.0},
    ],
    "limits": {"min_alt_amsl_m": 100.0, "max_alt_amsl_m": 120.0, "max_speed_m_s": 50.0, "max_accel_m_s2": 5.0},
    "options": PAPER,
}


def changed(base: Document, changes: dict[str, Any]) -> Document:
    """``base`` with fields at dotted paths replaced."""
    document = copy.deepcopy(base)
    for path, value in changes.items():
        place: Any = document
        *parents, last = path.split(".")
        for part in parents:
            place = place[int(part)] if isinstance(place, list) else place.setdefault(part, {})
        place[last] = value
    return document


def on_earth(local: Document) -> Document:
    """The same mission in latitude and longitude, through PROJ."""
    origin = local["origin"]
    plane = Transformer.from_pipeline(
        f"+proj=pipeline +step +inv +proj=aeqd +ellps=WGS84 +lat_0={origin['lat_deg']} +lon_0={origin['lon_deg']} "
        "+step +proj=unitconvert +xy_in=rad +xy_out=deg"
    )

    def placed(holder: Document) -> Document:
        rest = {key: value for key, value in holder.items() if key not in ("east_m", "north_m", "up_m")}
        lon, lat = plane.transform(holder["east_m"], holder["north_m"])
        return {**rest, "lat_deg": lat, "lon_deg": lon, "alt_amsl_m": holder["up_m"] + origin["alt_amsl_m"]}

    document = {key: value for key, value in copy.deepcopy(local).items() if key != "origin"}
    document["start"], document["destination"] = placed(local["start"]), placed(local["destination"])
    document["stations"] = [placed(station) for station in local["stations"]]
    return document


def random_mission(seed: int) -> Document:
    """A chain of one to five stations in a local plane or on the earth, with every option and limit at times.

    Numbers are drawn so that most missions have a plan and most options cost something; about one in five has none.
    """
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 6))
    ranges = rng.uniform(600.0, 2500.0, count)
    at = np.zeros((count, 3))
    at[:, 2] = rng.choice([0.0, 30.0, 105.0], count)
    course = rng.uniform(0.0, 2.0 * np.pi)
    for k in range(1, count):
        course += rng.normal(0.0, 0.7)
        step = (ranges[k - 1] + ranges[k]) * rng.uniform(0.6, 0.97)
        at[k, :2] = at[k - 1, :2] + step * np.array([np.cos(course), np.sin(course)])

    def end(k: int) -> Document:
        away, bearing = ranges[k] * rng.uniform(0.0, 0.9), rng.uniform(0.0, 2.0 * np.pi)
        return {
            "east_m": float(at[k, 0] + away * np.cos(bearing)),
            "north_m": float(at[k, 1] + away * np.sin(bearing)),
            "up_m": float(rng.uniform(100.0, 140.0)),
        }

    stations: list[Document] = [
        {"id": f"s{k}", "east_m": float(x), "north_m": float(y), "up_m": float(z), "range_m": float(ranges[k])}
        for k, (x, y, z) in enumerate(at)
    ]
    speed = float(rng.uniform(10.0, 50.0))
    limits: Document = {
        "min_alt_amsl_m": 100.0,
        "max_alt_amsl_m": 140.0,
        "max_speed_m_s": speed,
        "max_accel_m_s2": float(rng.uniform(1.0, 6.0)),
    }
    options: Document = {
        "min_overlap_s": float(rng.choice([0.0, 3.0, 5.0, 15.0])),
        "range_margin_m": float(rng.choice([0.0, 10.0, 25.0, 60.0])),
        "min_tenure_s": float(rng.choice([0.0, 10.0, 40.0])),
    }

    def sometimes(share: float = 0.25) -> bool:
        return bool(rng.random() < share)

    if sometimes():
        limits["max_jerk_m_s3"] = float(rng.uniform(1.0, 10.0))
    if sometimes():
        limits["max_climb_m_s"] = float(rng.uniform(0.3, 3.0))
    if sometimes():
        limits["max_descent_m_s"] = float(rng.uniform(0.3, 3.0))
    if sometimes():
        limits["max_airspeed_m_s"] = speed * float(rng.uniform(0.7, 1.3))
        limits["wind"] = {name: speed * float(rng.uniform(-0.45, 0.45)) for name in ("east_m_s", "north_m_s")}
    if sometimes(0.15):
        # Around what the straight line takes.
        guess = float(np.linalg.norm(at[-1] - at[0])) / speed + 2.0 * speed / limits["max_accel_m_s2"]
        limits["endurance_s"] = guess * float(rng.uniform(1.0, 6.0)) + 30.0
        if sometimes(0.5):
            limits["reserve_s"] = 20.0
    if sometimes(0.15):
        stations[int(rng.integers(count))]["min_elevation_deg"] = float(rng.uniform(0.5, 4.0))
    if sometimes():
        options["max_handovers"] = int(rng.integers(0, count + 1))
    if count > 1 and sometimes(0.1):
        options["excluded_stations"] = [f"s{int(rng.integers(count))}"]
    if sometimes():
        options["objective"] = ["energy", 0.5, 0.1][int(rng.integers(3))]
    if sometimes(0.15):
        velocity = rng.normal(size=3) * np.array([1.0, 1.0, 0.02])
        velocity *= speed * rng.uniform(0.1, 0.6) / np.linalg.norm(velocity)
        options["start_state"] = {"velocity_m_s": [float(x) for x in velocity], "acceleration_m_s2": [0.0, 0.0, 0.0]}
    if sometimes(0.15):
        options["arrival_s"] = float(rng.uniform(100.0, 1500.0))
    document: Document = {
        "name": f"random {seed}",
        "origin": ORIGIN,
        "start": end(0),
        "destination": end(count - 1),
        "stations": stations,
        "limits": limits,
        "options": options,
    }
    return on_earth(document) if sometimes(0.4) else document
