"""Every cause told, in flight order, each with its fix; and what is printed is what was tried."""

from __future__ import annotations

import re
from typing import Any

import pytest

from gcs.errors import MissionInfeasible
from gcs.mission import read_mission
from gcs.planning.mission_planning import plan_mission
from gcs.remedies.trial import is_linked
from tests.support.field_missions import field_mission
from tests.support.missions.infeasible import local
from tests.support.remedies import apply, remedies

PRINTED_PLACE = re.compile(r"(-?\d+\.\d+), (-?\d+\.\d+), (-?\d+\.\d) m AMSL")


def refusal(document: dict[str, Any]) -> MissionInfeasible:
    with pytest.raises(MissionInfeasible) as caught:
        plan_mission(read_mission(document), fast=True)
    return caught.value


def reasons(error: MissionInfeasible) -> list[tuple[object, list[str]]]:
    return [(cause["reason"], list(cause["stations"])) for cause in error.causes]  # type: ignore[call-overload]


def test_every_gap_is_told() -> None:
    error = refusal(field_mission("two_gaps"))
    assert reasons(error) == [
        ("broken_chain", ["terschelling", "lauwersoog"]),
        ("broken_chain", ["lauwersoog", "borkum"]),
    ]
    assert all(cause["fix_text"] for cause in error.causes)
    assert "(2)" in error.message


def test_an_end_and_a_gap_are_told_in_flight_order() -> None:
    error = refusal(field_mission("dest_uncovered_and_gap"))
    assert [reason for reason, _ in reasons(error)] == ["broken_chain", "destination_uncovered"]


def test_both_ends_outside_the_band_are_told_and_doubted_before_the_ceiling() -> None:
    error = refusal(field_mission("both_ends_wrong_altitude_ft"))
    assert [reason for reason, _ in reasons(error)] == ["start_altitude", "destination_altitude"]
    assert "328 ft are 100.0 m" in error.message
    assert [fix["action"] for fix in remedies(error.fix)] == ["set_altitude", "widen_band"]


def test_an_altitude_above_ground_is_doubted_and_the_floor_not_sunk() -> None:
    error = refusal(field_mission("relative_alt"))
    assert "height above ground" in error.message
    assert "472 m below the antenna of a" in error.message
    assert [fix["action"] for fix in remedies(error.fix)] == ["set_altitude"]


def test_an_exclusion_is_the_cause_and_its_end_the_first_fix() -> None:
    error = refusal(field_mission("excluded"))
    assert "borkum is excluded" in error.message
    assert error.fix is not None
    assert error.fix["action"] == "include_station"


def test_several_exclusions_together_are_a_cause() -> None:
    document = local(options__excluded_stations=["B", "C"], destination__east_m=3000.0)
    document["stations"].append({**document["stations"][1], "id": "C", "east_m": 3000.0, "system_id": None})
    error = refusal(document)
    assert error.fix is not None
    assert [error.fix["station"], *(step["station"] for step in error.fix["also"])] == ["B", "C"]  # type: ignore[attr-defined]


MASKED = ["start_masked", "band_below_antenna_mask0", "mask_1000", "mask0_mountain"]


@pytest.mark.parametrize("name", MASKED)
def test_a_mask_is_named_as_one_and_lowered_first(name: str) -> None:
    document = field_mission(name)
    error = refusal(document)
    told = [str(cause["message"]) for cause in error.causes] or [error.message]
    assert all("lowest elevation" in text for text in told)
    first = remedies(error.fix)[0]
    assert {step["action"] for step in (first, *first.get("also", []))} == {"lower_elevation"}
    assert is_linked(read_mission(apply(document, first)))


def test_a_mask_and_a_gap_are_told_apart() -> None:
    """Stations 4 km apart of 1 km range: masks are beside the point, and the gap is not called a mask."""
    document = local(stations__1__east_m=4000.0, destination__east_m=4000.0, stations__0__min_elevation_deg=1.0)
    error = refusal(document)
    assert error.gap_m is not None
    assert error.gap_m > 1000.0
    assert "mask" not in error.message


ADDED = ["addstation_m1049", "addstation_m1050", "two_gaps", "dest_uncovered_and_gap", "excluded"]


@pytest.mark.parametrize("name", ADDED)
def test_printed_places_are_the_ones_tried(name: str) -> None:
    """Typed in from the text, to its last printed digit, every station added and every end moved does what it says."""
    document = field_mission(name)
    error = refusal(document)
    typed = [fix for fix in remedies(error.fix) if fix["action"] in ("add_station", "move")]
    assert typed
    for fix in typed:
        for step in (fix, *fix.get("also", [])):
            place = step.get("position")
            if place is not None:
                printed = f"{place['lat_deg']:.6f}, {place['lon_deg']:.6f}, {place['alt_amsl_m']:.1f} m AMSL"
                assert printed in error.fix_text
                lat, lon, alt = PRINTED_PLACE.fullmatch(printed).groups()  # type: ignore[union-attr]
                assert (place["lat_deg"], place["lon_deg"], place["alt_amsl_m"]) == (float(lat), float(lon), float(alt))
        assert is_linked(read_mission(apply(document, fix)))


def test_a_gap_is_never_nothing() -> None:
    document = local(stations__1__east_m=2 * 994.987 + 0.02, destination__east_m=2 * 994.987 + 0.02)
    assert "less than 0.1 m" in refusal(document).message


def test_what_a_fix_costs_is_said() -> None:
    error = refusal(local(limits__max_airspeed_m_s=15.0, limits__wind={"east_m_s": 12.0, "north_m_s": 9.5}))
    assert error.fix is not None
    assert isinstance(error.fix["mission_time_s"], float)
    assert "the flight then takes" in error.fix_text


def test_causes_survive_the_way_through_store_and_processes() -> None:
    from gcs.errors import infeasible_from_document

    error = refusal(field_mission("two_gaps"))
    assert infeasible_from_document(error.to_document()).to_document() == error.to_document()
