"""The interior-point method by itself: it stops, it says so, and it finds the same optimum from anywhere."""

from __future__ import annotations

import numpy as np
import pytest

from planner import Problem
from planner.corridor.corridor import build_corridor
from planner.corridor.joint_placement import place_joints
from planner.joint.control_rows import P_ROWS
from planner.joint.interior_point import InteriorPointResult, Start, minimise_duration
from planner.joint.objective import Objective
from planner.joint.program import build_program, first_guess, scale_of
from planner.joint.transcription import Transcription
from tests.support.missions.problems import make_problem


def scene(problem: Problem, polyline: list[list[float]], pieces: int = 3) -> tuple[Transcription, Start]:
    """Program and guess along the problem's stations in their order."""
    corridor = build_corridor(problem, range(problem.station_count), pieces_per_leg=pieces)
    waypoints = place_joints(problem, corridor, np.array(polyline, dtype=float))
    scale = scale_of(problem, waypoints)
    program = build_program(problem, corridor, scale, waypoints)
    return program, Start(*first_guess(problem, program, scale, waypoints), barrier=0.02, slack=1e-2)


def solve(program: Transcription, start: Start, **options: float) -> InteriorPointResult:
    return minimise_duration(program, Objective(program.table, start.x[0::10]), start, **options)  # type: ignore[arg-type]


@pytest.fixture
def bend() -> tuple[Transcription, Start]:
    """Two ranges side by side; both ends above, so that the way bends around the tip of their overlap.

    start (0, 900)         (1600, 900) end
            \\___ tip (800, 600) ___/
        A (0, 0)            B (1600, 0)
    """
    problem = make_problem([0, 900, 110], [1600, 900, 110], [[0, 0, 0, 1000], [1600, 0, 0, 1000]])
    return scene(problem, [[0, 900, 110], [800, 580, 110], [1600, 900, 110]])


def test_answer_is_a_stationary_point(bend: tuple[Transcription, Start]) -> None:
    """Feasible to 1e-8, and no small move that keeps the constraints to first order shortens the flight."""
    program, start = bend
    result = solve(program, start, tolerance=1e-6)
    assert result.converged
    assert result.error < 1e-6
    point = program.evaluate(result.x, result.inner)
    assert point.inequalities.max() < 1e-8
    assert np.abs(point.equations).max() < 1e-8
    # Ranges, speed and acceleration are each in force somewhere: it is the limits that hold the time up.
    tight = point.inequalities[: len(program.norms.rows)] > -1e-4
    rows = set(program.norms.rows[tight].tolist())
    assert rows & set(P_ROWS)
    assert rows & {6, 7, 8, 9}
    assert rows & {10, 11, 12}


def test_same_optimum_from_another_start(bend: tuple[Transcription, Start]) -> None:
    program, start = bend
    reference = solve(program, start, tolerance=1e-6)
    slow = start.x.copy()
    slow[0::10] *= 3.0
    for component in range(4, 10):
        slow[component::10] = 0.0
    other = solve(program, Start(slow, program.consistent_inner(slow), barrier=0.5, slack=0.1), tolerance=1e-6)
    assert other.converged
    # The evenness term ties durations to the start's, at a weight that costs less than 0.1 %.
    assert other.x[0::10].sum() == pytest.approx(reference.x[0::10].sum(), rel=1e-3)


def test_is_deterministic(bend: tuple[Transcription, Start]) -> None:
    first, second = (solve(*bend) for _ in range(2))
    assert first.x.tobytes() == second.x.tobytes()
    assert first.inner.tobytes() == second.inner.tobytes()


def test_stops_after_the_iterations_allowed(bend: tuple[Transcription, Start]) -> None:
    result = solve(*bend, max_iterations=3)
    assert result.iterations == 3
    assert not result.converged


def test_a_larger_tolerance_takes_fewer_steps(bend: tuple[Transcription, Start]) -> None:
    assert solve(*bend, tolerance=1e-2).iterations < solve(*bend, tolerance=1e-6).iterations


def test_infeasible_says_so_and_ends() -> None:
    """Ranges 100 m apart: nothing fits, and the answer says by how much it does not."""
    problem = make_problem([0, 0, 110], [2100, 0, 110], [[0, 0, 0, 1000], [2100, 0, 0, 1000]])
    result = solve(*scene(problem, [[0, 0, 110], [1050, 0, 110], [2100, 0, 110]]), max_iterations=60)
    assert not result.converged
    assert result.violation > 1e-3


def test_nonsense_start_is_an_answer_too(bend: tuple[Transcription, Start]) -> None:
    program, start = bend
    broken = start.x.copy()
    broken[3] = np.nan
    with np.errstate(all="ignore"):
        result = solve(program, start._replace(x=broken))
    assert not result.converged
    assert not np.isfinite(result.violation)
