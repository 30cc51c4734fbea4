"""A flight planned anew under way: joined without a jump, proved from end to end by a judge that calls no planner."""

from __future__ import annotations

import json
from functools import cache
from importlib import resources
from typing import Any

import numpy as np
import pytest

from gcs.errors import MissionError, MissionInfeasible
from gcs.jobs.worker import answer
from gcs.mission import read_mission
from gcs.mission.model import LocalPosition
from gcs.plan import read_plan
from gcs.plan.model import Plan
from gcs.planning.joining import LEAST_PIECE_S
from gcs.planning.mission_planning import plan_mission
from gcs.planning.replanning import Replanned, ReplanOrder, replan
from tests.support.checker import check_plan
from tests.support.plans.planned import FIRST_JOIN_S, wide_document, wide_plan

FAST: dict[str, Any] = {"method": "fast"}


@cache
def earth_plan() -> Plan:
    """The same over WGS84, at 30 m/s over 60 km, so that projection matters."""
    stations = [
        {"id": name, "lat_deg": 53.0 + 0.01 * k, "lon_deg": 4.8 + 0.3 * k, "alt_amsl_m": 5.0, "range_m": 16_000.0}
        for k, name in enumerate(("a", "b", "c", "d"))
    ]
    document = {
        "start": {"lat_deg": 53.0, "lon_deg": 4.8, "alt_amsl_m": 100.0},
        "destination": {"lat_deg": 53.05, "lon_deg": 5.7, "alt_amsl_m": 100.0},
        "stations": stations,
        "limits": {"min_alt_amsl_m": 90.0, "max_alt_amsl_m": 120.0, "max_speed_m_s": 30.0, "max_accel_m_s2": 2.5},
    }
    return plan_mission(read_mission(document), fast=True)


def holds(new: Replanned, old: Plan, join_s: float) -> None:
    """What every replan must hold: a document that reads back, an independent proof, the flown part as flown."""
    document = json.loads(json.dumps(new.plan.to_document()))
    assert read_plan(document).plan_sha256 == new.plan.plan_sha256
    # The ids that were given out stay, so the mission the judge compares with is the plan's own.
    assert check_plan(document, document["mission"]) == []
    ids = {s.id: s.system_id for s in old.mission.stations if s.system_id is not None}
    assert {s.id: s.system_id for s in new.plan.mission.stations if s.id in ids} == ids
    assert new.plan.plane == old.plane
    begun = old.mission_time_s if not new.at_rest else join_s
    same_until_s = join_s if not new.at_rest else 2.0 * join_s - new.join_s
    for time_s in np.linspace(0.0, max(0.0, min(same_until_s, begun)), 23):
        for order in (0, 1, 2):
            off = new.plan.trajectory.evaluate(time_s, order) - old.trajectory.evaluate(time_s, order)
            assert np.abs(off).max() < 1e-6
    ways = new.plan.contingencies
    assert ways[0].from_s == 0.0
    assert ways[-1].to_s == pytest.approx(new.plan.mission_time_s)
    assert all(way.covered for way in ways)


def on_leg(leg: int, into_s: float) -> float:
    """A time of the plan so long after a leg began: past the tenure of its station, which is not to be cut short."""
    return into_s if leg == 0 else wide_plan().handovers[leg - 1].time_s + into_s


@pytest.mark.slow
@pytest.mark.parametrize("place", [(0, 5.0), (1, 13.0), (3, 12.0)])
def test_a_flight_in_motion_keeps_position_velocity_and_acceleration(place: tuple[int, float]) -> None:
    old, join_s = wide_plan(), on_leg(*place)
    new = replan(old, join_s, **FAST)
    assert join_s <= new.join_s <= join_s + LEAST_PIECE_S
    holds(new, old, new.join_s)
    assert new.plan.station_ids[-1] == old.station_ids[-1]


@pytest.mark.slow
def test_on_the_earth_the_plane_stays_the_flights_own() -> None:
    old = earth_plan()
    for join_s in (300.0, 0.5 * old.mission_time_s, 0.8 * old.mission_time_s):
        new = replan(old, join_s, **FAST)
        holds(new, old, join_s)
        assert new.plan.mission_time_s < 1.01 * old.mission_time_s


def test_a_new_destination_and_a_station_left_out() -> None:
    old = wide_plan()
    assert "s2" in old.station_ids
    join_s = FIRST_JOIN_S
    home = replan(old, join_s, destination=LocalPosition(0.0, 0.0, 40.0), **FAST)
    holds(home, old, join_s)
    end = home.plan.trajectory.evaluate(home.plan.mission_time_s)
    assert end == pytest.approx([0.0, 0.0, 40.0], abs=1e-6)
    assert home.plan.station_ids == ("s1",)

    around = replan(old, 3.0, excluded_stations=("s2",), **FAST)
    holds(around, old, 3.0)
    assert around.plan.station_ids[:2] == ("s1", "beside")
    assert "s2" not in around.plan.station_ids


@pytest.mark.parametrize("place", [(0, 2.0), (1, 13.0), (2, 13.0), (3, 12.0)])
def test_a_flight_that_stands_goes_on_from_rest(place: tuple[int, float]) -> None:
    old, stand_s = wide_plan(), on_leg(*place)
    new = replan(old, stand_s, at_rest=True, **FAST)
    holds(new, old, stand_s)
    place = new.plan.trajectory.evaluate(new.join_s)
    assert np.abs(place - old.trajectory.evaluate(stand_s)).max() < 1e-6
    for order in (1, 2):
        assert np.abs(new.plan.trajectory.evaluate(new.join_s, order)).max() < 1e-6
    # The braking stays on the old path: what is flown back over is what was flown.
    flown = old.trajectory.evaluate(np.linspace(0.0, stand_s, 4000))
    for time_s in np.linspace(0.0, new.join_s, 60):
        here = new.plan.trajectory.evaluate(time_s)
        assert np.linalg.norm(flown - here, axis=-1).min() < 0.3


@pytest.mark.slow
@pytest.mark.parametrize("after", [0.05, 0.2, 1.0, 5.0, "1e-7 after a joint", "0.01 after a joint"])
def test_no_piece_is_left_too_short_for_the_rounding_of_its_coordinates(after: float | str) -> None:
    """Right after the launch and right after a joint, 60 km from the plane's origin: moving it joins a little later."""
    old = earth_plan()
    joint_s = float(old.trajectory.knots_s[3])
    join_s = after if isinstance(after, float) else joint_s + float(after.split()[0])
    moving = replan(old, join_s, **FAST)
    assert -1e-6 <= moving.join_s - join_s <= LEAST_PIECE_S
    holds(moving, old, moving.join_s)
    standing = replan(old, join_s, at_rest=True, **FAST)
    assert standing.leave_s == join_s
    holds(standing, old, join_s)


@pytest.mark.parametrize("stand_s", [1.0, 3.0, 5.0, 7.5])
def test_a_flight_that_stops_while_it_speeds_up_goes_on_from_there(stand_s: float) -> None:
    name = resources.files("sitl_fixtures").joinpath("missions", "paper_like", "M300_02.json")
    old = plan_mission(read_mission(json.loads(name.read_bytes())), **FAST)
    holds(replan(old, stand_s, at_rest=True, **FAST), old, stand_s)


@pytest.mark.slow
def test_what_cannot_be_replanned_is_refused_with_a_reason() -> None:
    old = wide_plan()
    with pytest.raises(MissionInfeasible, match="is not on the plan") as refusal:
        replan(old, old.mission_time_s - 0.5, **FAST)
    assert refusal.value.reason == "join"
    with pytest.raises(MissionInfeasible) as refusal:
        replan(old, 5.0, excluded_stations=("s2", "s3", "beside"), **FAST)
    assert refusal.value.reason == "broken_chain"
    order = ReplanOrder(old.to_document(), 5.0, excluded_stations=("nobody",))
    with pytest.raises(MissionError, match="is no station of this mission"):
        order.execute(**FAST)
    order = ReplanOrder(old.to_document(), 5.0, destination={"east_m": 0.0, "north_m": 0.0})
    with pytest.raises(MissionError, match="up_m"):
        order.execute(**FAST)


def test_endurance_counts_from_the_launch() -> None:
    document = wide_document()
    document["limits"]["endurance_s"] = wide_plan().mission_time_s + 5.0
    old = plan_mission(read_mission(document), fast=True)
    assert replan(old, 20.0, elapsed_s=21.0, **FAST).plan.mission.limits == old.mission.limits
    with pytest.raises(MissionInfeasible) as refusal:
        replan(old, 20.0, elapsed_s=30.0, **FAST)
    assert refusal.value.reason == "limits"


@pytest.mark.slow
def test_a_planning_process_takes_the_order_and_answers_with_the_joined_plan() -> None:
    sent: list[dict[str, Any]] = []

    class Channel:
        def send_bytes(self, data: bytes) -> None:
            sent.append(json.loads(data))

    order = json.loads(json.dumps(ReplanOrder(wide_plan().to_document(), 5.0, excluded_stations=("s2",)).to_document()))
    answer(Channel(), {"task": 1, "replan": order, "method": "fast"})  # type: ignore[arg-type]
    result = sent[-1]["plan"]
    assert (result["join_s"], result["at_rest"]) == (5.0, False)
    assert "s2" not in read_plan(result["plan"]).station_ids
    answer(Channel(), {"task": 2, "replan": {**order, "join_s": 1e6}})  # type: ignore[arg-type]
    assert sent[-1]["infeasible"]["reason"] == "join"
