"""The direct assembly of P4 and P5 against the same programs written readably in cvxpy."""

from __future__ import annotations

import numpy as np
import pytest

from planner import build_corridor
from planner.corridor.polyline_program import polyline_length_m, shortest_polyline
from planner.errors import SolverError
from planner.paper.alternating import AlternatingMinimisation, plan_paper
from planner.paper.boundary import control_points
from planner.paper.station_graph import shortest_sequence
from tests.support.missions.problems import paper_problem

pytest.importorskip("cvxpy")

from planner.experiments.cvxpy_reference import ControlPointReference, plan_paper_cvxpy, shortest_polyline_cvxpy

CASES = [("M30_01", 0.0), ("M30_06", 6.0), ("M100_04", 0.0), ("M300_01", 0.0)]


@pytest.mark.parametrize(("name", "overlap_s"), CASES)
def test_p4_agrees(name: str, overlap_s: float) -> None:
    problem = paper_problem(name, min_overlap_s=overlap_s)
    corridor = build_corridor(problem, shortest_sequence(problem))
    direct, reference = shortest_polyline(problem, corridor), shortest_polyline_cvxpy(problem, corridor)
    assert polyline_length_m(direct) == pytest.approx(polyline_length_m(reference), rel=1e-6)


@pytest.mark.parametrize(("name", "overlap_s"), CASES)
def test_p5_agrees(name: str, overlap_s: float) -> None:
    problem = paper_problem(name, min_overlap_s=overlap_s)
    corridor = build_corridor(problem, shortest_sequence(problem))
    method, reference = AlternatingMinimisation(problem, corridor), ControlPointReference(problem, corridor)
    rng = np.random.default_rng(7)
    for factor in (1.0, 0.5):
        durations = factor * method.durations_s * rng.uniform(0.8, 1.2, len(corridor))
        boundary = method.program.solve(durations)
        reference.solve(durations)
        found = method.check.ratios(control_points(boundary, durations), durations)[:2].max()
        assert found == pytest.approx(reference.ratio, rel=1e-5)


def test_the_whole_method_agrees() -> None:
    """The polylines are equally short but not the same where an overlap leaves room, so descents differ a bit."""
    problem = paper_problem("M30_08")
    direct, reference = plan_paper(problem), plan_paper_cvxpy(problem)
    assert reference.certificate.feasible
    assert reference.method == "paper-cvxpy"
    assert reference.trajectory.duration_s == pytest.approx(direct.trajectory.duration_s, rel=0.02)
    assert plan_paper_cvxpy(problem, max_runtime_s=0.0).iterations == 0


def test_a_solver_that_gives_up_ends_the_descent_and_not_the_plan(monkeypatch: pytest.MonkeyPatch) -> None:
    problem, calls = paper_problem("M30_08"), iter(range(100))
    solve = ControlPointReference.solve

    def fails_third(self: ControlPointReference, durations_s: np.ndarray) -> np.ndarray:
        if next(calls) == 2:
            raise SolverError("out of digits")
        return solve(self, durations_s)

    monkeypatch.setattr(ControlPointReference, "solve", fails_third)
    stopped = plan_paper_cvxpy(problem)
    assert stopped.certificate.feasible
    assert stopped.iterations == 2
    assert stopped.notes == ("alternating minimisation stopped early: out of digits",)
