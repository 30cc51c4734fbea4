"""From mission to plan, in both frames and all over the earth, judged by the independent checker."""

from __future__ import annotations

import copy
import itertools
import json
from datetime import UTC, datetime, timedelta, timezone
from typing import Any

import numpy as np
import pytest
import rfc8785
from geographiclib.geodesic import Geodesic
from hypothesis import given, settings
from hypothesis import strategies as st

from gcs.errors import PlanError
from gcs.layout.planning_problem import lay_out
from gcs.mission import read_mission
from gcs.mission.document import parse_mission_json
from gcs.plan import read_plan
from gcs.plan.model import UNHASHED, Plan, hash_of
from gcs.planning.certification import recertify
from gcs.planning.mission_planning import plan_mission
from planner.trajectory import Trajectory
from tests.support.checker import check_plan
from tests.support.missions.infeasible import local, wgs84
from tests.support.missions.malformed import GOOD, GOOD_LOCAL
from tests.support.paths import MISSIONS


@pytest.fixture(scope="module")
def relay() -> Plan:
    """Den Helder to Texel: two stations, one handover."""
    return plan_mission(read_mission(GOOD))


@pytest.fixture(scope="module")
def flat() -> Plan:
    return plan_mission(read_mission(GOOD_LOCAL))


def planned(document: dict[str, Any]) -> Plan:
    plan = plan_mission(read_mission(document), fast=True)
    written = json.loads(json.dumps(plan.to_document(), allow_nan=False))
    assert check_plan(written, document) == []
    return plan


@pytest.mark.parametrize("name", ["paper_like/M30_02", "paper_like/M100_03", "wadden_relay"])
def test_shipped_missions_plan_and_pass_the_checker(name: str) -> None:
    raw = (MISSIONS / f"{name}.json").read_bytes()
    plan = plan_mission(parse_mission_json(raw), fast=True)
    written = json.dumps(plan.to_document(), allow_nan=False)
    assert check_plan(json.loads(written), json.loads(raw)) == []
    again = read_plan(json.loads(written))
    assert json.dumps(again.to_document()) == written
    assert plan.lower_bound_s <= plan.mission_time_s


@pytest.mark.parametrize(
    ("lat", "lon"),
    [(0.0, 0.0), (-33.9, 18.4), (69.6, 18.9), (84.0, -40.0), (10.0, 179.95), (-89.8, 12.0), (64.1, -180.0)],
)
def test_the_same_mission_anywhere_on_earth(lat: float, lon: float) -> None:
    """21.65 km flown under two stations, at the equator, near the poles, across the antimeridian."""
    far = Geodesic.WGS84.Direct(lat, lon, 37.0, 21_650.0)
    document = copy.deepcopy(GOOD)
    for place, at in (
        (document["start"], (lat, lon)),
        (document["destination"], (far["lat2"], far["lon2"])),
        (document["stations"][0], (lat, lon)),
        (document["stations"][1], (far["lat2"], far["lon2"])),
        (document["safe_points"][0], (far["lat2"], far["lon2"])),
    ):
        place |= {"lat_deg": at[0], "lon_deg": at[1]}
    plan = planned(document)
    assert plan.station_ids == ("den-helder", "texel")
    # rest to rest along a straight line, at least
    assert plan.mission_time_s >= 21_650.0 / 30.0 + 30.0 / 2.5 - 0.05
    assert plan.mission_time_s < 1.03 * (21_650.0 / 30.0 + 30.0 / 2.5)


def test_plan_says_what_it_is(relay: Plan) -> None:
    document = relay.to_document()
    assert set(document) >= {
        "plan_sha256", "created_utc", "planner", "mission", "mission_time_s", "path_length_m", "lower_bound_s",
        "solve_time_s", "origin", "projection", "stations", "segments", "handovers", "contingencies", "certificate",
    }  # fmt: skip
    assert document["projection"] == {"name": "aeqd", "ellipsoid": "WGS84"}
    assert document["stations"] == ["den-helder", "texel"]
    (handover,) = relay.handovers
    assert relay.station_at(0.0).id == "den-helder"
    assert relay.station_at(handover.time_s - 1e-6).id == "den-helder"
    assert relay.station_at(handover.time_s).id == "texel"
    assert relay.station_at(relay.mission_time_s + 100).id == "texel"
    assert [s.system_id for s in relay.mission.stations] == [241, 242]
    assert relay.certificate.worst["range_m"] <= -25.0
    assert relay.certificate.worst["range_margin_m"] <= 0.0
    assert relay.solve_time_s > 0
    assert datetime.strptime(relay.created_utc, "%Y-%m-%dT%H:%M:%SZ")


def test_the_hash_is_the_contract_s(relay: Plan) -> None:
    import hashlib

    document = relay.to_document()
    for key in ("plan_sha256", "solve_time_s", "created_utc"):
        del document[key]
    assert hashlib.sha256(rfc8785.dumps(document)).hexdigest() == relay.plan_sha256  # type: ignore[arg-type]


def test_same_mission_same_plan(relay: Plan) -> None:
    moment = datetime(2026, 11, 22, 9, 0, tzinfo=timezone(timedelta(hours=1)))
    again = plan_mission(read_mission(GOOD), created_utc=moment)
    assert again.plan_sha256 == relay.plan_sha256
    assert again.created_utc == "2026-11-22T08:00:00Z"
    assert plan_mission(read_mission({**GOOD, "name": "Another"})).plan_sha256 != relay.plan_sha256


def test_a_document_through_other_hands_is_the_same_plan(relay: Plan) -> None:
    """Keys sorted, 30.0 written as 30, Unicode escaped: the hash still fits and the same plan comes out."""
    text = json.dumps(relay.to_document(), sort_keys=True, ensure_ascii=True).replace("30.0,", "30,")
    again = read_plan(json.loads(text))
    assert again.to_document() == relay.to_document()
    assert again.trajectory.knots_s.tolist() == relay.trajectory.knots_s.tolist()
    assert again.handovers == relay.handovers
    assert again.contingencies == relay.contingencies


def resealed(document: dict[str, Any]) -> dict[str, Any]:
    return {**document, "plan_sha256": hash_of(document)}


ALTERED: list[tuple[str, Any, Any, str]] = [
    ("a control point", ("segments", 0, "control_points", 2, 0), 1.0, "plan_sha256"),
    ("a handover's time", ("handovers", 0, "time_s"), 1.0, "plan_sha256"),
    ("the certificate", ("certificate", "worst", "range_m"), -100.0, "plan_sha256"),
]
INCONSISTENT: list[tuple[str, Any, Any, str]] = [
    ("handover at another time", ("handovers", 0, "time_s"), 1.0, "handovers[0]"),
    ("handover to another station", ("handovers", 0, "to"), "den-helder", "handovers[0]"),
    ("handover to nobody", ("handovers", 0, "to"), "nobody", "handovers[0].to"),
    ("no handovers", ("handovers",), [], "handovers"),
    ("mission time", ("mission_time_s",), 5.0, ""),
    ("another station list", ("stations",), ["texel"], ""),
    ("start of a segment", ("segments", 1, "start_s"), 0.0, ""),
    ("negative duration", ("segments", 0, "duration_s"), -1.0, "segments[0].duration_s"),
    ("unknown station", ("segments", 0, "station"), "nobody", "segments[0].station"),
    ("a point of two numbers", ("segments", 0, "control_points", 0), [1.0, 2.0], "segments[0].control_points"),
    ("a point of text", ("segments", 0, "control_points", 0), "abc", "segments[0].control_points"),
    ("a missing point", ("segments", 1, "control_points"), [[0.0, 0.0, 0.0]] * 2, "segments[1].control_points"),
    ("no segments", ("segments",), [], "segments"),
    ("feasible though not", ("certificate", "feasible"), False, ""),
    ("certificate of words", ("certificate", "worst", "range_m"), "fine", "certificate.worst"),
    ("another projection", ("projection", "name"), "utm", "projection"),
    ("a broken mission", ("mission", "stations", 0, "range_m"), -1.0, "mission.stations[0].range_m"),
    ("no system id", ("mission", "stations", 0, "system_id"), None, "mission.stations[0].system_id"),
    ("unknown safe point", ("contingencies", 0, "safe_point"), "nowhere", "contingencies[0].safe_point"),
    ("covered maybe", ("contingencies", 0, "covered"), "maybe", "contingencies[0].covered"),
    ("an unknown field", ("colour",), "red", "colour"),
    ("no creation time", ("created_utc",), None, "created_utc"),
    ("an origin beyond the pole", ("origin", "lat_deg"), 95.0, "origin.lat_deg"),
]


def altered(plan: Plan, path: tuple[Any, ...], value: Any) -> dict[str, Any]:
    document = json.loads(json.dumps(plan.to_document()))
    place = document
    for part in path[:-1]:
        place = place[part]
    place[path[-1]] = value
    assert isinstance(document, dict)
    return document


@pytest.mark.parametrize(("path", "value", "where"), [c[1:] for c in ALTERED], ids=[c[0] for c in ALTERED])
def test_altered_plans_are_refused(relay: Plan, path: tuple[Any, ...], value: Any, where: str) -> None:
    with pytest.raises(PlanError, match="altered") as caught:
        read_plan(altered(relay, path, value))
    assert caught.value.where == where


@pytest.mark.parametrize(("path", "value", "where"), [c[1:] for c in INCONSISTENT], ids=[c[0] for c in INCONSISTENT])
def test_plans_that_disagree_with_themselves_are_refused(
    relay: Plan, path: tuple[Any, ...], value: Any, where: str
) -> None:
    """Sealed with a right hash, so that only looking closer tells."""
    with pytest.raises(PlanError) as caught:
        read_plan(resealed(altered(relay, path, value)))
    assert caught.value.where.startswith(where), caught.value


def _leaves(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    pairs = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    found = [leaf for key, item in pairs for leaf in _leaves(item, (*path, key))]
    return found or [path]


@pytest.mark.slow
@settings(max_examples=100)
@given(st.data())
def test_no_value_of_a_plan_can_be_changed_unnoticed(flat: Plan, data: st.DataObject) -> None:
    """Any leaf but the three that are not part of the plan; sealed anew, it is refused or says exactly what it says."""
    document = flat.to_document()
    path = data.draw(st.sampled_from([p for p in _leaves(document) if p[0] not in UNHASHED]))
    value = data.draw(st.sampled_from([0.5, -1, "x", None, True, [], {}, 1e300, float("nan")]))
    changed = altered(flat, path, value)
    if json.dumps(changed) == json.dumps(document):
        return
    with pytest.raises(PlanError):
        read_plan(changed)
    try:
        sealed = resealed(changed)
        plan = read_plan(sealed)
    except PlanError:
        return
    assert plan.to_document() == sealed


@pytest.mark.parametrize("document", [None, [], "plan", 5, {}, {"plan_sha256": "x"}, GOOD])
def test_what_is_no_plan_is_refused(document: Any) -> None:
    with pytest.raises(PlanError):
        read_plan(document)


def test_every_missing_field_is_named(relay: Plan) -> None:
    for key in relay.to_document():
        document = relay.to_document()
        del document[key]
        with pytest.raises(PlanError) as caught:
            read_plan(document)
        assert caught.value.where in (key, "plan_sha256")


def test_recertify_believes_nothing(flat: Plan) -> None:
    """A curve bent out of range under an honest-looking certificate is found out."""
    assert recertify(flat).worst == pytest.approx(flat.certificate.worst, abs=1e-12)
    points = flat.trajectory.control_points_m.copy()
    points[0, 2, 1] += 1500.0
    curve = Trajectory(points, flat.trajectory.durations_s, flat.trajectory.station_index)
    body = {f: getattr(flat, f) for f in flat.__dataclass_fields__}
    bent = Plan(**{**body, "trajectory": curve})
    worst = recertify(bent).worst
    assert worst["range_m"] > 400.0
    assert not recertify(bent).feasible


# --- options and limits ----------------------------------------------------------------------------------------


def test_local_missions_are_planned_in_their_own_numbers(flat: Plan) -> None:
    assert flat.plane.lat_deg == 39.96
    assert flat.trajectory.evaluate(0.0) == pytest.approx([0.0, 0.0, 110.0], abs=1e-9)
    laid = lay_out(flat.mission)
    assert laid.problem.ranges_m.tolist() == [1000.0, 1000.0]
    assert laid.problem.limits.max_speed_m_s == 50.0
    # 1500 m at 50 m/s and 5 m/s^2: 40 s, and bends at the overlap cost nothing here
    assert flat.lower_bound_s == pytest.approx(40.0, abs=1e-6)


def test_ranges_on_the_earth_lose_margin_and_projection() -> None:
    laid = lay_out(read_mission(GOOD))
    for planned_m, station in zip(laid.problem.ranges_m, GOOD["stations"], strict=True):
        assert station["range_m"] - 25.0 - 1.0 < planned_m < station["range_m"] - 25.0
    assert laid.problem.bound_ranges_m is not None
    assert (laid.problem.bound_ranges_m > laid.problem.ranges_m).all()
    assert 29.998 < laid.problem.limits.max_speed_m_s < 30.0
    assert laid.problem.bound_speed_factor * laid.problem.limits.max_speed_m_s >= 30.0


def test_excluded_stations_are_not_used() -> None:
    """A third station spans the whole way; without it, two must."""
    third = {"id": "tower", "lat_deg": 53.02, "lon_deg": 4.81, "alt_amsl_m": 1.0, "range_m": 30_000.0}
    document = wgs84(stations=[*GOOD["stations"], third])
    assert planned(document).station_ids == ("tower",)
    document["options"]["excluded_stations"] = ["tower"]
    assert planned(document).station_ids == ("den-helder", "texel")


def test_arrival_is_met_to_the_second() -> None:
    plan = planned(wgs84(options__arrival_s=900.0))
    assert plan.mission_time_s == pytest.approx(900.0, abs=1e-6)


def test_given_system_ids_stay() -> None:
    plan = planned(wgs84(stations__1__system_id=17, options__vehicle_system_id=18))
    assert [s.system_id for s in plan.mission.stations] == [16, 17]


def test_limits_are_kept() -> None:
    """Jerk, climb, wind and elevation at once; the checker measures each."""
    plan = planned(
        local(
            start__up_m=101.0,
            destination__up_m=119.0,
            limits__max_jerk_m_s3=3.0,
            limits__max_climb_m_s=0.4,
            limits__max_descent_m_s=0.5,
            limits__max_airspeed_m_s=30.0,
            limits__wind={"east_m_s": -5.0, "north_m_s": 2.0},
            limits__endurance_s=400.0,
            limits__reserve_s=60.0,
            options__min_overlap_s=5.0,
            options__min_tenure_s=10.0,
            options__range_margin_m=25.0,
            stations__0__min_elevation_deg=4.0,
            options__max_handovers=1,
        )
    )
    assert {"jerk_m_s3", "climb_m_s", "descent_m_s", "airspeed_m_s", "duration_s", "elevation_m"} <= set(
        plan.certificate.worst
    )
    assert plan.mission_time_s >= 18.0 / 0.4


def test_wind_and_elevation_on_the_earth() -> None:
    """The wind is along true axes, which turn in the plane; the true airspeed keeps the limit everywhere."""
    document = wgs84(
        limits__max_airspeed_m_s=25.0,
        limits__wind={"east_m_s": 6.0, "north_m_s": -4.0},
        stations__1__min_elevation_deg=0.05,
    )
    plan = planned(document)
    times = np.linspace(0.0, plan.mission_time_s, 400)
    at, velocity = plan.trajectory.evaluate(times), plan.trajectory.evaluate(times, 1)
    axes = plan.plane.true_axes(at[:, 0], at[:, 1], at[:, 2])
    true = np.einsum("nij,nj->ni", axes, velocity[:, :2]) - np.array([6.0, -4.0])
    assert np.hypot(np.hypot(true[:, 0], true[:, 1]), velocity[:, 2]).max() <= 25.0
    assert plan.lower_bound_s <= plan.mission_time_s
    outside = plan.geometry.outside_m(plan.trajectory.station_index[plan.trajectory.segment_at(times)], at)
    assert outside.max() <= 0.0


def test_an_elevation_of_a_station_not_flown_is_no_figure() -> None:
    """Only the third station has a lowest elevation, and the plan does without it: the document has no infinity."""
    third = {"id": "hill", "east_m": 700.0, "north_m": 900.0, "up_m": 0.0, "range_m": 500.0, "min_elevation_deg": 30.0}
    plan = planned(local(stations=[*GOOD_LOCAL["stations"], third]))
    assert "hill" not in plan.station_ids
    assert "elevation_m" not in plan.certificate.worst


def test_start_state_is_taken_up() -> None:
    plan = planned(local(options__start_state={"velocity_m_s": [10.0, 5.0, 0.0], "acceleration_m_s2": [1.0, 0.0, 0.0]}))
    assert plan.trajectory.evaluate(0.0, 1) == pytest.approx([10.0, 5.0, 0.0], abs=1e-7)


def test_a_start_state_on_the_earth_is_along_true_axes() -> None:
    plan = planned(wgs84(options__start_state={"velocity_m_s": [3.0, 12.0, 0.0]}))
    place, velocity = plan.trajectory.evaluate(0.0), plan.trajectory.evaluate(0.0, 1)
    true = plan.plane.true_axes(place[0], place[1], place[2]) @ velocity[:2]
    assert true == pytest.approx([3.0, 12.0], abs=1e-6)


def test_start_is_the_destination() -> None:
    plan = planned({**GOOD, "destination": GOOD["start"]})
    assert plan.path_length_m < 1.0
    assert plan.lower_bound_s == pytest.approx(0.0, abs=1e-9)


def test_progress_is_told_in_order() -> None:
    told: list[tuple[str, float]] = []
    plan_mission(read_mission(GOOD_LOCAL), progress=lambda *step: told.append(step))
    assert [phase for phase, _ in told] == ["preparing", "planning", "scheduling", "done"]
    assert all(a < b for (_, a), (_, b) in itertools.pairwise(told))


def test_notes_and_time_limits_are_recorded() -> None:
    plan = plan_mission(read_mission(GOOD_LOCAL), notes=["the first attempt hung"], time_limit_s=30.0)
    assert plan.notes[0] == "the first attempt hung"
    assert any("time limit of 30 s" in note for note in plan.notes)
    assert plan.created_utc <= datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
