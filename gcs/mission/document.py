"""Reading a mission from JSON, with every fault found. Writing it is `gcs.mission.writing`.

What is *malformed* is refused here, before anything is stored: wrong types, numbers out of range, unknown names, ids
used twice. What is well said but cannot be flown (a start outside the altitude band or out of every range) is
*infeasible*, and found by planning.
"""

from __future__ import annotations

import difflib
import math
import unicodedata
from collections.abc import Mapping
from dataclasses import fields, replace

from gcs.document_reader import MAX_DOCUMENT_BYTES, FaultList, Reader, parse_json, type_name
from gcs.errors import InputFault, MissionError
from gcs.mission.consistency import MAX_SPAN_M, check_ids, check_span, check_system_ids, same_system_ids
from gcs.mission.model import (
    MAX_STATIONS,
    GeoPosition,
    LocalPosition,
    Mission,
    MissionLimits,
    MissionOptions,
    Position,
    SafePoint,
    StartState,
    Station,
)
from gcs.mission.plausibility import check_masts
from gcs.mission.system_ids import HIGHEST_SYSTEM_ID, LOWEST_SYSTEM_ID
from gcs.mission.writing import write_mission

GEO_FIELDS = ("lat_deg", "lon_deg", "alt_amsl_m")
LOCAL_FIELDS = ("east_m", "north_m", "up_m")
STATION_FIELDS = ("id", "name", "range_m", "system_id", "contact", "radio_channel", "hours", "min_elevation_deg")
LIMIT_FIELDS = (
    "min_alt_amsl_m",
    "max_alt_amsl_m",
    "max_speed_m_s",
    "max_accel_m_s2",
    "max_jerk_m_s3",
    "max_climb_m_s",
    "max_descent_m_s",
    "max_airspeed_m_s",
    "wind",
    "endurance_s",
    "reserve_s",
)
OPTION_FIELDS = tuple(f.name for f in fields(MissionOptions))
_STATION_KEYS = frozenset((*STATION_FIELDS, *GEO_FIELDS, *LOCAL_FIELDS))
MISSION_FIELDS = ("name", "origin", "start", "destination", "stations", "limits", "safe_points", "options")

LOWEST_ALT_M, HIGHEST_ALT_M = -1_000.0, 50_000.0
MAX_RANGE_M = 500_000.0
MAX_SPEED_M_S = 1_000.0
MAX_TIME_S = 1_000_000.0
MAX_SAFE_POINTS = 1_000
# As long as so few faults are found, it is said what a wrong id may have been meant for.
MAX_GUESSES = 10


def parse_mission_json(
    data: bytes | str, *, max_bytes: int = MAX_DOCUMENT_BYTES, max_stations: int = MAX_STATIONS
) -> Mission:
    """The mission of JSON text; raises `MissionError`. See `gcs.document_reader.parse_json` for what counts as JSON."""
    return read_mission(parse_json(data, max_bytes=max_bytes), max_stations=max_stations)


def parse_option(text: str) -> tuple[str, object]:
    """``NAME=VALUE`` as (name, JSON value); a value that is not JSON is text. Raises `MissionError`."""
    name, equals, value = text.partition("=")
    name = name.strip()
    if not equals or name not in OPTION_FIELDS:
        close = difflib.get_close_matches(name, OPTION_FIELDS, n=1)
        fix = f"did you mean {close[0]}?" if close else "write NAME=VALUE"
        raise MissionError(
            [InputFault(f"options.{name or '?'}", "is not an option", text, ", ".join(OPTION_FIELDS), fix)]
        )
    try:
        return name, parse_json(value)
    except MissionError:
        return name, value.strip()


def read_mission(document: object, *, max_stations: int = MAX_STATIONS) -> Mission:
    """The mission of a parsed document; raises `MissionError` with every fault found."""
    faults = FaultList()
    _refuse_strangers(document)
    root = Reader(document, "", faults, MISSION_FIELDS)
    if not root.ok:
        raise MissionError(faults)
    local = root.has("origin")
    origin = _geo(root.child("origin", GEO_FIELDS)) if local else None
    name = root.text("name", 200) or "Unnamed mission"
    start = _position(root.child("start", (*GEO_FIELDS, *LOCAL_FIELDS)), local)
    destination = _position(root.child("destination", (*GEO_FIELDS, *LOCAL_FIELDS)), local)
    items = root.items("stations", max_stations, required=True)
    numbered = not same_system_ids([i.get("system_id") if isinstance(i, Mapping) else None for i in items], faults)
    stations = [
        _station(Reader(item, f"stations[{i}]", faults, _STATION_KEYS), local, numbered=numbered)
        for i, item in enumerate(items)
    ]
    if isinstance(root.data.get("stations"), list | tuple) and not root.data["stations"]:
        root.fault("stations", "is empty", "at least one station", "add the stations that are to guard the flight")
    safe_points = [
        _safe_point(Reader(item, f"safe_points[{i}]", faults, ("id", "name", *GEO_FIELDS, *LOCAL_FIELDS)), local)
        for i, item in enumerate(root.items("safe_points", MAX_SAFE_POINTS))
    ]
    limits = _limits(root.child("limits", LIMIT_FIELDS))
    options = MissionOptions()
    if root.has("options"):
        options = _options(root.child("options", OPTION_FIELDS), [s.id for s in stations])
    check_ids("stations", [s.id for s in stations], faults)
    check_ids("safe_points", [p.id for p in safe_points], faults)
    check_system_ids(stations, options.vehicle_system_id, faults)
    excluded = frozenset(options.excluded_stations)
    if stations and all(s.id in excluded for s in stations):
        what, fix = "leaves no station", "leave at least one of them in"
        faults.add("options.excluded_stations", what, list(options.excluded_stations), "not every station", fix)
    far: frozenset[int] = frozenset()
    if not local and not faults:
        far = check_span(start, destination, stations, safe_points, faults)
    check_masts([(s.id, s.position) for s in stations], origin, faults)
    left_out = tuple(stations[i].id for i in sorted(far))
    if far:
        gone = frozenset(left_out)
        stations = [station for i, station in enumerate(stations) if i not in far]
        kept = tuple(station for station in options.excluded_stations if station not in gone)
        options = replace(options, excluded_stations=kept)
    if faults:
        raise MissionError(faults)
    return Mission(
        start, destination, tuple(stations), limits, name, tuple(safe_points), options, origin, left_out=left_out
    )


def station_faults(document: object) -> list[InputFault]:
    """What is wrong with one station on its own, its place in latitude and longitude; by the rules of a mission."""
    faults = FaultList()
    _station(Reader(document, "", faults, frozenset((*STATION_FIELDS, *GEO_FIELDS))), local=False)
    return faults


def with_options(mission: Mission, changes: Mapping[str, object]) -> Mission:
    """The same mission with some options (JSON values, by their document names) replaced, and validated again."""
    document = write_mission(mission)
    options = document["options"]
    assert isinstance(options, dict)
    if "min_overlap_s" in changes:
        # Defaults follow the overlap.
        overlap_s = mission.options.min_overlap_s
        for name, default in (("handover_tolerance", _tolerance(overlap_s)), ("overlap_target_s", _target(overlap_s))):
            if options[name] == default:
                del options[name]
    changed = read_mission({**document, "options": {**options, **changes}}, max_stations=len(mission.stations))
    return replace(changed, left_out=mission.left_out)


def _tolerance(min_overlap_s: float) -> float:
    """The default of ``handover_tolerance``: where a handover asks for nothing it costs nothing."""
    return MissionOptions().handover_tolerance if min_overlap_s > 0.0 else 0.0


def _refuse_strangers(document: object) -> None:
    """Other documents a mission is taken for, refused as what they are and not field by field."""
    if not isinstance(document, Mapping):
        return
    if "plan_sha256" in document or "segments" in document:
        fault = InputFault(
            "mission", "is a plan, not a mission", None, "a mission", "give what stands in its field mission"
        )
        raise MissionError([fault])
    old = "MAV_AUTOPILOT" in document or "plannedHomePosition" in document
    if document.get("type") in ("FeatureCollection", "Feature") or document.get("fileType") == "Plan" or old:
        what = "is GeoJSON" if "type" in document else "is a QGroundControl plan"
        what = "is a mission file of an old QGroundControl" if old and "fileType" not in document else what
        fix = "write it as a mission: start, destination, stations, limits"
        raise MissionError([InputFault("mission", f"{what}, not a mission", None, "a mission", fix)])


def _geo(reader: Reader) -> GeoPosition:
    return GeoPosition(
        reader.number("lat_deg", -90.0, 90.0, "degrees"),
        reader.number("lon_deg", -180.0, 180.0, "degrees"),
        reader.number("alt_amsl_m", LOWEST_ALT_M, HIGHEST_ALT_M, "m above mean sea level"),
    )


def _position(reader: Reader, local: bool) -> Position:
    wrong = GEO_FIELDS if local else LOCAL_FIELDS
    strangers = [key for key in wrong if reader.has(key)]
    if strangers:
        if local:
            what, fix = (
                "is geographic in a mission with an origin",
                "give east_m, north_m and up_m, or remove the origin",
            )
        else:
            what = "is local in a mission without an origin"
            fix = "give lat_deg, lon_deg and alt_amsl_m, or an origin and local positions everywhere"
        reader.fault(strangers[0], what, "one frame in the whole mission", fix)
        if not any(reader.has(key) for key in (LOCAL_FIELDS if local else GEO_FIELDS)):
            return LocalPosition(math.nan, math.nan, math.nan)
    if not local:
        return _geo(reader)
    return LocalPosition(
        reader.number("east_m", -MAX_SPAN_M, MAX_SPAN_M, "m"),
        reader.number("north_m", -MAX_SPAN_M, MAX_SPAN_M, "m"),
        reader.number("up_m", LOWEST_ALT_M, HIGHEST_ALT_M, "m above the origin"),
    )


def _station(reader: Reader, local: bool, *, numbered: bool = True) -> Station:
    identifier = reader.identifier("id")
    given = reader.integer("system_id", LOWEST_SYSTEM_ID, HIGHEST_SYSTEM_ID, default=None) if numbered else None
    return Station(
        id=identifier,
        position=_position(reader, local),
        range_m=reader.number("range_m", 0.0, MAX_RANGE_M, "m", above_low=True),
        name=reader.text("name", 200) or identifier,
        system_id=given,
        contact=reader.text("contact", 200),
        radio_channel=reader.text("radio_channel", 200),
        hours=reader.text("hours", 200),
        min_elevation_deg=reader.optional_number("min_elevation_deg", 0.0, 85.0, "degrees"),
    )


def _safe_point(reader: Reader, local: bool) -> SafePoint:
    identifier = reader.identifier("id")
    return SafePoint(identifier, _position(reader, local), reader.text("name", 200) or identifier)


def _limits(reader: Reader) -> MissionLimits:
    def positive(key: str, high: float, unit: str) -> float | None:
        return reader.optional_number(key, 0.0, high, unit, above_low=True)

    low = reader.number("min_alt_amsl_m", LOWEST_ALT_M, HIGHEST_ALT_M, "m above mean sea level")
    high = reader.number("max_alt_amsl_m", LOWEST_ALT_M, HIGHEST_ALT_M, "m above mean sea level")
    if low > high:
        reader.fault("max_alt_amsl_m", f"is below min_alt_amsl_m ({low:g} m)", f"at least {low:g} m", "swap the two")
    wind = None
    if reader.has("wind"):
        air = reader.child("wind", ("east_m_s", "north_m_s"))
        wind = (air.number("east_m_s", -200.0, 200.0, "m/s"), air.number("north_m_s", -200.0, 200.0, "m/s"))
    limits = MissionLimits(
        min_alt_amsl_m=low,
        max_alt_amsl_m=high,
        max_speed_m_s=reader.number("max_speed_m_s", 0.0, MAX_SPEED_M_S, "m/s", above_low=True),
        max_accel_m_s2=reader.number("max_accel_m_s2", 0.0, 1_000.0, "m/s^2", above_low=True),
        max_jerk_m_s3=positive("max_jerk_m_s3", 100_000.0, "m/s^3"),
        max_climb_m_s=positive("max_climb_m_s", MAX_SPEED_M_S, "m/s"),
        max_descent_m_s=positive("max_descent_m_s", MAX_SPEED_M_S, "m/s"),
        max_airspeed_m_s=positive("max_airspeed_m_s", MAX_SPEED_M_S, "m/s"),
        wind_m_s=wind,
        endurance_s=positive("endurance_s", MAX_TIME_S, "s"),
        reserve_s=reader.optional_number("reserve_s", 0.0, MAX_TIME_S, "s"),
    )
    if wind is not None and not reader.has("max_airspeed_m_s"):
        reader.fault("wind", "has no effect without max_airspeed_m_s", fix="add max_airspeed_m_s, or remove the wind")
    if limits.reserve_s is not None:
        if not reader.has("endurance_s"):
            reader.fault("reserve_s", "has no effect without endurance_s", fix="add endurance_s, or remove the reserve")
        elif limits.endurance_s is not None and limits.reserve_s >= limits.endurance_s:
            reader.fault(
                "reserve_s", "leaves nothing of endurance_s", f"less than {limits.endurance_s:g} s", "lower it"
            )
    return limits


def _options(reader: Reader, station_ids: list[str]) -> MissionOptions:
    default = MissionOptions()
    vehicle = reader.integer(
        "vehicle_system_id", LOWEST_SYSTEM_ID, HIGHEST_SYSTEM_ID, default=default.vehicle_system_id
    )
    excluded: list[str] = []
    known = frozenset(station_ids)
    for i, item in enumerate(reader.items("excluded_stations", MAX_STATIONS)):
        if isinstance(item, str):
            item = unicodedata.normalize("NFC", item)
        if not isinstance(item, str) or item not in known:
            # Looking for what was meant takes a second on the largest maps.
            close = difflib.get_close_matches(str(item), station_ids, n=1) if len(reader.faults) < MAX_GUESSES else []
            fix = f"did you mean {close[0]}?" if close else "give the id of a station of this mission"
            where = reader.path(f"excluded_stations[{i}]")
            reader.faults.add(where, "is no station of this mission", item, "ids of stations", fix)
        else:
            excluded.append(item)
    overlap_s = reader.number("min_overlap_s", 0.0, 3_600.0, "s", default=default.min_overlap_s)
    return MissionOptions(
        min_overlap_s=overlap_s,
        range_margin_m=reader.number("range_margin_m", 0.0, MAX_RANGE_M, "m", default=default.range_margin_m),
        min_tenure_s=reader.number("min_tenure_s", 0.0, 86_400.0, "s", default=default.min_tenure_s),
        vehicle_system_id=default.vehicle_system_id if vehicle is None else vehicle,
        on_arrival=reader.choice("on_arrival", ("land", "hold"), default.on_arrival),
        excluded_stations=tuple(dict.fromkeys(excluded)),
        max_handovers=reader.integer("max_handovers", 0, MAX_STATIONS, default=None),
        handover_tolerance=reader.number(
            "handover_tolerance", 0.0, 1.0, "(part of the mission time)", default=_tolerance(overlap_s)
        ),
        overlap_target_s=_overlap_target(reader, overlap_s),
        objective=_objective(reader),
        start_state=_start_state(reader) if reader.has("start_state") else None,
        arrival_s=reader.optional_number("arrival_s", 0.0, MAX_TIME_S, "s", above_low=True),
    )


def _overlap_target(reader: Reader, min_overlap_s: float) -> str | float:
    value = reader.data.get("overlap_target_s")
    if value is None:
        return _target(min_overlap_s)
    if isinstance(value, str):
        return reader.choice("overlap_target_s", ("auto",), "auto")
    return reader.number("overlap_target_s", 0.0, 3_600.0, "s")


def _target(min_overlap_s: float) -> str | float:
    """The default of ``overlap_target_s``."""
    return MissionOptions().overlap_target_s if min_overlap_s > 0.0 else 0.0


def _objective(reader: Reader) -> str | float:
    value = reader.data.get("objective")
    if value is None:
        return "time"
    if isinstance(value, str):
        return reader.choice("objective", ("time", "energy"), "time")
    if isinstance(value, bool) or not isinstance(value, int | float):
        allowed = "time, energy, or a weight of energy from 0 to 1"
        reader.fault("objective", f"must be a word or a number, not {type_name(value)}", allowed, "choose one of them")
        return "time"
    return reader.number("objective", 0.0, 1.0, "(weight of energy)")


def _start_state(reader: Reader) -> StartState:
    state = reader.child("start_state", ("velocity_m_s", "acceleration_m_s2"))

    def vector(key: str, unit: str) -> tuple[float, float, float]:
        if not state.has(key):
            return 0.0, 0.0, 0.0
        items = state.data[key]
        if not isinstance(items, list | tuple) or len(items) != 3:
            what = f"must be a list of three numbers, not {type_name(items)}"
            if isinstance(items, list | tuple):
                what = f"must have three numbers, not {len(items)}"
            state.fault(key, what, f"[east, north, up] in {unit}", "give all three, 0 where there is none")
            return 0.0, 0.0, 0.0
        part = Reader(
            dict(zip(("east", "north", "up"), items, strict=True)),
            state.path(key),
            state.faults,
            ("east", "north", "up"),
        )
        east, north, up = (part.number(axis, -MAX_SPEED_M_S, MAX_SPEED_M_S, unit) for axis in ("east", "north", "up"))
        return east, north, up

    return StartState(vector("velocity_m_s", "m/s"), vector("acceleration_m_s2", "m/s^2"))
