"""Where an autopilot's own return takes the vehicle: by hand, and against a plain simulation of its choice."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gcs.layout.mission_geometry import MissionGeometry, choose_plane
from gcs.mission import read_mission, write_mission
from gcs.plan import read_plan
from gcs.plan.contingency import contingencies
from gcs.plan.failsafe_return import ReturnRules, cells, failsafe_returns
from gcs.planning.mission_planning import plan_mission
from planner.trajectory import Trajectory

STRAIGHT = Trajectory(
    np.array([[[1000.0 * k / 3, 0.0, 50.0] for k in range(4)]]), np.array([100.0]), np.array([0], dtype=np.int64)
)
"""1 km east in 100 s, 50 m up, at 10 m/s throughout."""


def geometry(range_m: float = 3000.0, max_speed_m_s: float = 10.0) -> MissionGeometry:
    document = {
        "origin": {"lat_deg": 53.0, "lon_deg": 5.0, "alt_amsl_m": 0.0},
        "start": {"east_m": 0.0, "north_m": 0.0, "up_m": 50.0},
        "destination": {"east_m": 1000.0, "north_m": 0.0, "up_m": 50.0},
        "stations": [{"id": "A", "east_m": 500.0, "north_m": 0.0, "up_m": 0.0, "range_m": range_m}],
        "limits": {
            "min_alt_amsl_m": 40.0,
            "max_alt_amsl_m": 120.0,
            "max_speed_m_s": max_speed_m_s,
            "max_accel_m_s2": 2.0,
        },
        "safe_points": [{"id": "end", "east_m": 1000.0, "north_m": 0.0, "up_m": 0.0}],
    }
    mission = read_mission(document)
    return MissionGeometry(mission, choose_plane(mission))


HOME = (0.0, 0.0, 0.0)
RULES = ReturnRules(HOME, speed_m_s=10.0, climb_m_s=2.0, sink_m_s=1.0)


def test_straight_home_by_hand() -> None:
    (way,) = failsafe_returns(geometry(), STRAIGHT, RULES)
    assert (way.from_s, way.to_s, way.to, way.covered) == (0.0, 100.0, None, True)
    # From the end: 990 m and 10 m of doubt at 10 m/s, 50 m down at 1 m/s, 10 s to stop and get going.
    assert way.duration_s == pytest.approx(100.0 + 50.0 + 10.0, abs=0.1)
    up = failsafe_returns(geometry(), STRAIGHT, ReturnRules(HOME, climb_to_up_m=90.0, speed_m_s=10.0, climb_m_s=2.0))[0]
    # 40 m up at 2 m/s first, then 90 m down at the default 1.5.
    assert up.duration_s == pytest.approx(20.0 + 100.0 + 60.0 + 10.0, abs=0.1)


def test_the_nearest_of_home_and_the_rally_points_within_the_limit() -> None:
    points = (("end", (1000.0, 0.0, 0.0)),)
    both = failsafe_returns(geometry(), STRAIGHT, ReturnRules(HOME, points))
    assert [(w.to, round(w.to_s)) for w in both] == [(None, 50), ("end", 100)]
    near = failsafe_returns(geometry(), STRAIGHT, ReturnRules(HOME, points, limit_m=300.0))
    # Beyond 300 m it does not count, and home is chosen however far.
    assert [(w.to, round(w.to_s)) for w in near] == [(None, 70), ("end", 100)]
    only = failsafe_returns(geometry(), STRAIGHT, ReturnRules(HOME, points, home_counts=False))
    assert [w.to for w in only] == ["end"]
    none = failsafe_returns(geometry(), STRAIGHT, ReturnRules(HOME, points, limit_m=1.0, home_counts=False))
    assert none[0].to is None


def test_a_way_out_of_range_is_seen_at_the_height_it_is_flown_at() -> None:
    assert failsafe_returns(geometry(600.0), STRAIGHT, RULES)[0].covered
    # 590 m up over a station of 600 m: its ball is 110 m wide there.
    high = failsafe_returns(geometry(600.0), STRAIGHT, ReturnRules(HOME, climb_to_up_m=590.0))
    assert not any(way.covered for way in high)
    away = (("sea", (1000.0, 700.0, 0.0)),)
    ways = failsafe_returns(geometry(600.0), STRAIGHT, ReturnRules(HOME, away))
    assert next((w.to, w.covered) for w in ways) == (None, True)
    assert not ways[-1].covered


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.tuples(st.floats(-800, 1800), st.floats(-800, 800)), max_size=5),
    st.one_of(st.none(), st.floats(50.0, 1500.0)),
    st.booleans(),
    st.floats(0.0, 1.0),
)
def test_wherever_it_begins_the_way_taken_is_covered_where_the_span_says_so(
    places: list[tuple[float, float]], limit_m: float | None, home_counts: bool, share: float
) -> None:
    """The choice made again, plainly, at one moment; its way sampled every metre or so against the station's range."""
    rules = ReturnRules(
        HOME, tuple((str(k), (e, n, 0.0)) for k, (e, n) in enumerate(places)), 60.0, limit_m, home_counts
    )
    time_s = 100.0 * share
    here = STRAIGHT.evaluate(time_s)
    away = sorted((math.hypot(e - here[0], n - here[1]), (e, n)) for e, n in places)
    target = (0.0, 0.0)
    counts = bool(away) and (limit_m is None or away[0][0] <= limit_m)
    if counts and (not home_counts or away[0][0] < math.hypot(here[0], here[1])):
        target = away[0][1]
    span = next(w for w in failsafe_returns(geometry(700.0), STRAIGHT, rules) if w.from_s <= time_s <= w.to_s)
    corners = np.array([here, [here[0], here[1], 60.0], [*target, 60.0], [*target, 0.0]])
    way = np.concatenate([np.linspace(a, b, 500) for a, b in itertools.pairwise(corners)])
    inside = np.linalg.norm(way - np.array([500.0, 0.0, 0.0]), axis=1) <= 700.0
    if span.covered:
        assert inside.all()


def test_a_plan_says_where_its_vehicle_goes_by_itself() -> None:
    document = write_mission(geometry().mission)
    document["options"] = {}
    plan = plan_mission(read_mission(document), fast=True)
    assert all(way.failsafe_return_covered for way in plan.contingencies)
    # The field at the end is the nearest there: over it, 50 m down at full speed's sink, and a while to turn.
    assert plan.contingencies[-1].failsafe_return_s is not None
    assert 0.0 < plan.contingencies[-1].failsafe_return_s < 100.0
    again = read_plan(plan.to_document())
    assert again.contingencies == plan.contingencies
    # Plans made before these were worked out stay readable, to the hash.
    old = plan.to_document()
    for way in old["contingencies"]:  # type: ignore[attr-defined]
        del way["own_return_covered"], way["own_return_s"]
    from gcs.plan.model import hash_of

    old["plan_sha256"] = hash_of(old)
    read = read_plan(old)
    assert read.contingencies[0].failsafe_return_covered is None
    assert read.plan_sha256 == old["plan_sha256"]


def test_spans_of_contingencies_and_cells_are_the_same() -> None:
    ways = contingencies(geometry(), STRAIGHT)
    edges = cells(STRAIGHT)
    assert {way.from_s for way in ways} <= set(edges.tolist())
