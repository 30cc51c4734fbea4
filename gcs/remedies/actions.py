"""What a fix does to a mission, and the search for fixes that only planning can find.

A fix is data (``{"action": "raise_range", ...}``, see `gcs.remedies.wording`). `apply_fix` carries one out, so that
every fix offered is one that was tried. Where ranges are at fault the planner itself solves for the least change. Where
a flight takes too long, or cannot take up its start state, nothing but planning again tells: every option that costs
time is given up as far as it takes, and no further (`Search`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from gcs.errors import MissionInfeasible
from gcs.layout.planning_problem import lay_out
from gcs.mission.model import GeoPosition, LocalPosition, Mission, Position, StartState, Station
from planner.infeasibility import diagnose

Fix = dict[str, object]
ADDED_STATION = "added"


def number(value: object) -> float:
    """A number out of a fix."""
    assert isinstance(value, int | float | np.integer | np.floating)
    return float(value)


def apply_fix(mission: Mission, fix: Mapping[str, object]) -> Mission:
    """The mission with a fix, and what it names under ``also``, carried out. ``ValueError`` for an unknown action."""
    also = fix.get("also")
    for step in (fix, *(also if isinstance(also, list | tuple) else ())):
        mission = _applied(mission, step)
    return mission


def _applied(mission: Mission, fix: Mapping[str, object]) -> Mission:
    options, limits = mission.options, mission.limits
    match fix["action"]:
        case "raise_range":
            return _with_station(mission, fix, lambda s: replace(s, range_m=s.range_m + number(fix["by_m"])))
        case "raise_all_ranges":
            by = number(fix["by_m"])
            return replace(mission, stations=tuple(replace(s, range_m=s.range_m + by) for s in mission.stations))
        case "lower_margin":
            return replace(mission, options=replace(options, range_margin_m=number(fix["range_margin_m"])))
        case "lower_option":
            return replace(mission, options=replace(options, **{str(fix["option"]): number(fix["to"])}))  # type: ignore[arg-type]
        case "lower_elevation":
            to = fix["to_deg"]
            return _with_station(
                mission, fix, lambda s: replace(s, min_elevation_deg=None if to is None else number(to))
            )
        case "lower_elevations":
            lowered = tuple(
                replace(s, min_elevation_deg=_lowered(s.min_elevation_deg, number(fix["by_deg"])))
                for s in mission.stations
            )
            return replace(mission, stations=lowered)
        case "widen_band":
            return replace(
                mission,
                limits=replace(
                    limits,
                    min_alt_amsl_m=number(fix.get("min_alt_amsl_m", limits.min_alt_amsl_m)),
                    max_alt_amsl_m=number(fix.get("max_alt_amsl_m", limits.max_alt_amsl_m)),
                ),
            )
        case "set_altitude":
            return _with_end(mission, str(fix["of"]), _at_altitude(mission, str(fix["of"]), number(fix["alt_amsl_m"])))
        case "move":
            return _with_end(mission, str(fix["of"]), _position(mission, fix["position"]))
        case "add_station":
            name = ADDED_STATION
            while any(s.id == name for s in mission.stations):
                name += "-x"
            added = Station(name, _position(mission, fix["position"]), number(fix["range_m"]), name)
            return replace(mission, stations=(*mission.stations, added))
        case "include_station":
            kept = tuple(one for one in options.excluded_stations if one != fix["station"])
            return replace(mission, options=replace(options, excluded_stations=kept))
        case "raise_limit" if fix["limit"] == "max_handovers":
            return replace(mission, options=replace(options, max_handovers=int(number(fix["to"]))))
        case "raise_limit" | "lower_limit":
            return replace(mission, limits=replace(limits, **{str(fix["limit"]): number(fix["to"])}))  # type: ignore[arg-type]
        case "lower_wind":
            wind = (number(fix["east_m_s"]), number(fix["north_m_s"]))
            return replace(mission, limits=replace(limits, wind_m_s=wind))
        case "lower_start_speed":
            state = StartState(_triple(fix["velocity_m_s"]), _triple(fix["acceleration_m_s2"]))
            return replace(mission, options=replace(options, start_state=state))
        case "later_arrival" | "earlier_arrival":
            return replace(mission, options=replace(options, arrival_s=number(fix["arrival_s"])))
    raise ValueError(f"no such fix: {fix['action']!r}")


def _with_station(mission: Mission, fix: Mapping[str, object], change: Callable[[Station], Station]) -> Mission:
    return replace(mission, stations=tuple(change(s) if s.id == fix["station"] else s for s in mission.stations))


def _lowered(angle_deg: float | None, by_deg: float) -> float | None:
    return None if angle_deg is None or angle_deg <= by_deg else angle_deg - by_deg


def _with_end(mission: Mission, end: str, position: Position) -> Mission:
    return replace(mission, start=position) if end == "start" else replace(mission, destination=position)


def _at_altitude(mission: Mission, end: str, amsl_m: float) -> Position:
    position = mission.start if end == "start" else mission.destination
    if isinstance(position, GeoPosition):
        return replace(position, alt_amsl_m=amsl_m)
    assert mission.origin is not None
    return replace(position, up_m=amsl_m - mission.origin.alt_amsl_m)


def _position(mission: Mission, place: object) -> Position:
    """The place a fix names, in the mission's own frame."""
    assert isinstance(place, Mapping)
    if mission.origin is None:
        return GeoPosition(number(place["lat_deg"]), number(place["lon_deg"]), number(place["alt_amsl_m"]))
    return LocalPosition(number(place["east_m"]), number(place["north_m"]), number(place["up_m"]))


def _triple(values: object) -> tuple[float, float, float]:
    assert isinstance(values, Sequence)
    east, north, up = (number(x) for x in values)
    return east, north, up


def chains(mission: Mission) -> bool:
    """Whether ranges, band, elevations and handovers allowed leave a way from start to destination."""
    try:
        return diagnose(lay_out(mission).problem) is None
    except MissionInfeasible:
        return False


def cost_order(fix: Mapping[str, object]) -> tuple[int, float]:
    """What fixes are sorted by: what is asked of the mission, then metres in all, then what asks for many or a new one.

    An option or an angle first; one place's metres next; a station that was left out on purpose, every station's
    range, and at last a station more.
    """
    late = ("include_station", "raise_all_ranges", "add_station")
    if fix["action"] in late:
        return 2 + late.index(str(fix["action"])), 0.0
    also = fix.get("also")
    steps = [fix, *(also if isinstance(also, list | tuple) else ())]
    if not all("by_m" in step for step in steps):
        return 0, 0.0
    return 1, sum(abs(number(step["by_m"])) for step in steps)
