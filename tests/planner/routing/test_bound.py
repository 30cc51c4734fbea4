"""The lower bound: hand-worked figures, an exhaustive search as oracle, and never above what a vehicle can do."""

from __future__ import annotations

import heapq
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

import planner.routing.bound as bound_module
from planner import Limits, Problem
from planner.routing.bound import lower_bound
from planner.routing.navmesh import NavigationMesh
from planner.speed_profile import fastest_time_s
from tests.support.missions.problems import make_problem, paper_problem

Array = NDArray[np.float64]


def test_one_station_is_a_straight_line() -> None:
    """800 m in one range: L/v + v/a = 800/50 + 10, and the straight line is the path."""
    problem = make_problem([-400, 0, 100], [400, 0, 100], [[0, 0, 0, 1000]])
    bound = lower_bound(problem)
    assert bound.exact
    assert bound.time_s == pytest.approx(26.0, rel=1e-8)
    assert bound.path_m == pytest.approx(np.array([[-400, 0], [400, 0]]))


def test_a_short_hop_never_reaches_full_speed() -> None:
    """100 m at 5 m/s^2: 2 sqrt(100/5) s."""
    problem = make_problem([0, 0, 100], [100, 0, 100], [[0, 0, 0, 1000]])
    assert lower_bound(problem).time_s == pytest.approx(2 * np.sqrt(20.0), rel=1e-8)


def test_climb_counts() -> None:
    """300 m along and 20 m up: hypot(300, 20) m of path."""
    problem = make_problem([0, 0, 100], [300, 0, 120], [[0, 0, 0, 1000]])
    assert lower_bound(problem).length_m == pytest.approx(np.hypot(300, 20), rel=1e-8)


def test_start_is_destination() -> None:
    problem = make_problem([5, 5, 100], [5, 5, 100], [[0, 0, 0, 1000]])
    assert lower_bound(problem).time_s == 0.0


def test_two_discs_and_the_tip_of_their_overlap() -> None:
    """Antennas at the band's floor: discs of radius 1000 at x = 0 and x = 1600 cross at (800, +-600).

        start (0, 900) ........ tip (800, 600) ........ end (1600, 900)

    The straight line at y = 900 leaves both discs, so the path bends at the upper tip: 2 sqrt(800^2 + 300^2).
    """
    problem = make_problem([0, 900, 100], [1600, 900, 100], [[0, 0, 100, 1000], [1600, 0, 100, 1000]])
    bound = lower_bound(problem)
    assert bound.length_m == pytest.approx(2 * np.hypot(800, 300), rel=1e-8)
    assert bound.path_m is not None
    assert bound.path_m[1] == pytest.approx([800, 600], abs=1e-3)


def test_a_corridor_with_one_reflex_corner() -> None:
    """An L of three discs of radius 500: (0, 0), (800, 0), (800, 800).

        C            The first and second cross at (400, +-300), second and third at (800 -+ 300, 400).
        |            From (0, 0) to (800, 1200), the inner corner is (500, 400): it is seen from the start past
    A---B            (400, 300)?  The line start - (500, 400) passes x = 400 at y = 320 > 300: no. So the path
                     turns at (400, 300), then at (500, 400), then runs to the end.
    """
    stations = [[0, 0, 100, 500], [800, 0, 100, 500], [800, 800, 100, 500]]
    problem = make_problem([0, 0, 100], [800, 1200, 100], stations)
    expected = 500.0 + np.hypot(100, 100) + np.hypot(300, 800)
    bound = lower_bound(problem)
    assert bound.length_m == pytest.approx(expected, rel=1e-7)
    assert bound.path_m == pytest.approx(np.array([[0, 0], [400, 300], [500, 400], [800, 1200]]), abs=1e-3)


def test_an_antenna_on_a_hill_covers_most_at_its_own_height() -> None:
    """The plane z_min would show radius 800 (1000 at 600 m below); at the band's top, 300 m below, it is 954 m."""
    problem = make_problem([0, 950, 400], [0, -950, 400], [[0, 0, 700, 1000]], band=(100.0, 400.0))
    assert lower_bound(problem).exact
    assert lower_bound(problem).length_m == pytest.approx(1900.0, rel=1e-8)


def test_discs_that_touch_in_a_point_are_joined() -> None:
    problem = make_problem([0, 0, 100], [2000, 0, 100], [[0, 0, 100, 1000], [2000, 0, 100, 1000]])
    bound = lower_bound(problem)
    assert bound.exact
    assert bound.length_m == pytest.approx(2000.0, rel=1e-8)


def test_stations_in_line_and_twice_the_same() -> None:
    stations = [[x, 0, 100, 600] for x in range(0, 8000, 1000)] * 2
    problem = make_problem([0, 0, 100], [7000, 0, 100], stations)
    assert lower_bound(problem).length_m == pytest.approx(7000.0, rel=1e-8)


def test_a_broken_chain_still_has_a_bound() -> None:
    """No path at all: the straight line bounds, and says that it is not exact."""
    problem = make_problem([0, 0, 100], [9000, 0, 100], [[0, 0, 0, 1000], [9000, 0, 0, 1000]])
    bound = lower_bound(problem)
    assert not bound.exact
    assert bound.path_m is None
    assert bound.length_m == pytest.approx(9000.0, rel=1e-8)


def test_bound_ranges_and_speed_factor() -> None:
    """The ranges no true trajectory exceeds are used, and a plane that stretches distances by 1 % takes 1 % off."""
    stations = [[0, 0, 100, 900], [1600, 0, 100, 900]]
    problem = make_problem(
        [0, 800, 100], [1600, 800, 100], stations, bound_ranges_m=np.array([1000.0, 1000.0]), bound_speed_factor=1.01
    )
    length = 2 * np.hypot(800, 200)
    assert lower_bound(problem).time_s == pytest.approx(length / 1.01 / 50 + 10, rel=1e-8)


def test_optional_limits_raise_the_bound() -> None:
    """10 km straight ahead, worked by hand for each limit."""

    def time_s(**limits: object) -> float:
        stations = [[5000, 0, 100, 9000]]
        return lower_bound(make_problem([0, 0, 100], [10000, 0, 110], stations, limits=dict(limits))).time_s

    length = np.hypot(10000, 10)
    assert time_s() == pytest.approx(length / 50 + 10, rel=1e-8)
    # Speeding up with jerk 5 takes 1 s longer at either end: L/v + v/a + a/j - a^3 / (12 j^2 v).
    assert time_s(max_jerk_m_s3=5.0) == pytest.approx(length / 50 + 10 + 1 - 125 / (12 * 25 * 50), rel=1e-8)
    # 10 m of climb at 0.02 m/s.
    assert time_s(max_climb_m_s=0.02) == pytest.approx(500.0, rel=1e-8)
    # Against 10 m/s of wind at 30 m/s of airspeed: 20 m/s over ground.
    assert time_s(max_airspeed_m_s=30.0, wind_m_s=(-10.0, 0.0)) == pytest.approx(500.0, rel=1e-4)
    # With it: 40 m/s over ground, and the ends at rest.
    assert time_s(max_airspeed_m_s=30.0, wind_m_s=(10.0, 0.0)) == pytest.approx(length / 40 + 40 / 5, rel=1e-4)


def test_a_moving_start_saves_time() -> None:
    """1000 m from 50 m/s: no speeding up, 250 m of braking; 750/50 + 10."""
    assert fastest_time_s(Limits(0, 1, 50, 5), 500.0 + 250.0 + 250.0, 50.0) == pytest.approx(15.0 + 10.0)
    # Too fast to stop in 100 m: still 10 s of braking.
    assert fastest_time_s(Limits(0, 1, 50, 5), 100.0, 50.0) == pytest.approx(10.0)


@given(st.floats(0, 1e5), st.floats(0.5, 100), st.floats(0.05, 50), st.none() | st.floats(0.05, 50), st.floats(0, 1))
def test_fastest_time_matches_integration(
    length: float, speed: float, accel: float, jerk: float | None, start: float
) -> None:
    """Integrating the speed envelope over the returned time gives the length (or the stop from the start speed)."""
    limits = Limits(0, 1, speed, accel, max_jerk_m_s3=jerk)
    time = fastest_time_s(limits, length, start * speed)
    t = np.linspace(0, time, 20001)
    envelope = np.minimum(speed, start * speed + _grown(t, accel, jerk))
    envelope = np.minimum(envelope, _grown(time - t, accel, jerk))
    distance = float(np.trapezoid(envelope, t))
    stop = np.interp(start * speed, _grown(np.linspace(0, 1e4, 100001), accel, jerk), np.linspace(0, 1e4, 100001))
    assert distance == pytest.approx(length, rel=1e-3, abs=1e-3) or time <= stop * (1 + 1e-3) + 0.2


def _grown(t: Array, accel: float, jerk: float | None) -> Array:
    if jerk is None:
        return accel * t
    full = accel / jerk
    return np.where(t < full, 0.5 * jerk * t**2, accel * t - accel**2 / (2 * jerk))


def random_map(seed: int, count: int, side_m: float = 10_000.0) -> tuple[Array, Array, Array, Array]:
    """Centres, radii and two covered points of a random map."""
    rng = np.random.default_rng(seed)
    centres = rng.uniform(0, side_m, (count, 2))
    radii = rng.uniform(500, 1500, count)
    start, end = (centres[k] + rng.uniform(-0.5, 0.5, 2) * radii[k] for k in rng.integers(0, count, 2))
    return centres, radii, start, end


def exhaustive_shortest_path(centres: Array, radii: Array, start: Array, end: Array) -> float:
    """The oracle: Dijkstra over every uncovered crossing of two circles, each line checked against every disc."""
    nodes = [start, end]
    for i in range(len(radii)):
        for j in range(i):
            offset = centres[j] - centres[i]
            apart = float(np.hypot(*offset))
            foot = (apart**2 + radii[i] ** 2 - radii[j] ** 2) / (2 * apart)
            if radii[i] < abs(foot):
                continue
            half = np.sqrt(radii[i] ** 2 - foot**2)
            unit = offset / apart
            for side in (half, -half):
                point = centres[i] + foot * unit + side * np.array([-unit[1], unit[0]])
                if (np.linalg.norm(centres - point, axis=1) >= radii - 1e-6).all():
                    nodes.append(point)
    points = np.array(nodes)
    best = np.full(len(points), np.inf)
    best[0] = 0.0
    queue = [(0.0, 0)]
    while queue:
        length, k = heapq.heappop(queue)
        if length > best[k]:
            continue
        if k == 1:
            return length
        for m in range(len(points)):
            onward = length + float(np.hypot(*(points[m] - points[k])))
            if onward < best[m] and _covered(points[k], points[m], centres, radii + 1e-6):
                best[m] = onward
                heapq.heappush(queue, (onward, m))
    return np.inf


def _covered(a: Array, b: Array, centres: Array, radii: Array) -> bool:
    along = b - a
    square = float(along @ along)
    if square == 0.0:
        return True
    middle = (centres - a) @ along / square
    reach = radii**2 - ((centres - a) ** 2).sum(axis=1) + middle**2 * square
    hit = reach > 0
    half = np.sqrt(reach[hit] / square)
    spans = sorted(zip(middle[hit] - half, middle[hit] + half, strict=True))
    upto = 0.0
    for low, high in spans:
        if low > upto + 1e-9:
            break
        upto = max(upto, high)
    return upto >= 1.0 - 1e-9


@pytest.mark.parametrize("seed", range(40))
def test_mesh_agrees_with_an_exhaustive_search(seed: int) -> None:
    centres, radii, start, end = random_map(seed, 12 + seed, 7_000.0)
    expected = exhaustive_shortest_path(centres, radii, start, end)
    found = NavigationMesh(centres, radii).shortest_path((start[0], start[1]), (end[0], end[1]))
    if np.isinf(expected):
        assert found is None
    else:
        assert found is not None
        assert found.length_m == pytest.approx(expected, rel=1e-6, abs=1e-3)
        assert found.length_m == pytest.approx(np.linalg.norm(np.diff(found.points_m, axis=0), axis=1).sum(), rel=1e-9)
        assert all(_covered(a, b, centres, radii + 1e-3) for a, b in pairwise(found.points_m))


def test_a_search_cut_short_still_bounds() -> None:
    problem = paper_problem("M300_10")
    exact = lower_bound(problem)
    previous = 0.0
    for steps in (0, 10, 100, 1000):
        cut = lower_bound(problem, max_expansions=steps)
        assert previous <= cut.time_s <= exact.time_s
        previous = cut.time_s
    assert exact.exact
    assert not lower_bound(problem, max_expansions=10).exact


def test_stations_out_of_reach_are_left_out() -> None:
    problem = paper_problem("M300_04")
    exact = lower_bound(problem)
    assert lower_bound(problem, upper_length_m=exact.length_m * 1.01).length_m == pytest.approx(
        exact.length_m, rel=1e-9
    )


BEST_KNOWN_S = {"M30_01": 181.16, "M30_05": 149.87, "M100_08": 436.39, "M300_01": 385.80, "M300_10": 869.66}


@given(st.integers(0, 10_000), st.floats(0.4, 1.0))
def test_what_a_large_map_leaves_out_does_not_matter(seed: int, spread: float) -> None:
    """Stations out of reach, and ways no shorter than others: the same length with all of them searched.

    Dense and sparse maps, some with a hole in the middle, ends anywhere: straight ways, detours, and none at all.
    """
    rng = np.random.default_rng(seed)
    centres = rng.uniform(0, 10_000.0, (90, 2))
    if seed % 2:
        centres = centres[np.linalg.norm(centres - 5_000.0, axis=1) > 3_000.0]
    stations = np.column_stack([centres, np.full(len(centres), 100.0), rng.uniform(600, 1600, len(centres)) * spread])
    ends = [[*centres[k], 100.0] for k in rng.integers(0, len(centres), 2)]
    problem = make_problem(ends[0], ends[1], stations)
    whole = NavigationMesh(problem.station_positions_m[:, :2], problem.ranges_m)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bound_module, "CROWD", 0)
        bound = lower_bound(problem)
        patch.setattr("planner.routing.navmesh._Search._beaten", lambda *_: False)
        expected = whole.shortest_path(tuple(problem.start_m[:2]), tuple(problem.destination_m[:2]))
    assert bound.exact == (expected is not None)
    if expected is not None:
        assert bound.length_m == pytest.approx(expected.length_m, rel=1e-8)
        assert bound.path_m is not None
        steps = np.linalg.norm(np.diff(bound.path_m, axis=0), axis=1)
        assert steps.sum() == pytest.approx(expected.length_m, rel=1e-8)


def test_a_detour_longer_than_guessed_is_found() -> None:
    """A horseshoe: the ends 2 km apart, the way round seven times that; what is near the straight line does not do."""
    angles = np.linspace(0.1, 2 * np.pi - 0.1, 40)
    stations = np.column_stack([3000 * np.cos(angles), 3000 * np.sin(angles), np.full(40, 100.0), np.full(40, 290.0)])
    problem = make_problem([*stations[0, :2], 100], [*stations[-1, :2], 100], stations)
    whole = lower_bound(problem)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bound_module, "CROWD", 0)
        assert lower_bound(problem).length_m == pytest.approx(whole.length_m, rel=1e-9)
    assert whole.exact
    assert 2 * np.pi * 2600 < whole.length_m < 2 * np.pi * 3000


@pytest.mark.parametrize("name", sorted(BEST_KNOWN_S))
def test_best_known_times_are_just_above(name: str) -> None:
    """Within 1.1 % of the best times any method has reached on these missions, and never above them."""
    time = lower_bound(paper_problem(name)).time_s
    assert time <= BEST_KNOWN_S[name] <= 1.011 * time


@given(st.integers(0, 10_000), st.integers(1, 9), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
def test_never_above_a_path_that_exists(seed: int, count: int, bend: float, lift: float) -> None:
    """A chain of overlaps on hills, a polyline inside it: no bound may exceed that polyline's length."""
    rng = np.random.default_rng(seed)
    stations, points = [], [np.array([0.0, 0.0, 150.0 + 40 * lift])]
    for _ in range(count):
        heading = rng.uniform(-1.5, 1.5) * bend
        step = rng.uniform(100, 1500) * np.array([np.cos(heading), np.sin(heading)])
        nxt = points[-1] + [*step, 0.0]
        nxt[2] = rng.uniform(100, 200)
        centre = np.array([*(0.5 * (points[-1] + nxt)[:2] + rng.uniform(-50, 50, 2)), rng.uniform(0, 400)])
        reach = max(np.linalg.norm(points[-1] - centre), np.linalg.norm(nxt - centre))
        stations.append([*centre, reach * rng.uniform(1.0, 1.3)])
        points.append(nxt)
    problem: Problem = make_problem(points[0], points[-1], stations, band=(100.0, 200.0))
    bound = lower_bound(problem)
    assert bound.exact
    assert bound.length_m <= sum(np.linalg.norm(b - a) for a, b in pairwise(points)) + 1e-6


def test_an_elevation_mask_narrows_the_disc() -> None:
    """At 45 degrees a station at altitude 0 hears 120 m around it at the top of the band, so two 200 m apart
    meet and the crossing at (100, 66) is a corner."""
    mask = np.array([45.0, 45.0])
    stations = [[0, 0, 0, 1000], [200, 0, 0, 1000]]
    problem = make_problem([0, 90, 120], [200, 90, 120], stations, min_elevation_deg=mask)
    corner = np.array([100.0, np.sqrt(120.0**2 - 100.0**2)])
    assert lower_bound(problem).length_m == pytest.approx(2 * np.hypot(100, 90 - corner[1]), rel=1e-6)
