"""The corridor solver: hand-worked optima, every option in force when tight, symmetries, extremes, certificates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from planner import Problem, Trajectory, certify
from planner.corridor.corridor import Corridor, build_corridor
from planner.corridor.handover_polyline import polyline_along
from planner.corridor.joint_placement import place_joints
from planner.coverage.overlap import overlap_point_m
from planner.errors import SolverError
from planner.joint.sequence_planner import planar_problem, without_rounding
from planner.joint.solver import CorridorSolution, solve_corridor
from planner.routing.bound import lower_bound
from planner.routing.station_sequence import candidate_routes, is_chain
from tests.support.missions.problems import PAPER_LIKE, make_problem, paper_problem, random_chain

Array = NDArray[np.float64]


def polyline_through(problem: Problem) -> Array:
    """Start, the middle of every overlap of neighbouring stations, destination."""
    middles = [overlap_point_m(problem, k, k + 1) for k in range(problem.station_count - 1)]
    return np.array([problem.start_m, *middles, problem.destination_m])


def plan(
    problem: Problem, *, pieces: int = 2, at_ends: int | None = 4, polyline: Array | None = None, **options: Any
) -> CorridorSolution:
    """Solve along all stations in their order."""
    corridor = build_corridor(problem, range(problem.station_count), pieces_per_leg=pieces, pieces_at_ends=at_ends)
    line = polyline_through(problem) if polyline is None else polyline
    return solve_corridor(problem, corridor, place_joints(problem, corridor, line), **options)


def one_piece_time_s(length_m: float, **limits: Any) -> float:
    """Rest to rest over ``length_m`` in one piece inside one huge range: P = (0, 0, 0, L, L, L) along the way."""
    speed, accel = limits.pop("speed_m_s", 1e3), limits.pop("accel_m_s2", 1e3)
    problem = make_problem(
        [0, 0, 110], [length_m, 0, 110], [[0, 0, 0, 1e5]], speed_m_s=speed, accel_m_s2=accel, limits=limits
    )
    solution = plan(problem, pieces=1, at_ends=None)
    assert solution.converged
    assert certify(problem, solution.trajectory).feasible
    return solution.trajectory.duration_s


class TestHandWorked:
    """One piece from rest to rest: its control points are fixed, only T is free, and one limit decides it.

    With L = 100 m: Q_2 = 5 L / T, K_1 = -K_2 = 20 L / T^2, |L_1| = 3 (K_1 - K_2) / T = 120 L / T^3.
    """

    def test_speed_decides(self) -> None:
        assert one_piece_time_s(100.0, speed_m_s=10.0) == pytest.approx(5 * 100 / 10, rel=1e-4)

    def test_acceleration_decides(self) -> None:
        assert one_piece_time_s(100.0, accel_m_s2=5.0) == pytest.approx(np.sqrt(20 * 100 / 5), rel=1e-4)

    def test_jerk_decides(self) -> None:
        assert one_piece_time_s(100.0, max_jerk_m_s3=2.0) == pytest.approx(np.cbrt(120 * 100 / 2), rel=1e-4)

    def test_headwind_decides(self) -> None:
        """Against 4 m/s of wind at 14 m/s of airspeed: 10 m/s over ground."""
        time_s = one_piece_time_s(100.0, max_airspeed_m_s=14.0, wind_m_s=(-4.0, 0.0))
        assert time_s == pytest.approx(5 * 100 / 10, rel=1e-4)

    @pytest.mark.parametrize(("low", "high", "limit"), [(0, 20, "max_climb_m_s"), (20, 0, "max_descent_m_s")])
    def test_climb_and_descent_decide(self, low: float, high: float, limit: str) -> None:
        """20 m straight up or down at 2 m/s."""
        problem = make_problem([0, 0, low], [0, 0, high], [[0, 0, 0, 1e4]], band=(0, 20), limits={limit: 2.0})
        solution = plan(problem, pieces=1, at_ends=None)
        assert solution.trajectory.duration_s == pytest.approx(5 * 20 / 2, rel=1e-4)

    def test_more_pieces_come_near_bang_bang(self) -> None:
        """1 km at 50 m/s and 5 m/s^2: L/v + v/a = 30 s with jumps of acceleration, which many short pieces imitate."""
        problem = make_problem([0, 0, 110], [1000, 0, 110], [[0, 0, 0, 1e4]])
        times = [plan(problem, pieces=k, at_ends=None).trajectory.duration_s for k in (1, 2, 3, 4, 6, 8)]
        assert all(later < earlier for earlier, later in pairwise(times))
        assert 30.0 < times[-1] < 30.0 * 1.01

    def test_energy_decides(self) -> None:
        """T + w E, E = 120/7 L^2 / (a_max^2 T^3) without drag: stationary at T^4 = 360/7 w L^2 / a_max^2."""
        length, accel, weight = 100.0, 5.0, 100.0
        problem = make_problem([0, 0, 110], [length, 0, 110], [[0, 0, 0, 1e5]], speed_m_s=1e3, accel_m_s2=accel)
        solution = plan(problem, pieces=1, at_ends=None, energy_weight=weight)
        expected = (360 / 7 * weight * length**2 / accel**2) ** 0.25
        assert solution.trajectory.duration_s == pytest.approx(expected, rel=1e-3)

    def test_least_durations_decide(self) -> None:
        """A hop of 1 m between two stations that must be in control for 40 s each."""
        problem = make_problem([0, 0, 110], [1, 0, 110], [[0, 0, 0, 500], [1, 0, 0, 500]], min_tenure_s=40.0)
        solution = plan(problem)
        assert solution.trajectory.duration_s == pytest.approx(80.0, rel=1e-4)
        assert certify(problem, solution.trajectory).worst["tenure_s"] == pytest.approx(0.0, abs=1e-3)


OPTIONS: dict[str, tuple[dict[str, float | tuple[float, float]], str]] = {
    "jerk": ({"max_jerk_m_s3": 1.0}, "jerk_m_s3"),
    "climb": ({"max_climb_m_s": 0.2}, "climb_m_s"),
    "descent": ({"max_descent_m_s": 0.2}, "descent_m_s"),
    "airspeed": ({"max_airspeed_m_s": 40.0, "wind_m_s": (-8.0, 12.0)}, "airspeed_m_s"),
}


class TestOptions:
    """Each limit holds by certificate, costs time, and is reached where it is tight."""

    scene = (
        [-700.0, 0.0, 100.0],
        [2300.0, 200.0, 120.0],
        [[0.0, 0.0, 0.0, 1000.0], [1600.0, 200.0, 0.0, 1000.0]],
    )

    def problem(self, **options: Any) -> Problem:
        start, destination, stations = self.scene
        if options.pop("downwards", False):
            start, destination = [*start[:2], 120.0], [*destination[:2], 100.0]
        return make_problem(start, destination, stations, **options)

    @pytest.mark.parametrize("name", sorted(OPTIONS))
    def test_limit_holds_and_binds(self, name: str) -> None:
        limits, excess = OPTIONS[name]
        downwards = name == "descent"
        free = plan(self.problem(downwards=downwards)).trajectory
        problem = self.problem(limits=limits, downwards=downwards)
        assert not certify(problem, free).feasible
        solution = plan(problem)
        assert solution.converged
        worst = certify(problem, solution.trajectory).worst
        assert certify(problem, solution.trajectory).feasible
        limit = max(value for value in limits.values() if isinstance(value, float))
        assert worst[excess] == pytest.approx(0.0, abs=1e-3 * limit)
        assert solution.trajectory.duration_s > free.duration_s

    def test_overlap_holds_and_binds(self) -> None:
        """The overlap is 400 m wide where it is crossed: 8 s at full speed; 20 s are asked for."""
        problem = self.problem(min_overlap_s=20.0)
        solution = plan(problem)
        worst = certify(problem, solution.trajectory).worst
        assert certify(problem, solution.trajectory).feasible
        assert worst["overlap_s"] == pytest.approx(0.0, abs=0.05)
        assert solution.trajectory.duration_s > plan(self.problem()).trajectory.duration_s + 1.0

    def test_elevation_mask_makes_it_climb(self) -> None:
        """Heard only above 45 degrees, two stations 210 m apart meet at 105 m and above, midway.

              ┌ 105 m: the cones' surfaces meet
             / \\        from 100 m to 100 m, the flight must climb 5 m
            /   \\
           A     B
        """
        problem = make_problem(
            [0, 0, 100],
            [210, 0, 100],
            [[0, 0, 0, 500], [210, 0, 0, 500]],
            min_elevation_deg=np.array([45.0, 45.0]),
        )
        solution = plan(problem)
        assert solution.converged
        assert certify(problem, solution.trajectory).feasible
        time = np.linspace(0, solution.trajectory.duration_s, 2001)
        # A height of exactly 105 m is a cusp of the overlap: the flight stays as low as it can.
        assert 105.0 <= solution.trajectory.evaluate(time)[:, 2].max() < 106.0
        free = plan(replace(problem, min_elevation_deg=None))
        assert free.trajectory.evaluate(time)[:, 2].max() < 105.0

    def test_an_antenna_hears_nothing_below_itself(self) -> None:
        """The second station stands at 112 m with no elevation below 0: the handover is above that."""
        problem = make_problem(
            [0, 0, 100],
            [900, 0, 120],
            [[0, 0, 0, 600], [900, 0, 112, 600]],
            min_elevation_deg=np.array([-90.0, 0.0]),
        )
        solution = plan(problem, polyline=np.array([[0, 0, 100], [450, 0, 116], [900, 0, 120.0]]))
        assert certify(problem, solution.trajectory).feasible
        assert float(solution.trajectory.evaluate(solution.trajectory.handover_times_s[0])[2]) >= 112.0

    def test_moving_start(self) -> None:
        """Off at 30 m/s: the state is met exactly, and nothing has to be sped up."""
        problem = self.problem(
            start_velocity_m_s=np.array([30.0, 0.0, 0.0]), start_acceleration_m_s2=np.array([1.0, 0.5, 0.0])
        )
        solution = plan(problem)
        assert solution.converged
        assert certify(problem, solution.trajectory).feasible
        assert solution.trajectory.evaluate(0.0, 1) == pytest.approx([30.0, 0.0, 0.0], abs=1e-9)
        assert solution.trajectory.evaluate(0.0, 2) == pytest.approx([1.0, 0.5, 0.0], abs=1e-8)
        assert solution.trajectory.duration_s < plan(self.problem()).trajectory.duration_s - 1.0

    def test_energy_trades_time(self) -> None:
        """The heavier the energy weighs, the slower the flight and the less |a|^2 and |v|^3 it takes."""
        problem = self.problem()
        plans = [plan(problem, energy_weight=w) for w in (0.0, 0.3, 3.0)]
        for solution in plans:
            assert solution.converged
            assert certify(problem, solution.trajectory).feasible
        times = [solution.trajectory.duration_s for solution in plans]
        energies = [energy_s(problem, solution.trajectory) for solution in plans]
        assert times == sorted(times)
        assert energies == sorted(energies, reverse=True)
        # Each is the best of the three at its own weight.
        for k, weight in enumerate((0.0, 0.3, 3.0)):
            costs = [t + weight * e for t, e in zip(times, energies, strict=True)]
            assert costs[k] == pytest.approx(min(costs), rel=1e-3)


def energy_s(problem: Problem, trajectory: Trajectory) -> float:
    """The integral of |a|^2 / a_max^2 + |v|^3 / v_max^3, by a fine sum."""
    time = np.linspace(0, trajectory.duration_s, 20001)
    accel = np.linalg.norm(trajectory.evaluate(time, 2), axis=1) / problem.limits.max_accel_m_s2
    speed = np.linalg.norm(trajectory.evaluate(time, 1), axis=1) / problem.limits.max_speed_m_s
    return float(np.trapezoid(accel**2 + speed**3, time))


class TestSymmetries:
    def test_there_and_back_take_the_same_time(self) -> None:
        problem = make_problem(
            [-700, 0, 100], [3900, 0, 100], [[0, 0, 0, 1000], [1600, 300, 0, 1000], [3200, 0, 0, 1000]]
        )
        there = plan(problem).trajectory
        stations = problem.station_positions_m[::-1]
        back = plan(
            replace(problem, start_m=problem.destination_m, destination_m=problem.start_m, station_positions_m=stations)
        ).trajectory
        assert back.duration_s == pytest.approx(there.duration_s, rel=2e-4)
        # The scene is its own mirror image, and so is the flight.
        assert there.durations_s == pytest.approx(there.durations_s[::-1], rel=2e-2)
        middle = there.evaluate(0.5 * there.duration_s)
        assert middle[0] == pytest.approx(1600.0, abs=2.0)

    @settings(max_examples=15, deadline=None)
    @given(
        st.floats(-3, 3).map(lambda e: 10.0**e),
        st.floats(-2, 2).map(lambda e: 10.0**e),
        st.floats(0, 6.28),
        st.floats(-1, 1),
    )
    def test_units_and_axes_do_not_matter(self, length: float, time: float, angle: float, shift: float) -> None:
        """The same scene in other units of length and time, turned and moved, is the same flight in those units."""
        stations = np.array([[0, 0, 0, 1000], [1600, 300, 0, 1000], [3000, 0, 0, 900.0]])
        reference = make_problem([-500, 0, 100], [3300, 100, 110], stations.tolist())
        turn = np.array([[np.cos(angle), np.sin(angle), 0], [-np.sin(angle), np.cos(angle), 0], [0, 0, 1]])

        def moved(point: Sequence[float] | Array) -> Array:
            return np.asarray(length * (np.asarray(point, dtype=float) @ turn + shift * np.array([1e3, -1e3, 0])))

        other = make_problem(
            moved(reference.start_m).tolist(),
            moved(reference.destination_m).tolist(),
            np.column_stack([moved(stations[:, :3]), length * stations[:, 3]]).tolist(),
            band=(100 * length, 120 * length),
            speed_m_s=50 * length / time,
            accel_m_s2=5 * length / time**2,
        )
        here, there = plan(reference, pieces=1, at_ends=2), plan(other, pieces=1, at_ends=2)
        assert certify(other, there.trajectory).feasible
        assert there.trajectory.duration_s == pytest.approx(time * here.trajectory.duration_s, rel=1e-3)


def route(problem: Problem, pieces: int, at_ends: int) -> tuple[Corridor, Array]:
    sequence = candidate_routes(problem, 1)[0].sequence
    corridor = build_corridor(problem, sequence, pieces_per_leg=pieces, pieces_at_ends=at_ends)
    return corridor, place_joints(problem, corridor, polyline_along(problem, sequence)[0])


class TestPaperLike:
    def test_is_deterministic(self, small_problem: Problem) -> None:
        corridor, waypoints = route(small_problem, 1, 3)
        plans = [solve_corridor(small_problem, corridor, waypoints).trajectory for _ in range(2)]
        assert plans[0].control_points_m.tobytes() == plans[1].control_points_m.tobytes()
        assert plans[0].durations_s.tobytes() == plans[1].durations_s.tobytes()

    def test_warm_start(self, small_problem: Problem) -> None:
        """From its own answer a few steps confirm it; from the answer to other limits it saves some."""
        corridor, waypoints = route(small_problem, 2, 4)
        cold = solve_corridor(small_problem, corridor, waypoints)
        warm = solve_corridor(small_problem, corridor, start_trajectory=cold.trajectory)
        assert warm.converged
        assert warm.trajectory.duration_s <= cold.trajectory.duration_s * (1 + 1e-4)
        assert warm.iterations < cold.iterations
        slower = replace(small_problem, limits=replace(small_problem.limits, max_speed_m_s=45.0))
        adapted = solve_corridor(slower, corridor, start_trajectory=cold.trajectory)
        assert adapted.converged
        assert certify(slower, adapted.trajectory).feasible
        direct = solve_corridor(slower, corridor, waypoints)
        assert adapted.trajectory.duration_s == pytest.approx(direct.trajectory.duration_s, rel=1e-2)

    def test_starts_that_do_not_fit(self, small_problem: Problem) -> None:
        corridor, waypoints = route(small_problem, 1, 3)
        answer = solve_corridor(small_problem, corridor, waypoints).trajectory
        with pytest.raises(ValueError, match="waypoints_m must be"):
            solve_corridor(small_problem, corridor, waypoints[:-1])
        with pytest.raises(ValueError, match="must be given"):
            solve_corridor(small_problem, corridor)
        with pytest.raises(ValueError, match="pieces of degree up to 5"):
            solve_corridor(small_problem, corridor, start_trajectory=answer.split([1.0]))
        with pytest.raises(ValueError, match="pieces of degree up to 5"):
            solve_corridor(small_problem, corridor, start_trajectory=answer.elevate(6))

    @pytest.mark.slow
    @pytest.mark.parametrize("group", ["M30", "M100", "M300"])
    def test_all_missions_certified_and_near_the_bound(self, group: str) -> None:
        """The paper's problem, two pieces a station, four at the ends: at most 0.65 % over the bound in the mean."""
        gaps = []
        for name in (name for name in PAPER_LIKE if name.startswith(group + "_")):
            problem = paper_problem(name)
            solution = solve_corridor(problem, *route(problem, 2, 4))
            assert solution.converged, name
            assert certify(problem, solution.trajectory).feasible, name
            gaps.append(solution.trajectory.duration_s / lower_bound(problem).time_s - 1.0)
        assert len(gaps) == 10
        assert min(gaps) >= 0.0
        assert np.mean(gaps) < 0.0065

    @pytest.mark.slow
    def test_all_missions_with_overlap_certified(self) -> None:
        for name in PAPER_LIKE:
            problem = paper_problem(name, min_overlap_s=5.0, min_tenure_s=10.0)
            solution = solve_corridor(problem, *route(problem, 1, 3))
            assert certify(problem, solution.trajectory).feasible, name


class TestJointPlacement:
    def test_joints_lie_on_the_polyline_and_gather_where_speed_changes(self) -> None:
        """One long leg: the first and last pieces are the shortest, the longest is in the middle."""
        problem = make_problem([0, 0, 110], [9000, 0, 110], [[4500, 0, 0, 6000]])
        corridor = build_corridor(problem, [0], pieces_per_leg=6)
        points = place_joints(problem, corridor, np.array([[0, 0, 110], [9000, 0, 110.0]]))
        assert points[[0, -1]] == pytest.approx(np.array([[0, 0, 110], [9000, 0, 110.0]]))
        assert points[:, 1:] == pytest.approx(np.tile([0.0, 110.0], (7, 1)))
        lengths = np.diff(points[:, 0])
        assert (lengths > 0).all()
        assert lengths == pytest.approx(lengths[::-1], rel=1e-6)
        assert lengths[0] < lengths[1] < lengths[2]

    def test_entry_and_exit_pieces_stay_in_both_ranges(self) -> None:
        """The overlap of two ranges is 200 m wide on the way; half the overlap time at full speed would be 250 m."""
        problem = make_problem(
            [-500, 0, 100], [2300, 0, 100], [[0, 0, 100, 1000], [1800, 0, 100, 1000]], min_overlap_s=10.0
        )
        corridor = build_corridor(problem, [0, 1])
        points = place_joints(problem, corridor, np.array([[-500, 0, 100], [880, 0, 100], [2300, 0, 100.0]]))
        assert len(points) == len(corridor) + 1
        # start, exit piece begins, handover, entry piece ends, destination
        assert points[:, 0] == pytest.approx([-500, 880 - 0.99 * 80, 880, 880 + 0.99 * 120, 2300])
        for joint in range(1, len(corridor)):
            for ball in corridor.joint_balls(joint):
                assert np.linalg.norm(points[joint] - problem.station_positions_m[ball]) <= 1000.0

    def test_legs_without_length(self) -> None:
        problem = make_problem([5, 5, 110], [5, 5, 110], [[0, 0, 0, 600], [0, 10, 0, 600]], min_overlap_s=5.0)
        corridor = build_corridor(problem, [0, 1], pieces_per_leg=2)
        points = place_joints(problem, corridor, np.tile([5.0, 5.0, 110.0], (3, 1)))
        assert points == pytest.approx(np.tile([5.0, 5.0, 110.0], (len(corridor) + 1, 1)))

    def test_polyline_of_another_corridor(self) -> None:
        problem = make_problem([0, 0, 110], [900, 0, 110], [[0, 0, 0, 600], [900, 0, 0, 600]])
        with pytest.raises(ValueError, match=r"\(legs \+ 1, 3\) = \(3, 3\)"):
            place_joints(problem, build_corridor(problem, [0, 1]), np.zeros((2, 3)))


class TestExtremes:
    """Whatever the numbers: a certified plan, or an answer that says it is none; never a hang, a warning or a crash."""

    @pytest.mark.parametrize(
        ("speed", "accel"), [(50.0, 0.05), (50.0, 500.0), (0.5, 5.0), (5000.0, 5.0), (0.5, 0.005), (5000.0, 5e4)]
    )
    def test_limits_far_apart(self, speed: float, accel: float) -> None:
        problem = make_problem(
            [-500, 0, 100],
            [3300, 100, 110],
            [[0, 0, 0, 1000], [1600, 300, 0, 1000], [3000, 0, 0, 900]],
            speed_m_s=speed,
            accel_m_s2=accel,
        )
        solution = plan(problem)
        assert solution.converged
        assert certify(problem, solution.trajectory).feasible
        assert solution.trajectory.duration_s < 1.2 * lower_bound(problem).time_s

    @pytest.mark.parametrize("thickness_m", [1e-2, 1e-5, 1e-8])
    def test_thin_bands(self, thickness_m: float) -> None:
        problem = make_problem(
            [0, 0, 100],
            [900, 50, 100 + thickness_m],
            [[0, 0, 0, 600], [900, 0, 0, 600]],
            band=(100, 100 + thickness_m),
        )
        solution = plan(problem)
        assert solution.converged
        assert certify(problem, solution.trajectory).feasible

    def test_a_millimetre_of_overlap(self) -> None:
        """Through an opening of 1 mm by 1.4 m the flight hardly slows down, with an overlap it stops."""
        for overlap_s in (0.0, 5.0):
            problem = make_problem(
                [0, 0, 100], [1000, 0, 100], [[0, 0, 100, 500], [1000 - 1.001e-3, 0, 100, 500]], min_overlap_s=overlap_s
            )
            solution = plan(problem)
            assert certify(problem, solution.trajectory).feasible
            assert solution.trajectory.duration_s == pytest.approx(30.0 if not overlap_s else 49.0, rel=0.05)

    def test_start_is_destination(self) -> None:
        problem = make_problem([5, 5, 110], [5, 5, 110], [[0, 0, 0, 600]])
        solution = plan(problem)
        assert certify(problem, solution.trajectory).feasible
        assert solution.trajectory.path_length_m() < 1e-3

    def test_far_from_the_origin(self) -> None:
        """Coordinates of 150 km and pieces of seconds: the joints stay continuous to 1e-9."""
        stations = [[1.5e5 + x, -1.5e5, 0, 16000] for x in (0, 25000, 50000)]
        problem = make_problem(
            [1.4e5, -1.5e5, 100],
            [2.1e5, -1.5e5, 110],
            stations,
            speed_m_s=30.0,
            accel_m_s2=2.5,
            min_overlap_s=5.0,
            min_tenure_s=10.0,
        )
        solution = plan(problem)
        assert solution.converged
        certificate = certify(problem, solution.trajectory)
        assert certificate.feasible
        assert certificate.worst["continuity"] < 5e-10

    def test_ends_on_the_edge_of_range_and_band(self) -> None:
        problem = make_problem([-500, 0, 100], [1400, 0, 100], [[0, 0, 100, 500], [900, 0, 100, 500]])
        solution = plan(problem)
        assert solution.converged
        assert certify(problem, solution.trajectory).feasible

    @pytest.mark.slow
    def test_hostile_chains(self) -> None:
        """Of random chains at most one in fifty comes out without a certificate, and that one says so."""
        solved, failed = 0, 0
        for seed in range(1000, 1080):
            problem = random_chain(seed)
            if problem is None or not is_chain(problem, range(problem.station_count)):
                continue
            flat = problem.limits.min_alt_m == problem.limits.max_alt_m
            polyline, _ = polyline_along(problem, range(problem.station_count))
            corridor = build_corridor(problem, range(problem.station_count), pieces_per_leg=2, pieces_at_ends=3)
            waypoints = place_joints(problem, corridor, polyline)
            solved += 1
            try:
                solution = solve_corridor(planar_problem(problem) if flat else problem, corridor, waypoints)
            except SolverError:
                failed += 1
                continue
            certificate = certify(problem, without_rounding(problem, solution.trajectory))
            assert certificate.feasible or not solution.converged, seed
            failed += not certificate.feasible
        assert solved > 50
        assert failed <= 1
