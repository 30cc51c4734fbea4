"""Remedies of every kind as the contract's ``fix``: the document to the letter, its words, and what it does."""

from __future__ import annotations

import copy
import json
from typing import Any, get_args

import pytest

from gcs.mission import read_mission, write_mission
from gcs.mission.model import GeoPosition, LocalPosition
from gcs.remedies.application import applied, apply
from gcs.remedies.changes import (
    AddStation,
    Change,
    EarlierArrival,
    IncludeStation,
    LaterArrival,
    Location,
    LowerElevation,
    LowerElevations,
    LowerLimit,
    LowerMargin,
    LowerOption,
    LowerStartSpeed,
    LowerWind,
    Move,
    RaiseAllRanges,
    RaiseLimit,
    RaiseRange,
    SetAltitude,
    WidenBand,
    to_document,
)
from gcs.remedies.remedy import Remedy, document_of
from gcs.remedies.wording import words, words_of
from tests.support.missions.infeasible import local, wgs84
from tests.support.remedies import apply as followed

EARTH = Location(GeoPosition(52.5, 4.75, 100.0))
PLANE = Location(GeoPosition(52.5, 4.75, 100.0), LocalPosition(1500.0, -20.5, 110.0))

PINNED: list[tuple[Change, str, str]] = [
    (
        RaiseRange("A", 12.25, 1012.25),
        '{"action": "raise_range", "station": "A", "by_m": 12.25, "range_m": 1012.25}',
        "raise the range of A by 12.3 m to 1012.3 m",
    ),
    (RaiseAllRanges(0.5), '{"action": "raise_all_ranges", "by_m": 0.5}', "raise every range by 0.5 m"),
    (
        LowerMargin(15.03, 9.97),
        '{"action": "lower_margin", "by_m": 15.03, "range_margin_m": 9.97}',
        "lower range_margin_m to 9.9 m",
    ),
    (
        LowerOption("min_overlap_s", 3.75, 1.25),
        '{"action": "lower_option", "option": "min_overlap_s", "by_s": 3.75, "to": 1.25}',
        "lower min_overlap_s to 1.2 s",
    ),
    (
        LowerElevation("A", 6.349, 13.651),
        '{"action": "lower_elevation", "station": "A", "to_deg": 6.349, "by_deg": 13.651}',
        "lower min_elevation_deg of A to 6.34 degrees",
    ),
    (
        LowerElevation("A", None, 20.0),
        '{"action": "lower_elevation", "station": "A", "to_deg": null, "by_deg": 20.0}',
        "drop the lowest elevation of A",
    ),
    (
        LowerElevations(2.001),
        '{"action": "lower_elevations", "by_deg": 2.001}',
        "lower every min_elevation_deg by 2.01 degrees",
    ),
    (
        WidenBand(min_alt_amsl_m=79.96, by_m=20.04),
        '{"action": "widen_band", "min_alt_amsl_m": 79.96, "by_m": 20.04}',
        "lower min_alt_amsl_m to 79.9 m",
    ),
    (
        WidenBand(max_alt_amsl_m=140.04, by_m=20.04),
        '{"action": "widen_band", "max_alt_amsl_m": 140.04, "by_m": 20.04}',
        "raise max_alt_amsl_m to 140.1 m",
    ),
    (
        SetAltitude("start", 100.0, -12.5),
        '{"action": "set_altitude", "of": "start", "alt_amsl_m": 100.0, "by_m": -12.5}',
        "set the altitude of the start to 100 m AMSL",
    ),
    (
        Move("destination", EARTH, 500.01),
        '{"action": "move", "of": "destination", '
        '"position": {"lat_deg": 52.5, "lon_deg": 4.75, "alt_amsl_m": 100.0}, "by_m": 500.01}',
        "move the destination by 500.1 m to 52.500000, 4.750000, 100.0 m AMSL",
    ),
    (
        Move("start", PLANE, 500.0),
        '{"action": "move", "of": "start", "position": {"lat_deg": 52.5, "lon_deg": 4.75, "alt_amsl_m": 100.0, '
        '"east_m": 1500.0, "north_m": -20.5, "up_m": 110.0}, "by_m": 500.0}',
        "move the start by 500.0 m to east 1500.0 m, north -20.5 m, up 110.0 m",
    ),
    (
        AddStation(PLANE, 255.01),
        '{"action": "add_station", "position": {"lat_deg": 52.5, "lon_deg": 4.75, "alt_amsl_m": 100.0, '
        '"east_m": 1500.0, "north_m": -20.5, "up_m": 110.0}, "range_m": 255.01}',
        "add a station with a range of 255.1 m at east 1500.0 m, north -20.5 m, up 110.0 m",
    ),
    (IncludeStation("B"), '{"action": "include_station", "station": "B"}', "do not exclude B"),
    (
        RaiseLimit("endurance_s", 5.125, 50.125),
        '{"action": "raise_limit", "limit": "endurance_s", "by": 5.125, "to": 50.125}',
        "raise endurance_s to 50.13 s",
    ),
    (
        RaiseLimit("max_accel_m_s2", None, 6.0),
        '{"action": "raise_limit", "limit": "max_accel_m_s2", "to": 6.0}',
        "raise max_accel_m_s2 to 6.00 m/s^2",
    ),
    (
        RaiseLimit("max_handovers", None, 1),
        '{"action": "raise_limit", "limit": "max_handovers", "to": 1}',
        "allow 1 handover (max_handovers)",
    ),
    (
        LowerLimit("reserve_s", 5.0, 5.009),
        '{"action": "lower_limit", "limit": "reserve_s", "by": 5.0, "to": 5.009}',
        "lower reserve_s to 5.00 s",
    ),
    (
        LowerWind(12.55, 10.0, -7.5),
        '{"action": "lower_wind", "below_m_s": 12.55, "east_m_s": 10.0, "north_m_s": -7.5}',
        "wait until the wind is below 12.5 m/s",
    ),
    (
        LowerStartSpeed(5.0, (3.0, 4.0, 0.0), (0.0, 0.0, 0.5)),
        '{"action": "lower_start_speed", "below_m_s": 5.0, "velocity_m_s": [3.0, 4.0, 0.0], '
        '"acceleration_m_s2": [0.0, 0.0, 0.5]}',
        "start at 5.00 m/s or less in the same direction",
    ),
    (
        LaterArrival(10.125, 40.125),
        '{"action": "later_arrival", "by_s": 10.125, "arrival_s": 40.125}',
        "ask for arrival_s of 40.2 s or later",
    ),
    (
        EarlierArrival(10.0, 60.07),
        '{"action": "earlier_arrival", "by_s": 10.0, "arrival_s": 60.07}',
        "ask for arrival_s of 60.0 s or earlier",
    ),
]
# Enough in it for every change to mean something.
FULL = local(
    options={"min_overlap_s": 5.0, "excluded_stations": ["B"], "max_handovers": 0, "range_margin_m": 25.0},
    limits__endurance_s=300.0,
    limits__reserve_s=20.0,
    limits__max_airspeed_m_s=30.0,
    limits__wind={"east_m_s": 1.0, "north_m_s": 2.0},
    stations__0__min_elevation_deg=20.0,
    stations__1__min_elevation_deg=1.0,
)


def test_no_kind_of_change_is_missing_here() -> None:
    assert {type(change) for change, _, _ in PINNED} == set(get_args(Change))


@pytest.mark.parametrize(("change", "document", "text"), PINNED, ids=[document for _, document, _ in PINNED])
def test_a_change_is_written_and_said_to_the_letter(change: Change, document: str, text: str) -> None:
    assert json.dumps(to_document(change), allow_nan=False) == document
    assert words(change) == text


@pytest.mark.parametrize("change", [change for change, _, _ in PINNED], ids=[document for _, document, _ in PINNED])
def test_a_change_made_is_its_document_followed(change: Change) -> None:
    """The mission after a change is the one a reader of the ``fix`` would write."""
    on_earth = isinstance(change, Move) and change.position.local is None
    mission: dict[str, Any] = write_mission(read_mission(wgs84() if on_earth else FULL))
    wanted = read_mission(followed(copy.deepcopy(mission), to_document(change)))
    assert write_mission(apply(read_mission(mission), change)) == write_mission(wanted)
    assert write_mission(wanted) != mission


def test_what_goes_together_and_what_else_would_do() -> None:
    both = (RaiseRange("A", 1.0, 1001.0), RaiseRange("B", 2.0, 1002.0))
    other = (LowerMargin(10.0, 15.0), WidenBand(min_alt_amsl_m=90.0, by_m=10.0))
    remedies: list[Remedy] = [both, other, (RaiseAllRanges(3.0),)]
    assert json.dumps(document_of(remedies)) == (
        '{"action": "raise_range", "station": "A", "by_m": 1.0, "range_m": 1001.0, '
        '"also": [{"action": "raise_range", "station": "B", "by_m": 2.0, "range_m": 1002.0}], '
        '"alternatives": [{"action": "lower_margin", "by_m": 10.0, "range_margin_m": 15.0, '
        '"also": [{"action": "widen_band", "min_alt_amsl_m": 90.0, "by_m": 10.0}]}, '
        '{"action": "raise_all_ranges", "by_m": 3.0}]}'
    )
    assert words_of(remedies) == (
        "Raise the range of A by 1.0 m to 1001.0 m and raise the range of B by 2.0 m to 1002.0 m; or lower "
        "range_margin_m to 15.0 m and lower min_alt_amsl_m to 90.0 m; or raise every range by 3.0 m."
    )
    mission = read_mission(local())
    raised = zip(mission.stations, applied(mission, both).stations, strict=True)
    assert [after.range_m - before.range_m for before, after in raised] == [1.0, 2.0]


def test_nothing_to_offer() -> None:
    assert document_of([]) is None
    assert words_of([]) == ""
