"""What stands in the way of a mission, in an operator's words: a sentence a cause, and what to doubt first."""

from __future__ import annotations

import numpy as np

from gcs.layout.mission_geometry import MissionGeometry
from gcs.layout.planning_problem import PlanningProblem
from gcs.mission.model import Mission, amsl_m
from gcs.remedies.remedy import document_of
from gcs.remedies.translation import alone, location_of
from gcs.remedies.wording import words_of
from planner import Infeasibility

# Causes told in a sentence each; of more it is said how many.
MAX_CAUSES = 12
METRES_A_FOOT = 0.3048
# An end this far below the antenna nearest to it is in the ground, or its altitude counts from there.
GROUND_DEPTH_M = 100.0


def told(laid: PlanningProblem, found: Infeasibility) -> tuple[str, list[dict[str, object]]]:
    """The finding as text, and its causes in flight order as data where there are several."""
    if len(found.causes) < 2:
        return sentence_of(laid, found), []
    causes = [_document(laid, cause) for cause in found.causes[:MAX_CAUSES]]
    more = len(found.causes) - len(causes)
    listed = " ".join(f"({k}) {cause['message']}" for k, cause in enumerate(causes, start=1))
    rest = f" And {more} more." if more else ""
    return f"{len(found.causes)} things stand in the way, in flight order: {listed}{rest}", causes


def _document(laid: PlanningProblem, cause: Infeasibility) -> dict[str, object]:
    remedy = alone(laid, cause)
    remedies = [remedy] if remedy else []
    return {
        "reason": cause.reason,
        "message": sentence_of(laid, cause, among=True),
        "stations": _ids(laid, cause.stations),
        "where": place_of(laid.geometry, cause),
        "gap_m": cause.gap_m,
        "fix": document_of(remedies),
        "fix_text": words_of(remedies),
    }


def place_of(geometry: MissionGeometry, cause: Infeasibility) -> dict[str, float] | None:
    """Where a cause is, in every frame the mission has."""
    return None if cause.position_m is None else location_of(geometry, cause.position_m).to_document()


def sentence_of(laid: PlanningProblem, found: Infeasibility, *, among: bool = False) -> str:
    """One cause as a sentence; ``among`` others, a gap is not all that is wrong with the chain."""
    mission, ids = laid.geometry.mission, _ids(laid, found.stations)
    margin = mission.options.range_margin_m
    gap = None if found.gap_m is None else metres(found.gap_m)
    less = f" less the margin of {margin:g} m" if margin > 0 else ""
    end = "start" if found.reason.startswith("start") else "destination"
    if found.reason in ("start_uncovered", "destination_uncovered"):
        if found.gap_m == 0.0 and ids:
            return f"The {end} is in range of {ids[0]} but below its lowest elevation{_angle(mission, ids[0])}."
        nearest = f"; the nearest, {ids[0]}, misses it by {gap}" if gap and ids else ""
        return f"The {end} is out of every station's range{less}{nearest}."
    if found.reason in ("start_altitude", "destination_altitude"):
        return _altitude(laid.geometry, end, gap)
    if found.reason == "broken_chain":
        if found.masked and len(ids) == 2:
            deaf = " and ".join(f"{one}{_angle(mission, one)}" for one in _ids(laid, found.masked))
            return (
                f"The ranges of {ids[0]} and {ids[1]} overlap, but not above the lowest elevation of {deaf}: "
                "the mask breaks the chain, not the range."
            )
        if among and len(ids) == 2 and gap:
            return f"A gap of {gap} remains between the ranges{less} of {ids[0]} and {ids[1]}."
        between = (
            f": in the best one a gap of {gap} remains between {ids[0]} and {ids[1]}" if len(ids) == 2 and gap else ""
        )
        return f"No chain of overlapping ranges{less} leads from the start to the destination{between}."
    return sentence(found.message)


def sentence(text: str) -> str:
    """Text with a capital and a full stop."""
    return text[:1].upper() + text[1:].rstrip(".") + "."


def metres(length_m: float) -> str:
    """A length that is missing: never as nothing."""
    return "less than 0.1 m" if 0.0 < length_m < 0.05 else f"{length_m:.1f} m"


def _ids(laid: PlanningProblem, stations: tuple[int, ...]) -> list[str]:
    return [laid.geometry.mission.stations[int(laid.stations[k])].id for k in stations]


def _angle(mission: Mission, station: str) -> str:
    angle = mission.stations[mission.station_index(station)].min_elevation_deg
    return "" if angle is None else f" of {angle:g} degrees"


def _altitude(geometry: MissionGeometry, end: str, gap: str | None) -> str:
    mission = geometry.mission
    limits = mission.limits
    band = f"{limits.min_alt_amsl_m:g} to {limits.max_alt_amsl_m:g} m AMSL"
    text = f"The {end} is outside the altitude band of {band}" + (f" by {gap}." if gap else ".")
    position = mission.start if end == "start" else mission.destination
    altitude = amsl_m(mission, position)
    if limits.min_alt_amsl_m <= altitude * METRES_A_FOOT <= limits.max_alt_amsl_m:
        return f"{text} Is {altitude:g} m meant as feet? {altitude:g} ft are {altitude * METRES_A_FOOT:.1f} m."
    away = np.linalg.norm((geometry.stations_enu_m - geometry.enu_m([position])[0])[:, :2], axis=1)
    near = mission.stations[int(np.argmin(away))]
    below = amsl_m(mission, near.position) - altitude
    if below > GROUND_DEPTH_M:
        return (
            f"{text} {altitude:g} m AMSL are {below:.0f} m below the antenna of {near.id}, the nearest: "
            "is it a height above ground?"
        )
    return text
