"""What only the whole mission tells: ids used twice, system ids that do not go together, places too far apart."""

from __future__ import annotations

import unicodedata

import numpy as np

from gcs.document_reader import FaultList
from gcs.errors import MissionError
from gcs.geodesy.ellipsoid import slant_range_m
from gcs.mission.model import GeoPosition, Position, SafePoint, Station
from gcs.mission.system_ids import assign_system_ids

# How far anything may be from the start (WGS84) or the origin, per axis (local).
MAX_SPAN_M = 1_000_000.0


def check_ids(where: str, ids: list[str], faults: FaultList) -> None:
    """Notes ids used twice, and ids people cannot tell apart, in the list ``where``."""
    first: dict[str, int] = {}
    for i, identifier in enumerate(ids):
        if identifier and first.setdefault(identifier, i) != i:
            what = f"is the id of {where}[{first[identifier]}] as well"
            faults.add(f"{where}[{i}].id", what, identifier, "each id once", "rename one of the two")
    # Ids are spoken over the radio and stand in file names: what differs only in letter case or blanks is one.
    spoken: dict[str, int] = {}
    for identifier, i in first.items():
        word = "".join(unicodedata.normalize("NFKC", identifier).casefold().split())
        if spoken.setdefault(word, i) != i:
            what = f"differs only in letter case or blanks from that of {where}[{spoken[word]}], {ids[spoken[word]]}"
            faults.add(f"{where}[{i}].id", what, identifier, "ids that people can tell apart", "rename one of the two")


def check_system_ids(stations: list[Station], vehicle_id: int, faults: FaultList) -> None:
    """Notes MAVLink system ids used twice or by the vehicle, and sets to which no further station could be added."""
    first: dict[int, int] = {}
    clean = True
    for i, station in enumerate(stations):
        if station.system_id is None:
            continue
        where = f"stations[{i}].system_id"
        if station.system_id == vehicle_id:
            fix = "give another one, or change options.vehicle_system_id"
            faults.add(where, "is the vehicle's own system id", station.system_id, "another id from 1 to 254", fix)
            clean = False
        elif first.setdefault(station.system_id, i) != i:
            what = f"is the system id of stations[{first[station.system_id]}] as well"
            faults.add(where, what, station.system_id, "each system id once", "give another one, or leave both out")
            clean = False
    given = [s.system_id for s in stations]
    if clean and first and None in given:
        # Which stations a plan uses is not known yet; what can be told now is whether a single one more would fit.
        holders = [i for i, system_id in enumerate(given) if system_id is not None]
        try:
            assign_system_ids(given, [*holders, given.index(None)], vehicle_id)
        except MissionError as error:
            faults.extend(error.problems)


def check_span(
    start: Position, destination: Position, stations: list[Station], safe_points: list[SafePoint], faults: FaultList
) -> None:
    """Notes places of a WGS84 mission that are farther from its start than `MAX_SPAN_M`."""
    places: list[tuple[str, Position]] = [("destination", destination)]
    places += [(f"stations[{i}]", station.position) for i, station in enumerate(stations)]
    places += [(f"safe_points[{i}]", point.position) for i, point in enumerate(safe_points)]
    at = np.array([(p.lat_deg, p.lon_deg) for _, p in places if isinstance(p, GeoPosition)])
    assert isinstance(start, GeoPosition)
    distance = slant_range_m(start.lat_deg, start.lon_deg, 0.0, at[:, 0], at[:, 1], 0.0)
    far, allowed = np.flatnonzero(distance > MAX_SPAN_M), f"at most {MAX_SPAN_M / 1000:.0f} km"
    if len(far) == len(places):
        # Everything is far from the start: it is the start that is wrong.
        swapped = abs(start.lon_deg) <= 90.0 and bool(
            (slant_range_m(start.lon_deg, start.lat_deg, 0.0, at[:, 0], at[:, 1], 0.0) <= MAX_SPAN_M).any()
        )
        what = f"is {distance.min() / 1000:.0f} km and more from destination and stations"
        faults.add("start", what, _shown(start), allowed, _fix_of_place(swapped))
        return
    for i in far:
        lat, lon = at[i]
        swapped = (
            abs(lon) <= 90.0 and float(slant_range_m(start.lat_deg, start.lon_deg, 0.0, lon, lat, 0.0)) <= MAX_SPAN_M
        )
        what = f"is {distance[i] / 1000:.0f} km from the start"
        faults.add(places[i][0], what, f"{lat:.6g}, {lon:.6g}", allowed, _fix_of_place(swapped))


def _shown(position: GeoPosition) -> str:
    return f"{position.lat_deg:.6g}, {position.lon_deg:.6g}"


def _fix_of_place(swapped: bool) -> str:
    return "swap lat_deg and lon_deg" if swapped else "check latitude and longitude"
