"""The joint planner's own parts: what is done around the solver so that its answer is certified."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from planner import SolverError, Trajectory, build_corridor, certify
from planner.joint import sequence_planner as joint_module
from planner.joint.sequence_planner import Effort, plan_joint, planar_problem, within_limits, without_rounding
from planner.planner import plan_alternating
from planner.routing.bound import lower_bound
from planner.routing.station_sequence import candidate_routes
from tests.support.missions.problems import make_problem, paper_problem

TWO = [[0, 0, 0, 1000], [1600, 0, 0, 1000]]


def test_too_fast_a_curve_is_flown_slower_as_a_whole() -> None:
    """Twice too fast in speed, four times in acceleration, eight times in jerk: the same factor of two mends all."""
    problem = paper_problem("M30_03", limits={"max_jerk_m_s3": 5.0})
    attempt = plan_joint(problem, candidate_routes(problem)[0].sequence, Effort(2, 4))
    assert attempt is not None
    corridor = build_corridor(problem, attempt.sequence, pieces_per_leg=2, pieces_at_ends=4)
    hurried = attempt.trajectory.scale_time(0.5)
    mended = within_limits(problem, corridor, hurried)
    assert certify(problem, mended).feasible
    assert mended.duration_s == pytest.approx(attempt.duration_s, rel=1e-4)
    assert within_limits(problem, corridor, attempt.trajectory) is attempt.trajectory


def test_a_moving_start_is_not_slowed_down() -> None:
    problem = make_problem([0, 0, 110], [1600, 0, 110], TWO, start_velocity_m_s=np.array([10.0, 0.0, 0.0]))
    attempt = plan_joint(problem, (0, 1), Effort(2, 4))
    assert attempt is not None
    corridor = build_corridor(problem, (0, 1), pieces_per_leg=2, pieces_at_ends=4)
    hurried = attempt.trajectory.scale_time(0.99)
    assert within_limits(problem, corridor, hurried) is hurried


def test_roundings_at_the_ends_and_the_band_are_taken_out() -> None:
    problem = make_problem([0.1, 0.2, 100.0], [900.3, 0.7, 120.0], [[0, 0, 0, 2000]])
    attempt = plan_joint(problem, (0,), Effort(2, 4))
    assert attempt is not None
    noisy = replace(attempt.trajectory, control_points_m=attempt.trajectory.control_points_m * (1.0 - 3e-13))
    assert not certify(problem, noisy).feasible
    clean = without_rounding(problem, noisy)
    assert certify(problem, clean).feasible
    assert (clean.control_points_m[0, :3] == problem.start_m).all()
    assert (clean.control_points_m[-1, -3:] == problem.destination_m).all()


def test_what_is_more_than_a_rounding_stays() -> None:
    problem = make_problem([0, 0, 100], [900, 0, 100], [[0, 0, 0, 2000]])
    ends = np.linspace([0.0, 0.0, 100.0], [900.0, 0.0, 100.0], 4)
    lines = np.linspace(ends[:-1], ends[1:], 6, axis=1)
    lines[1, 2, 2] -= 1e-3
    low = Trajectory(lines, np.full(3, 100.0), np.zeros(3, dtype=np.int64))
    assert without_rounding(problem, low).control_points_m[1, 2, 2] == pytest.approx(99.999, abs=1e-9)


def test_a_flat_band_becomes_a_plane() -> None:
    """At 100 m above antennas on the ground a range of 1000 m is a disc of 995 m; one 45 degrees up hears 100 m."""
    problem = make_problem(
        [0, 0, 100],
        [50, 0, 100],
        [[0, 0, 0, 1000], [0, 0, 0, 1000], [0, 0, 5000, 1000]],
        band=(100.0, 100.0),
        min_elevation_deg=np.array([-90.0, 45.0, -90.0]),
    )
    plane = planar_problem(problem)
    assert plane.ranges_m == pytest.approx([np.sqrt(990_000.0), 100.0, 0.0])
    assert (plane.station_positions_m[:, 2] == 100.0).all()
    assert plane.limits.min_alt_m < 100.0 < plane.limits.max_alt_m


def test_few_stations_get_more_pieces() -> None:
    """Three pieces a station, but at least 24 in all: one station gets 2 x 5 + 3, two get 2 x (5 + 3)."""
    one = make_problem([-900, 0, 110], [900, 0, 110], [[0, 0, 0, 1500]])
    # The least time under one station has a closed form; the least energy has not.
    attempt = plan_joint(one, (0,), Effort(3, 5, 24), energy_weight=0.1)
    assert attempt is not None
    assert len(attempt.trajectory) == 13
    attempt = plan_joint(make_problem([0, 0, 110], [1600, 0, 110], TWO), (0, 1), Effort(3, 5, 24))
    assert attempt is not None
    assert len(attempt.trajectory) == 16


def test_more_pieces_come_closer_to_the_bound() -> None:
    problem = paper_problem("M100_05")
    sequence = candidate_routes(problem)[0].sequence
    bound = lower_bound(problem).time_s
    attempts = [plan_joint(problem, sequence, effort) for effort in (Effort(1, 1), Effort(1, 3), Effort(2, 4))]
    gaps = [attempt.duration_s / bound - 1.0 for attempt in attempts if attempt is not None]
    assert len(gaps) == 3
    assert gaps[0] > 2 * gaps[1] > 3 * gaps[2] > 0.0


def test_the_next_start_is_tried_where_the_solver_breaks_down(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = paper_problem("M30_03")
    sequence = candidate_routes(problem)[0].sequence
    solve = joint_module.solve_corridor
    calls = []

    def broken_at_first(*args: object, **kwargs: object) -> object:
        calls.append(args)
        if len(calls) == 1:
            raise SolverError("broken")
        return solve(*args, **kwargs)  # type: ignore[arg-type]

    monkeypatch.setattr(joint_module, "solve_corridor", broken_at_first)
    attempt = plan_joint(problem, sequence, Effort(2, 4))
    assert attempt is not None
    assert attempt.certificate.feasible
    assert len(calls) == 2


def test_alternating_minimisation_stands_in() -> None:
    problem = paper_problem("M30_03", margin_m=25.0, min_overlap_s=5.0, min_tenure_s=10.0)
    sequence = candidate_routes(problem)[0].sequence
    slow, quick = plan_alternating(problem, sequence), plan_joint(problem, sequence, Effort(2, 4))
    assert slow is not None
    assert quick is not None
    assert slow.certificate.feasible
    assert quick.duration_s < slow.duration_s
