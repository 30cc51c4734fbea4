"""Lenses, gaps and the reasons a chain is broken; the geometry of most scenes is worked by hand."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planner_missions import PAPER_LIKE, make_problem, paper_problem

from planner import Infeasibility, Problem, lens
from planner.discs import covering_stations, disc_radius_m, range_to_meet_m
from planner.lens import MIN_LENS_M, adjacent_pairs, diagnose, lens_depth_m, lens_point_m, usable_stations


def scene(*stations: tuple[float, float, float, float], **options: object) -> Problem:
    """Ends at the first and last station's axes, 100 m up, band 100 to 120 m."""
    first, last = stations[0], stations[-1]
    return make_problem([first[0], first[1], 100], [last[0], last[1], 100], stations, **options)


def test_lens_of_two_ground_stations_is_measured_at_the_floor_of_the_band() -> None:
    # sqrt(500^2 - 100^2) = 489.898 m each; 970 m apart: 9.796 m deep, 990 m apart: a gap of 10.204 m.
    radius = np.sqrt(500.0**2 - 100.0**2)
    for distance in (970.0, 990.0):
        problem = scene((0, 0, 0, 500), (distance, 0, 0, 500))
        assert float(lens_depth_m(problem, 0, 1)) == pytest.approx(2 * radius - distance, abs=1e-9)
    np.testing.assert_allclose(lens_point_m(problem, 0, 1), [495.0, 0.0, 100.0])


def test_two_hills_meet_where_the_floor_of_the_band_would_say_they_do_not() -> None:
    # Antennas at 120 m, range 50 m: at the band's floor the radius is sqrt(2500 - 400) = 45.8 m, at 120 m it is 50 m.
    problem = scene((0, 0, 120, 50), (95, 0, 120, 50))
    assert float(lens_depth_m(problem, 0, 1)) == pytest.approx(5.0)
    assert 2 * np.sqrt(2100.0) < 95.0


def test_a_hill_and_a_valley_meet_on_the_line_between_their_antennas() -> None:
    # h = 80 and 140, R = 50 both: the deepest altitude is 110 m, where both radii are sqrt(2500 - 900) = 40 m. At 100 m
    # they are 45.8 and 30, at 120 m 30 and 45.8: 75.8 in sum, so the planes of either station miss a lens 78 m away.
    problem = scene((0, 0, 80, 50), (78, 0, 140, 50))
    assert float(lens_depth_m(problem, 0, 1)) == pytest.approx(2.0)
    np.testing.assert_allclose(lens_point_m(problem, 0, 1), [39.0, 0.0, 110.0])


def test_a_disc_inside_another_is_as_deep_as_it_is_wide() -> None:
    problem = scene((0, 0, 100, 500), (10, 0, 100, 20))
    assert float(lens_depth_m(problem, 0, 1)) == pytest.approx(40.0)
    np.testing.assert_allclose(lens_point_m(problem, 0, 1), [10.0, 0.0, 100.0])


def test_coincident_stations() -> None:
    problem = scene((0, 0, 0, 500), (0, 0, 0, 500))
    assert float(lens_depth_m(problem, 0, 1)) == pytest.approx(2 * np.sqrt(500.0**2 - 100.0**2))
    np.testing.assert_allclose(lens_point_m(problem, 0, 1), [0.0, 0.0, 100.0])


def test_a_station_that_does_not_reach_the_band_is_unusable() -> None:
    problem = scene((0, 0, 0, 500), (100, 0, 0, 99.9), (0, 50, 200, 79.9), (0, 60, 200, 80.0))
    assert usable_stations(problem).tolist() == [True, False, False, True]
    assert float(lens_depth_m(problem, 0, 1)) == -np.inf
    assert adjacent_pairs(problem).pairs.tolist() == []


def test_stations_that_share_no_altitude_do_not_meet() -> None:
    # One reaches up to 105 m, the other down to 110 m, on one axis: 5 m apart.
    problem = scene((0, 0, 0, 105), (0, 0, 500, 390))
    assert float(lens_depth_m(problem, 0, 1)) == pytest.approx(-5.0)


def test_an_elevation_limit_narrows_the_range_to_a_cone() -> None:
    # At 45 degrees the radius at altitude z is z, largest at the top of the band: 120 m each.
    problem = scene((0, 0, 0, 500), (235, 0, 0, 500), min_elevation_deg=np.array([45.0, 45.0]))
    assert float(disc_radius_m(problem, 0, 100.0)) == pytest.approx(100.0)
    assert float(lens_depth_m(problem, 0, 1)) == pytest.approx(2 * 120.0 - 235.0)
    # The cone is widest at the top of the band; an end 100 m out and 100 m up is just heard, 101 m out is not.
    assert covering_stations(problem, np.array([99.999, 0, 100])).tolist() == [0]
    assert covering_stations(problem, np.array([117.0, 0, 100])).tolist() == []


station = st.tuples(
    st.floats(-300, 300),
    st.floats(-300, 300),
    st.floats(0, 250),
    st.floats(20, 300),
    st.sampled_from([-90.0, 0.0, 30.0]),
)


@given(station, station, st.booleans())
@settings(max_examples=120, deadline=None)
def test_lens_depth_is_the_deepest_over_the_band(
    a: tuple[float, ...], b: tuple[float, ...], with_elevation: bool
) -> None:
    rows = np.array([a, b])
    elevation = {"min_elevation_deg": rows[:, 4]} if with_elevation else {}
    problem = make_problem([0, 0, 100], [0, 0, 100], rows[:, :4], **elevation)
    depth = float(lens_depth_m(problem, 0, 1))
    assert depth == pytest.approx(float(lens_depth_m(problem, 1, 0)), abs=1e-9)
    altitudes = np.linspace(100.0, 120.0, 2001)
    radii = np.stack([disc_radius_m(problem, k, altitudes) for k in (0, 1)])
    reached = np.abs(altitudes - rows[:, 2:3]) <= rows[:, 3:4]
    if with_elevation:
        reached &= (altitudes >= rows[:, 2:3]) | (rows[:, 4:5] < 0)
    both = reached.all(axis=0)
    if both.any():
        distance = np.hypot(*(rows[1, :2] - rows[0, :2]))
        sampled = float((radii.sum(axis=0) - distance)[both].max())
        widest = float(2 * radii.min(axis=0)[both].max())
        assert depth <= sampled + 0.05 + 1e-3 * abs(sampled)
        assert depth >= min(sampled, 0.0) - 1e-9 or depth >= min(sampled, widest) - 1e-9
        if sampled > 1e-6:
            assert depth >= 0.0
    else:
        assert depth < 1.0
    if depth >= MIN_LENS_M:
        point = lens_point_m(problem, 0, 1)
        inside = np.linalg.norm(point - rows[:, :3], axis=1) - rows[:, 3]
        assert inside.max() <= 0.0
        assert 100.0 <= point[2] <= 120.0


@given(station, station)
@settings(max_examples=100, deadline=None)
def test_the_range_that_meets_is_the_least_one(a: tuple[float, ...], b: tuple[float, ...]) -> None:
    rows = np.array([a, b])
    problem = make_problem([0, 0, 100], [0, 0, 100], rows[:, :4])
    if not usable_stations(problem)[1]:
        return
    needed = float(range_to_meet_m(problem, np.array([0]), np.array([1]), 1.0)[0])
    widest = float(disc_radius_m(problem, 1, np.linspace(100, 120, 200)).max())
    enough = replace(problem, ranges_m=np.array([needed * (1 + 1e-9), rows[1, 3]]))
    assert float(lens_depth_m(enough, 0, 1)) >= min(1.0, 2.0 * widest) - 1e-6
    if np.hypot(*(rows[1, :2] - rows[0, :2])) > widest + 1.0:
        less = replace(problem, ranges_m=np.array([needed * (1 - 1e-6), rows[1, 3]]))
        assert float(lens_depth_m(less, 0, 1)) < 1.0


@pytest.mark.parametrize("name", ["M30_01", "M100_02", "M300_03"])
def test_neighbour_search_agrees_with_all_pairs(name: str) -> None:
    problem = paper_problem(name)
    radius = np.sqrt(problem.ranges_m**2 - 100.0**2)
    ground = problem.station_positions_m[:, :2]
    expected = [
        (i, j)
        for i, j in itertools.combinations(range(problem.station_count), 2)
        if np.hypot(*(ground[i] - ground[j])) <= radius[i] + radius[j] - MIN_LENS_M
    ]
    assert [tuple(pair) for pair in adjacent_pairs(problem).pairs.tolist()] == expected


def test_neighbour_search_with_one_far_reaching_station() -> None:
    rng = np.random.default_rng(5)
    rows = np.column_stack([rng.uniform(0, 2e4, (400, 2)), rng.uniform(0, 200, 400), rng.uniform(150, 900, 400)])
    rows[17, 3] = 9000.0
    problem = make_problem([0, 0, 100], [0, 0, 100], rows)
    i, j = np.triu_indices(400, 1)
    expected = np.stack([i, j], axis=1)[lens_depth_m(problem, i, j) >= MIN_LENS_M]
    np.testing.assert_array_equal(adjacent_pairs(problem).pairs, expected)
    assert (expected == 17).any(axis=1).sum() > 50


# --- why there is no trajectory ---------------------------------------------------------------------------------


def applied(problem: Problem, found: Infeasibility) -> Problem:
    """The problem with the offered fix made."""
    assert found.fix is not None
    ranges = problem.ranges_m.copy()
    for fix in [found.fix, *found.fix.get("also", [])]:  # type: ignore[misc]
        assert fix["action"] == "raise_range"
        ranges[fix["station"]] += fix["by_m"]
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
    assert found.fix == {"action": "set_altitude", "of": "start", "alt_m": nearest, "by_m": nearest - altitude}
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


def test_a_broken_chain_names_the_two_sides_the_gap_and_the_fix() -> None:
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
    assert found.fix is not None
    assert found.fix["station"] in (1, 2)
    assert found.fix["by_m"] == pytest.approx(np.hypot(1000.0 - radius + MIN_LENS_M, 100.0) - 500.0, rel=1e-6)
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
    assert found.fix is not None
    assert found.fix["station"] == 3
    assert "also" not in found.fix
    assert diagnose(applied(problem, found)) is None


@pytest.mark.parametrize("name", PAPER_LIKE[::3])
def test_the_fix_always_works(name: str) -> None:
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
    monkeypatch.setattr(lens, "ALL_PAIRS_STATIONS", 10)
    large = diagnose(problem)
    assert whole is not None
    assert large is not None
    assert whole.reason == "broken_chain"
    assert (large.stations, large.gap_m) == (whole.stations, whole.gap_m)
    assert large.fix == whole.fix
    monkeypatch.setattr(lens, "MAX_PAIRS", 0)
    rough = diagnose(problem)
    assert rough is not None
    assert rough.gap_m is not None
    assert whole.gap_m is not None
    assert rough.gap_m >= whole.gap_m - 1e-9
    assert diagnose(applied(problem, rough)) is None


def test_stations_in_one_line_have_no_triangles(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lens, "ALL_PAIRS_STATIONS", 2)
    problem = scene(*[(900.0 * k, 0.0, 0.0, 500.0 if k != 3 else 300.0) for k in range(7)])
    found = diagnose(problem)
    assert found is not None
    assert found.gap_m == pytest.approx(900 - np.sqrt(500**2 - 100**2) - np.sqrt(300**2 - 100**2))
    assert found.fix is not None
    assert found.fix["station"] == 3
    assert "also" not in found.fix


def test_a_tangent_pair_is_a_broken_chain_until_the_lens_is_a_millimetre_deep() -> None:
    for depth, broken in ((0.0, True), (0.5 * MIN_LENS_M, True), (1.01 * MIN_LENS_M, False)):
        problem = scene((0, 0, 100, 500), (1000.0 - depth, 0, 100, 500))
        assert (diagnose(problem) is not None) is broken


def test_more_handovers_than_allowed() -> None:
    problem = scene((0, 0, 0, 500), (900, 0, 0, 500), (1800, 0, 0, 500), max_handovers=1)
    found = diagnose(problem)
    assert found is not None
    assert found.reason == "limits"
    assert found.fix == {"action": "raise_limit", "limit": "max_handovers", "to": 2}
    assert diagnose(replace(problem, max_handovers=2)) is None
