"""Why a chain of ranges is broken, and that what is advised mends it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from planner import Infeasibility, Problem
from planner.coverage.overlap import MIN_OVERLAP_M
from planner.infeasibility import diagnosis
from planner.infeasibility.diagnosis import diagnose
from planner.remedy import RaiseLimit, RaiseRange, SetAltitude
from tests.support.missions.problems import PAPER_LIKE, make_problem, paper_problem, scene


def applied(problem: Problem, found: Infeasibility) -> Problem:
    """The problem with the offered remedy made."""
    ranges = problem.ranges_m.copy()
    (remedy,) = found.remedies
    for change in remedy:
        assert isinstance(change, RaiseRange)
        ranges[change.station] += change.by_m
    return replace(problem, ranges_m=ranges)


def test_nothing_to_say_about_a_chain_that_holds(two_stations: Problem) -> None:
    assert diagnose(two_stations) is None
    for name in PAPER_LIKE:
        assert diagnose(paper_problem(name)) is None


@pytest.mark.parametrize(("altitude", "nearest"), [(99.0, 100.0), (130.0, 120.0)])
def test_an_end_outside_the_band(two_stations: Problem, altitude: float, nearest: float) -> None:
    found = diagnose(replace(two_stations, start_m=np.array([0, 0, altitude])))
    assert found is not None
    assert found.reason == "start_altitude"
    assert found.gap_m == abs(altitude - nearest)
    assert found.remedies == ((SetAltitude("start", nearest, nearest - altitude),),)
    assert "120.00" in found.message
    found = diagnose(replace(two_stations, destination_m=np.array([0, 0, altitude])))
    assert found is not None
    assert found.reason == "destination_altitude"


def test_an_end_out_of_every_range(two_stations: Problem) -> None:
    # 3 4 5: station 1 at (1600, 0, 0); (2800, 0, 100) is sqrt(1200^2 + 100^2) away, 1,000 m in range.
    problem = replace(two_stations, destination_m=np.array([2800.0, 0.0, 100.0]))
    found = diagnose(problem)
    assert found is not None
    assert found.reason == "destination_uncovered"
    assert found.stations == (1,)
    assert found.gap_m == pytest.approx(np.hypot(1200.0, 100.0) - 1000.0)
    assert found.position_m == (2800.0, 0.0, 100.0)
    assert diagnose(applied(problem, found)) is None


def test_an_end_below_the_elevation_angle(two_stations: Problem) -> None:
    problem = replace(two_stations, start_m=np.array([-200.0, 0, 100]), min_elevation_deg=np.array([30.0, 0.0]))
    found = diagnose(problem)
    assert found is not None
    assert found.reason == "start_uncovered"
    assert "elevation" in found.message


def test_a_broken_chain_names_the_two_sides_the_gap_and_the_remedy() -> None:
    """A and B meet, C and D meet, B and C are 2 sqrt(500^2 - 100^2) - 1000 = 20.2 m apart.

    A(0) ─ B(900) ╳ C(1900) ─ D(2800)
    """
    problem = scene((0, 0, 0, 500), (900, 0, 0, 500), (1900, 0, 0, 500), (2800, 0, 0, 500))
    radius = np.sqrt(500.0**2 - 100.0**2)
    found = diagnose(problem)
    assert found is not None
    assert found.reason == "broken_chain"
    assert found.stations == (1, 2)
    assert found.gap_m == pytest.approx(1000.0 - 2 * radius)
    assert found.position_m == pytest.approx((1400.0, 0.0, 100.0))
    (raised,) = found.remedies[0]
    assert isinstance(raised, RaiseRange)
    assert raised.station in (1, 2)
    assert raised.by_m == pytest.approx(np.hypot(1000.0 - radius + MIN_OVERLAP_M, 100.0) - 500.0, rel=1e-6)
    assert diagnose(applied(problem, found)) is None
    nearly = replace(problem, ranges_m=applied(problem, found).ranges_m - np.array([0, 1e-4, 1e-4, 0]))
    assert diagnose(nearly) is not None


def test_the_chain_with_the_narrowest_gap_is_the_one_explained() -> None:
    """Two ways round: north misses 200 m once, south misses 30 m twice; the south is the better one."""
    reach = float(np.hypot(500.0, 100.0))
    problem = scene(
        (0, 0, 0, reach), (600, 900, 0, reach), (1800, 900, 0, reach), (1030, 0, 0, reach), (2060, 0, 0, reach)
    )
    found = diagnose(problem)
    assert found is not None
    assert found.stations in ((0, 3), (3, 4))
    assert found.gap_m == pytest.approx(30.0)
    # One station in the middle raised once closes both gaps.
    (raised,) = found.remedies[0]
    assert isinstance(raised, RaiseRange)
    assert raised.station == 3
    assert diagnose(applied(problem, found)) is None


@pytest.mark.parametrize("name", PAPER_LIKE[::3])
def test_the_remedy_always_works(name: str) -> None:
    broken = 0
    for margin_m in (40.0, 90.0, 160.0):
        problem = paper_problem(name, margin_m=margin_m)
        for _ in range(4):
            found = diagnose(problem)
            if found is None:
                break
            broken += found.reason == "broken_chain"
            problem = applied(problem, found)
        assert diagnose(problem) is None
    assert broken >= 0


def island_map(seed: int) -> Problem:
    """Three clusters of stations of very different reach, two of them at one place, apart by some hundred metres."""
    rng = np.random.default_rng(seed)
    centres = np.array([[0, 0], [4200, 300], [8400, -500]])
    ground = np.concatenate([centre + rng.uniform(-1500, 1500, (25, 2)) for centre in centres])
    rows = np.column_stack([ground, rng.uniform(0, 90, 75), rng.uniform(150, 900, 75)])
    rows[5] = rows[4]
    return make_problem([*rows[0, :2], 105], [*rows[-1, :2], 105], rows)


@pytest.mark.parametrize("seed", range(6))
def test_large_maps_are_explained_as_exactly(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Above some stations the pairs are not all listed; where that is cut short, the chain is still a chain."""
    problem = island_map(seed)
    whole = diagnose(problem)
    monkeypatch.setattr(diagnosis, "ALL_PAIRS_STATIONS", 10)
    large = diagnose(problem)
    assert whole is not None
    assert large is not None
    assert whole.reason == "broken_chain"
    assert (large.stations, large.gap_m) == (whole.stations, whole.gap_m)
    assert large.remedies == whole.remedies
    monkeypatch.setattr(diagnosis, "MAX_PAIRS", 0)
    rough = diagnose(problem)
    assert rough is not None
    assert rough.gap_m is not None
    assert whole.gap_m is not None
    assert rough.gap_m >= whole.gap_m - 1e-9
    assert diagnose(applied(problem, rough)) is None


def test_stations_in_one_line_have_no_triangles(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(diagnosis, "ALL_PAIRS_STATIONS", 2)
    problem = scene(*[(900.0 * k, 0.0, 0.0, 500.0 if k != 3 else 300.0) for k in range(7)])
    found = diagnose(problem)
    assert found is not None
    assert found.gap_m == pytest.approx(900 - np.sqrt(500**2 - 100**2) - np.sqrt(300**2 - 100**2))
    (raised,) = found.remedies[0]
    assert isinstance(raised, RaiseRange)
    assert raised.station == 3


def test_a_tangent_pair_is_a_broken_chain_until_the_overlap_is_a_millimetre_deep() -> None:
    for depth, broken in ((0.0, True), (0.5 * MIN_OVERLAP_M, True), (1.01 * MIN_OVERLAP_M, False)):
        problem = scene((0, 0, 100, 500), (1000.0 - depth, 0, 100, 500))
        assert (diagnose(problem) is not None) is broken


def test_more_handovers_than_allowed() -> None:
    problem = scene((0, 0, 0, 500), (900, 0, 0, 500), (1800, 0, 0, 500), max_handovers=1)
    found = diagnose(problem)
    assert found is not None
    assert found.reason == "limits"
    assert found.remedies == ((RaiseLimit("max_handovers", 2),),)
    assert diagnose(replace(problem, max_handovers=2)) is None
