"""The planner's finding in an operator's words: stations by id, places on the earth, the smallest fix.

The planner speaks of balls in the plane; a fix here is one of the mission document, so that doing what it says makes
the mission feasible: ranges grow by what the projection's correction will take off again.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gcs.errors import MissionInfeasible
from gcs.ground import Ground
from gcs.ranges import range_needed_m
from planner.errors import Infeasibility

Array = NDArray[np.float64]


def explain(
    ground: Ground, stations: NDArray[np.int64], finding: Infeasibility, planned_ranges_m: Array
) -> MissionInfeasible:
    """``finding`` in the mission's terms.

    ``stations`` are the mission's indices of the problem's stations and ``planned_ranges_m`` the problem's ranges.
    """
    mission = ground.mission
    ids = [mission.stations[int(stations[k])].id for k in finding.stations]
    where = None
    if finding.position_m is not None:
        where = _place(ground, finding.position_m)
    fix = None if finding.fix is None else _Remedy(ground, stations, planned_ranges_m).translate(finding.fix)
    return MissionInfeasible(
        finding.reason,
        _message(ground, finding, ids),
        stations=ids,
        where=where,
        gap_m=finding.gap_m,
        fix=fix,
        fix_text=_fix_text(finding, fix),
    )


def _place(ground: Ground, position_m: Sequence[float]) -> dict[str, float]:
    """A plane point in every frame the mission has."""
    east, north, up = (float(x) for x in position_m)
    place = ground.geo(np.array([east, north, up]))
    where = {"lat_deg": place.lat_deg, "lon_deg": place.lon_deg, "alt_amsl_m": place.alt_amsl_m}
    return where | ({"east_m": east, "north_m": north, "up_m": up} if ground.is_local else {})


@dataclass(frozen=True)
class _Remedy:
    """Turns fixes of the problem into fixes of the mission document."""

    ground: Ground
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
        }
        make = makers.get(str(fix.get("action")))
        result = dict(fix) if make is None else make(fix)
        for key in ("also", "alternatives"):
            more = fix.get(key)
            if isinstance(more, list | tuple):
                result[key] = [self.translate(one) for one in more]
        return result

    def _needed_m(self, planned_m: Array) -> Array:
        """``(M,)``: ranges to give for these planned ones of all the mission's stations, margin included."""
        return self.ground.needed_ranges_m(planned_m) + self.ground.mission.options.range_margin_m

    def _raise_range(self, fix: Mapping[str, object]) -> dict[str, object]:
        k = int(number(fix["station"]))
        station = int(self.stations[k])
        planned = np.zeros(len(self.ground.mission.stations))
        planned[station] = self.planned_m[k] + number(fix["by_m"])
        given = self.ground.mission.stations[station].range_m
        # A billionth of the range more, so that the sum does not fall short in its last digits.
        needed = max(float(self._needed_m(planned)[station]), given) * (1.0 + 1e-9)
        identifier = self.ground.mission.stations[station].id
        return {"action": "raise_range", "station": identifier, "by_m": needed - given, "range_m": needed}

    def _raise_all(self, fix: Mapping[str, object]) -> dict[str, object]:
        planned = np.zeros(len(self.ground.mission.stations))
        planned[self.stations] = self.planned_m + number(fix["by_m"])
        more = (self._needed_m(planned) - self.ground.full_ranges_m)[self.stations]
        by = float(more.max()) + 1e-9 * float(self.ground.full_ranges_m.max())
        margin = self.ground.mission.options.range_margin_m
        if by <= margin:
            return {"action": "lower_margin", "by_m": by, "range_margin_m": margin - by}
        return {"action": "raise_all_ranges", "by_m": by}

    def _set_altitude(self, fix: Mapping[str, object]) -> dict[str, object]:
        amsl = float(self.ground.plane.altitude_amsl_m(number(fix["alt_m"])))
        return {"action": "set_altitude", "of": fix["of"], "alt_amsl_m": amsl, "by_m": number(fix["by_m"])}

    def _widen_band(self, fix: Mapping[str, object]) -> dict[str, object]:
        # A wider band makes the correction of the ranges a little larger: a fiftieth more covers it.
        by = number(fix["by_m"]) * 1.02 + 0.001
        limits = self.ground.mission.limits
        if "min_alt_m" in fix:
            return {"action": "widen_band", "min_alt_amsl_m": limits.min_alt_amsl_m - by, "by_m": by}
        return {"action": "widen_band", "max_alt_amsl_m": limits.max_alt_amsl_m + by, "by_m": by}

    def _add_station(self, fix: Mapping[str, object]) -> dict[str, object]:
        position = fix["position_m"]
        assert isinstance(position, Sequence)
        place = _place(self.ground, [number(x) for x in position])
        limits, planned = self.ground.mission.limits, number(fix["range_m"])
        if not self.ground.is_local:
            highest = max(place["alt_amsl_m"], limits.max_alt_amsl_m)
            lowest = min(place["alt_amsl_m"], limits.min_alt_amsl_m)
            # The place is written in degrees and read back: a millimetre is more than that can lose.
            planned = float(range_needed_m(planned + 0.001, highest, highest - lowest))
        return {
            "action": "add_station",
            "position": place,
            "range_m": planned + self.ground.mission.options.range_margin_m,
        }

    def _raise_limit(self, fix: Mapping[str, object]) -> dict[str, object]:
        """Limits of the problem that are several, or other, in the mission."""
        to = number(fix["to"])
        limits = self.ground.mission.limits
        if fix["limit"] == "max_duration_s":
            return {"action": "raise_limit", "limit": "endurance_s", "to": to + (limits.reserve_s or 0.0) + 1e-6}
        return {"action": "raise_limit", "limit": fix["limit"], "to": to}


def number(value: object) -> float:
    """A number out of a fix."""
    assert isinstance(value, int | float | np.integer | np.floating)
    return float(value)


def _message(ground: Ground, finding: Infeasibility, ids: list[str]) -> str:
    limits, margin = ground.mission.limits, ground.mission.options.range_margin_m
    gap = None if finding.gap_m is None else f"{finding.gap_m:.1f} m"
    less = f" less the margin of {margin:g} m" if margin > 0 else ""
    end = "start" if finding.reason.startswith("start") else "destination"
    if finding.reason in ("start_uncovered", "destination_uncovered"):
        if finding.fix is None and ids:
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


def _fix_text(finding: Infeasibility, fix: Mapping[str, object] | None) -> str:
    if fix is None:
        return ""
    alternatives = fix.get("alternatives")
    texts = [_words(fix)]
    if finding.reason in ("start_uncovered", "destination_uncovered"):
        texts.append(f"move the {finding.reason.partition('_')[0]} into range")
    texts += [_words(one) for one in alternatives] if isinstance(alternatives, list) else []
    text = ", or ".join(texts)
    return text[:1].upper() + text[1:] + "."


def _words(fix: Mapping[str, object]) -> str:
    """One remedy as an order; metres are rounded towards the safe side, so that what is read suffices."""
    match fix.get("action"):
        case "raise_range":
            also = fix.get("also")
            raises = [fix, *(also if isinstance(also, list) else [])]
            return "raise the range of " + " and ".join(f"{r['station']} by {_up(r['by_m'])} m" for r in raises)
        case "raise_all_ranges":
            return f"raise every range by {_up(fix['by_m'])} m"
        case "lower_margin":
            return f"lower range_margin_m to {_down(fix['range_margin_m'])} m"
        case "set_altitude":
            return f"set the altitude of the {fix['of']} to {number(fix['alt_amsl_m']):g} m AMSL"
        case "widen_band" if "min_alt_amsl_m" in fix:
            return f"lower min_alt_amsl_m to {_down(fix['min_alt_amsl_m'])} m"
        case "widen_band":
            return f"raise max_alt_amsl_m to {_up(fix['max_alt_amsl_m'])} m"
        case "add_station":
            place = fix["position"]
            assert isinstance(place, Mapping)
            at = f"{place['lat_deg']:.6f}, {place['lon_deg']:.6f}"
            if "east_m" in place:
                at = f"east {place['east_m']:.1f} m, north {place['north_m']:.1f} m"
            return f"add a station with a range of {_up(fix['range_m'])} m at {at}"
        case "raise_limit" if fix["limit"] == "max_handovers":
            return f"allow {number(fix['to']):.0f} handovers (max_handovers)"
        case "raise_limit":
            return f"raise {fix['limit']} to {_up(fix['to'])}"
        case "lower_start_speed":
            return f"start slower than {number(fix['below_m_s']):.1f} m/s, or where there is more room"
        case action:
            rest = ", ".join(f"{key} {value}" for key, value in fix.items() if key not in ("action", "alternatives"))
            return f"{str(action).replace('_', ' ')} {rest}".strip()


def _up(value: object) -> str:
    return f"{math.ceil(number(value) * 10.0 - 1e-9) / 10.0:.1f}"


def _down(value: object) -> str:
    return f"{math.floor(number(value) * 10.0 + 1e-9) / 10.0:.1f}"
