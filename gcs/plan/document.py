"""Reading a plan document: shape, hash, and that what it says twice agrees."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from gcs.document_reader import FaultList, Reader
from gcs.errors import MissionError, PlanError
from gcs.geodesy.plane import Plane
from gcs.mission.document import read_mission
from gcs.plan.contingency import Contingency
from gcs.plan.handover_schedule import Handover
from gcs.plan.model import PROJECTION, Fastest, OptionCost, Plan, hash_of
from planner import Certificate, ProblemError, Trajectory

MAX_SEGMENTS = 100_000
# Whether a mission is too large was asked when it was planned.
MAX_STATIONS = 1_000_000
_BIG = 1e9

_FIELDS = (
    "plan_sha256",
    "created_utc",
    "planner",
    "mission",
    "mission_time_s",
    "path_length_m",
    "lower_bound_s",
    "solve_time_s",
    "origin",
    "projection",
    "stations",
    "segments",
    "handovers",
    "contingencies",
    "certificate",
)
# There when they were asked for, or when there is something to say.
_OPTIONAL_FIELDS = ("costs", "fastest")


def read_plan(document: object) -> Plan:
    """The plan of a document; raises `PlanError` when its shape or its hash is not right, or its parts disagree."""
    faults = FaultList()
    root = Reader(document, "", faults, (*_FIELDS, *_OPTIONAL_FIELDS))
    _raise_first(faults)
    assert isinstance(document, Mapping)
    for key in _FIELDS:
        if key not in document:
            raise PlanError("is missing", key)
    claimed = document["plan_sha256"]
    actual = hash_of(document)
    if claimed != actual:
        raise PlanError(f"does not fit the document, whose hash is {actual}: it was altered", "plan_sha256")
    try:
        mission = read_mission(document["mission"], max_stations=MAX_STATIONS)
    except MissionError as error:
        first = error.problems[0]
        raise PlanError(f"{first.what}; {error}", f"mission.{first.where}") from None
    origin = root.child("origin", ("lat_deg", "lon_deg", "alt_amsl_m"))
    lat, lon = origin.number("lat_deg", -90.0, 90.0, "degrees"), origin.number("lon_deg", -180.0, 180.0, "degrees")
    alt = origin.number("alt_amsl_m", -1e5, 1e5, "m")
    _raise_first(faults)
    if document["projection"] != PROJECTION:
        raise PlanError(f"must be {PROJECTION}", "projection")
    index = {station.id: i for i, station in enumerate(mission.stations)}
    trajectory = _read_curve(root, index, faults)
    planner = root.child("planner", ("version", "method", "iterations", "notes"))
    notes = planner.items("notes", 1000)
    certificate = root.child("certificate", ("feasible", "worst"))
    worst = certificate.data.get("worst")
    if not isinstance(worst, Mapping) or not all(_is_number(v) for v in worst.values()):
        raise PlanError("must be an object of numbers", "certificate.worst")
    plan = Plan(
        mission=mission,
        trajectory=trajectory,
        plane=Plane(lat, lon, alt),
        handovers=_read_handovers(root, index, faults),
        contingencies=_read_contingencies(root, {p.id for p in mission.safe_points}, faults),
        certificate=Certificate({str(k): float(v) for k, v in worst.items()}),
        lower_bound_s=root.number("lower_bound_s", 0.0, _BIG, "s"),
        path_length_m=root.number("path_length_m", 0.0, _BIG, "m"),
        solve_time_s=root.number("solve_time_s", 0.0, _BIG, "s"),
        created_utc=root.text("created_utc", 40, required=True) or "",
        method=planner.text("method", 200, required=True) or "",
        planner_version=planner.text("version", 100, required=True) or "",
        iterations=planner.integer("iterations", 0, 10**9, default=0) or 0,
        notes=tuple(str(note) for note in notes),
        costs=_read_costs(root, faults),
        fastest=_read_fastest(root) if root.has("fastest") else None,
    )
    _raise_first(faults)
    _check_agreement(plan, document)
    return plan


def _check_agreement(plan: Plan, document: Mapping[str, object]) -> None:
    """What is said twice must agree, and the plan must write the document it was read from."""
    expected = plan.trajectory.handover_times_s
    ids = plan.station_ids
    if len(plan.handovers) != len(expected):
        raise PlanError(
            f"has {len(plan.handovers)} entries, but the segments change station {len(expected)} times", "handovers"
        )
    for k, handover in enumerate(plan.handovers):
        where = f"handovers[{k}]"
        if (handover.index, handover.from_station, handover.to_station) != (k + 1, ids[k], ids[k + 1]):
            raise PlanError(f"is not number {k + 1}, from {ids[k]} to {ids[k + 1]}, as the segments say", where)
        if abs(handover.time_s - expected[k]) > 1e-9 * max(1.0, expected[k]):
            raise PlanError(f"time_s is not when the segments change station, {expected[k]}", where)
    for index in plan.trajectory.sequence:
        if plan.mission.stations[index].system_id is None:
            raise PlanError("a station in control has no system id", f"mission.stations[{index}].system_id")
    if plan.plan_sha256 != document["plan_sha256"]:
        raise PlanError("holds values that say something else than its segments, or fields of another version")


def _read_curve(root: Reader, index: Mapping[str, int], faults: FaultList) -> Trajectory:
    stations, durations = [], []
    curves: list[list[object]] = []
    for k, item in enumerate(root.items("segments", MAX_SEGMENTS, required=True)):
        segment = Reader(item, f"segments[{k}]", faults, ("station", "start_s", "duration_s", "control_points"))
        station = segment.data.get("station")
        if not isinstance(station, str) or station not in index:
            segment.fault("station", "is no station of the mission")
            break
        stations.append(index[station])
        segment.number("start_s", 0.0, _BIG, "s")
        durations.append(segment.number("duration_s", 0.0, _BIG, "s", above_low=True))
        points = segment.items("control_points", 100, required=True)
        if not all(
            isinstance(p, Sequence) and not isinstance(p, str) and len(p) == 3 and all(_is_number(x) for x in p)
            for p in points
        ) or (curves and len(points) != len(curves[0])):
            segment.fault("control_points", "must be points [east, north, up], equally many in every segment")
            break
        curves.append(points)
    _raise_first(faults)
    try:
        return Trajectory(np.array(curves, dtype=float), np.array(durations), np.array(stations, dtype=np.int64))
    except (ProblemError, ValueError) as error:
        raise PlanError(str(error), "segments") from None


def _read_handovers(root: Reader, index: Mapping[str, int], faults: FaultList) -> tuple[Handover, ...]:
    names = ("index", "time_s", "from", "to", "position", "speed_m_s", "course_deg", "overlap", "margin")
    result = []
    for k, item in enumerate(root.items("handovers", MAX_SEGMENTS)):
        at = Reader(item, f"handovers[{k}]", faults, names)
        for key in ("from", "to"):
            if at.data.get(key) not in index:
                at.fault(key, "is no station of the mission")
        position = at.child("position", ("lat_deg", "lon_deg", "alt_amsl_m"))
        overlap, margin = at.child("overlap", ("start_s", "end_s")), at.child("margin", ("from_m", "to_m"))
        result.append(
            Handover(
                index=at.integer("index", 1, MAX_SEGMENTS, default=0) or 0,
                time_s=at.number("time_s", 0.0, _BIG, "s"),
                from_station=str(at.data.get("from")),
                to_station=str(at.data.get("to")),
                lat_deg=position.number("lat_deg", -90.0, 90.0, "degrees"),
                lon_deg=position.number("lon_deg", -180.0, 180.0, "degrees"),
                alt_amsl_m=position.number("alt_amsl_m", -_BIG, _BIG, "m"),
                speed_m_s=at.number("speed_m_s", 0.0, _BIG, "m/s"),
                course_deg=at.number("course_deg", 0.0, 360.0, "degrees"),
                overlap_start_s=overlap.number("start_s", 0.0, _BIG, "s"),
                overlap_end_s=overlap.number("end_s", 0.0, _BIG, "s"),
                margin_from_m=margin.number("from_m", -_BIG, _BIG, "m"),
                margin_to_m=margin.number("to_m", -_BIG, _BIG, "m"),
            )
        )
    return tuple(result)


def _read_contingencies(root: Reader, safe_points: set[str], faults: FaultList) -> tuple[Contingency, ...]:
    names = (
        *("from_s", "to_s", "action", "safe_point", "covered", "duration_s", "straight_home_covered", "leave_path_s"),
        *("own_return_covered", "own_return_s"),
    )
    result = []
    for k, item in enumerate(root.items("contingencies", MAX_SEGMENTS)):
        at = Reader(item, f"contingencies[{k}]", faults, names)
        point = at.data.get("safe_point")
        if point is not None and point not in safe_points:
            at.fault("safe_point", "is no safe point of the mission")
        for key in ("covered", "straight_home_covered"):
            if not isinstance(at.data.get(key), bool):
                at.fault(key, "must be true or false")
        own_covered = at.data.get("own_return_covered")
        if own_covered is not None and not isinstance(own_covered, bool):
            at.fault("own_return_covered", "must be true or false")
        result.append(
            Contingency(
                from_s=at.number("from_s", 0.0, _BIG, "s"),
                to_s=at.number("to_s", 0.0, _BIG, "s"),
                action=at.choice("action", ("return", "divert", "hold"), "return"),
                safe_point=None if point is None else str(point),
                covered=at.data.get("covered") is True,
                duration_s=at.number("duration_s", 0.0, _BIG, "s"),
                straight_home_covered=at.data.get("straight_home_covered") is True,
                leave_path_s=at.optional_number("leave_path_s", 0.0, _BIG, "s"),
                failsafe_return_covered=own_covered if isinstance(own_covered, bool) else None,
                failsafe_return_s=at.optional_number("own_return_s", 0.0, _BIG, "s"),
            )
        )
    return tuple(result)


def _read_costs(root: Reader, faults: FaultList) -> tuple[OptionCost, ...]:
    result = []
    for k, item in enumerate(root.items("costs", 100)):
        at = Reader(item, f"costs[{k}]", faults, ("option", "value", "cost_s"))
        cost_s = at.optional_number("cost_s", -_BIG, _BIG, "s")
        result.append(OptionCost(str(at.data.get("option")), str(at.data.get("value")), cost_s))
    return tuple(result)


def _read_fastest(root: Reader) -> Fastest:
    at = root.child("fastest", ("mission_time_s", "handovers", "fewer_cost_s"))
    time_s = at.number("mission_time_s", 0.0, _BIG, "s")
    handovers = at.integer("handovers", 0, MAX_SEGMENTS, default=0) or 0
    return Fastest(time_s, handovers, at.number("fewer_cost_s", -_BIG, _BIG, "s"))


def _is_number(value: object) -> bool:
    return (
        isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= _BIG and math.isfinite(value)
    )


def _raise_first(faults: FaultList) -> None:
    if faults:
        fault = faults[0]
        more = f" ({fault.allowed})" if fault.allowed else ""
        raise PlanError(f"{fault.what}{more}", fault.where if fault.where != "mission" else "")
