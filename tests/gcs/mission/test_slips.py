"""What people slip in a mission: other programs' files, commas, ids, heights in feet, whole networks of stations."""

from __future__ import annotations

import copy
import json
from datetime import UTC, datetime
from typing import Any

import pytest

from gcs.errors import InputFault, MissionError, MissionInfeasible
from gcs.exports import parse_launch, summary
from gcs.exports.handovers import utc_at
from gcs.mission import parse_mission_json, read_mission, with_options
from gcs.planning.certification import recertify
from gcs.planning.mission_planning import plan_mission
from tests.support.field_missions import field_mission, text_of
from tests.support.missions.infeasible import local, wgs84


def faults_of(document: Any) -> list[InputFault]:
    read = parse_mission_json if isinstance(document, str | bytes) else read_mission
    with pytest.raises(MissionError) as caught:
        read(document)
    return list(caught.value.problems)


# --- files ------------------------------------------------------------------------------------------------------------

WAYPOINTS = "QGC WPL 110\n0\t1\t0\t16\t0\t0\t0\t0\t47.39\t8.54\t488\t1\n"
KML = '<?xml version="1.0" encoding="UTF-8"?>\n<kml xmlns="http://www.opengis.net/kml/2.2"><Document/></kml>'
CSV = "id,lat,lon,alt\na,47.4,8.5,488\nb,47.5,8.6,520\n"
SEMICOLONS = "id;lat;lon;alt\na;47,4;8,5;488\n"
FOREIGN = [
    (WAYPOINTS, "waypoint file"),
    ("\ufeff" + WAYPOINTS.replace("\n", "\r\n"), "waypoint file"),
    (KML, "KML"),
    ("<gpx/>", "GPX"),
    (CSV, "CSV"),
    (SEMICOLONS, "CSV"),
    (b"PK\x03\x04\x14\x00\x08\x00", "zip"),
    (json.dumps({"MAV_AUTOPILOT": 12, "items": [], "plannedHomePosition": {}}), "old QGroundControl"),
    (json.dumps({"fileType": "Plan", "mission": {}}), "QGroundControl plan"),
    (json.dumps({"type": "FeatureCollection", "features": []}), "GeoJSON"),
]


@pytest.mark.parametrize(("data", "word"), FOREIGN, ids=[f"{word} {k}" for k, (_, word) in enumerate(FOREIGN)])
def test_other_programs_files_are_named(data: str | bytes, word: str) -> None:
    (fault,) = faults_of(data)
    assert word in fault.what
    assert "mission" in fault.fix


def test_a_slip_in_json_is_still_a_place() -> None:
    (fault,) = faults_of('{"name": "x",\n "start" {}}')
    assert "line 2" in fault.what


# --- numbers ----------------------------------------------------------------------------------------------------------


def test_a_decimal_comma_is_called_one() -> None:
    (fault,) = faults_of(text_of("comma_number"))
    assert "decimal comma, 14,09698, at line 4" in fault.what
    assert "14.09698" in fault.fix


def test_a_decimal_comma_in_quotes_is_called_one() -> None:
    (fault,) = faults_of(wgs84(start__lat_deg="52,9234"))
    assert "52.9234" in fault.fix
    assert "decimal point" in fault.fix


# --- ids --------------------------------------------------------------------------------------------------------------


def test_one_system_id_for_all_is_told_once() -> None:
    (fault,) = faults_of(field_mission("all_255"))
    assert "14 stations" in fault.what
    assert "leave the ids out" in fault.fix
    document = field_mission("all_255")
    for station in document["stations"]:
        station["system_id"] = 7
    (fault,) = faults_of(document)
    assert "leave the ids out" in fault.fix


def test_a_letter_is_the_same_however_it_is_encoded() -> None:
    document = wgs84()
    document["stations"][0]["id"] = "Terschelling-ho\u0308g"
    document["options"] = {"excluded_stations": ["Terschelling-ho\u0308g"]}
    mission = read_mission(document)
    assert mission.stations[0].id == "Terschelling-h\u00f6g"
    assert mission.options.excluded_stations == (mission.stations[0].id,)
    document["stations"][1]["id"] = "Terschelling-h\u00f6g"
    assert any("as well" in fault.what for fault in faults_of(document))


@pytest.mark.parametrize("identifier", ["t\u0435xel", "\u0422exel", "\u03bfslo airfield", "north-\u0410"])
def test_an_id_of_mixed_scripts_is_refused(identifier: str) -> None:
    document = wgs84()
    document["stations"][0]["id"] = identifier
    assert any("look the same" in fault.what for fault in faults_of(document))


def test_ids_that_look_alike_in_two_scripts_are_refused() -> None:
    document = wgs84()
    document["stations"][0]["id"], document["stations"][1]["id"] = "COPA", "\u0421\u041e\u0420\u0410"
    assert any("another script" in fault.what for fault in faults_of(document))


@pytest.mark.parametrize(
    "identifier", ["Москва", "Θεσσαλονίκη", "北京 1", "東京タワー", "Zürich", "Łódź", "서울", "تهران 2"]
)
def test_an_id_of_any_one_script_is_fine(identifier: str) -> None:
    document = wgs84()
    document["stations"][0]["id"] = identifier
    assert read_mission(document).stations[0].id == identifier


# --- places and heights -----------------------------------------------------------------------------------------------


def network() -> dict[str, Any]:
    """A near mission, and three stations of the same network on other continents, one of them excluded."""
    document = wgs84()
    near = document["stations"][0]
    for name, lat, lon in (("sydney", -33.9, 151.2), ("lima", -12.0, -77.1), ("oslo-far", 64.0, -150.0)):
        document["stations"].append({**near, "id": name, "lat_deg": lat, "lon_deg": lon, "system_id": None})
    document["options"] = {**document.get("options", {}), "excluded_stations": ["lima"]}
    return document


def test_stations_out_of_every_reach_are_left_out_and_counted() -> None:
    mission = read_mission(network())
    assert mission.left_out == ("sydney", "lima", "oslo-far")
    assert [station.id for station in mission.stations] == [s["id"] for s in wgs84()["stations"]]
    assert mission.options.excluded_stations == ()
    assert with_options(mission, {"min_overlap_s": 2.0}).left_out == mission.left_out
    plan = plan_mission(mission, fast=True)
    assert any("3 stations more than 1000 km from the start left out" in note for note in plan.notes)
    assert recertify(plan).feasible


def test_a_station_with_swapped_coordinates_is_a_fault_beside_far_ones() -> None:
    document = network()
    texel = document["stations"][1]
    texel["lat_deg"], texel["lon_deg"] = texel["lon_deg"], texel["lat_deg"]
    (fault,) = faults_of(document)
    assert fault.where == "stations[1]"
    assert "swap" in fault.fix


def test_both_ends_swapped_are_told_once() -> None:
    (fault,) = faults_of(field_mission("ends_swapped"))
    assert fault.where == "start"
    assert "start and destination" in fault.fix


def test_a_mast_in_feet_is_refused() -> None:
    found = faults_of(field_mission("nexrad_feet_as_metres"))
    assert [fault.where for fault in found] == ["stations[1].alt_amsl_m", "stations[2].alt_amsl_m"]
    assert "9991 ft are 3045.3 m" in found[0].fix


def test_a_band_under_the_ground_is_told_in_the_plan() -> None:
    document = field_mission("relative_alt")
    document["limits"] |= {"min_alt_amsl_m": 10, "max_alt_amsl_m": 60}
    notes = plan_mission(read_mission(document), fast=True).notes
    assert any("below every antenna" in note and "above ground" in note for note in notes)


def test_an_antenna_far_above_the_band_is_told_in_the_plan() -> None:
    document = wgs84()
    document["stations"][1] |= {"alt_amsl_m": 3500.0, "range_m": 30_000.0}
    notes = plan_mission(read_mission(document), fast=True).notes
    assert any("check the altitude of texel" in note for note in notes)


def test_a_sound_mission_is_not_doubted() -> None:
    assert not any("check" in note for note in plan_mission(read_mission(wgs84()), fast=True).notes)


# --- counts and times -------------------------------------------------------------------------------------------------


def test_more_stations_than_system_ids_is_no_fault_of_ours() -> None:
    with pytest.raises(MissionInfeasible) as caught:
        plan_mission(read_mission(field_mission("more_stations_than_ids")), fast=True)
    assert "301 stations" in caught.value.message
    assert "253" in caught.value.message
    assert "max_handovers" not in caught.value.fix_text


def test_where_fewer_stations_will_do_they_are_flown() -> None:
    """Three hundred stations in a row, and one amid them that reaches from end to end along a detour in time."""
    document = copy.deepcopy(field_mission("more_stations_than_ids"))
    document["stations"].append({"id": "wide", "lat_deg": 52.0, "lon_deg": 2.0, "alt_amsl_m": 5, "range_m": 80_000})
    document["options"] = {"min_overlap_s": 0, "range_margin_m": 0, "min_tenure_s": 0}
    plan = plan_mission(read_mission(document), fast=True)
    assert len(plan.station_ids) <= 253


def test_a_flight_of_no_length_is_called_one() -> None:
    document = local()
    document["destination"] = document["start"]
    plan = plan_mission(read_mission(document), fast=True)
    assert any("one place" in note for note in plan.notes)
    assert "0.0 % over 0.0 s" not in summary(plan)


@pytest.mark.parametrize(
    ("text", "moment"),
    [
        ("2016-12-31T23:59:60Z", datetime(2017, 1, 1, tzinfo=UTC)),
        ("2016-12-31T23:59:60.250Z", datetime(2017, 1, 1, 0, 0, 0, 250_000, tzinfo=UTC)),
        ("2017-01-01T05:29:60+05:30", datetime(2017, 1, 1, tzinfo=UTC)),
        ("2016-12-31T23:59:59Z", datetime(2016, 12, 31, 23, 59, 59, tzinfo=UTC)),
    ],
)
def test_a_leap_second_is_a_time(text: str, moment: datetime) -> None:
    assert parse_launch(text) == moment


def test_milliseconds_are_rounded() -> None:
    launch = datetime(2026, 11, 22, 9, tzinfo=UTC)
    assert utc_at(launch, 0.9996) == "2026-11-22T09:00:01.000Z"
    assert utc_at(launch, 1.0004) == "2026-11-22T09:00:01.000Z"
    assert utc_at(launch, 1.2345678) == "2026-11-22T09:00:01.235Z"
