"""A certificate holds for a good trajectory and names the broken constraint of every bad one.

The good one is flown by hand: rest to rest on straight lines, each 400 m in 40 s (50 m/s and 5 m/s^2 at most in the
control points), hovering where it hands over.

     A(0, 0)               B(800, 0)           ranges 600 m, antennas on the ground, band 100 .. 120 m
     start (0, 0, 110) ─► (400, 0, 110) hover ─► (800, 0, 110)
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from planner import Problem, ProblemError, Trajectory, build_corridor, certify
from tests.support.missions.problems import make_problem

MEETING = [400.0, 0.0, 110.0]


def scene(**options: Any) -> Problem:
    return make_problem([0, 0, 110], [800, 0, 110], [[0, 0, 0, 600], [800, 0, 0, 600]], **options)


def flight(hover_s: float = 6.0, half_s: float = 40.0) -> Trajectory:
    """To the meeting point, two hovers around the handover, and on to the destination."""
    stops = np.array([[0, 0, 110.0], MEETING, MEETING, MEETING, [800, 0, 110.0]])
    points = np.stack([np.repeat([a, b], 3, axis=0) for a, b in pairwise(stops)])
    half_hover = 0.5 * hover_s
    return Trajectory(points, np.array([half_s, half_hover, half_hover, half_s]), np.array([0, 0, 1, 1]))


def moved(trajectory: Trajectory, segment: int, index: int, by: list[float]) -> Trajectory:
    points = trajectory.control_points_m.copy()
    points[segment, index] += by
    return Trajectory(points, trajectory.durations_s, trajectory.station_index)


def positive(problem: Problem, trajectory: Trajectory) -> set[str]:
    certificate = certify(problem, trajectory)
    broken = {name for name, value in certificate.worst.items() if value > (1e-9 if name == "continuity" else 0.0)}
    assert certificate.feasible is (not broken)
    return broken


ALL_LIMITS = {
    "max_jerk_m_s3": 1.0,
    "max_climb_m_s": 3.0,
    "max_descent_m_s": 2.0,
    "max_airspeed_m_s": 56.0,
    "wind_m_s": (-5.0, 0.0),
    "max_duration_s": 90.0,
}


def everything(**options: Any) -> Problem:
    """Every optional limit and option, kept by the good flight."""
    chosen = {"limits": ALL_LIMITS, "min_overlap_s": 6.0, "min_tenure_s": 40.0, "max_handovers": 1}
    return scene(**(chosen | {"min_elevation_deg": np.array([10.0, 10.0])} | options))


def test_the_good_flight_by_hand() -> None:
    certificate = certify(everything(), flight())
    assert certificate.feasible
    worst = certificate.worst
    # The farthest control points: 400 m out and 110 m up.
    assert worst["range_m"] == pytest.approx(np.hypot(400, 110) - 600)
    assert worst["altitude_m"] == -10.0
    assert worst["speed_m_s"] == pytest.approx(0.0, abs=1e-12)
    assert worst["accel_m_s2"] == pytest.approx(20 * 400 / 40**2 - 5)
    assert worst["jerk_m_s3"] == pytest.approx(120 * 400 / 40**3 - 1)
    assert worst["climb_m_s"] == -3.0
    assert worst["descent_m_s"] == -2.0
    assert worst["airspeed_m_s"] == pytest.approx(55.0 - 56.0)
    assert worst["duration_s"] == pytest.approx(86 - 90)
    assert worst["tenure_s"] == pytest.approx(40 - 43)
    assert worst["handovers"] == 0.0
    assert worst["elevation_m"] == pytest.approx(400 * np.tan(np.radians(10)) - 110)
    assert worst["continuity"] == 0.0
    # The hover alone is long enough. Both ranges reach beyond it, so that longer overlaps are there too.
    assert worst["overlap_s"] == 0.0
    assert certify(everything(min_overlap_s=16.0), flight()).worst["overlap_s"] < 0.0


def test_the_papers_problem_has_only_the_papers_constraints() -> None:
    names = {"range_m", "altitude_m", "speed_m_s", "accel_m_s2", "overlap_s", "tenure_s", "continuity"}
    assert set(certify(scene(), flight()).worst) == names


def raised(by_m: float) -> tuple[Problem, Trajectory]:
    """The whole scene flown higher, the ends with it."""
    lift = np.array([0, 0, by_m])
    problem, good = everything(), flight()
    return (
        replace(problem, start_m=problem.start_m + lift, destination_m=problem.destination_m + lift),
        Trajectory(good.control_points_m + lift, good.durations_s, good.station_index),
    )


WIND = {"max_airspeed_m_s": 54.99, "wind_m_s": (-5.0, 0.0)}
# Each break and exactly the entries it turns positive.
BREAKS: dict[str, tuple[Problem, Trajectory, set[str]]] = {
    "range": (replace(scene(), ranges_m=np.array([414.8, 600.0])), flight(), {"range_m"}),
    "floor": (*raised(-10.01), {"altitude_m"}),
    "ceiling": (*raised(10.01), {"altitude_m"}),
    "speed": (scene(accel_m_s2=6.0), flight(half_s=39.999), {"speed_m_s"}),
    "jerk": (scene(limits={"max_jerk_m_s3": 0.7499}), flight(), {"jerk_m_s3"}),
    "head wind": (scene(limits=WIND), flight(), {"airspeed_m_s"}),
    "tail wind": (scene(limits={"max_airspeed_m_s": 45.1, "wind_m_s": (45.0, 0.0)}), flight(), set()),
    "no hover in such wind": (
        scene(limits={"max_airspeed_m_s": 44.9, "wind_m_s": (45.0, 0.0)}),
        flight(),
        {"airspeed_m_s"},
    ),
    "endurance": (scene(limits={"max_duration_s": 85.9}), flight(), {"duration_s"}),
    "tenure": (scene(min_tenure_s=43.001), flight(), {"tenure_s"}),
    "handovers": (scene(max_handovers=0), flight(), {"handovers"}),
    "elevation": (scene(min_elevation_deg=np.array([15.4, 0.0])), flight(), {"elevation_m"}),
    "no elevation limit": (scene(min_elevation_deg=np.array([-90.0, -90.0])), flight(), set()),
    "start": (scene(), moved(flight(), 0, 0, [1e-3, 0, 0]), {"continuity"}),
    "start speed": (scene(), moved(flight(), 0, 1, [-1e-3, 0, 0]), {"continuity"}),
    "start acceleration": (scene(), moved(flight(), 0, 2, [1e-3, 0, 0]), {"continuity"}),
    "destination": (scene(), moved(flight(), 3, 5, [0, 1e-3, 0]), {"continuity"}),
    "joint position": (scene(), moved(flight(), 1, 0, [0, 1e-3, 0]), {"continuity"}),
    "joint speed": (scene(), moved(flight(), 1, 1, [0, 1e-3, 0]), {"continuity"}),
    "joint acceleration": (scene(), moved(flight(), 2, 3, [0, 1e-3, 0]), {"continuity"}),
}


@pytest.mark.parametrize("name", BREAKS)
def test_every_break_is_named(name: str) -> None:
    problem, trajectory, broken = BREAKS[name]
    assert positive(problem, trajectory) == broken


def test_altitude_is_measured_to_the_nearer_edge() -> None:
    points = np.repeat([[0, 0, 103.0], [0, 0, 118.0]], 3, axis=0)[None]
    problem = make_problem([0, 0, 103], [0, 0, 118], [[0, 0, 0, 600]])
    climb = Trajectory(points, np.array([60.0]), np.array([0]))
    assert certify(problem, climb).worst["altitude_m"] == -2.0
    lower = make_problem([0, 0, 103], [0, 0, 118], [[0, 0, 0, 600]], band=(102.0, 120.0))
    assert certify(lower, climb).worst["altitude_m"] == -1.0


def test_acceleration_alone() -> None:
    # 100 m in 15 s: 33.3 m/s and 8.9 m/s^2.
    points = np.repeat([[0, 0, 110.0], [100, 0, 110.0]], 3, axis=0)[None]
    problem = make_problem([0, 0, 110], [100, 0, 110], [[0, 0, 0, 600]])
    assert positive(problem, Trajectory(points, np.array([15.0]), np.array([0]))) == {"accel_m_s2"}


@pytest.mark.parametrize(("step", "name"), [(8.0, "climb_m_s"), (-8.0, "descent_m_s")])
def test_climb_and_descent_have_their_own_limits(step: float, name: str) -> None:
    points = np.repeat([[0, 0, 110.0], [0, 0, 110.0 + step]], 3, axis=0)[None]
    limits = {"max_climb_m_s": 4.001, "max_descent_m_s": 4.001}
    problem = make_problem([0, 0, 110], [0, 0, 110 + step], [[0, 0, 0, 600]], limits=limits)
    assert positive(problem, Trajectory(points, np.array([10.0]), np.array([0]))) == set()  # 5 * 8 / 10 = 4 m/s
    assert positive(problem, Trajectory(points, np.array([9.99]), np.array([0]))) == {name}


# --- overlap ---------------------------------------------------------------------------------------------------


def touching(range_m: float, **options: Any) -> Problem:
    """Antennas at flying height: with 400 m the ranges touch in the meeting point and nowhere else."""
    return make_problem([0, 0, 110], [800, 0, 110], [[0, 0, 110, range_m], [800, 0, 110, range_m]], **options)


def test_a_hover_in_the_only_common_point_is_overlap_to_the_last_digit() -> None:
    problem = touching(400.0, min_overlap_s=6.0)
    certificate = certify(problem, flight(hover_s=6.0))
    assert certificate.worst["overlap_s"] == pytest.approx(0.0, abs=1e-12)
    assert certificate.worst["overlap_s"] <= 0.0
    assert certificate.feasible
    # A ten-thousandth of a second less is found out.
    assert positive(problem, flight(hover_s=5.9999)) == {"overlap_s"}


@pytest.mark.parametrize("degrees", [7.0, 33.0, 81.0, 203.0])
def test_hovering_on_the_very_edge_counts_although_the_roots_see_noise(degrees: float) -> None:
    """The whole flight is a hover where two ranges touch, at coordinates whose squares do not add up exactly."""
    angle = np.radians(degrees)
    spot = np.array([1234.567, 7654.321, 110.0])
    arm = 400.0 * np.array([np.cos(angle), np.sin(angle), 0.0])
    centres = np.array([spot - arm, spot + arm])
    reach = np.linalg.norm(spot - centres, axis=1)
    problem = make_problem(spot, spot, np.column_stack([centres, reach]), min_overlap_s=6.0)
    hover = Trajectory(np.broadcast_to(spot, (4, 6, 3)), np.full(4, 1.5), np.array([0, 0, 1, 1]))
    assert certify(problem, hover).worst["overlap_s"] == 0.0
    assert certify(problem, hover).feasible


def test_overlap_is_wanted_before_and_after() -> None:
    problem, balanced = touching(400.0, min_overlap_s=6.0), flight(hover_s=6.0)
    for durations in ([40, 2, 4, 40], [40, 4, 2, 40]):
        lopsided = Trajectory(balanced.control_points_m, np.array(durations, dtype=float), balanced.station_index)
        assert certify(problem, lopsided).worst["overlap_s"] == pytest.approx(1.0, abs=1e-9)


def test_overlap_in_flight_is_seen_by_the_roots() -> None:
    """Ranges of 500 m overlap from x = 300 to 500: at constant 10 m/s ten seconds before and ten after."""
    points = np.array([[[0, 0, 110], [400, 0, 110]], [[400, 0, 110], [800, 0, 110]]], dtype=float)
    passing = Trajectory(points, np.array([40.0, 40.0]), np.array([0, 1]))
    worst = certify(touching(500.0, min_overlap_s=20.0), passing).worst["overlap_s"]
    assert worst == pytest.approx(0.0, abs=1e-9)
    assert certify(touching(500.0, min_overlap_s=21.0), passing).worst["overlap_s"] == pytest.approx(0.5, abs=1e-9)
    assert certify(touching(500.0, min_overlap_s=19.0), passing).worst["overlap_s"] == pytest.approx(-0.5, abs=1e-9)
    assert certify(touching(500.0), passing).worst["overlap_s"] <= 0.0  # nothing is asked, nothing is missing


def test_overlap_counts_only_above_the_elevation_angle() -> None:
    high = scene(min_overlap_s=6.0, min_elevation_deg=np.array([15.0, 15.0]))
    assert certify(high, flight()).feasible
    # Nor is it much longer than that: 15 degrees end 410.5 m from each station, shortly before and after the hover.
    longer, much_longer = (replace(high, min_overlap_s=overlap_s) for overlap_s in (6.1, 30.0))
    assert certify(longer, flight()).worst["overlap_s"] < 0.0
    assert certify(much_longer, flight()).worst["overlap_s"] > 0.0
    # The next station hears the vehicle from 16 degrees up only, which it reaches after the handover.
    later = replace(high, min_elevation_deg=np.array([0.0, 16.0]))
    assert "overlap_s" in positive(later, flight())


def test_a_single_station_owes_no_overlap_and_no_tenure() -> None:
    points = np.repeat([[0, 0, 110.0], [100, 0, 110.0]], 3, axis=0)[None]
    problem = make_problem([0, 0, 110], [100, 0, 110], [[0, 0, 0, 600]], min_overlap_s=5.0, min_tenure_s=1e3)
    worst = certify(problem, Trajectory(points, np.array([50.0]), np.array([0]))).worst
    assert worst["overlap_s"] == 0.0
    assert worst["tenure_s"] == 0.0


def test_a_given_start_state_is_part_of_continuity() -> None:
    problem = replace(scene(), start_velocity_m_s=np.array([1.0, 0, 0]))
    assert positive(problem, flight()) == {"continuity"}


@pytest.mark.parametrize("station", [-1, 2])
def test_stations_the_problem_does_not_have(station: int) -> None:
    good = flight()
    with pytest.raises(ProblemError, match="the problem has 0 to 1"):
        certify(scene(), Trajectory(good.control_points_m, good.durations_s, np.array([0, 0, 1, station])))


# --- the corridor ----------------------------------------------------------------------------------------------


def test_corridor_of_the_papers_problem_is_one_ball_a_piece() -> None:
    corridor = build_corridor(scene(), [0, 1])
    assert [piece.balls for piece in corridor.pieces] == [(0,), (1,)]
    assert corridor.min_leg_s == 0.0
    assert corridor.joint_balls(1) == (0, 1)


def test_corridor_with_overlap() -> None:
    """As drawn in the module: own pieces between an entry and an exit piece that lie in both balls."""
    rows = [[0, 0, 0, 600], [800, 0, 0, 600], [1600, 0, 0, 600]]
    problem = make_problem([0, 0, 110], [1600, 0, 110], rows, min_overlap_s=5.0, min_tenure_s=10.0)
    corridor = build_corridor(problem, [0, 1, 2], pieces_per_leg=1, pieces_at_ends=2)
    assert [(p.station, p.leg, p.balls, p.min_duration_s) for p in corridor.pieces] == [
        (0, 0, (0,), 0.0),
        (0, 0, (0,), 0.0),
        (0, 0, (0, 1), 2.5),
        (1, 1, (1, 0), 2.5),
        (1, 1, (1,), 0.0),
        (1, 1, (1, 2), 2.5),
        (2, 2, (2, 1), 2.5),
        (2, 2, (2,), 0.0),
        (2, 2, (2,), 0.0),
    ]
    assert corridor.min_leg_s == 10.0
    assert corridor.leg_pieces(1) == [3, 4, 5]
    assert [corridor.joint_balls(k) for k in range(1, 5)] == [(0,), (0, 1), (0, 1), (1, 0)]
    assert build_corridor(problem, [0]).min_leg_s == 0.0


@pytest.mark.parametrize("options", [{"pieces_per_leg": 0}, {"pieces_at_ends": 0}])
def test_corridors_without_own_pieces_are_refused(options: dict[str, int]) -> None:
    with pytest.raises(ProblemError, match="a piece of its own"):
        build_corridor(scene(), [0, 1], **options)
    with pytest.raises(ProblemError, match="needs a station"):
        build_corridor(scene(), [])
