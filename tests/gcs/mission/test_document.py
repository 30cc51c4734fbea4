"""The door: what missions come in, what stays out, and what the answer says."""

from __future__ import annotations

import copy
import json
import math
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gcs.errors import InputFault, MissionError, MissionInfeasible, infeasible_from_document
from gcs.mission import read_mission, with_options, write_mission
from gcs.mission.document import parse_mission_json, parse_option
from gcs.mission.system_ids import assign_system_ids
from tests.support.missions.malformed import GOOD, GOOD_LOCAL, MALFORMED
from tests.support.paths import MISSIONS


@pytest.mark.parametrize(("document", "where"), [case[1:] for case in MALFORMED], ids=[case[0] for case in MALFORMED])
def test_malformed_missions_are_refused_by_name(document: Any, where: str) -> None:
    with pytest.raises(MissionError) as caught:
        parse_mission_json(document) if isinstance(document, bytes) else read_mission(document)
    problems = caught.value.problems
    assert any(where in fault.where for fault in problems), [str(f) for f in problems]
    for fault in problems:
        assert fault.what
        assert fault.allowed or fault.fix or fault.what, fault
    json.dumps(caught.value.to_document(), allow_nan=False).encode()
    assert "Traceback" not in str(caught.value)
    assert str(caught.value).isprintable() or "\n" in str(caught.value)


def test_the_table_is_long_enough() -> None:
    assert len(MALFORMED) >= 30
    assert len({name for name, _, _ in MALFORMED}) == len(MALFORMED)


def test_every_fault_is_told_at_once() -> None:
    document = copy.deepcopy(GOOD)
    document["start"]["lat_deg"] = 95.0
    document["stations"][1]["range_m"] = -5
    document["limits"]["max_sped_m_s"] = 30.0
    del document["limits"]["max_accel_m_s2"]
    with pytest.raises(MissionError) as caught:
        read_mission(document)
    assert [f.where for f in caught.value.problems] == [
        "start.lat_deg",
        "stations[1].range_m",
        "limits.max_sped_m_s",
        "limits.max_accel_m_s2",
    ]
    text = str(caught.value)
    assert "4 faults" in text
    assert "stations[1].range_m: must not be negative (value -5; allowed: more than 0 up to 500000 m)" in text
    assert "did you mean max_speed_m_s?" in text


def test_garbage_does_not_make_an_endless_answer() -> None:
    with pytest.raises(MissionError) as caught:
        read_mission({**GOOD, "stations": [{}] * 5_000})
    assert len(caught.value.problems) <= 200
    assert len(str(caught.value)) < 10_000


@pytest.mark.slow
def test_garbage_on_a_large_map_is_answered_soon() -> None:
    """Twenty thousand strangers excluded from a map of twenty thousand: linear work, and a guess for the first few."""
    stations = [{**GOOD["stations"][0], "id": f"S{k}"} for k in range(20_000)]
    excluded = [f"S{k}x" for k in range(20_000)]
    with pytest.raises(MissionError) as caught:
        read_mission({**GOOD, "stations": stations, "options": {"excluded_stations": excluded}})
    assert len(caught.value.problems) <= 200
    assert "did you mean" in str(caught.value)
    kept = read_mission(
        {**GOOD, "stations": stations, "options": {"excluded_stations": [f"S{k}" for k in range(1, 20_000)]}}
    )
    assert len(kept.options.excluded_stations) == 19_999


def test_limits_of_size() -> None:
    with pytest.raises(MissionError, match="at most 100 bytes"):
        parse_mission_json(json.dumps(GOOD), max_bytes=100)
    with pytest.raises(MissionError, match="has 2 items"):
        read_mission(GOOD, max_stations=1)


def test_defaults_are_the_contracts() -> None:
    mission = read_mission({k: v for k, v in GOOD.items() if k != "options"})
    options = mission.options
    assert (options.min_overlap_s, options.range_margin_m, options.min_tenure_s) == (5.0, 25.0, 10.0)
    assert (options.vehicle_system_id, options.on_arrival, options.objective) == (1, "land", "time")
    assert mission.frame == "wgs84"
    document = write_mission(mission)
    assert document["options"] == {
        "min_overlap_s": 5.0,
        "range_margin_m": 25.0,
        "min_tenure_s": 10.0,
        "vehicle_system_id": 1,
        "on_arrival": "land",
        "excluded_stations": [],
        "max_handovers": None,
        "handover_tolerance": 0.001,
        "overlap_target_s": "auto",
        "objective": "time",
        "start_state": None,
        "arrival_s": None,
    }
    assert document["stations"][0]["name"] == "den-helder"  # type: ignore[index]


@pytest.mark.parametrize("path", sorted(MISSIONS.rglob("*.json")), ids=lambda p: p.stem)
def test_shipped_missions_read_and_round_trip(path: Path) -> None:
    mission = parse_mission_json(path.read_bytes())
    assert mission.frame == ("wgs84" if path.stem == "wadden_relay" else "local")
    again = read_mission(json.loads(json.dumps(write_mission(mission), allow_nan=False)))
    assert again == mission


def test_start_may_be_the_destination_and_outside_the_band() -> None:
    """Well said, whatever can be flown: planning finds out."""
    document = {**GOOD, "destination": GOOD["start"]}
    assert read_mission(document).destination == read_mission(document).start
    low = {**GOOD, "start": {**GOOD["start"], "alt_amsl_m": 5.0}}
    assert read_mission(low).start.alt_amsl_m == 5.0  # type: ignore[union-attr]


def test_options_override() -> None:
    mission = read_mission(GOOD)
    name, value = parse_option("min_overlap_s=0")
    changed = with_options(mission, {name: value, "on_arrival": "hold"})
    assert (changed.options.min_overlap_s, changed.options.on_arrival) == (0.0, "hold")
    assert changed.options.range_margin_m == 25.0
    assert parse_option('excluded_stations=["texel"]') == ("excluded_stations", ["texel"])
    assert parse_option("objective=energy") == ("objective", "energy")
    with pytest.raises(MissionError, match="min_overlap_s"):
        with_options(mission, {"min_overlap_s": "soon"})
    for bad in ("min_overlap=5", "min_overlap_s", "=5", "vehicle"):
        with pytest.raises(MissionError, match="is not an option"):
            parse_option(bad)


@pytest.mark.parametrize(("objective", "weight"), [("time", 0.0), ("energy", 1.0), (0, 0.0), (0.25, 0.25), (1, 1.0)])
def test_the_weight_of_energy(objective: str | float, weight: float) -> None:
    options = read_mission({**GOOD, "options": {"objective": objective}}).options
    assert options.energy_weight == weight


@pytest.mark.parametrize("document", [case[1] for case in MALFORMED], ids=[case[0] for case in MALFORMED])
def test_every_fault_says_what_is_allowed_and_what_to_do(document: Any) -> None:
    raw = document if isinstance(document, bytes) else json.dumps(document).encode()
    with pytest.raises(MissionError) as caught:
        parse_mission_json(raw)
    for fault in caught.value.problems:
        assert fault.where, fault
        assert fault.what, fault
        assert fault.fix, fault
        assert fault.allowed or fault.where in ("limits.wind", "limits.reserve_s"), fault


@pytest.mark.parametrize(
    ("path", "value", "fix"),
    [
        (("stations", 1, "lon_deg"), 184.8, "write -175.2"),
        (("stations", 0, "range_m"), "16000.0", "write 16000 without quotes"),
        (("stations", 0, "range_m"), "16 km", "give a plain number, in m, without quotes"),
        (("start",), {"lat_deg": 4.8, "lon_deg": 52.9, "alt_amsl_m": 100.0}, "swap lat_deg and lon_deg"),
        (("stations", 1), {**GOOD["stations"][1], "lat_deg": 4.8, "lon_deg": 53.1}, "swap lat_deg and lon_deg"),
        (("start",), {"lat_deg": 52.9, "lon_deg": 4.8, "alt_ft": 300}, "did you mean alt_amsl_m?"),
        (("options", "excluded_stations"), ["txel"], "did you mean texel?"),
    ],
)
def test_the_fault_says_what_is_likely_meant(path: tuple[Any, ...], value: object, fix: str) -> None:
    document = copy.deepcopy(GOOD)
    place: Any = document
    for part in path[:-1]:
        place = place[part]
    place[path[-1]] = value
    with pytest.raises(MissionError) as caught:
        read_mission(document)
    assert caught.value.problems[0].fix == fix


# --- system ids ------------------------------------------------------------------------------------------------


def test_ids_start_at_241_when_none_is_given() -> None:
    assert assign_system_ids([None] * 4, [2, 0], 1) == [242, None, 241, None]


def test_ids_fill_the_smallest_range_that_holds_those_given() -> None:
    # 10 and 13 given: 10..13 has just room for two more
    assert assign_system_ids([10, None, None, 13], [0, 1, 2, 3], 1) == [10, 11, 12, 13]
    # one more needs 10..14
    assert assign_system_ids([10, None, None, 13, None], [0, 1, 2, 3, 4], 1) == [10, 11, 12, 13, 14]
    # 242 belongs to a station the plan does not use: 240..241 is the smallest range that will do
    assert assign_system_ids([241, 242, None], [0, 2], 1) == [241, 242, 240]
    # at the upper end the range grows downwards
    assert assign_system_ids([254, None], [0, 1], 1) == [254, 253]
    # the vehicle's own id is never in the range
    assert assign_system_ids([None, None, None], [0, 1, 2], 242) == [243, 244, 245]
    assert assign_system_ids([5, None], [0, 1], 6) == [5, 4]


def test_more_stations_than_ids_is_bad_input() -> None:
    with pytest.raises(MissionError, match="254 are flown, and system ids tell no more than 253 apart"):
        assign_system_ids([None] * 254, list(range(254)), 1)
    with pytest.raises(MissionError, match="no contiguous range"):
        assign_system_ids([3, 5, None], [0, 1, 2], 4)
    assert sorted(i for i in assign_system_ids([None] * 253, list(range(253)), 1) if i) == list(range(2, 255))


@settings(max_examples=200)
@given(
    st.lists(st.one_of(st.none(), st.integers(1, 254)), min_size=1, max_size=12, unique_by=lambda x: x or object()),
    st.integers(1, 254),
    st.data(),
)
def test_assigned_ids_are_what_was_promised(given_ids: list[int | None], vehicle: int, data: st.DataObject) -> None:
    given_ids = [i for i in given_ids if i != vehicle] or [None]
    used = data.draw(st.permutations(range(len(given_ids))))
    used = used[: data.draw(st.integers(1, len(used)))]
    try:
        result = assign_system_ids(given_ids, used, vehicle)
    except MissionError:
        held = [i for i in (given_ids[k] for k in used) if i is not None]
        # only the vehicle's id between those given, or squeezed against an end, can make it impossible here
        assert held
        return
    assert all(a == b for a, b in zip(given_ids, result, strict=True) if a is not None)
    ids = [i for i in result if i is not None]
    assert len(set(ids)) == len(ids)
    assert vehicle not in ids
    assert all(result[k] is not None for k in used)
    if any(given_ids[k] is None for k in used):
        flown = [result[k] or 0 for k in used]
        assert vehicle not in range(min(flown), max(flown) + 1)


# --- properties of documents -----------------------------------------------------------------------------------


def _leaves(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    if isinstance(value, dict):
        return [leaf for key, item in value.items() for leaf in _leaves(item, (*path, key))]
    if isinstance(value, list):
        return [leaf for i, item in enumerate(value) for leaf in _leaves(item, (*path, i))]
    return [path]


def _path_text(path: tuple[Any, ...]) -> str:
    text = ""
    for part in path:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else str(part)
    return text


GARBAGE = st.one_of(
    st.just({"surprise": 1}),
    st.just([[]]),
    st.just(math.nan),
    st.just(-math.inf),
    st.just(True),
    st.just("\x00"),
    st.just(1e300),
    st.just(-1e300),
)


@settings(max_examples=300)
@given(st.sampled_from([GOOD, GOOD_LOCAL]), st.data())
def test_any_field_made_garbage_is_named(base: dict[str, Any], data: st.DataObject) -> None:
    path = data.draw(st.sampled_from(_leaves(base)))
    document = copy.deepcopy(base)
    place = document
    for part in path[:-1]:
        place = place[part]
    place[path[-1]] = data.draw(GARBAGE)
    with pytest.raises(MissionError) as caught:
        read_mission(document)
    assert any(fault.where.startswith(_path_text(path)) for fault in caught.value.problems)
    json.dumps(caught.value.to_document(), allow_nan=False)


JSON_VALUES = st.recursive(
    st.none() | st.booleans() | st.floats() | st.text(max_size=5) | st.integers(),
    lambda children: st.lists(children, max_size=3) | st.dictionaries(st.text(max_size=8), children, max_size=3),
    max_leaves=10,
)


@pytest.mark.slow
@settings(max_examples=200)
@given(JSON_VALUES)
def test_no_document_does_worse_than_a_mission_error(value: object) -> None:
    with pytest.raises(MissionError):
        read_mission(value)


@settings(max_examples=200)
@given(st.binary(max_size=200))
def test_no_bytes_do_worse_than_a_mission_error(data: bytes) -> None:
    with pytest.raises(MissionError):
        parse_mission_json(data)


NUMBER = st.floats(0.001, 1000.0)


@st.composite
def documents(draw: st.DrawFn) -> dict[str, Any]:
    document = copy.deepcopy(draw(st.sampled_from([GOOD, GOOD_LOCAL])))
    limits, options = document["limits"], {}
    for key in ("max_jerk_m_s3", "max_climb_m_s", "max_descent_m_s", "endurance_s"):
        if draw(st.booleans()):
            limits[key] = draw(NUMBER)
    if draw(st.booleans()):
        limits |= {"max_airspeed_m_s": draw(NUMBER), "wind": {"east_m_s": draw(st.floats(-50, 50)), "north_m_s": -3}}
    for key in ("min_overlap_s", "range_margin_m", "min_tenure_s", "arrival_s"):
        if draw(st.booleans()):
            options[key] = draw(NUMBER)
    if "arrival_s" not in options and draw(st.booleans()):
        options["start_state"] = {"velocity_m_s": draw(st.lists(st.floats(-50, 50), min_size=3, max_size=3))}
    if draw(st.booleans()):
        options["max_handovers"] = draw(st.integers(0, 50))
    document["options"] = options
    for station in document["stations"]:
        for key in ("name", "contact", "radio_channel", "hours"):
            if draw(st.booleans()):
                station[key] = draw(st.text("aÄ→ß日 0", min_size=1, max_size=9).map(lambda t: f"x{t}x"))
        if draw(st.booleans()):
            station["min_elevation_deg"] = draw(st.floats(0, 45))
    return document


@settings(max_examples=150)
@given(documents())
def test_documents_round_trip(document: dict[str, Any]) -> None:
    mission = read_mission(document)
    text = json.dumps(write_mission(mission), allow_nan=False)
    assert parse_mission_json(text) == mission
    assert json.dumps(write_mission(parse_mission_json(text))) == text
    # nothing that was said is lost
    for section in ("limits", "options"):
        said, kept = document[section], write_mission(mission)[section]
        assert all(_same(kept[key], value) for key, value in said.items() if key != "start_state")  # type: ignore[index]


def _same(kept: object, said: object) -> bool:
    return kept == said


def test_infeasible_survives_documents_and_pickles() -> None:
    import pickle

    error = MissionInfeasible(
        "broken_chain",
        "No chain of stations reaches the destination.",
        stations=["a", "b"],
        where={"lat_deg": 53.0, "lon_deg": 5.0, "alt_amsl_m": 100.0},
        gap_m=12.25,
        fix={"action": "raise_range", "station": "a", "by_m": 12.25},
        fix_text="Raise the range of a by 12.3 m.",
    )
    assert infeasible_from_document(error.to_document()).to_document() == error.to_document()
    copied = pickle.loads(pickle.dumps(error))
    assert copied.to_document() == error.to_document()
    assert str(copied) == "No chain of stations reaches the destination. Raise the range of a by 12.3 m."


def test_fault_shows_long_values_short() -> None:
    fault = InputFault("x", "is wrong", ["y" * 1000])
    assert len(str(fault)) < 200
    assert isinstance(fault.to_document()["value"], str)
