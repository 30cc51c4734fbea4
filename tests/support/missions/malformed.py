"""Missions no door may let in: (name, document or raw bytes, part of the path the error must name).

Used against `gcs.mission.model`, the command line and the REST interface alike.
"""

from __future__ import annotations

import copy
import json
import math
from typing import Any

Document = dict[str, Any]

GOOD: Document = {
    "name": "Den Helder to Texel",
    "start": {"lat_deg": 52.9234, "lon_deg": 4.7806, "alt_amsl_m": 100.0},
    "destination": {"lat_deg": 53.1153, "lon_deg": 4.8336, "alt_amsl_m": 100.0},
    "stations": [
        {"id": "den-helder", "lat_deg": 52.9234, "lon_deg": 4.7806, "alt_amsl_m": 1.0, "range_m": 16000.0},
        {"id": "texel", "lat_deg": 53.1153, "lon_deg": 4.8336, "alt_amsl_m": 1.0, "range_m": 18000.0},
    ],
    "limits": {"min_alt_amsl_m": 90.0, "max_alt_amsl_m": 120.0, "max_speed_m_s": 30.0, "max_accel_m_s2": 2.5},
    "safe_points": [{"id": "texel-field", "lat_deg": 53.1153, "lon_deg": 4.8336, "alt_amsl_m": 30.0}],
    "options": {"min_overlap_s": 5.0, "range_margin_m": 25.0},
}

GOOD_LOCAL: Document = {
    "name": "Two discs",
    "origin": {"lat_deg": 39.96, "lon_deg": 116.32, "alt_amsl_m": 0.0},
    "start": {"east_m": 0.0, "north_m": 0.0, "up_m": 110.0},
    "destination": {"east_m": 1500.0, "north_m": 0.0, "up_m": 110.0},
    "stations": [
        {"id": "A", "east_m": 0.0, "north_m": 0.0, "up_m": 0.0, "range_m": 1000.0},
        {"id": "B", "east_m": 1500.0, "north_m": 0.0, "up_m": 0.0, "range_m": 1000.0},
    ],
    "limits": {"min_alt_amsl_m": 100.0, "max_alt_amsl_m": 120.0, "max_speed_m_s": 50.0, "max_accel_m_s2": 5.0},
    "options": {"min_overlap_s": 0, "range_margin_m": 0, "min_tenure_s": 0},
}

_DROP = object()


def _with(path: str, value: Any, base: Document = GOOD) -> Document:
    """``base`` with the field at ``path`` (dots, numbers for list items) replaced, or dropped."""
    document = copy.deepcopy(base)
    *parents, last = path.split(".")
    place: Any = document
    for part in parents:
        place = place[int(part)] if isinstance(place, list) else place.setdefault(part, {})
    if value is _DROP:
        del place[last]
    elif isinstance(place, list):
        place[int(last)] = value
    else:
        place[last] = value
    return document


def _raw(text: str) -> bytes:
    return json.dumps(GOOD).replace('"range_m": 16000.0', text).encode()


MALFORMED: list[tuple[str, Document | bytes | Any, str]] = [
    # missing
    ("no start", _with("start", _DROP), "start"),
    ("no destination", _with("destination", _DROP), "destination"),
    ("no stations", _with("stations", _DROP), "stations"),
    ("empty stations", _with("stations", []), "stations"),
    ("no limits", _with("limits", _DROP), "limits"),
    ("no latitude", _with("start.lat_deg", _DROP), "start.lat_deg"),
    ("no altitude", _with("destination.alt_amsl_m", _DROP), "destination.alt_amsl_m"),
    ("no station id", _with("stations.1.id", _DROP), "stations[1].id"),
    ("no range", _with("stations.0.range_m", _DROP), "stations[0].range_m"),
    ("no speed limit", _with("limits.max_speed_m_s", _DROP), "limits.max_speed_m_s"),
    ("null range", _with("stations.0.range_m", None), "stations[0].range_m"),
    # wrong type
    ("start is a list", _with("start", [52.9, 4.8, 100.0]), "start"),
    ("stations is an object", _with("stations", {"a": 1}), "stations"),
    ("station is text", _with("stations.0", "den-helder"), "stations[0]"),
    ("number as text", _with("stations.1.range_m", "18000"), "stations[1].range_m"),
    ("boolean as number", _with("limits.max_speed_m_s", True), "limits.max_speed_m_s"),
    ("list as number", _with("start.lat_deg", [52.9]), "start.lat_deg"),
    ("number as id", _with("stations.0.id", 7), "stations[0].id"),
    ("number as name", _with("name", 7), "name"),
    ("fraction as system id", _with("stations.0.system_id", 241.5), "stations[0].system_id"),
    ("options is text", _with("options", "fast"), "options"),
    # out of range
    ("negative range", _with("stations.0.range_m", -1.0), "stations[0].range_m"),
    ("zero range", _with("stations.0.range_m", 0), "stations[0].range_m"),
    ("absurd range", _with("stations.0.range_m", 1e9), "stations[0].range_m"),
    ("latitude 91", _with("start.lat_deg", 91.0), "start.lat_deg"),
    ("longitude 181", _with("stations.1.lon_deg", 181.0), "stations[1].lon_deg"),
    ("altitude of a satellite", _with("destination.alt_amsl_m", 400e3), "destination.alt_amsl_m"),
    ("zero speed", _with("limits.max_speed_m_s", 0.0), "limits.max_speed_m_s"),
    ("negative acceleration", _with("limits.max_accel_m_s2", -2.5), "limits.max_accel_m_s2"),
    ("zero jerk", _with("limits.max_jerk_m_s3", 0), "limits.max_jerk_m_s3"),
    ("band upside down", _with("limits.max_alt_amsl_m", 80.0), "limits.max_alt_amsl_m"),
    ("negative overlap", _with("options.min_overlap_s", -1), "options.min_overlap_s"),
    ("negative margin", _with("options.range_margin_m", -25.0), "options.range_margin_m"),
    ("negative tenure", _with("options.min_tenure_s", -0.1), "options.min_tenure_s"),
    ("negative handovers", _with("options.max_handovers", -1), "options.max_handovers"),
    ("zero arrival", _with("options.arrival_s", 0), "options.arrival_s"),
    ("objective out of range", _with("options.objective", 1.5), "options.objective"),
    ("objective unknown", _with("options.objective", "tiem"), "options.objective"),
    ("arrival action unknown", _with("options.on_arrival", "explode"), "options.on_arrival"),
    ("elevation above the zenith", _with("stations.0.min_elevation_deg", 95.0), "stations[0].min_elevation_deg"),
    ("wind without airspeed", _with("limits.wind", {"east_m_s": 3.0, "north_m_s": 0.0}), "limits.wind"),
    ("half a wind", _with("limits.wind", {"east_m_s": 3.0}), "limits.wind.north_m_s"),
    ("reserve without endurance", _with("limits.reserve_s", 60.0), "limits.reserve_s"),
    ("start state of two numbers", _with("options.start_state", {"velocity_m_s": [1.0, 2.0]}), "start_state"),
    ("start state of four numbers", _with("options.start_state", {"velocity_m_s": [1, 2, 3, 4]}), "velocity_m_s"),
    ("start state with text", _with("options.start_state", {"velocity_m_s": [1, "2", 3]}), "velocity_m_s.north"),
    ("reserve above endurance", _with("limits.reserve_s", 90.0, _with("limits.endurance_s", 80.0)), "limits.reserve_s"),
    ("objective true", _with("options.objective", True), "options.objective"),
    ("negative tolerance", _with("options.handover_tolerance", -0.001), "options.handover_tolerance"),
    ("tolerance in per cent", _with("options.handover_tolerance", 5), "options.handover_tolerance"),
    ("half a handover", _with("options.max_handovers", 1.5), "options.max_handovers"),
    ("arrival by the clock", _with("options.arrival_s", "10:00"), "options.arrival_s"),
    # not finite
    ("nan", _with("stations.0.range_m", math.nan), "stations[0].range_m"),
    ("infinity", _with("limits.max_speed_m_s", math.inf), "limits.max_speed_m_s"),
    ("number of 400 digits", _with("start.lat_deg", 10**400), "start.lat_deg"),
    ("overflowing literal", _raw('"range_m": 1e999'), "stations[0].range_m"),
    # ids
    ("duplicate station", _with("stations.1.id", "den-helder"), "stations[1].id"),
    ("empty id", _with("stations.0.id", ""), "stations[0].id"),
    ("blank id", _with("stations.0.id", "   "), "stations[0].id"),
    ("id with an equals sign", _with("stations.0.id", "a=b"), "stations[0].id"),
    ("id with a line break", _with("stations.0.id", "den\nhelder"), "stations[0].id"),
    ("id with a bell", _with("stations.0.id", "den\x07helder"), "stations[0].id"),
    ("id written backwards", _with("stations.0.id", "abc\u202edef"), "stations[0].id"),
    ("half a surrogate", _with("stations.0.name", "x\ud800"), "stations[0].name"),
    ("id of 65 characters", _with("stations.0.id", "x" * 65), "stations[0].id"),
    ("name of a novel", _with("name", "x" * 10_000), "name"),
    ("duplicate safe point", _with("safe_points", [GOOD["safe_points"][0]] * 2), "safe_points[1].id"),
    ("unknown excluded station", _with("options.excluded_stations", ["txel"]), "options.excluded_stations[0]"),
    ("all excluded", _with("options.excluded_stations", ["den-helder", "texel"]), "options.excluded_stations"),
    ("ids that differ in letter case", _with("stations.1.id", "Den-Helder"), "stations[1].id"),
    (
        "ids that differ in a blank",
        _with("stations.1.id", "denhelder", _with("stations.0.id", "den helder")),
        "stations[1].id",
    ),
    # system ids
    ("system id 0", _with("stations.0.system_id", 0), "stations[0].system_id"),
    ("system id 255", _with("stations.0.system_id", 255), "stations[0].system_id"),
    ("the vehicle's own id", _with("stations.1.system_id", 1), "stations[1].system_id"),
    (
        "system id twice",
        _with("stations.1.system_id", 241, _with("stations.0.system_id", 241)),
        "stations[1].system_id",
    ),
    ("vehicle id 300", _with("options.vehicle_system_id", 300), "options.vehicle_system_id"),
    (
        "the vehicle amid the stations",
        {
            **GOOD,
            "stations": [
                {**GOOD["stations"][0], "system_id": 240},
                {**GOOD["stations"][1], "system_id": 242},
                {**GOOD["stations"][1], "id": "third"},
            ],
            "options": {"vehicle_system_id": 241},
        },
        "stations",
    ),
    # unknown fields
    ("typo in a station", _with("stations.0.rnage_m", 5.0), "stations[0].rnage_m"),
    ("typo in an option", _with("options.min_overlap", 5.0), "options.min_overlap"),
    ("typo in the mission", _with("safepoints", []), "safepoints"),
    ("unknown limit", _with("limits.max_bank_deg", 30.0), "limits.max_bank_deg"),
    # frames
    ("local start without an origin", _with("start", GOOD_LOCAL["start"]), "start"),
    ("both frames in one position", _with("start.east_m", 5.0), "start"),
    ("geographic station with an origin", _with("stations.1", GOOD["stations"][1], GOOD_LOCAL), "stations[1]"),
    ("half an origin", _with("origin.lon_deg", _DROP, GOOD_LOCAL), "origin.lon_deg"),
    ("a station on the other side of the earth", _with("stations.1.lon_deg", -170.0), "stations[1]"),
    ("latitude and longitude swapped", _with("start", {"lat_deg": 4.8, "lon_deg": 52.9, "alt_amsl_m": 100.0}), "start"),
    ("altitude in feet", _with("start", {"lat_deg": 52.9, "lon_deg": 4.8, "alt_ft": 300}), "start.alt_ft"),
    ("a start of letters", _with("start", {"lat_deg": "N52", "lon_deg": "E4", "alt_amsl_m": "high"}), "start.lat_deg"),
    # other documents
    ("a plan", {"plan_sha256": "0", "mission": GOOD, "segments": []}, "mission"),
    ("GeoJSON", {"type": "FeatureCollection", "features": []}, "mission"),
    # not JSON
    ("not an object", b"[1, 2, 3]", "mission"),
    ("null", b"null", "mission"),
    ("empty body", b"", "mission"),
    ("truncated", json.dumps(GOOD).encode()[:-20], "mission"),
    ("trailing garbage", json.dumps(GOOD).encode() + b" }", "mission"),
    ("literal NaN", _raw('"range_m": NaN'), "mission"),
    ("literal Infinity", _raw('"range_m": -Infinity'), "mission"),
    ("key twice", _raw('"range_m": 1.0, "range_m": 16000.0'), "range_m"),
    ("not UTF-8", b'{"name": "\xff\xfe"}', "mission"),
    ("nested without end", b"[" * 100_000, "mission"),
    ("number of 5000 digits", _raw('"range_m": ' + "9" * 5_000), "mission"),
]
