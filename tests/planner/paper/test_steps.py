"""The paper's lower level step by step: P4, the initial trajectory, P5 and the binary search."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner import InfeasibleError, Limits, Problem, Trajectory, build_corridor, certify
from planner.corridor.chebyshev import find_refuges, slack_m
from planner.corridor.corridor import Corridor, Piece
from planner.corridor.limit_check import CorridorCheck, speed_ratio
from planner.corridor.polyline_program import polyline_length_m, settled, shortest_polyline
from planner.paper.alternating import AlternatingMinimisation
from planner.paper.boundary import CONTROL_FROM_BOUNDARY, control_points, rest_at, shortest_piece_s
from planner.paper.initial import initial_durations, leg_durations
from planner.paper.station_graph import shortest_sequence
from planner.paper.time_search import _keep_tenure, shortest_durations
from tests.support.planner_missions import HARD_SCENES, HARD_SEQUENCES, make_problem, paper_problem

# --- boundary conditions -----------------------------------------------------------------------------------------


def test_boundary_conditions_are_those_of_the_curve() -> None:
    rng = np.random.default_rng(2)
    boundary, durations = rng.normal(size=(4, 3, 3)), rng.uniform(0.5, 3.0, 3)
    points = control_points(boundary, durations)
    t = durations[:, None]
    np.testing.assert_allclose(points[:, 0], boundary[:-1, 0])
    np.testing.assert_allclose(points[:, 5], boundary[1:, 0])
    np.testing.assert_allclose(5 * (points[:, 1] - points[:, 0]) / t, boundary[:-1, 1])  # equation (9)
    np.testing.assert_allclose(5 * (points[:, 5] - points[:, 4]) / t, boundary[1:, 1])
    second = points[:, 2:] - 2 * points[:, 1:-1] + points[:, :-2]
    np.testing.assert_allclose(20 * second[:, 0] / t**2, boundary[:-1, 2], atol=1e-9)  # equation (11)
    np.testing.assert_allclose(20 * second[:, -1] / t**2, boundary[1:, 2], atol=1e-9)
    np.testing.assert_allclose(CONTROL_FROM_BOUNDARY[:, [0, 3]].sum(axis=1), 1.0)


# --- P4 ----------------------------------------------------------------------------------------------------------


def corridor_of(problem: Problem, **options: Any) -> Any:
    return build_corridor(problem, shortest_sequence(problem), **options)


def test_p4_on_a_straight_line(two_stations: Problem) -> None:
    waypoints = shortest_polyline(two_stations, corridor_of(two_stations))
    assert polyline_length_m(waypoints) == pytest.approx(1600.0, abs=1e-5)
    np.testing.assert_allclose(waypoints[[0, -1]], [two_stations.start_m, two_stations.destination_m])
    assert 600.0 < waypoints[1, 0] < 1000.0


def test_p4_turns_at_the_corner_of_a_lens() -> None:
    """Flying height is the antennas', so the discs are circles of 500 m; the way from A's west to B's west bends
    round the southern corner of their lens.

        A(0, 0), B(0, 800): the circles cross at (+-300, 400). Start (-400, 0), destination (-400, 800): straight up
        along x = -400 the corridor is left, so the path turns at (-300, 400).
    """
    problem = make_problem([-400, 0, 100], [-400, 800, 100], [[0, 0, 100, 500], [0, 800, 100, 500]])
    waypoints = shortest_polyline(problem, corridor_of(problem))
    np.testing.assert_allclose(waypoints[1, :2], [-300.0, 400.0], atol=0.01)
    assert polyline_length_m(waypoints) == pytest.approx(2 * np.hypot(100, 400), abs=0.01)


def test_p4_uses_the_whole_band_for_a_hill() -> None:
    # The hill and valley of the lens tests: they share a strip 2 m wide at 110 m.
    problem = make_problem([0, 0, 100], [78, 0, 120], [[0, 0, 80, 50], [78, 0, 140, 50]])
    waypoints = shortest_polyline(problem, corridor_of(problem))
    assert abs(waypoints[1, 2] - 110.0) < 5.0
    assert slack_m(problem, (0, 1), waypoints[1]) >= 0.0


@pytest.mark.parametrize("name", HARD_SCENES)
@pytest.mark.parametrize("overlap_s", [0.0, 4.0])
def test_p4_keeps_every_constraint_exactly(name: str, overlap_s: float) -> None:
    problem = replace(HARD_SCENES[name], min_overlap_s=overlap_s)
    corridor = build_corridor(problem, HARD_SEQUENCES.get(name) or shortest_sequence(problem))
    waypoints = shortest_polyline(problem, corridor)
    assert waypoints.shape == (len(corridor) + 1, 3)
    for k in range(1, len(corridor)):
        assert slack_m(problem, corridor.joint_balls(k), waypoints[k]) >= 0.0
        assert problem.limits.min_alt_m <= waypoints[k, 2] <= problem.limits.max_alt_m
    straight = float(np.linalg.norm(problem.destination_m - problem.start_m))
    assert straight - 1e-6 <= polyline_length_m(waypoints) <= straight + 10.0


@pytest.mark.parametrize("angle_deg", [45.0, 60.0])
def test_p4_turns_at_the_corner_of_two_elevation_cones(angle_deg: float) -> None:
    """At the one altitude of 100 m a cone of 45 degrees is a disc of 100 m, one of 60 degrees a disc of 57.7 m.

    The discs are 1.8 radii apart and cross at (0.9 r, +-0.436 r); the straight way at 0.7 r lies above that.
    """
    r = 100.0 / np.tan(np.radians(angle_deg))
    problem = make_problem(
        [-0.6 * r, 0.7 * r, 100],
        [2.4 * r, 0.7 * r, 100],
        [[0, 0, 0, 600], [1.8 * r, 0, 0, 600]],
        band=(100.0, 100.0),
        min_elevation_deg=np.full(2, angle_deg),
    )
    waypoints = shortest_polyline(problem, corridor_of(problem))
    np.testing.assert_allclose(waypoints[1], [0.9 * r, np.sqrt(0.19) * r, 100.0], atol=0.02)
    # With room above, the cones are wider there and the way goes over the top: 100 r / 100 m at 160 m is straight.
    high = replace(problem, limits=replace(problem.limits, max_alt_m=160.0))
    over = shortest_polyline(high, corridor_of(high))
    assert polyline_length_m(over) < polyline_length_m(waypoints) - 1.0
    assert over[1, 2] > 105.0
    assert slack_m(high, (0, 1), over[1]) >= 0.0


def test_an_elevation_of_zero_is_the_antennas_horizon() -> None:
    # The second antenna is at 115 m of a band from 100 to 120 m: the way must be that high at the handover, no higher.
    problem = make_problem(
        [0, 0, 100], [900, 0, 116], [[0, 0, 0, 600], [900, 0, 115, 600]], min_elevation_deg=np.array([-90.0, 0.0])
    )
    waypoints = shortest_polyline(problem, corridor_of(problem))
    assert waypoints[1, 2] == pytest.approx(115.0, abs=0.01)
    assert waypoints[1, 2] >= 115.0


def test_a_joint_just_outside_is_drawn_in_no_farther_than_needed(two_stations: Problem) -> None:
    corridor = corridor_of(two_stations)
    refuges = find_refuges(two_stations, corridor)
    radius = np.sqrt(1000.0**2 - 100.0**2)
    for outside_m in (1e-9, 1e-5, 0.1):
        joint = np.array([[radius + outside_m, 0.0, 100.0 - outside_m]])
        settled_joint = settled(two_stations, corridor, refuges, joint)[1]
        assert slack_m(two_stations, (0, 1), settled_joint) >= 0.0
        assert settled_joint[2] >= 100.0
        assert np.linalg.norm(settled_joint - joint[0]) < 10.0 * outside_m + 1e-5
    inside = np.array([[800.0, 5.0, 103.0]])
    np.testing.assert_array_equal(settled(two_stations, corridor, refuges, inside)[1], inside[0])


def test_refuges_are_inside_everything() -> None:
    problem = paper_problem("M100_04", min_overlap_s=5.0)
    corridor = corridor_of(problem)
    refuges = find_refuges(problem, corridor)
    for k in range(len(corridor) - 1):
        assert slack_m(problem, corridor.joint_balls(k + 1), refuges.points_m[k]) == pytest.approx(refuges.slack_m[k])
        assert refuges.slack_m[k] > 0.0
        assert 100.0 < refuges.points_m[k, 2] < 120.0


def test_three_balls_at_a_joint() -> None:
    """Three ranges that meet in the middle only: their deepest point is found, and missed when they do not meet."""
    side = 1000.0
    rows = [[0, 0, 110, 590], [side, 0, 110, 590], [side / 2, side * np.sqrt(3) / 2, 110, 590]]
    problem = make_problem([0, 0, 110], [side, 0, 110], rows)
    corridor = Corridor((0, 1), (Piece(0, 0, (0,)), Piece(0, 0, (0, 2)), Piece(1, 1, (1, 0)), Piece(1, 1, (1,))), 0.0)
    assert corridor.joint_balls(2) == (0, 2, 1)
    refuges = find_refuges(problem, corridor)
    np.testing.assert_allclose(refuges.points_m[1], [500.0, side * np.sqrt(3) / 6, 110.0], atol=0.5)
    waypoints = shortest_polyline(problem, corridor)
    assert slack_m(problem, (0, 1, 2), waypoints[2]) >= 0.0
    # From antennas far above the band the most range is left at its top, where less is left the wider the triangle.
    raised = make_problem([0, 0, 110], [side, 0, 110], np.array(rows) + np.array([0, 0, 190, 60]))
    assert find_refuges(raised, corridor).points_m[1, 2] == pytest.approx(120.0, abs=6.0)
    apart = make_problem([0, 0, 110], [side, 0, 110], np.array(rows) - np.array([0, 0, 0, 15.0]))
    with pytest.raises(InfeasibleError, match="no point in common"):
        find_refuges(apart, corridor)


# --- the initial trajectory ----------------------------------------------------------------------------------------


def test_initial_durations_by_hand(two_stations: Problem) -> None:
    # 800 m a piece: 5 * 800 / 50 = 80 s for the speed, sqrt(20 * 800 / 5) = 56.6 s for the acceleration.
    waypoints = np.array([[0, 0, 100], [800, 0, 100], [1600, 0, 100.0]])
    np.testing.assert_allclose(initial_durations(two_stations, corridor_of(two_stations), waypoints), [80.0, 80.0])
    # 100 m: 10 s for the speed, sqrt(20 * 100 / 5) = 20 s for the acceleration.
    short = np.array([[0, 0, 100], [100, 0, 100], [900, 0, 100.0]])
    np.testing.assert_allclose(initial_durations(two_stations, corridor_of(two_stations), short), [20.0, 80.0])


@pytest.mark.parametrize(
    ("limits", "expected_s"),
    [
        ({"max_jerk_m_s3": 0.1}, np.cbrt(120 * 100 / 0.1)),
        ({"max_climb_m_s": 0.5}, 5 * 12 / 0.5),
        ({"max_descent_m_s": 0.5}, 20.0),
        # Head wind of 5 m/s and an airspeed of 8: 3 m/s over ground, and 5 * 100 / 3 s.
        ({"max_airspeed_m_s": 8.0, "wind_m_s": (-5.0, 0.0)}, 5 * np.hypot(100, 0) / 3.0),
    ],
)
def test_initial_durations_keep_the_optional_limits(limits: dict[str, Any], expected_s: float) -> None:
    rise = 12.0 if "max_climb_m_s" in limits or "max_descent_m_s" in limits else 0.0
    length = float(np.sqrt(100.0**2 - rise**2))
    problem = make_problem([0, 0, 100], [length, 0, 100 + rise], [[0, 0, 0, 600]], limits=limits)
    corridor = build_corridor(problem, [0])
    waypoints = np.vstack([problem.start_m, problem.destination_m])
    durations = initial_durations(problem, corridor, waypoints)
    assert durations[0] == pytest.approx(expected_s)
    assert (
        CorridorCheck(problem, corridor).slowdown(control_points(rest_at(waypoints), durations), durations) <= 1 + 1e-12
    )


def test_initial_durations_hover_and_stay_for_the_tenure() -> None:
    problem = make_problem(
        [0, 0, 100], [10, 0, 100], [[0, 0, 0, 600], [10, 0, 0, 600]], min_overlap_s=6.0, min_tenure_s=100.0
    )
    corridor = build_corridor(problem, [0, 1])
    waypoints = np.array([[0, 0, 100], [5, 0, 100], [5, 0, 100], [5, 0, 100], [10, 0, 100.0]])
    durations = initial_durations(problem, corridor, waypoints)
    assert (durations[1:3] >= 3.0).all()
    np.testing.assert_allclose(leg_durations(corridor, durations), [100.0, 100.0])
    # Without tenure, sqrt(20 * 5 / 5) = 4.47 s to move and 3 s to hover.
    free = make_problem([0, 0, 100], [10, 0, 100], [[0, 0, 0, 600], [10, 0, 0, 600]], min_overlap_s=6.0)
    np.testing.assert_allclose(
        initial_durations(free, corridor_of_pair(free), waypoints), [np.sqrt(20), 3, 3, np.sqrt(20)]
    )


def corridor_of_pair(problem: Problem) -> Any:
    return build_corridor(problem, [0, 1])


def test_no_piece_is_too_short_for_its_coordinates() -> None:
    near = make_problem([0, 0, 100], [0, 0, 100], [[0, 0, 0, 600]])
    far = make_problem([3e5, 0, 100], [3e5, 0, 100], [[3e5, 0, 0, 600]])
    assert 0.0 < shortest_piece_s(near) < shortest_piece_s(far) < 1.0
    corridor = build_corridor(far, [0])
    durations = initial_durations(far, corridor, np.vstack([far.start_m, far.destination_m]))
    assert durations.tolist() == [shortest_piece_s(far)]


# --- ratios --------------------------------------------------------------------------------------------------------


@given(st.tuples(*[st.floats(-30, 30)] * 3), st.tuples(*[st.floats(-10, 10)] * 2), st.floats(0.1, 10.0), st.booleans())
@settings(deadline=None)
def test_speed_ratio_is_one_exactly_at_the_limit(
    velocity: tuple[float, ...], wind: tuple[float, ...], slower: float, vertical: bool
) -> None:
    extra = {"max_climb_m_s": 4.0, "max_descent_m_s": 3.0} if vertical else {}
    limits = Limits(0.0, 1.0, 40.0, 1.0, max_airspeed_m_s=20.0, wind_m_s=(wind[0], wind[1]), **extra)
    v = np.array(velocity)
    ratio = float(speed_ratio(limits, v))
    assert float(speed_ratio(limits, v / slower)) == pytest.approx(ratio / slower, rel=1e-6, abs=1e-12)
    if ratio < 1e-6:
        return
    at_limit = v / ratio
    air = float(np.linalg.norm(at_limit - [*wind, 0.0]))
    tight = [np.linalg.norm(at_limit) / 40.0, air / 20.0]
    if vertical:
        tight += [at_limit[2] / 4.0, -at_limit[2] / 3.0]
    assert max(tight) == pytest.approx(1.0, abs=1e-6)


def test_no_speed_is_slow_enough_when_the_wind_is_too_strong() -> None:
    limits = Limits(0.0, 1.0, 40.0, 1.0, max_airspeed_m_s=10.0, wind_m_s=(10.0, 0.0))
    assert float(speed_ratio(limits, np.array([1.0, 0, 0]))) == np.inf


@given(st.integers(0, 100_000))
@settings(deadline=None, max_examples=40)
def test_the_check_measures_what_the_certificate_does(seed: int) -> None:
    rng = np.random.default_rng(seed)
    limits = {"max_jerk_m_s3": 2.0, "max_climb_m_s": 3.0, "max_descent_m_s": 2.0}
    rows = np.column_stack([rng.uniform(-300, 300, (3, 2)), rng.uniform(0, 110, 3), rng.uniform(200, 500, 3)])
    problem = make_problem(
        [0, 0, 100], [0, 0, 100], rows, limits=limits, min_elevation_deg=rng.choice([-90.0, 0.0, 20.0], 3)
    )
    corridor = build_corridor(problem, [0, 1, 2])
    points, durations = rng.uniform([-400, -400, 90], [400, 400, 130], (3, 6, 3)), rng.uniform(5, 60, 3)
    worst = certify(problem, Trajectory(points, durations, np.arange(3))).worst
    check = CorridorCheck(problem, corridor)
    places = [worst["range_m"], worst["altitude_m"], worst["elevation_m"]]
    assert check.place_excess_m(points).max() == pytest.approx(max(places), abs=1e-9)
    speed, accel, jerk = check.ratios(points, durations).max(axis=1)
    named = [(worst["speed_m_s"], 50.0), (worst["climb_m_s"], 3.0), (worst["descent_m_s"], 2.0)]
    assert speed == pytest.approx(max(excess / limit + 1.0 for excess, limit in named))
    assert accel == pytest.approx(worst["accel_m_s2"] / 5.0 + 1.0)
    assert jerk == pytest.approx(worst["jerk_m_s3"] / 2.0 + 1.0)
    # Slowed by the largest slowdown, the fastest piece is exactly at a limit.
    slower = durations * check.slowdown(points, durations).max()
    assert check.ratios(points, slower).max() == pytest.approx(1.0)


# --- P5 and the binary search -----------------------------------------------------------------------------------------


def single(length_m: float, **options: Any) -> AlternatingMinimisation:
    problem = make_problem([0, 0, 100], [length_m, 0, 100], [[0, 0, 0, 2000]], **options)
    return AlternatingMinimisation(problem, build_corridor(problem, [0]))


def test_binary_search_finds_the_rest_to_rest_time() -> None:
    # As by hand above: 100 m takes 20 s, from wherever the search starts.
    method = single(100.0)
    for start_s in (21.0, 100.0, 3000.0):
        found = shortest_durations(
            method.check, method.corridor, method.boundary, np.array([start_s]), method.minima_s, tolerance_s=1e-6
        )
        assert found[0] == pytest.approx(20.0, abs=1e-6)
        assert found[0] >= 20.0 - 1e-12


def test_binary_search_stops_at_the_minimum_and_the_tenure() -> None:
    problem = make_problem(
        [0, 0, 100], [900, 0, 100], [[0, 0, 0, 600], [900, 0, 0, 600]], min_overlap_s=8.0, min_tenure_s=70.0
    )
    method = AlternatingMinimisation(problem, build_corridor(problem, [0, 1]))
    long = 3.0 * method.durations_s
    found = shortest_durations(method.check, method.corridor, method.boundary, long, method.minima_s)
    assert (found[1:3] >= 4.0).all()
    assert (leg_durations(method.corridor, found) >= 70.0).all()
    assert leg_durations(method.corridor, found) == pytest.approx([70.0, 70.0], abs=1e-4)
    assert method.check.holds(control_points(method.boundary, found), found).all()


class Thresholds:
    """Stands in for the constraints: piece k holds from ``least_s[k]`` up."""

    def __init__(self, least_s: list[float]) -> None:
        self.least_s = np.array(least_s)

    def holds(self, points: np.ndarray, durations_s: np.ndarray) -> np.ndarray:
        return np.asarray(durations_s >= self.least_s)


def search(least_s: list[float], before_s: list[float], min_leg_s: float = 0.0, legs: str = "001") -> np.ndarray:
    """The binary search over pieces whose legs are given by digits, 1 s at least each."""
    pieces = tuple(Piece(0, int(leg), (0,)) for leg in legs)
    return shortest_durations(
        Thresholds(least_s),  # type: ignore[arg-type]
        Corridor((0, 1), pieces, min_leg_s),
        np.zeros((len(pieces) + 1, 3, 3)),
        np.array(before_s),
        np.ones(len(pieces)),
    )


def test_every_piece_is_searched_to_the_tolerance() -> None:
    np.testing.assert_allclose(search([2.0, 777.0, 0.1], [2.1, 900.0, 5e4]), [2.0, 777.0, 1.0], atol=2e-6)


def test_a_leg_short_of_its_tenure_keeps_what_it_takes_and_the_other_does_not() -> None:
    # Leg 0 would take 2 + 3 s and must take 12; it had 10 + 10, so 7 of the 15 s gained are given back to it.
    found = search([2.0, 3.0, 30.0], [10.0, 10.0, 60.0], min_leg_s=12.0)
    np.testing.assert_allclose(found, [2 + 8 * 7 / 15, 3 + 7 * 7 / 15, 30.0], atol=1e-5)
    assert found[:2].sum() >= 12.0
    # At its present durations it has just the tenure: nothing is gained.
    np.testing.assert_allclose(search([2.0, 3.0, 30.0], [6.0, 6.0, 60.0], min_leg_s=12.0)[:2], [6.0, 6.0], atol=1e-5)


def test_what_is_given_back_is_feasible_again() -> None:
    class Island(Thresholds):
        """Piece 0 holds at 2 s and from 8 s up, and not between."""

        def holds(self, points: np.ndarray, durations_s: np.ndarray) -> np.ndarray:
            held = durations_s >= self.least_s
            held[0] = durations_s[0] >= 8.0
            return np.asarray(held)

    check = Island([2.0, 3.0])
    found = _keep_tenure(
        check,  # type: ignore[arg-type]
        Corridor((0, 1), (Piece(0, 0, (0,)), Piece(1, 1, (1,))), 5.0),
        np.zeros((3, 3, 3)),
        np.array([10.0, 20.0]),
        np.array([2.0, 9.0]),
    )
    np.testing.assert_allclose(found, [8.0, 9.0], atol=1e-4)
    assert found[0] >= 8.0


def test_binary_search_never_lengthens_and_keeps_the_feasible_end() -> None:
    method = AlternatingMinimisation(paper_problem("M30_05"), corridor_of(paper_problem("M30_05")))
    for _ in range(4):
        before = method.durations_s
        method.step()
        assert (method.durations_s <= before).all()
        assert method.check.holds(control_points(method.boundary, method.durations_s), method.durations_s).all()


def test_p5_flattens_the_initial_trajectory_by_hand(two_stations: Problem) -> None:
    """1,600 m in 160 s on a straight line: the least largest velocity control point is between the mean speed of
    10 m/s and the 50 m/s of stopping half way, and the same whichever way it is flown.
    """
    method = AlternatingMinimisation(two_stations, corridor_of(two_stations))
    np.testing.assert_allclose(method.durations_s.sum(), 160.0, rtol=1e-3)
    boundary = method.program.solve(method.durations_s)
    speed, accel, _ = method.check.ratios(control_points(boundary, method.durations_s), method.durations_s).max(axis=1)
    assert 10.0 / 50.0 < speed < 0.5
    assert max(speed, accel) < 0.4
    assert np.abs(boundary[:, :, 1]).max() < 1e-6  # nothing to gain sideways
    assert method.check.place_excess_m(control_points(boundary, method.durations_s)).max() <= 0.0


@pytest.mark.parametrize("name", ["elevation", "tangent", "a millimetre of band", "one inside the other"])
def test_p5_answers_inside_the_ranges_by_itself(name: str) -> None:
    """Before anything is repaired: within the solver's tolerance of balls, band and elevation cones."""
    problem = replace(HARD_SCENES[name], min_overlap_s=4.0)
    corridor = build_corridor(problem, HARD_SEQUENCES.get(name) or shortest_sequence(problem))
    method = AlternatingMinimisation(problem, corridor)
    boundary = method.program.solve(method.durations_s)
    points = control_points(boundary, method.durations_s)
    assert method.check.place_excess_m(points).max() <= 1e-5
    before = method.check.ratios(control_points(method.boundary, method.durations_s), method.durations_s).max()
    assert method.check.ratios(points, method.durations_s).max() < before


def test_p5_is_a_minimum() -> None:
    """Random feasible displacements of the joints only make the worst ratio worse."""
    problem = paper_problem("M30_04")
    method = AlternatingMinimisation(problem, corridor_of(problem))
    t = method.durations_s
    best = method.program.solve(t)
    least = method.check.ratios(control_points(best, t), t).max()
    rng = np.random.default_rng(0)
    for size in (1e-2, 1.0, 30.0):
        for _ in range(20):
            other = best.copy()
            other[1:-1] += size * rng.normal(size=other[1:-1].shape) * np.array([1.0, 0.05, 0.005])[:, None]
            points = control_points(other, t)
            if method.check.place_excess_m(points).max() <= 0.0:
                assert method.check.ratios(points, t).max() >= least - 1e-6


def test_p5_in_place_update_equals_a_fresh_program() -> None:
    problem = paper_problem("M100_05")
    first, second = (AlternatingMinimisation(problem, corridor_of(problem)) for _ in range(2))
    t = first.durations_s
    rng = np.random.default_rng(1)
    for _ in range(3):
        first.program.solve(t * rng.uniform(0.7, 1.3, len(t)))
    again, fresh = first.program.solve(0.8 * t), second.program.solve(0.8 * t)
    ratios = [
        method.ratios(control_points(b, t), t).max() for method, b in ((first.check, again), (second.check, fresh))
    ]
    assert ratios[0] == pytest.approx(ratios[1], rel=1e-6)


@pytest.mark.parametrize(
    ("limits", "row"),
    [
        ({"max_jerk_m_s3": 0.05}, 2),
        ({"max_climb_m_s": 0.1}, 0),
        ({"max_airspeed_m_s": 40.0, "wind_m_s": (9.0, 9.0)}, 0),
    ],
)
def test_p5_counts_the_optional_limits(limits: dict[str, Any], row: int) -> None:
    """A limit that binds lowers its own ratio at the expense of the others."""
    free, bound = paper_problem("M30_04"), paper_problem("M30_04", limits=limits)
    corridor = corridor_of(free)
    ratios = []
    durations = AlternatingMinimisation(free, corridor).durations_s
    check = CorridorCheck(bound, corridor)
    for problem in (free, bound):
        boundary = AlternatingMinimisation(problem, corridor).program.solve(durations)
        ratios.append(check.ratios(control_points(boundary, durations), durations).max(axis=1))
    assert ratios[1].max() < ratios[0].max() - 1e-3
    assert ratios[1][row] < ratios[0][row]
