"""What only the whole mission tells: ids used twice, system ids that do not go together, places too far apart."""

from __future__ import annotations

import unicodedata
from collections import Counter

import numpy as np

from gcs.document_reader import FaultList
from gcs.errors import MissionError
from gcs.geodesy.ellipsoid import slant_range_m
from gcs.mission.model import GeoPosition, Position, SafePoint, Station
from gcs.mission.system_ids import assign_system_ids

# How far anything may be from the start (WGS84) or the origin, per axis (local).
MAX_SPAN_M = 1_000_000.0
PROGRAMS_SYSTEM_ID = 255
# Fewer stations are no network's list: one that is far away is mistyped.
LEAST_NETWORK = 4
# Small letters of other scripts that are drawn as a Latin one.
_LOOK_ALIKES = str.maketrans("асеоіјѕрхуһԁԛԝгкмтвнαονρυικτγ", "aceoijspxyhdqwrkmtbhaovpuiktv")


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
    seen: dict[str, int] = {}
    for word, i in spoken.items():
        if seen.setdefault(word.translate(_LOOK_ALIKES), i) != i:
            k = seen[word.translate(_LOOK_ALIKES)]
            what = f"looks like that of {where}[{k}], {ids[k]}, in letters of another script"
            faults.add(f"{where}[{i}].id", what, ids[i], "ids that people can tell apart", "rename one of the two")


def same_system_ids(values: list[object], faults: FaultList) -> bool:
    """Notes once that one system id stands at many stations; True where it does, and ids are not to be looked at.

    255 at every station is what a ground-station program gives itself.
    """
    counts = Counter(value for value in values if isinstance(value, int) and not isinstance(value, bool))
    crowded = [value for value, count in counts.items() if count >= (2 if value == PROGRAMS_SYSTEM_ID else 3)]
    for value in crowded:
        what = f"is the same at {counts[value]} stations"
        if value == PROGRAMS_SYSTEM_ID:
            what += ": what a ground-station program comes with"
        where, fix = f"stations[{values.index(value)}].system_id", "leave the ids out: they are given out here"
        faults.add(where, what, value, "each system id once, from 1 to 254", fix)
    return bool(crowded)


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
) -> frozenset[int]:
    """Notes places of a WGS84 mission that are farther from its start than `MAX_SPAN_M`.

    Returns the stations (indices) that are: a network's list holds many no flight from here can reach, which are left
    out. One that is near with latitude and longitude swapped is a fault, and any in a list too short for a network.
    """
    places: list[tuple[str, Position]] = [("destination", destination)]
    places += [(f"safe_points[{i}]", point.position) for i, point in enumerate(safe_points)]
    others = len(places)
    places += [(f"stations[{i}]", station.position) for i, station in enumerate(stations)]
    at = np.array([(p.lat_deg, p.lon_deg) for _, p in places if isinstance(p, GeoPosition)])
    assert isinstance(start, GeoPosition)
    distance = slant_range_m(start.lat_deg, start.lon_deg, 0.0, at[:, 0], at[:, 1], 0.0)
    far, allowed = np.flatnonzero(distance > MAX_SPAN_M).tolist(), f"at most {MAX_SPAN_M / 1000:.0f} km"
    stations_far = [i for i in far if i >= others]
    if far and (len(far) == len(places) or len(stations_far) == len(stations)):
        swapped = abs(start.lon_deg) <= 90.0 and bool(
            (slant_range_m(start.lon_deg, start.lat_deg, 0.0, at[others:, 0], at[others:, 1], 0.0) <= MAX_SPAN_M).any()
        )
        if swapped or len(far) == len(places):
            # Everything is far from the start: it is the start that is wrong.
            what = f"is {distance[far].min() / 1000:.0f} km and more from destination and stations"
            if len(far) < len(places):
                what = f"is {distance[stations_far].min() / 1000:.0f} km and more from every station"
            ends_too = swapped and 0 not in far
            fix = "swap lat_deg and lon_deg" + (" of start and destination" if ends_too else "")
            faults.add("start", what, _shown(start), allowed, fix if swapped else _fix_of_place(swapped=False))
            return frozenset()
    left_out: set[int] = set()
    for i in far:
        lat, lon = at[i]
        swapped = (
            abs(lon) <= 90.0 and float(slant_range_m(start.lat_deg, start.lon_deg, 0.0, lon, lat, 0.0)) <= MAX_SPAN_M
        )
        if i >= others and not swapped and len(stations_far) < len(stations) >= LEAST_NETWORK:
            left_out.add(i - others)
            continue
        name = f" ({stations[i - others].id})" if i >= others else ""
        what = f"is {distance[i] / 1000:.0f} km from the start{name}"
        faults.add(places[i][0], what, f"{lat:.6g}, {lon:.6g}", allowed, _fix_of_place(swapped))
    return frozenset(left_out)


def _shown(position: GeoPosition) -> str:
    return f"{position.lat_deg:.6g}, {position.lon_deg:.6g}"


def _fix_of_place(swapped: bool) -> str:
    return "swap lat_deg and lon_deg" if swapped else "check latitude and longitude"
