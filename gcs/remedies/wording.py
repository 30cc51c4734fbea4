"""The planner's finding in an operator's words: stations by id, places on the earth, the smallest fix.

The planner speaks of balls in the plane; a fix here is one of the mission document, so that doing what it says makes
the mission feasible: ranges grow by what the projection's correction will take off again. Every fix is carried out on
a copy of the mission before it is offered, and the smallest comes first.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gcs.errors import MissionInfeasible
from gcs.geodesy.range_bounds import planning_elevation_deg, range_needed_m
from gcs.layout.mission_geometry import MissionGeometry
from gcs.mission.model import Mission
from gcs.remedies.actions import Fix, apply_fix, chains, cost_order, number
from planner import Infeasibility

Array = NDArray[np.float64]

# Shares by which a fix is made larger until it holds: the earth's plane shifts a little with what a fix moves.
PADS = (0.0, 1e-9, 1e-6, 1e-4, 2e-3)
# Above this many stations fixes are not tried.
MAX_TRIED = 2_000


def explain(
    geometry: MissionGeometry, stations: NDArray[np.int64], finding: Infeasibility, planned_ranges_m: Array
) -> MissionInfeasible:
    """``finding`` in the mission's terms.

    ``stations`` are the mission's indices of the problem's stations and ``planned_ranges_m`` the problem's ranges.
    """
    mission = geometry.mission
    ids = [mission.stations[int(stations[k])].id for k in finding.stations]
    where = None
    if finding.position_m is not None:
        where = _place(geometry, finding.position_m)
    remedy = _Remedy(geometry, stations, planned_ranges_m)
    fixes = _fixes(mission, remedy, finding)
    fix = {**fixes[0], "alternatives": fixes[1:]} if len(fixes) > 1 else fixes[0] if fixes else None
    return MissionInfeasible(
        finding.reason,
        _message(geometry, finding, ids),
        stations=ids,
        where=where,
        gap_m=finding.gap_m,
        fix=fix,
        fix_text="" if fix is None else words(fix),
    )


def _fixes(mission: Mission, remedy: _Remedy, finding: Infeasibility) -> list[Fix]:
    """The finding's remedies as fixes of the mission that hold, and stations that need not be left out; sorted."""
    if finding.fix is None:
        return []
    alternatives = finding.fix.get("alternatives", [])
    assert isinstance(alternatives, list)
    found = [{key: value for key, value in finding.fix.items() if key != "alternatives"}, *alternatives]
    if len(mission.stations) > MAX_TRIED:
        return [remedy.translate(one) for one in found]
    holding = [fix for one in found if (fix := _holding(mission, remedy, one)) is not None]
    for station in mission.options.excluded_stations:
        include: Fix = {"action": "include_station", "station": station}
        if chains(apply_fix(mission, include)):
            holding.append(include)
            break
    return sorted(holding, key=cost_order)


def _holding(mission: Mission, remedy: _Remedy, found: Mapping[str, object]) -> Fix | None:
    """A remedy as a fix that cures the mission, made a little larger where rounding and the earth ask for it."""
    for pad in PADS:
        fix = remedy.translate(_padded(found, pad))
        if chains(apply_fix(mission, fix)):
            return fix
    return None


def _padded(fix: Mapping[str, object], pad: float) -> Fix:
    larger: Fix = {
        key: number(value) * (1.0 + pad) if key in ("by_m", "by_deg", "range_m") else value
        for key, value in fix.items()
    }
    if "min_alt_m" in fix:
        larger["min_alt_m"] = number(fix["min_alt_m"]) - pad * number(fix["by_m"])
    if "max_alt_m" in fix:
        larger["max_alt_m"] = number(fix["max_alt_m"]) + pad * number(fix["by_m"])
    if "to_deg" in fix:
        larger["to_deg"] = number(fix["to_deg"]) - pad
    also = fix.get("also")
    if isinstance(also, list | tuple):
        larger["also"] = [_padded(one, pad) for one in also]
    return larger


def _place(geometry: MissionGeometry, position_m: Sequence[float]) -> dict[str, float]:
    """A plane point in every frame the mission has."""
    east, north, up = (float(x) for x in position_m)
    place = geometry.geo(np.array([east, north, up]))
    where = {"lat_deg": place.lat_deg, "lon_deg": place.lon_deg, "alt_amsl_m": place.alt_amsl_m}
    return where | ({"east_m": east, "north_m": north, "up_m": up} if geometry.is_local else {})


@dataclass(frozen=True)
class _Remedy:
    """Turns fixes of the problem into fixes of the mission document."""

    geometry: MissionGeometry
    stations: NDArray[np.int64]
    planned_m: Array

    def translate(self, fix: Mapping[str, object]) -> dict[str, object]:
        makers = {
            "raise_range": self._raise_range,
            "raise_all_ranges": self._raise_all,
            "set_altitude": self._set_altitude,
            "widen_band": self._widen_band,
            "add_station": self._add_station,
            "raise_limit": self._raise_limit,
            "lower_elevation": self._lower_elevation,
            "move": self._move,
        }
        make = makers.get(str(fix.get("action")))
        result = dict(fix) if make is None else make(fix)
        also = fix.get("also")
        if isinstance(also, list | tuple):
            result["also"] = [self.translate(one) for one in also]
        return result

    def _needed_m(self, planned_m: Array) -> Array:
        """``(M,)``: ranges to give for these planned ones of all the mission's stations, margin included."""
        return self.geometry.needed_ranges_m(planned_m) + self.geometry.mission.options.range_margin_m

    def _raise_range(self, fix: Mapping[str, object]) -> dict[str, object]:
        k = int(number(fix["station"]))
        station = int(self.stations[k])
        planned = np.zeros(len(self.geometry.mission.stations))
        planned[station] = self.planned_m[k] + number(fix["by_m"])
        given = self.geometry.mission.stations[station].range_m
        # A billionth of the range more, so that the sum does not fall short in its last digits.
        needed = max(float(self._needed_m(planned)[station]), given) * (1.0 + 1e-9)
        identifier = self.geometry.mission.stations[station].id
        return {"action": "raise_range", "station": identifier, "by_m": needed - given, "range_m": needed}

    def _raise_all(self, fix: Mapping[str, object]) -> dict[str, object]:
        planned = np.zeros(len(self.geometry.mission.stations))
        planned[self.stations] = self.planned_m + number(fix["by_m"])
        more = (self._needed_m(planned) - self.geometry.full_ranges_m)[self.stations]
        by = float(more.max()) + 1e-9 * float(self.geometry.full_ranges_m.max())
        margin = self.geometry.mission.options.range_margin_m
        if by <= margin:
            return {"action": "lower_margin", "by_m": by, "range_margin_m": margin - by}
        return {"action": "raise_all_ranges", "by_m": by}

    def _set_altitude(self, fix: Mapping[str, object]) -> dict[str, object]:
        amsl = float(self.geometry.plane.altitude_amsl_m(number(fix["alt_m"])))
        return {"action": "set_altitude", "of": fix["of"], "alt_amsl_m": amsl, "by_m": number(fix["by_m"])}

    def _widen_band(self, fix: Mapping[str, object]) -> dict[str, object]:
        limits = self.geometry.mission.limits
        if "min_alt_m" in fix:
            to = float(self.geometry.plane.altitude_amsl_m(number(fix["min_alt_m"])))
            return {"action": "widen_band", "min_alt_amsl_m": to, "by_m": limits.min_alt_amsl_m - to}
        to = float(self.geometry.plane.altitude_amsl_m(number(fix["max_alt_m"])))
        return {"action": "widen_band", "max_alt_amsl_m": to, "by_m": to - limits.max_alt_amsl_m}

    def _lower_elevation(self, fix: Mapping[str, object]) -> dict[str, object]:
        """The angle to give, so that what the projection's correction adds to it again still leaves enough."""
        station = int(self.stations[int(number(fix["station"]))])
        given = self.geometry.min_elevations_deg[station]
        to = number(fix["to_deg"])
        if not self.geometry.is_local:
            to -= float(planning_elevation_deg(0.0, self.geometry.full_ranges_m[station]))
        allowed = to if to >= 0.0 else None
        identifier = self.geometry.mission.stations[station].id
        by = given - max(to, 0.0)
        return {"action": "lower_elevation", "station": identifier, "to_deg": allowed, "by_deg": float(by)}

    def _move(self, fix: Mapping[str, object]) -> dict[str, object]:
        position = fix["position_m"]
        assert isinstance(position, Sequence)
        place = _place(self.geometry, [number(x) for x in position])
        return {"action": "move", "of": fix["of"], "position": place, "by_m": number(fix["by_m"])}

    def _add_station(self, fix: Mapping[str, object]) -> dict[str, object]:
        position = fix["position_m"]
        assert isinstance(position, Sequence)
        place = _place(self.geometry, [number(x) for x in position])
        limits, planned = self.geometry.mission.limits, number(fix["range_m"])
        if not self.geometry.is_local:
            highest = max(place["alt_amsl_m"], limits.max_alt_amsl_m)
            lowest = min(place["alt_amsl_m"], limits.min_alt_amsl_m)
            # The place is written in degrees and read back: a millimetre is more than that can lose.
            planned = float(range_needed_m(planned + 0.001, highest, highest - lowest))
        return {
            "action": "add_station",
            "position": place,
            "range_m": planned + self.geometry.mission.options.range_margin_m,
        }

    def _raise_limit(self, fix: Mapping[str, object]) -> dict[str, object]:
        """Limits of the problem that are several, or other, in the mission."""
        to = number(fix["to"])
        limits = self.geometry.mission.limits
        if fix["limit"] == "max_duration_s":
            return {"action": "raise_limit", "limit": "endurance_s", "to": to + (limits.reserve_s or 0.0) + 1e-6}
        if fix["limit"] == "max_handovers":
            return {"action": "raise_limit", "limit": "max_handovers", "to": int(to)}
        return {"action": "raise_limit", "limit": fix["limit"], "to": to}


def _message(geometry: MissionGeometry, finding: Infeasibility, ids: list[str]) -> str:
    limits, margin = geometry.mission.limits, geometry.mission.options.range_margin_m
    gap = None if finding.gap_m is None else f"{finding.gap_m:.1f} m"
    less = f" less the margin of {margin:g} m" if margin > 0 else ""
    end = "start" if finding.reason.startswith("start") else "destination"
    if finding.reason in ("start_uncovered", "destination_uncovered"):
        if finding.gap_m == 0.0 and ids:
            return f"The {end} is in range of {ids[0]} but below its lowest elevation."
        nearest = f"; the nearest, {ids[0]}, misses it by {gap}" if gap and ids else ""
        return f"The {end} is out of every station's range{less}{nearest}."
    if finding.reason in ("start_altitude", "destination_altitude"):
        band = f"{limits.min_alt_amsl_m:g} to {limits.max_alt_amsl_m:g} m AMSL"
        return f"The {end} is outside the altitude band of {band}" + (f" by {gap}." if gap else ".")
    if finding.reason == "broken_chain":
        between = (
            f": in the best one a gap of {gap} remains between {ids[0]} and {ids[1]}" if len(ids) == 2 and gap else ""
        )
        return f"No chain of overlapping ranges{less} leads from the start to the destination{between}."
    return finding.message[:1].upper() + finding.message[1:].rstrip(".") + "."


def words(fix: Mapping[str, object]) -> str:
    """A fix and its alternatives as one sentence."""
    alternatives = fix.get("alternatives")
    texts = [_with_also(fix), *(map(_with_also, alternatives) if isinstance(alternatives, list) else ())]
    text = "; or ".join(texts)
    return text[:1].upper() + text[1:] + "."


def _with_also(fix: Mapping[str, object]) -> str:
    also = fix.get("also")
    return " and ".join(_order(step) for step in (fix, *(also if isinstance(also, list) else ())))


def _order(fix: Mapping[str, object]) -> str:
    """One remedy as an order; figures are rounded towards the safe side, so that what is read suffices."""
    match fix.get("action"):
        case "raise_range":
            to = f" to {_up(fix['range_m'])} m" if "range_m" in fix else ""
            return f"raise the range of {fix['station']} by {_up(fix['by_m'])} m{to}"
        case "raise_all_ranges":
            return f"raise every range by {_up(fix['by_m'])} m"
        case "lower_margin":
            return f"lower range_margin_m to {_down(fix['range_margin_m'])} m"
        case "lower_option":
            return f"lower {fix['option']} to {_down(fix['to'])} s"
        case "set_altitude":
            return f"set the altitude of the {fix['of']} to {number(fix['alt_amsl_m']):g} m AMSL"
        case "widen_band" if "min_alt_amsl_m" in fix:
            return f"lower min_alt_amsl_m to {_down(fix['min_alt_amsl_m'])} m"
        case "widen_band":
            return f"raise max_alt_amsl_m to {_up(fix['max_alt_amsl_m'])} m"
        case "lower_elevation" if fix["to_deg"] is None:
            return f"drop the lowest elevation of {fix['station']}"
        case "lower_elevation":
            return f"lower min_elevation_deg of {fix['station']} to {_down(fix['to_deg'], 100.0)} degrees"
        case "lower_elevations":
            return f"lower every min_elevation_deg by {_up(fix['by_deg'], 100.0)} degrees"
        case "move":
            return f"move the {fix['of']} by {_up(fix['by_m'])} m to {_at(fix['position'])}"
        case "add_station":
            return f"add a station with a range of {_up(fix['range_m'])} m at {_at(fix['position'])}"
        case "include_station":
            return f"do not exclude {fix['station']}"
        case "raise_limit" if fix["limit"] == "max_handovers":
            count = int(number(fix["to"]))
            return f"allow {count} handover{'' if count == 1 else 's'} (max_handovers)"
        case "raise_limit":
            return f"raise {fix['limit']} to {_up(fix['to'], _DIGITS)} {_unit(fix['limit'])}"
        case "lower_limit":
            return f"lower {fix['limit']} to {_down(fix['to'], _DIGITS)} {_unit(fix['limit'])}"
        case "lower_wind":
            return f"wait until the wind is below {_down(fix['below_m_s'])} m/s"
        case "lower_start_speed":
            return f"start at {_down(fix['below_m_s'], _DIGITS)} m/s or less in the same direction"
        case "later_arrival":
            return f"ask for arrival_s of {_up(fix['arrival_s'])} s or later"
        case "earlier_arrival":
            return f"ask for arrival_s of {_down(fix['arrival_s'])} s or earlier"
        case action:
            rest = ", ".join(f"{key} {value}" for key, value in fix.items() if key not in ("action", "alternatives"))
            return f"{str(action).replace('_', ' ')} {rest}".strip()


_DIGITS = 100.0


def _unit(limit: object) -> str:
    """The unit a limit's name ends with."""
    for suffix, unit in (("_m_s3", "m/s^3"), ("_m_s2", "m/s^2"), ("_m_s", "m/s"), ("_s", "s")):
        if str(limit).endswith(suffix):
            return unit
    return ""


def _at(place: object) -> str:
    """Where something is to go, in the mission's own frame."""
    assert isinstance(place, Mapping)
    if "east_m" in place:
        return f"east {place['east_m']:.1f} m, north {place['north_m']:.1f} m, up {place['up_m']:.1f} m"
    return f"{place['lat_deg']:.6f}, {place['lon_deg']:.6f}, {place['alt_amsl_m']:.1f} m AMSL"


def _up(value: object, digits: float = 10.0) -> str:
    return _plain(math.ceil(number(value) * digits - 1e-9) / digits, digits)


def _down(value: object, digits: float = 10.0) -> str:
    return _plain(math.floor(number(value) * digits + 1e-9) / digits, digits)


def _plain(value: float, digits: float) -> str:
    return f"{value:.{round(math.log10(digits))}f}"
