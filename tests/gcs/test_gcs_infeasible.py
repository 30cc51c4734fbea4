"""Missions that cannot be flown: the reason, the place, the words, and a fix that works."""

from __future__ import annotations

import copy
import json
import math
from typing import Any

import pytest

from gcs.errors import MissionInfeasible
from gcs.mission import Mission
from gcs.planning import lay_out, plan_mission
from planner.lens import diagnose
from tests.infeasible_missions import INFEASIBLE, local, wgs84

NAMES = [case[0] for case in INFEASIBLE]


def infeasible(document: dict[str, Any]) -> MissionInfeasible:
    with pytest.raises(MissionInfeasible) as caught:
        plan_mission(Mission.from_document(document), fast=True)
    return caught.value


@pytest.mark.parametrize(("document", "reason", "words"), [case[1:] for case in INFEASIBLE], ids=NAMES)
def test_infeasible_missions_are_explained(document: dict[str, Any], reason: str, words: tuple[str, ...]) -> None:
    error = infeasible(document)
    assert error.reason == reason
    for word in words:
        assert word in str(error), str(error)
    known = {station["id"] for station in document["stations"]}
    assert set(error.stations) <= known
    text = json.dumps(error.to_document(), allow_nan=False)
    assert "np." not in text
    assert "station 0" not in str(error)
    assert "station 1" not in str(error)
    if error.where is not None:
        assert {"lat_deg", "lon_deg", "alt_amsl_m"} <= set(error.where)
        assert ("east_m" in error.where) == ("origin" in document)


def remedies(fix: dict[str, Any] | None) -> list[dict[str, Any]]:
    """A fix and its alternatives, each on its own."""
    if fix is None:
        return []
    alone = {key: value for key, value in fix.items() if key != "alternatives"}
    return [alone, *fix.get("alternatives", [])]


def apply(document: dict[str, Any], fix: dict[str, Any]) -> dict[str, Any]:
    """The mission with one remedy followed to the letter."""
    result = copy.deepcopy(document)
    margin = result.setdefault("options", {})
    match fix["action"]:
        case "raise_range":
            for one in [fix, *fix.get("also", [])]:
                station = next(s for s in result["stations"] if s["id"] == one["station"])
                station["range_m"] += one["by_m"]
        case "raise_all_ranges":
            for station in result["stations"]:
                station["range_m"] += fix["by_m"]
        case "lower_margin":
            margin["range_margin_m"] = fix.get("range_margin_m", margin["range_margin_m"] - fix["by_m"] - 1e-6)
        case "widen_band":
            result["limits"] |= {key: value for key, value in fix.items() if key.endswith("_alt_amsl_m")}
        case "set_altitude":
            key = "up_m" if "origin" in result else "alt_amsl_m"
            result[fix["of"]][key] = fix["alt_amsl_m"] - result.get("origin", {}).get("alt_amsl_m", 0.0)
        case "add_station":
            place = fix["position"]
            keys = ("east_m", "north_m", "up_m") if "origin" in result else ("lat_deg", "lon_deg", "alt_amsl_m")
            result["stations"].append({"id": "added", "range_m": fix["range_m"], **{key: place[key] for key in keys}})
        case "raise_limit" if fix["limit"] == "max_handovers":
            margin["max_handovers"] = fix["to"]
        case "raise_limit":
            result["limits"][fix["limit"]] = fix["to"]
        case "later_arrival":
            margin["arrival_s"] += fix["by_s"] + 1e-6
        case action:
            raise AssertionError(action)
    return result


FIXABLE = [case for case in INFEASIBLE if case[0] not in {"below the lowest elevation"}]


@pytest.mark.parametrize(("name", "document"), [case[:2] for case in FIXABLE], ids=[case[0] for case in FIXABLE])
def test_doing_what_the_fix_says_mends_what_was_wrong(name: str, document: dict[str, Any]) -> None:
    """Each remedy, followed to the letter: the finding is gone (the mission may have another, further on)."""
    error = infeasible(document)
    found = remedies(error.fix)
    assert found, error
    for fix in found:
        mission = Mission.from_document(apply(document, fix))
        following = outcome(mission)
        if following is None:
            continue
        # Another fault than the one the fix was for, e.g. a start moved into range but a chain broken behind it.
        assert (following.reason, following.stations, following.fix) != (error.reason, error.stations, error.fix)
        assert error.reason not in ("broken_chain", "arrival"), (fix, following)


def outcome(mission: Mission) -> MissionInfeasible | None:
    """None when it can be planned."""
    try:
        assert plan_mission(mission, fast=True).certificate.feasible
    except MissionInfeasible as error:
        return error
    return None


def test_endurance_fixes_lead_to_a_plan() -> None:
    """The first answer is the bound no flight can beat; following the next one at the latest makes a plan."""
    document = next(case[1] for case in INFEASIBLE if case[0] == "too little endurance")
    for _ in range(3):
        error = outcome(Mission.from_document(document))
        if error is None:
            return
        assert error.fix is not None
        assert error.fix["limit"] == "endurance_s"
        document = apply(document, error.fix)
    raise AssertionError("three fixes were not enough")


def test_the_gap_is_the_hand_worked_one() -> None:
    """Discs of sqrt(1000^2 - 100^2) = 994.987 m around 0 and 2500 m: 510.025 m apart."""
    error = infeasible(local(stations__1__east_m=2500.0, destination__east_m=2500.0))
    assert error.gap_m == pytest.approx(2500.0 - 2.0 * math.sqrt(1000.0**2 - 100.0**2), abs=0.01)
    assert error.stations == ("A", "B")
    assert error.where is not None
    assert error.where["east_m"] == pytest.approx(1250.0, abs=1.0)
    assert error.fix is not None
    # one of the two must reach the other's disc: sqrt((2500 - 994.987)^2 + 100^2) - 1000
    assert error.fix["by_m"] == pytest.approx(math.hypot(2500.0 - 994.987, 100.0) - 1000.0, abs=0.01)


def test_uncovered_start_tells_how_far() -> None:
    """1200 m west and 110 m up of A: hypot(1200, 110) - 1000 = 205.03 m short."""
    error = infeasible(local(start__east_m=-1200.0))
    assert error.gap_m == pytest.approx(math.hypot(1200.0, 110.0) - 1000.0, abs=1e-6)


def test_the_margin_named_is_the_largest_that_holds() -> None:
    """Lens of 19.97 m depth between two stations: each may lose half of it, 9.98 m, not 10.05."""
    document = local(stations__1__east_m=1970.0, destination__east_m=1970.0, options__range_margin_m=25.0)
    error = infeasible(document)
    fix = next(f for f in remedies(error.fix) if f["action"] == "lower_margin")
    margin = fix["range_margin_m"]
    assert diagnose(lay_out(Mission.from_document(apply(document, fix))).problem) is None
    worse = {**document, "options": {**document["options"], "range_margin_m": margin + 0.05}}
    assert diagnose(lay_out(Mission.from_document(worse)).problem) is not None


@pytest.mark.parametrize("short_m", [0.5, 40.0, 900.0])
def test_a_fix_on_the_earth_counts_the_projection_in(short_m: float) -> None:
    """Texel reaches ``short_m`` too little to meet Den Helder; the range asked for is enough, to the centimetre."""
    document = wgs84()
    error = infeasible(wgs84(stations__1__range_m=5_600.0 - short_m))
    assert error.fix is not None
    raised = next(s for s in document["stations"] if s["id"] == error.fix["station"])
    document["stations"][1]["range_m"] = 5_600.0 - short_m
    raised["range_m"] += error.fix["by_m"]
    assert diagnose(lay_out(Mission.from_document(document)).problem) is None
    raised["range_m"] -= 0.02
    assert diagnose(lay_out(Mission.from_document(document)).problem) is not None
