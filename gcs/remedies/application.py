"""Remedies carried out: a mission as it would be after the changes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from gcs.mission.model import GeoPosition, Mission, Position, StartState, Station
from gcs.remedies.changes import (
    AddStation,
    Change,
    EarlierArrival,
    IncludeStation,
    LaterArrival,
    LowerElevation,
    LowerElevations,
    LowerLimit,
    LowerMargin,
    LowerOption,
    LowerStartSpeed,
    LowerWind,
    Move,
    RaiseAllRanges,
    RaiseLimit,
    RaiseRange,
    SetAltitude,
    WidenBand,
)
from gcs.remedies.remedy import Remedy

ADDED_STATION = "added"


def applied(mission: Mission, remedy: Remedy) -> Mission:
    """The mission with every change of a remedy made, in order."""
    for change in remedy:
        mission = apply(mission, change)
    return mission


def apply(mission: Mission, change: Change) -> Mission:
    """The mission with one change made."""
    match change:
        case RaiseRange(station, by_m):
            return _each_station(mission, lambda s: replace(s, range_m=s.range_m + by_m), station)
        case RaiseAllRanges(by_m):
            return _each_station(mission, lambda s: replace(s, range_m=s.range_m + by_m))
        case LowerMargin(_, range_margin_m):
            return _with_options(mission, range_margin_m=range_margin_m)
        case LowerOption(option, _, to):
            return _with_options(mission, **{option: to})
        case LowerElevation(station, to_deg):
            return _each_station(mission, lambda s: replace(s, min_elevation_deg=to_deg), station)
        case LowerElevations(by_deg):
            return _each_station(mission, lambda s: replace(s, min_elevation_deg=_lowered(s.min_elevation_deg, by_deg)))
        case WidenBand(low_m, high_m):
            given = {"min_alt_amsl_m": low_m, "max_alt_amsl_m": high_m}
            return _with_limits(mission, **{name: value for name, value in given.items() if value is not None})
        case SetAltitude(of, alt_amsl_m):
            return _with_end(mission, of, _at_altitude(mission, of, alt_amsl_m))
        case Move(of, location):
            return _with_end(mission, of, location.position)
        case AddStation(location, range_m):
            name = ADDED_STATION
            while any(s.id == name for s in mission.stations):
                name += "-x"
            return replace(mission, stations=(*mission.stations, Station(name, location.position, range_m, name)))
        case IncludeStation(station):
            kept = tuple(one for one in mission.options.excluded_stations if one != station)
            return _with_options(mission, excluded_stations=kept)
        case RaiseLimit("max_handovers", _, to):
            return _with_options(mission, max_handovers=int(to))
        case RaiseLimit(limit, _, to) | LowerLimit(limit, _, to):
            return _with_limits(mission, **{limit: to})
        case LowerWind(_, east_m_s, north_m_s):
            return _with_limits(mission, wind_m_s=(east_m_s, north_m_s))
        case LowerStartSpeed(_, velocity_m_s, acceleration_m_s2):
            return _with_options(mission, start_state=StartState(velocity_m_s, acceleration_m_s2))
        case LaterArrival(_, arrival_s) | EarlierArrival(_, arrival_s):
            return _with_options(mission, arrival_s=arrival_s)


def _each_station(mission: Mission, change: Callable[[Station], Station], only: str | None = None) -> Mission:
    return replace(mission, stations=tuple(change(s) if only in (None, s.id) else s for s in mission.stations))


def _lowered(angle_deg: float | None, by_deg: float) -> float | None:
    return None if angle_deg is None or angle_deg <= by_deg else angle_deg - by_deg


def _with_options(mission: Mission, **values: Any) -> Mission:
    return replace(mission, options=replace(mission.options, **values))


def _with_limits(mission: Mission, **values: Any) -> Mission:
    return replace(mission, limits=replace(mission.limits, **values))


def _with_end(mission: Mission, end: str, position: Position) -> Mission:
    return replace(mission, start=position) if end == "start" else replace(mission, destination=position)


def _at_altitude(mission: Mission, end: str, amsl_m: float) -> Position:
    position = mission.start if end == "start" else mission.destination
    if isinstance(position, GeoPosition):
        return replace(position, alt_amsl_m=amsl_m)
    assert mission.origin is not None
    return replace(position, up_m=amsl_m - mission.origin.alt_amsl_m)
