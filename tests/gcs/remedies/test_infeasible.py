"""Missions that cannot be flown: the reason, the place, the words, and a fix that works."""

from __future__ import annotations

import copy
import json
import math
from dataclasses import replace
from typing import Any

import pytest

from gcs.errors import Finding, MissionInfeasible
from gcs.layout.planning_problem import lay_out
from gcs.mission import read_mission
from gcs.mission.model import Mission
from gcs.planning.mission_planning import plan_mission
from planner.infeasibility.diagnosis import diagnose
from tests.support.checker import check_plan
from tests.support.missions.infeasible import INFEASIBLE, local, wgs84
from tests.support.missions.malformed import GOOD
from tests.support.missions.with_options import BASE, changed
from tests.support.remedies import apply, remedies

NAMES = [case[0] for case in INFEASIBLE]


def infeasible(document: dict[str, Any]) -> MissionInfeasible:
    with pytest.raises(MissionInfeasible) as caught:
        plan_mission(read_mission(document), fast=True)
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


def smaller(document: dict[str, Any], fix: dict[str, Any]) -> dict[str, Any] | None:
    """The same remedy with a hundredth less of it; None where there is nothing in between."""
    less = copy.deepcopy(fix)
    match fix["action"]:
        case "raise_range" | "raise_all_ranges":
            less["by_m"] *= 0.99
        case "lower_margin":
            less["range_margin_m"] += 0.01 * fix["by_m"]
        case "lower_option":
            less["to"] += 0.01 * fix["by_s"]
        case "lower_elevation":
            less["to_deg"] = (0.0 if fix["to_deg"] is None else fix["to_deg"]) + 0.01 * fix["by_deg"]
        case "lower_elevations":
            less["by_deg"] *= 0.99
        case "widen_band":
            for key, sign in (("min_alt_amsl_m", 1), ("max_alt_amsl_m", -1)):
                if key in fix:
                    less[key] += sign * 0.01 * fix["by_m"]
        case "set_altitude":
            less["alt_amsl_m"] -= 0.01 * fix["by_m"]
        case "move":
            for key, value in document[fix["of"]].items():
                less["position"][key] += 0.01 * (value - fix["position"][key])
        case "add_station":
            less["range_m"] *= 0.99
        case "raise_limit" if fix["limit"] == "max_handovers":
            less["to"] -= 1
        case "raise_limit" if fix["limit"] in ("max_speed_m_s", "max_accel_m_s2"):
            return None  # the planner's times are not smooth enough in these for a hundredth to tell
        case "raise_limit":
            less["to"] *= 0.99
        case "lower_limit":
            less["to"] += 0.01 * fix["by"]
        case "lower_wind":
            less |= {key: fix[key] / 0.99 for key in ("east_m_s", "north_m_s")}
        case "lower_start_speed":
            # The quick method that finds it gives up a little early.
            less |= {key: [x * 1.06 for x in fix[key]] for key in ("velocity_m_s", "acceleration_m_s2")}
        case "later_arrival":
            less["arrival_s"] *= 0.99
        case "earlier_arrival":
            less["arrival_s"] *= 1.01
        case _:
            return None
    return less


TURNED = changed(BASE, {"options.min_overlap_s": 15.0, "options.min_tenure_s": 20.0, "options.range_margin_m": 30.0})
# More that cannot be flown, for kinds of fixes the shared list has none for.
FURTHER: list[tuple[str, dict[str, Any], set[str]]] = [
    ("a start seen too low", local(start__east_m=-900.0, stations__0__min_elevation_deg=20.0), {"lower_elevation"}),
    (
        "a start seen too low on the earth",
        wgs84(
            start__lat_deg=52.9734,
            destination=GOOD["start"],
            stations__0__min_elevation_deg=20.0,
            stations__1__min_elevation_deg=20.0,
        ),
        {"lower_elevation", "move"},
    ),
    (
        "a chain cut by elevations",
        local(stations__0__min_elevation_deg=12.0, stations__1__min_elevation_deg=12.0),
        {"lower_elevations"},
    ),
    (
        "arrival after the endurance",
        local(limits__endurance_s=100.0, limits__reserve_s=40.0, options__arrival_s=70.0),
        {"earlier_arrival", "raise_limit", "lower_limit"},
    ),
    (
        "too short for the overlap",
        changed(TURNED, {"limits.endurance_s": 80.0}),
        {"raise_limit", "lower_option"},
    ),
    (
        "one handover too many",
        changed(BASE, {"options.max_handovers": 0}),
        {"raise_limit", "raise_range", "raise_all_ranges"},
    ),
    (
        "out of the band on the earth",
        wgs84(start__alt_amsl_m=80.0, destination__alt_amsl_m=85.0),
        {"set_altitude", "widen_band"},
    ),
    (
        "a band too high",
        local(limits__min_alt_amsl_m=990.0, limits__max_alt_amsl_m=995.0, start__up_m=995.0, destination__up_m=995.0),
        {"widen_band", "raise_range"},
    ),
    (
        "the only way excluded",
        local(options__excluded_stations=["B"]),
        {"include_station", "move", "add_station"},
    ),
    (
        "no range and a gap",
        local(options__range_margin_m=5000.0, stations__1__east_m=2500.0, destination__east_m=2500.0),
        {"lower_margin"},
    ),
    (
        "a start faster than allowed",
        local(options__start_state={"velocity_m_s": [70.0, 0.0, 0.0]}),
        {"lower_start_speed", "raise_limit"},
    ),
    (
        "wind on the earth",
        wgs84(limits__max_airspeed_m_s=9.0, limits__wind={"east_m_s": 8.0, "north_m_s": -6.0}),
        {"raise_limit", "lower_wind"},
    ),
]
FIXABLE = [*((case[0], case[1], set()) for case in INFEASIBLE), *FURTHER]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "document", "kinds"), FIXABLE, ids=[case[0] for case in FIXABLE])
def test_every_fix_offered_works_and_is_the_least(name: str, document: dict[str, Any], kinds: set[str]) -> None:
    """Each remedy, followed to the letter, makes a plan the checker accepts; with a hundredth less there is none."""
    error = infeasible(document)
    found = remedies(error.fix)
    assert found, error
    assert kinds <= {fix["action"] for fix in found}, error
    for fix in found:
        mended = apply(document, fix)
        try:
            plan = plan_mission(read_mission(mended), fast=True)
        except MissionInfeasible as still:
            raise AssertionError(f"{fix} did not help: {still}") from None
        assert check_plan(json.loads(json.dumps(plan.to_document())), mended) == [], fix
        less = smaller(document, fix)
        if less is not None:
            assert not possible(read_mission(apply(document, less))), f"less than {fix} is enough"


@pytest.mark.slow
def test_a_start_that_cannot_stop_in_time() -> None:
    """10 m above the floor, sinking at 10 m/s, 5 m/s^2: sqrt(2 x 5 x 10) = 10 m/s would need all of it at once."""
    document = local(options__start_state={"velocity_m_s": [0.0, 0.0, -10.0]})
    error = infeasible(document)
    found = remedies(error.fix)
    assert {fix["action"] for fix in found} == {"lower_start_speed", "raise_limit", "widen_band"}
    assert found[0]["below_m_s"] == pytest.approx(9.7, abs=0.25)
    for fix in found:
        assert outcome(read_mission(apply(document, fix))) is None
        less = smaller(document, fix)
        assert less is None or outcome(read_mission(apply(document, less))) is not None


def test_the_smallest_fix_comes_first() -> None:
    """Metres in all, of one kind against the other: an overlap short of 30 m, a margin of 25 m that can be 9.98 m."""
    error = infeasible(local(stations__1__east_m=1970.0, destination__east_m=1970.0, options__range_margin_m=25.0))
    asked = [fix["by_m"] for fix in remedies(error.fix) if fix["action"] in ("lower_margin", "raise_range")]
    assert asked == sorted(asked)
    assert remedies(error.fix)[0]["action"] == "lower_margin"


def possible(mission: Mission) -> bool:
    """Whether there is a plan; without the search for fixes that a refusal would cost."""
    limits, options = mission.limits, mission.options
    allowed = math.inf if limits.endurance_s is None else limits.endurance_s - (limits.reserve_s or 0.0)
    arrival = math.inf if options.arrival_s is None else options.arrival_s
    free = replace(
        mission,
        limits=replace(limits, endurance_s=None, reserve_s=None),
        options=replace(options, arrival_s=None),
    )
    if arrival < math.inf and arrival > allowed:
        return False
    try:
        if diagnose(lay_out(mission).problem) is not None:
            return False
        return plan_mission(free, fast=True).mission_time_s <= min(allowed, arrival)
    except (Finding, MissionInfeasible):
        return False


def outcome(mission: Mission) -> MissionInfeasible | None:
    """None when it can be planned."""
    try:
        assert plan_mission(mission, fast=True).certificate.feasible
    except MissionInfeasible as error:
        return error
    return None


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
    """Overlap of 19.97 m depth between two stations: each may lose half of it, 9.98 m, not 10.05."""
    document = local(stations__1__east_m=1970.0, destination__east_m=1970.0, options__range_margin_m=25.0)
    error = infeasible(document)
    fix = next(f for f in remedies(error.fix) if f["action"] == "lower_margin")
    margin = fix["range_margin_m"]
    assert diagnose(lay_out(read_mission(apply(document, fix))).problem) is None
    worse = {**document, "options": {**document["options"], "range_margin_m": margin + 0.05}}
    assert diagnose(lay_out(read_mission(worse)).problem) is not None


@pytest.mark.parametrize("short_m", [0.5, 40.0, 900.0])
def test_a_fix_on_the_earth_counts_the_projection_in(short_m: float) -> None:
    """Texel reaches ``short_m`` too little to meet Den Helder; the range asked for is enough, to the centimetre."""
    document = wgs84()
    error = infeasible(wgs84(stations__1__range_m=5_600.0 - short_m))
    assert error.fix is not None
    raised = next(s for s in document["stations"] if s["id"] == error.fix["station"])
    document["stations"][1]["range_m"] = 5_600.0 - short_m
    raised["range_m"] += error.fix["by_m"]
    assert diagnose(lay_out(read_mission(document)).problem) is None
    raised["range_m"] -= 0.02
    assert diagnose(lay_out(read_mission(document)).problem) is not None
