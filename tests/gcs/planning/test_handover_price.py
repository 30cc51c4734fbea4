"""Handovers have a price, and a relaxed mission is never slower."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gcs.errors import MissionError
from gcs.exports.plan_summary import summary
from gcs.mission import read_mission
from gcs.mission.document import with_options
from gcs.mission.model import overlap_after_target_s
from gcs.plan import read_plan
from gcs.plan.model import Plan
from gcs.planning import plan_mission, with_costs
from tests.support.checker import check_plan
from tests.support.paths import MISSIONS

FIELD = Path(__file__).parents[2] / "support" / "field_missions"
MONOTONIC = 1.0002


def given(name: str) -> dict[str, Any]:
    """A mission of the field, or a shipped one."""
    path = FIELD / f"{name}.json"
    document: dict[str, Any] = json.loads((path if path.exists() else MISSIONS / f"{name}.json").read_bytes())
    return document


def planned(document: dict[str, Any], **options: object) -> Plan:
    """The plan of a mission with some options replaced, judged by the independent checker."""
    asked = {**document, "options": {**document.get("options", {}), **options}}
    plan = plan_mission(read_mission(asked))
    assert check_plan(json.loads(json.dumps(plan.to_document())), asked) == []
    return plan


def fastest_s(document: dict[str, Any]) -> float:
    """Its time where handovers cost nothing but time."""
    return planned(document, handover_tolerance=0).mission_time_s


@pytest.mark.parametrize(
    ("name", "handovers"),
    [("handovers_1030", 10), ("handovers_1040", 12), ("handovers_1045", 4), ("wadden_relay", 6)],
)
@pytest.mark.slow
def test_needless_handovers_go(name: str, handovers: int) -> None:
    assert len(planned(given(name)).handovers) <= handovers
    plan = planned(given(name), overlap_target_s=0)
    assert len(plan.handovers) <= handovers
    fastest = fastest_s(given(name))
    assert plan.mission_time_s <= fastest + max(0.001 * fastest, 1.0) + 1e-6


def test_two_sectors_on_one_mast_do_not_hand_over_to_one_another() -> None:
    document = given("colocated_sectors")
    plan = planned(document)
    places = {s["id"]: (s["lat_deg"], s["lon_deg"]) for s in document["stations"]}
    assert all(places[a] != places[b] for a, b in pairwise(plan.station_ids))
    assert plan.mission_time_s <= planned(given("wadden_relay")).mission_time_s + 1.0


@pytest.mark.slow
def test_the_plan_says_what_fewer_handovers_cost() -> None:
    plan = planned(given("handovers_1040"))
    assert plan.fastest is not None
    assert plan.fastest.handovers > len(plan.handovers)
    assert plan.fastest.mission_time_s <= plan.mission_time_s
    assert read_plan(json.loads(json.dumps(plan.to_document()))).fastest == plan.fastest
    fewer = plan.fastest.handovers - len(plan.handovers)
    assert f"{fewer} fewer than in the fastest plan found" in summary(plan)
    costs = {cost.option: cost.cost_s for cost in with_costs(plan).costs}
    assert costs["handover_tolerance"] == pytest.approx(plan.fastest.fewer_cost_s, abs=1e-6)
    both_s = plan.mission_time_s - plan.fastest.mission_time_s
    assert costs["overlap_target_s"] == pytest.approx(both_s - plan.fastest.fewer_cost_s, abs=1e-6)


@pytest.mark.slow
def test_more_tolerance_never_more_handovers() -> None:
    counts = [len(planned(given("handovers_1040"), handover_tolerance=t).handovers) for t in (0.0, 1e-4, 1e-3, 1e-2)]
    assert counts == sorted(counts, reverse=True)


def test_an_endurance_is_not_given_up_for_fewer_handovers() -> None:
    document = given("wadden_relay")
    fastest = fastest_s(document)
    assert planned(document).mission_time_s > fastest + 0.1
    hurried = {**document, "limits": {**document["limits"], "endurance_s": fastest + 0.05}}
    assert planned(hurried).mission_time_s <= fastest + 0.05
    assert planned(document, arrival_s=fastest + 0.05).mission_time_s == pytest.approx(fastest + 0.05)


def test_the_tolerance_is_nothing_where_the_overlap_is() -> None:
    mission = read_mission(given("wadden_relay"))
    assert mission.options.handover_tolerance == 0.001
    assert with_options(mission, {"min_overlap_s": 0}).options.handover_tolerance == 0.0
    assert with_options(mission, {"min_overlap_s": 0, "handover_tolerance": 0.01}).options.handover_tolerance == 0.01
    kept = with_options(mission, {"handover_tolerance": 0.02})
    assert with_options(kept, {"min_overlap_s": 0}).options.handover_tolerance == 0.02


@pytest.mark.parametrize("name", ["relaxed_1005_range", "relaxed_1038_overlap"])
def test_a_relaxed_mission_is_not_slower(name: str) -> None:
    """The second of each pair asks for less, or has more range."""
    assert fastest_s(given(f"{name}_b")) <= MONOTONIC * fastest_s(given(f"{name}_a"))


def test_one_station_and_straight_is_as_fast_as_the_formula() -> None:
    plan = planned(given("relaxed_1188_one_station_slow"))
    assert plan.station_ids == ("po-06",)
    limits = plan.mission.limits
    formula = plan.path_length_m / limits.max_speed_m_s + limits.max_speed_m_s / limits.max_accel_m_s2
    assert plan.mission_time_s <= 1.0005 * formula
    assert plan.mission_time_s <= MONOTONIC * 736.0


def test_a_long_level_flight_stays_level() -> None:
    plan = plan_mission(read_mission(given("1000km_near")))
    assert plan.certificate.feasible
    altitude = plan.trajectory.control_points_m[..., 2]
    assert np.ptp(altitude) < 1.0


def _relaxed(document: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
    """The same mission with more range, less overlap, margin or tenure, or a station added."""
    changed = json.loads(json.dumps(document))
    options = changed.setdefault("options", {})
    match int(rng.integers(5)):
        case 0:
            for station in changed["stations"]:
                station["range_m"] *= float(rng.uniform(1.0, 1.1))
        case 1:
            options["min_overlap_s"] = float(rng.uniform(1.0, 5.0))
            options["handover_tolerance"] = 0
        case 2:
            options["range_margin_m"] = float(rng.uniform(0.0, 25.0))
        case 3:
            options["min_tenure_s"] = float(rng.uniform(0.0, 10.0))
        case _:
            twin = dict(changed["stations"][int(rng.integers(len(changed["stations"])))])
            changed["stations"].append({**twin, "id": "twin", "name": "twin", "range_m": 1.02 * twin["range_m"]})
    return dict(changed)


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("name", ["wadden_relay", "handovers_1045", "relaxed_1038_overlap_a"])
def test_relaxations_drawn(name: str, seed: int) -> None:
    document = given(name)
    strict = plan_mission(with_options(read_mission(document), {"handover_tolerance": 0}))
    asked = _relaxed(document, np.random.default_rng(seed))
    mission = read_mission(asked)
    loose = plan_mission(replace(mission, options=replace(mission.options, handover_tolerance=0.0)))
    assert loose.mission_time_s <= MONOTONIC * strict.mission_time_s


def test_the_overlap_aimed_at_is_reached_where_it_costs_little() -> None:
    """Enough after every handover to notice a failed station and to stop, at 0.1 % of the time each, at most."""
    narrow, wide = planned(given("wadden_relay"), overlap_target_s=0), planned(given("wadden_relay"))
    target_s = overlap_after_target_s(wide.mission.options, wide.mission.limits)
    assert min(h.overlap_end_s - h.time_s for h in narrow.handovers) < 5.0
    assert min(h.overlap_end_s - h.time_s for h in wide.handovers) >= target_s - 1e-6
    assert wide.mission_time_s <= narrow.mission_time_s + len(wide.handovers) * 0.001 * narrow.mission_time_s
    assert any("overlaps as long as aimed at" in note for note in wide.notes)


def test_the_plan_names_the_handovers_that_fall_short() -> None:
    plan = planned(given("wadden_relay"), overlap_target_s=200)
    short = [h.index for h in plan.handovers if h.overlap_end_s - h.time_s < 197.5]
    assert short
    (note,) = [note for note in plan.notes if "fall short of 197.5 s" in note]
    assert all(f"{index} (" in note for index in short)


def test_the_target_may_be_given_and_follows_the_overlap() -> None:
    mission = read_mission(given("wadden_relay"))
    assert mission.options.overlap_target_s == "auto"
    assert with_options(mission, {"min_overlap_s": 0}).options.overlap_target_s == 0.0
    assert with_options(mission, {"overlap_target_s": 12}).options.overlap_target_s == 12.0
    with pytest.raises(MissionError):
        with_options(mission, {"overlap_target_s": "wide"})
    with pytest.raises(MissionError):
        with_options(mission, {"overlap_target_s": -1})
