"""The optimisers the paper compares with: each descends, keeps every constraint, stops when told and repeats itself."""

from __future__ import annotations

import itertools
import sys
from dataclasses import replace

import numpy as np
import pytest

from planner import InfeasibleError, Problem, ProblemError, certify
from planner.experiments.rivals import RIVALS, TimeAllocation, plan_by_rival
from planner.paper.alternating import Iteration, plan_paper
from planner.paper.station_graph import shortest_sequence
from tests.support.missions.problems import make_problem, paper_problem

pytest.importorskip("nlopt")


def test_all_of_the_papers_table_4_is_there() -> None:
    assert set(RIVALS) == {"COBYLA", "BOBYQA", "NEWUOA-BOUND", "PRAXIS", "NELDERMEAD", "SBPLX", "BGD"}


@pytest.mark.parametrize("rival", RIVALS)
def test_a_rival_descends_through_certified_plans(rival: str) -> None:
    problem = paper_problem("M30_08")
    record: list[Iteration] = []
    solution = plan_by_rival(problem, rival, time_limit_s=None, max_evaluations=60, record=record)
    assert solution.certificate.feasible
    assert solution.iterations <= 60
    assert solution.method == f"paper-{rival.lower()}"
    times = [entry.mission_time_s for entry in record]
    assert (np.diff(times) < 0).all()
    assert times[-1] == solution.trajectory.duration_s
    assert all(certify(problem, entry.trajectory).feasible for entry in record)
    # Starts where the paper starts, gains, and does not catch up with alternating minimisation.
    start: list[Iteration] = []
    plan_paper(problem, max_runtime_s=0.0, record=start)
    assert times[0] == pytest.approx(start[0].mission_time_s)
    assert len(times) > 1
    assert times[-1] > plan_paper(problem).trajectory.duration_s


@pytest.mark.parametrize("rival", ["SBPLX", "PRAXIS", "BGD"])
def test_rivals_repeat(rival: str) -> None:
    problem = paper_problem("M30_03")
    first, second = (plan_by_rival(problem, rival, time_limit_s=None, max_evaluations=30) for _ in range(2))
    np.testing.assert_array_equal(first.trajectory.durations_s, second.trajectory.durations_s)


def test_overlap_and_tenure_hold_for_rivals_too() -> None:
    problem = paper_problem("M30_04", min_overlap_s=5.0, min_tenure_s=10.0)
    solution = plan_by_rival(problem, "SBPLX", time_limit_s=None, max_evaluations=25)
    assert solution.certificate.worst["overlap_s"] <= 0.0
    assert solution.certificate.worst["tenure_s"] <= 0.0


@pytest.mark.parametrize("rival", ["SBPLX", "BGD"])
def test_the_time_limit_ends_it(rival: str) -> None:
    ticks = itertools.count()
    solution = plan_by_rival(paper_problem("M30_08"), rival, time_limit_s=20.0, clock=lambda: float(next(ticks)))
    assert 0 < solution.iterations <= 20


def test_the_objective_is_the_papers() -> None:
    """Sum of durations where J <= 1; a penalty on top in proportion to what J exceeds 1."""
    problem = make_problem([0, 0, 100], [1000, 0, 100], [[500, 0, 0, 2000]])
    objective = TimeAllocation(problem, (0,), None, 10, None, lambda: 0.0)
    # One piece of 1,000 m from rest to rest: 100 s is J = 1 by its speed, 80 s is J = 1.25.
    assert objective(np.array([100.0])) == pytest.approx(100.0)
    assert objective(np.array([120.0])) == pytest.approx(120.0)
    assert objective(np.array([80.0])) == pytest.approx(80.0 + 10.0 * 100.0 * 0.25)
    assert objective.best.duration_s == pytest.approx(100.0)
    assert objective.evaluations == 3


def test_bad_requests_are_refused(two_stations: Problem) -> None:
    with pytest.raises(ProblemError, match="there are COBYLA, BOBYQA"):
        plan_by_rival(two_stations, "SIMPLEX")
    with pytest.raises(ProblemError, match="time limit or a number of evaluations"):
        plan_by_rival(two_stations, "BGD", time_limit_s=None)
    with pytest.raises(ProblemError, match="start from rest"):
        plan_by_rival(replace(two_stations, start_velocity_m_s=np.array([1.0, 0, 0])), "BGD")
    with pytest.raises(InfeasibleError):
        plan_by_rival(replace(two_stations, ranges_m=np.array([700.0, 700.0])), "BGD")
    with pytest.raises(InfeasibleError):
        plan_by_rival(two_stations, "BGD", shortest_sequence(two_stations)[:1])


def test_without_nlopt_gradient_descent_still_works(two_stations: Problem, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "nlopt", None)
    assert plan_by_rival(two_stations, "BGD", time_limit_s=None, max_evaluations=8).certificate.feasible
    with pytest.raises(ImportError):
        plan_by_rival(two_stations, "COBYLA")
