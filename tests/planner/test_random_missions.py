"""Missions drawn at random, each planned and judged, or refused for a reason that the judge does not know better."""

from __future__ import annotations

import os
from collections import Counter

import pytest

from tests.support.missions.seeded import has_a_way, outcome, random_mission

SEED = 2026
# Of the soak: `SKYRELAY_SOAK_FIRST` and `SKYRELAY_SOAK_COUNT` choose a part of it.
FIRST = int(os.environ.get("SKYRELAY_SOAK_FIRST", "0"))
COUNT = int(os.environ.get("SKYRELAY_SOAK_COUNT", "2000"))


def faults_of(numbers: range) -> tuple[Counter[str], list[str]]:
    """How the missions ended, and everything that is wrong."""
    ends: Counter[str] = Counter()
    faults = []
    for number in numbers:
        try:
            end, complaints = outcome(random_mission(SEED, number), fast=number % 2 == 1)
        except Exception as error:
            end, complaints = "failed", [f"{type(error).__name__}: {error}"]
        ends[end] += 1
        faults += [f"mission {number}: {complaint}" for complaint in complaints]
        if number % 50 == 49:
            print(f"{number + 1} missions: {dict(ends)}, {len(faults)} faults", flush=True)
    return ends, faults


@pytest.mark.slow
def test_a_sample_of_random_missions() -> None:
    ends, faults = faults_of(range(40))
    assert faults == []
    assert ends["planned"] >= 20, ends
    assert len(ends) >= 3, ends


@pytest.mark.soak
def test_two_thousand_random_missions() -> None:
    """About a second a mission. `pytest -s -m soak tests/planner/test_random_missions.py --timeout 0`."""
    ends, faults = faults_of(range(FIRST, FIRST + COUNT))
    print(dict(ends))
    assert faults == []


def test_the_judge_of_refusals_knows_a_way_when_there_is_one() -> None:
    """Two ranges of 500 m, 900 m apart: a way; 1100 m apart: none; less a margin of 60 m: none."""
    station = {"north_m": 0.0, "up_m": 0.0, "range_m": 500.0}
    end = {"north_m": 0.0, "up_m": 100.0}
    mission = {
        "origin": {"lat_deg": 0.0, "lon_deg": 0.0, "alt_amsl_m": 0.0},
        "start": {"east_m": 0.0, **end},
        "destination": {"east_m": 900.0, **end},
        "stations": [{"id": "a", "east_m": 0.0, **station}, {"id": "b", "east_m": 900.0, **station}],
        "limits": {"min_alt_amsl_m": 100.0, "max_alt_amsl_m": 120.0, "max_speed_m_s": 20.0, "max_accel_m_s2": 2.0},
        "options": {"range_margin_m": 0.0},
    }
    assert has_a_way(mission)
    assert not has_a_way(mission | {"options": {"range_margin_m": 60.0}})
    mission["stations"][1]["east_m"] = mission["destination"]["east_m"] = 1100.0  # type: ignore[index]
    assert not has_a_way(mission)
