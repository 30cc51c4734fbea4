"""Every option and limit held by the independent checker: without it a plan breaks it, with it none does."""

from __future__ import annotations

import json
import re
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gcs.errors import MissionInfeasible
from gcs.mission import read_mission, write_mission
from gcs.plan import read_plan
from gcs.plan.model import Plan, hash_of
from gcs.planning.mission_planning import plan_mission
from gcs.planning.option_costs import with_costs
from tests.support.checker import check_plan, flight_energy_s
from tests.support.missions.with_options import BASE, changed, on_earth, random_mission
from tests.support.remedies import apply

Document = dict[str, Any]

CLIMB = {"start.up_m": 101.0, "destination.up_m": 119.0}
SINK = {"start.up_m": 119.0, "destination.up_m": 101.0}
# What binds, the rest of the mission, and a word of the complaint that a plan made without it must cause.
BINDING: list[tuple[str, Document, Document, str]] = [
    ("min_overlap_s", {"options.min_overlap_s": 15.0}, {}, "overlap asked for"),
    ("range_margin_m", {"options.range_margin_m": 80.0}, {}, "range less the margin"),
    ("min_tenure_s", {"options.min_tenure_s": 60.0}, {}, "in control for"),
    ("max_jerk_m_s3", {"limits.max_jerk_m_s3": 2.0}, {}, "jerk of"),
    ("max_climb_m_s", {"limits.max_climb_m_s": 0.2}, CLIMB, "climbs too fast"),
    ("max_descent_m_s", {"limits.max_descent_m_s": 0.2}, SINK, "sinks too fast"),
    (
        "max_airspeed_m_s",
        {"limits.max_airspeed_m_s": 40.0, "limits.wind": {"east_m_s": -8.0, "north_m_s": 5.0}},
        {},
        "airspeed",
    ),
    (
        "endurance_s",
        {"limits.endurance_s": 120.0, "limits.reserve_s": 40.0},
        {"options.objective": "energy"},
        "above endurance less reserve",
    ),
    ("min_elevation_deg", {"stations.1.min_elevation_deg": 7.5}, {}, "below the elevation B"),
    ("max_handovers", {"options.max_handovers": 1}, {}, "handovers, allowed 1"),
    ("excluded_stations", {"options.excluded_stations": ["B"]}, {}, "excluded station"),
    (
        "start_state",
        {"options.start_state": {"velocity_m_s": [12.0, -9.0, 0.3], "acceleration_m_s2": [-1.0, 0.5, 0.1]}},
        {},
        "joint 0: derivative",
    ),
    ("arrival_s", {"options.arrival_s": 150.0}, {}, "but arrival asked for"),
    (
        "start_state and arrival_s",
        {"options.start_state": {"velocity_m_s": [25.0, 0.0, 0.0]}, "options.arrival_s": 150.0},
        {},
        "but arrival asked for",
    ),
    (
        "objective and arrival_s",
        {"options.objective": 0.5, "options.arrival_s": 85.0},
        {},
        "but arrival asked for",
    ),
]
NAMES = [case[0] for case in BINDING]


def planned(mission: Document, **how: Any) -> Document:
    """The plan as a reader gets it: through JSON text and back."""
    plan = plan_mission(read_mission(mission), **{"fast": True, **how})
    document: Document = json.loads(json.dumps(plan.to_document(), allow_nan=False))
    return document


@pytest.fixture(scope="module")
def free_plans() -> dict[str, Document]:
    """Plans without the option, by mission text: most cases share one."""
    return {}


@pytest.mark.parametrize("frame", ["local", "wgs84"])
@pytest.mark.parametrize(("name", "option", "rest", "complaint"), BINDING, ids=NAMES)
def test_an_option_binds_and_is_kept(
    free_plans: dict[str, Document], frame: str, name: str, option: Document, rest: Document, complaint: str
) -> None:
    free, asked = changed(BASE, rest), changed(changed(BASE, rest), option)
    if frame == "wgs84":
        free, asked = on_earth(free), on_earth(asked)
    key = json.dumps(free)
    if key not in free_plans:
        free_plans[key] = planned(free)
        assert check_plan(free_plans[key], free) == []
    assert any(complaint in found for found in check_plan(free_plans[key], asked)), "the option does not bind"
    assert check_plan(planned(asked), asked) == []


@pytest.mark.parametrize("objective", ["energy", 0.4])
def test_energy_is_saved_and_time_is_what_it_costs(objective: str | float) -> None:
    """Energy by Simpson's rule in the checker: the weighted sum is the least at its own weight, in both directions."""
    asked = changed(BASE, {"options.objective": objective})
    weight = 1.0 if objective == "energy" else float(objective)
    fastest, saving = planned(BASE), planned(asked)
    assert check_plan(saving, asked) == []
    assert saving["mission_time_s"] > 1.02 * fastest["mission_time_s"]
    energy = [flight_energy_s(plan, asked) for plan in (fastest, saving)]
    assert energy[1] < 0.98 * energy[0]
    cost = [
        (1 - weight) * plan["mission_time_s"] + weight * e for plan, e in zip((fastest, saving), energy, strict=True)
    ]
    assert cost[1] < cost[0]


def test_a_slowed_moving_start_waits_but_little() -> None:
    """Sixty seconds too early: most of them are flown slower, few are waited for over the destination."""
    mission = changed(BASE, {"options.start_state": {"velocity_m_s": [25.0, 0.0, 0.0]}, "options.arrival_s": 150.0})
    plan = planned(mission)
    last = plan["segments"][-1]
    assert plan["mission_time_s"] == pytest.approx(150.0, abs=1e-6)
    still = [point == last["control_points"][0] for point in last["control_points"]]
    assert not all(still) or last["duration_s"] < 3.0


@pytest.mark.parametrize("arrival_s", [100.0, 123.456, 133.3, 150.7])
def test_an_arrival_at_the_very_end_of_the_endurance(arrival_s: float) -> None:
    """Durations that add up to a rounding more would break the endurance."""
    mission = changed(BASE, {"options.arrival_s": arrival_s, "limits.endurance_s": arrival_s})
    assert check_plan(planned(mission), mission) == []


# --- what the options cost --------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def with_all() -> Plan:
    options = {
        "options.min_overlap_s": 10.0,
        "options.range_margin_m": 40.0,
        "options.min_tenure_s": 35.0,
        "limits.max_jerk_m_s3": 3.0,
        "options.arrival_s": 160.0,
    }
    mission = read_mission(changed(BASE, options))
    return with_costs(plan_mission(mission, fast=True), method="fast")


def test_costs_are_what_planning_without_the_option_saves(with_all: Plan) -> None:
    costs = {cost.option: cost.cost_s for cost in with_all.costs}
    options = {"min_overlap_s", "overlap_target_s", "range_margin_m", "min_tenure_s", "handover_tolerance"}
    assert set(costs) == {*options, "max_jerk_m_s3", "arrival_s", "together"}
    mission = write_mission(with_all.mission)
    hurried = changed(mission, {"options.arrival_s": None})
    base_s = planned(hurried)["mission_time_s"]
    assert costs["arrival_s"] == pytest.approx(160.0 - base_s)
    without_s = planned(changed(hurried, {"options.min_overlap_s": 0.0}))["mission_time_s"]
    assert costs["min_overlap_s"] == pytest.approx(base_s - without_s)
    assert costs["min_overlap_s"] > 0.5
    numbers = [cost for name, cost in costs.items() if name != "together" and cost is not None]
    assert min(numbers) >= 0.0
    assert costs["together"] is not None
    assert costs["together"] >= max(numbers)


def test_costs_are_part_of_the_plan_and_of_its_hash(with_all: Plan) -> None:
    document = json.loads(json.dumps(with_all.to_document()))
    assert document["costs"][0].keys() == {"option", "value", "cost_s"}
    assert document["plan_sha256"] == hash_of(document)
    assert check_plan(document, write_mission(with_all.mission)) == []
    assert read_plan(document).costs == with_all.costs


# --- any mixture ------------------------------------------------------------------------------------------------------


def flown_or_explained(seed: int) -> None:
    """A plan the checker finds nothing wrong with; or a reason, and a first fix after which there is such a plan."""
    document = random_mission(seed)
    for _ in range(3):
        error = outcome(document)
        if error is None:
            return
        assert error.message.endswith("."), error.message
        assert not re.search(r"\bstation \d", error.message), error.message
        assert error.fix is not None, error.message
        assert error.fix_text.endswith("."), error.fix_text
        json.dumps(error.to_document(), allow_nan=False)
        document = apply(document, error.fix)
    raise AssertionError(f"seed {seed}: three fixes were not enough, {outcome(document)}")


def outcome(document: Document) -> MissionInfeasible | None:
    """None for a plan the checker finds nothing wrong with."""
    try:
        plan = planned(document)
    except MissionInfeasible as error:
        return error
    assert check_plan(plan, document) == []
    return None


@pytest.mark.slow
@settings(max_examples=15)
@given(st.integers(0, 10**6))
def test_random_missions_are_flown_or_explained(seed: int) -> None:
    flown_or_explained(seed)


@pytest.mark.soak
@pytest.mark.timeout(3600)
@settings(max_examples=600)
@given(st.integers(0, 10**6))
def test_many_random_missions_are_flown_or_explained(seed: int) -> None:
    flown_or_explained(seed)
