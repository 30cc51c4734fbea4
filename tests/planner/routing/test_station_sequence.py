"""Routing: sequences that hold the shortest path, prices of handovers, limits on them, and large maps."""

from __future__ import annotations

import time
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planner import InfeasibleError, Problem, build_corridor
from planner.corridor.handover_polyline import polyline_along
from planner.corridor.polyline_program import polyline_length_m, shortest_polyline
from planner.infeasibility.diagnosis import diagnose
from planner.remedy import RaiseLimit
from planner.routing import station_sequence
from planner.routing.bound import lower_bound
from planner.routing.portal_graph import PortalGraph
from planner.routing.station_sequence import candidate_routes, geodesic_sequence, is_chain
from tests.support.missions.problems import make_problem, paper_problem


def random_problem(seed: int, count: int, side_m: float, **options: float) -> Problem:
    """A random map with ranges 500 to 1500 m and ends near two stations."""
    rng = np.random.default_rng(seed)
    stations = np.column_stack([rng.uniform(0, side_m, (count, 2)), np.zeros(count), rng.uniform(500, 1500, count)])
    first, last = np.argmin(stations[:, :2].sum(axis=1)), np.argmax(stations[:, :2].sum(axis=1))
    return make_problem([*stations[first, :2], 110.0], [*stations[last, :2], 105.0], stations, **options)


def feasible_maps(count: int, side_m: float, wanted: int, **options: float) -> list[Problem]:
    found: list[Problem] = []
    seed = 0
    while len(found) < wanted:
        problem = random_problem(seed, count, side_m, **options)
        if diagnose(problem) is None:
            found.append(problem)
        seed += 1
    return found


def tight_length_m(problem: Problem, sequence: tuple[int, ...]) -> float:
    return polyline_length_m(shortest_polyline(problem, build_corridor(problem, sequence)))


def test_shortest_polyline_of_the_geodesic_sequence_is_the_bound(mission_name: str) -> None:
    """P4 on the extracted sequence is within 1e-4 of the bound on every mission: the sequence is exact."""
    problem = paper_problem(mission_name)
    bound = lower_bound(problem)
    assert bound.path_m is not None
    sequence = geodesic_sequence(problem, bound.path_m)
    assert sequence is not None
    assert is_chain(problem, sequence)
    assert bound.length_m <= tight_length_m(problem, sequence) <= bound.length_m * (1.0 + 1e-4)


@pytest.mark.slow
def test_routes_of_random_maps_of_300() -> None:
    """Geodesic sequence within 1e-4 of the bound, portal graph within 0.1 % on average and 0.3 % at worst."""
    geodesic, portal = [], []
    for problem in feasible_maps(300, 24_000.0, 8):
        bound = lower_bound(problem)
        assert bound.path_m is not None
        sequence = geodesic_sequence(problem, bound.path_m)
        assert sequence is not None
        geodesic.append(tight_length_m(problem, sequence) / bound.length_m - 1.0)
        portal.append(tight_length_m(problem, PortalGraph(problem).routes(1)[0].sequence) / bound.length_m - 1.0)
    assert max(geodesic) < 1e-4
    assert np.mean(portal) < 1e-3
    assert max(portal) < 3e-3


def test_the_fewest_stations_that_cover_the_path() -> None:
    """Of three ranges along a line, the outer two meet: the middle one is not needed.

    A (0) ---- B (800) ---- C (1600), range 1000 each: A and C overlap from 600 to 1000. The ends are out of B's range.
    """
    stations = [[0, 0, 0, 1000], [800, 0, 0, 950], [1600, 0, 0, 1000]]
    problem = make_problem([-200, 0, 100], [1800, 0, 100], stations)
    assert candidate_routes(problem)[0].sequence == (0, 2)


def test_one_station_that_holds_both_ends_is_enough() -> None:
    stations = [[0, 0, 0, 1000], [300, 0, 0, 2000], [800, 0, 0, 1000]]
    problem = make_problem([0, 0, 100], [800, 0, 100], stations)
    routes = candidate_routes(problem, 3)
    assert routes[0].sequence == (1,)


def test_a_start_held_only_high_up_begins_with_the_station_that_holds_it() -> None:
    """At 120 m the start is outside A's ball, though inside its disc at 100 m; B holds it there."""
    stations = [[0, 0, 0, 1000], [-900, 0, 0, 1000]]
    edge = float(np.sqrt(1000.0**2 - 110.0**2))
    # B does not reach the destination, so the flight starts with B and ends with A.
    problem = make_problem([-edge, 0, 120], [900, 0, 100], stations)
    assert candidate_routes(problem)[0].sequence == (1, 0)


def test_hills_meet_where_a_plane_would_not_see_it() -> None:
    """Antennas at 400 m: on the plane z = 100 the discs of radius 400 are 150 m apart; at 400 m they meet."""
    stations = [[0, 0, 400, 500], [950, 0, 400, 500]]
    problem = make_problem([0, 0, 350], [950, 0, 350], stations, band=(100.0, 500.0))
    assert candidate_routes(problem)[0].sequence == (0, 1)


def test_a_costly_handover_is_flown_around() -> None:
    """Two ways: through an overlap 2 m deep, straight on, or over a third station a little aside.

        A (0, 0) R 1000 ........ B (1988, 0) R 1000     discs of 995 m at 100 m: an overlap 2 m deep at x = 994
                    C (994, -920) R 900                 wide overlaps with both

    Free handovers: A, B. With 5 s of overlap a stop costs more than the detour: A, C, B.
    """
    stations = [[0, 0, 0, 1000], [1988, 0, 0, 1000], [994, -920, 0, 900]]
    free = make_problem([0, 200, 100], [1988, 200, 100], stations)
    assert candidate_routes(free)[0].sequence == (0, 1)
    priced = replace(free, min_overlap_s=5.0)
    assert candidate_routes(priced)[0].sequence == (0, 2, 1)


def test_tenure_prices_short_legs() -> None:
    """A short stay with C costs tenure; A and B meet directly a little aside, which is then better.

    Without tenure the straight line through C's small range is shortest.
    """
    stations = [[0, 0, 0, 1000], [1900, 0, 0, 1000], [950, 330, 0, 150]]
    problem = make_problem([0, 330, 100], [1900, 330, 100], stations)
    assert candidate_routes(problem)[0].sequence == (0, 2, 1)
    assert candidate_routes(replace(problem, min_tenure_s=10.0))[0].sequence == (0, 1)


def test_several_routes_are_different_chains_in_order() -> None:
    problem = paper_problem("M100_06", margin_m=25.0, min_overlap_s=5.0, min_tenure_s=10.0)
    routes = candidate_routes(problem, 6)
    assert len({route.sequence for route in routes}) == 6
    assert all(is_chain(problem, route.sequence) for route in routes)
    assert [r.estimate_s for r in routes] == sorted(r.estimate_s for r in routes)


@pytest.mark.parametrize("name", ["M30_01", "M30_10", "M100_08", "M300_04"])
def test_fewer_handovers_when_limited(name: str) -> None:
    """Down to the fewest there are; one less is infeasible, and says which number would do."""
    problem = paper_problem(name)
    handovers = len(candidate_routes(problem)[0].sequence) - 1
    for limit in range(handovers - 1, 0, -1):
        limited = replace(problem, max_handovers=limit)
        if diagnose(limited) is not None:
            break
        sequence = candidate_routes(limited)[0].sequence
        assert len(sequence) - 1 <= limit
        assert is_chain(limited, sequence)
    with pytest.raises(InfeasibleError) as raised:
        candidate_routes(limited)
    assert raised.value.infeasibility.reason == "limits"
    assert raised.value.infeasibility.remedies == ((RaiseLimit("max_handovers", limit + 1),),)


def test_portal_routes_keep_the_limit_exactly() -> None:
    problem = paper_problem("M100_08", min_overlap_s=5.0)
    free = candidate_routes(problem)[0]
    limited = candidate_routes(replace(problem, max_handovers=len(free.sequence) - 2))[0]
    assert len(limited.sequence) < len(free.sequence)
    assert limited.estimate_s >= free.estimate_s


@given(st.integers(0, 10_000))
def test_polylines_stay_in_their_ranges(seed: int) -> None:
    """Every handover lies in both ranges and the band, on hills too; the direct one is not longer than others."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 7))
    stations = []
    at = np.zeros(2)
    for _ in range(count):
        stations.append([*at, rng.uniform(0, 400), rng.uniform(700, 1200)])
        angle = rng.uniform(-1.2, 1.2)
        at = at + rng.uniform(300, 1000) * np.array([np.cos(angle), np.sin(angle)])
    problem = make_problem([*stations[0][:2], 150], [*stations[-1][:2], 150], stations, band=(100.0, 200.0))
    sequence = tuple(range(count))
    if not is_chain(problem, sequence):
        return
    straight, _ = polyline_along(problem, sequence)
    middle, _ = polyline_along(problem, sequence, inwards=1.0)
    for polyline in (straight, middle):
        for point, (a, b) in zip(polyline[1:-1], pairwise(sequence), strict=True):
            for station in (a, b):
                away = np.linalg.norm(point - problem.station_positions_m[station])
                assert away <= problem.ranges_m[station] * (1 + 1e-9)
            assert 100.0 - 1e-9 <= point[2] <= 200.0 + 1e-9
    assert polyline_length_m(straight) <= polyline_length_m(middle) * (1 + 1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("overlap_s", [0.0, 5.0])
def test_ten_thousand_stations(overlap_s: float) -> None:
    """A map of 10,000 is routed, and without handover costs exactly."""
    problem = random_problem(7, 10_000, 125_000.0, min_overlap_s=overlap_s)
    bound = lower_bound(problem)
    route = candidate_routes(problem, bound=bound)[0]
    assert bound.exact
    assert is_chain(problem, route.sequence)
    if overlap_s == 0.0:
        straight, _ = polyline_along(problem, route.sequence)
        assert polyline_length_m(straight) <= bound.length_m * (1.0 + 1e-3)
    else:
        assert route.estimate_s >= bound.time_s - 10.0


@pytest.mark.slow
def test_chords_off_any_good_route_do_without_portals(monkeypatch: pytest.MonkeyPatch) -> None:
    """Which changes no more than the last digits of what the best route is expected to take."""
    problem = random_problem(7, 3_000, 68_000.0, min_overlap_s=5.0)
    routes = candidate_routes(problem, 3)
    monkeypatch.setattr(station_sequence, "_pairs_worth_all_portals", lambda _, pairs: pairs)
    expected = candidate_routes(problem, 3)
    assert [route.estimate_s for route in routes] == pytest.approx([r.estimate_s for r in expected], rel=1e-3)
    assert all(is_chain(problem, route.sequence) for route in routes)


@pytest.mark.soak
@pytest.mark.parametrize("count", [10_000, 100_000])
@pytest.mark.parametrize("overlap_s", [0.0, 5.0])
def test_routing_at_scale(count: int, overlap_s: float) -> None:
    """Figures for docs/planner.md, as seconds of processor time; maps of the same density as that of 10,000 above."""
    problem = random_problem(7, count, 125_000.0 * np.sqrt(count / 10_000), min_overlap_s=overlap_s)
    began = time.process_time()
    bound = lower_bound(problem)
    bounded = time.process_time()
    routes = candidate_routes(problem, 9 if overlap_s else 1, bound=bound)
    routed = time.process_time()
    length = polyline_length_m(polyline_along(problem, routes[0].sequence)[0])
    times = f"bound {bounded - began:.2f} s, {len(routes)} routes {routed - bounded:.2f} s"
    print(f"{count} stations, overlap {overlap_s:g} s: {times}")
    assert is_chain(problem, routes[0].sequence)
    assert bound.length_m * (1.0 - 1e-9) <= length <= bound.length_m * (1.001 if overlap_s == 0.0 else 1.1)


def test_routing_does_not_depend_on_the_order_of_stations() -> None:
    problem = paper_problem("M100_03")
    order = np.random.default_rng(3).permutation(problem.station_count)
    shuffled = replace(
        problem, station_positions_m=problem.station_positions_m[order], ranges_m=problem.ranges_m[order]
    )
    expected = candidate_routes(problem)[0].sequence
    assert tuple(int(order[k]) for k in candidate_routes(shuffled)[0].sequence) == expected
