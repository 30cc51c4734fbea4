"""Overlaps and gaps; the geometry of most scenes is worked by hand."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.coverage.disc import covering_stations, disc_radius_m, range_to_meet_m, usable_stations
from planner.coverage.overlap import MIN_OVERLAP_M, adjacent_pairs, overlap_depth_m, overlap_point_m
from tests.support.missions.problems import make_problem, paper_problem, scene


def test_overlap_of_two_ground_stations_is_measured_at_the_floor_of_the_band() -> None:
    # sqrt(500^2 - 100^2) = 489.898 m each; 970 m apart: 9.796 m deep, 990 m apart: a gap of 10.204 m.
    radius = np.sqrt(500.0**2 - 100.0**2)
    for distance in (970.0, 990.0):
        problem = scene((0, 0, 0, 500), (distance, 0, 0, 500))
        assert float(overlap_depth_m(problem, 0, 1)) == pytest.approx(2 * radius - distance, abs=1e-9)
    np.testing.assert_allclose(overlap_point_m(problem, 0, 1), [495.0, 0.0, 100.0])


def test_two_hills_meet_where_the_floor_of_the_band_would_say_they_do_not() -> None:
    # Antennas at 120 m, range 50 m: at the band's floor the radius is sqrt(2500 - 400) = 45.8 m, at 120 m it is 50 m.
    problem = scene((0, 0, 120, 50), (95, 0, 120, 50))
    assert float(overlap_depth_m(problem, 0, 1)) == pytest.approx(5.0)
    assert 2 * np.sqrt(2100.0) < 95.0


def test_a_hill_and_a_valley_meet_on_the_line_between_their_antennas() -> None:
    # h = 80 and 140, R = 50 both: the deepest altitude is 110 m, where both radii are sqrt(2500 - 900) = 40 m. At 100 m
    # they are 45.8 and 30, at 120 m 30 and 45.8: 75.8 in sum, so either station's plane misses an overlap 78 m away.
    problem = scene((0, 0, 80, 50), (78, 0, 140, 50))
    assert float(overlap_depth_m(problem, 0, 1)) == pytest.approx(2.0)
    np.testing.assert_allclose(overlap_point_m(problem, 0, 1), [39.0, 0.0, 110.0])


def test_a_disc_inside_another_is_as_deep_as_it_is_wide() -> None:
    problem = scene((0, 0, 100, 500), (10, 0, 100, 20))
    assert float(overlap_depth_m(problem, 0, 1)) == pytest.approx(40.0)
    np.testing.assert_allclose(overlap_point_m(problem, 0, 1), [10.0, 0.0, 100.0])


def test_coincident_stations() -> None:
    problem = scene((0, 0, 0, 500), (0, 0, 0, 500))
    assert float(overlap_depth_m(problem, 0, 1)) == pytest.approx(2 * np.sqrt(500.0**2 - 100.0**2))
    np.testing.assert_allclose(overlap_point_m(problem, 0, 1), [0.0, 0.0, 100.0])


def test_a_station_that_does_not_reach_the_band_is_unusable() -> None:
    problem = scene((0, 0, 0, 500), (100, 0, 0, 99.9), (0, 50, 200, 79.9), (0, 60, 200, 80.0))
    assert usable_stations(problem).tolist() == [True, False, False, True]
    assert float(overlap_depth_m(problem, 0, 1)) == -np.inf
    assert adjacent_pairs(problem).pairs.tolist() == []


def test_stations_that_share_no_altitude_do_not_meet() -> None:
    # One reaches up to 105 m, the other down to 110 m, on one axis: 5 m apart.
    problem = scene((0, 0, 0, 105), (0, 0, 500, 390))
    assert float(overlap_depth_m(problem, 0, 1)) == pytest.approx(-5.0)


def test_an_elevation_limit_narrows_the_range_to_a_cone() -> None:
    # At 45 degrees the radius at altitude z is z, largest at the top of the band: 120 m each.
    problem = scene((0, 0, 0, 500), (235, 0, 0, 500), min_elevation_deg=np.array([45.0, 45.0]))
    assert float(disc_radius_m(problem, 0, 100.0)) == pytest.approx(100.0)
    assert float(overlap_depth_m(problem, 0, 1)) == pytest.approx(2 * 120.0 - 235.0)
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
def test_overlap_depth_is_the_deepest_over_the_band(
    a: tuple[float, ...], b: tuple[float, ...], with_elevation: bool
) -> None:
    rows = np.array([a, b])
    elevation = {"min_elevation_deg": rows[:, 4]} if with_elevation else {}
    problem = make_problem([0, 0, 100], [0, 0, 100], rows[:, :4], **elevation)
    depth = float(overlap_depth_m(problem, 0, 1))
    assert depth == pytest.approx(float(overlap_depth_m(problem, 1, 0)), abs=1e-9)
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
    if depth >= MIN_OVERLAP_M:
        point = overlap_point_m(problem, 0, 1)
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
    assert float(overlap_depth_m(enough, 0, 1)) >= min(1.0, 2.0 * widest) - 1e-6
    if np.hypot(*(rows[1, :2] - rows[0, :2])) > widest + 1.0:
        less = replace(problem, ranges_m=np.array([needed * (1 - 1e-6), rows[1, 3]]))
        assert float(overlap_depth_m(less, 0, 1)) < 1.0


@pytest.mark.parametrize("name", ["M30_01", "M100_02", "M300_03"])
def test_neighbour_search_agrees_with_all_pairs(name: str) -> None:
    problem = paper_problem(name)
    radius = np.sqrt(problem.ranges_m**2 - 100.0**2)
    ground = problem.station_positions_m[:, :2]
    expected = [
        (i, j)
        for i, j in itertools.combinations(range(problem.station_count), 2)
        if np.hypot(*(ground[i] - ground[j])) <= radius[i] + radius[j] - MIN_OVERLAP_M
    ]
    assert [tuple(pair) for pair in adjacent_pairs(problem).pairs.tolist()] == expected


def test_neighbour_search_with_one_far_reaching_station() -> None:
    rng = np.random.default_rng(5)
    rows = np.column_stack([rng.uniform(0, 2e4, (400, 2)), rng.uniform(0, 200, 400), rng.uniform(150, 900, 400)])
    rows[17, 3] = 9000.0
    problem = make_problem([0, 0, 100], [0, 0, 100], rows)
    i, j = np.triu_indices(400, 1)
    expected = np.stack([i, j], axis=1)[overlap_depth_m(problem, i, j) >= MIN_OVERLAP_M]
    np.testing.assert_array_equal(adjacent_pairs(problem).pairs, expected)
    assert (expected == 17).any(axis=1).sum() > 50
