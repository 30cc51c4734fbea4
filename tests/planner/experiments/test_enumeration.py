"""The paper's enumeration of station sequences, on a map small enough to know them all."""

from __future__ import annotations

import itertools
from dataclasses import replace
from itertools import pairwise

import networkx as nx
import numpy as np
import pytest

from planner import InfeasibleError, Problem, certify
from planner.coverage.disc import covering_stations
from planner.coverage.overlap import adjacent_pairs
from planner.experiments.enumeration import Evaluation, enumerate_plans, plan_by_enumeration
from planner.experiments.sequence_bound import sequence_bound_s, shortest_from_rest_s
from planner.joint.sequence_planner import Effort, plan_joint
from planner.paper.alternating import plan_paper
from planner.paper.station_graph import shortest_sequence
from tests.support.missions.problems import make_problem, paper_problem


@pytest.fixture
def ladder() -> Problem:
    """Two rows of three stations, neighbours 900 m apart, the south row with larger ranges than the north row.

    3 ─ 4 ─ 5      range 520
    0 ─ 1 ─ 2      range 560       start at 0, destination at 2; diagonals do not meet
    """
    rows = [[900 * (k % 3), 900 * (k // 3), 0, 560 if k < 3 else 520] for k in range(6)]
    return make_problem([0, 0, 110], [1800, 0, 110], rows)


def every_sequence(problem: Problem) -> set[tuple[int, ...]]:
    graph = nx.Graph()
    graph.add_nodes_from(range(problem.station_count))
    graph.add_edges_from(adjacent_pairs(problem).pairs.tolist())
    ends = itertools.product(
        covering_stations(problem, problem.start_m).tolist(), covering_stations(problem, problem.destination_m).tolist()
    )
    return {tuple(path) for a, b in ends for path in nx.all_simple_paths(graph, a, b)}


def test_every_simple_sequence_is_planned_once(ladder: Problem) -> None:
    steps = list(enumerate_plans(ladder, prune=False))
    assert len(steps) == len({step.sequence for step in steps})
    assert {step.sequence for step in steps} == every_sequence(ladder)
    assert every_sequence(ladder) == {(0, 1, 2), (0, 3, 4, 1, 2), (0, 1, 4, 5, 2), (0, 3, 4, 5, 2)}
    assert [step.planned for step in steps] == [1, 2, 3, 4]
    best = steps[-1].best
    assert best is not None
    assert best.trajectory.duration_s == min(step.mission_time_s for step in steps)
    for step in steps:
        assert step.mission_time_s == plan_paper(ladder, step.sequence).trajectory.duration_s
        partial_s = sequence_bound_s(ladder, step.sequence)
        assert partial_s <= sequence_bound_s(ladder, step.sequence, complete=True) < step.mission_time_s


def test_pruning_changes_the_work_and_not_the_answer(ladder: Problem) -> None:
    whole = plan_by_enumeration(ladder, prune=False)
    record: list[Evaluation] = []
    pruned = plan_by_enumeration(ladder, record=record)
    assert pruned.trajectory.duration_s == whole.trajectory.duration_s
    assert pruned.trajectory.sequence == whole.trajectory.sequence == (0, 1, 2)
    assert record[0].sequence == (0, 1, 2)
    assert record[-1].pruned > 0
    assert pruned.method == "enumeration"
    assert certify(ladder, pruned.trajectory).feasible


@pytest.mark.slow
@pytest.mark.parametrize("kept", [0, 3])
def test_little_memory_changes_the_order_and_not_the_answer(kept: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the frontier is full branches are walked depth first: the same best plan, nothing planned twice."""
    problem = paper_problem("M30_04")
    expected = plan_by_enumeration(problem)
    monkeypatch.setattr("planner.experiments.enumeration.MAX_FRONTIER", kept)
    steps = list(enumerate_plans(problem))
    best = steps[-1].best
    assert best is not None
    assert best.trajectory.sequence == expected.trajectory.sequence
    assert best.trajectory.duration_s == expected.trajectory.duration_s
    planned = [after.sequence for before, after in pairwise(steps) if after.planned > before.planned]
    assert len(planned) == len(set(planned)) == steps[-1].planned - 1


def test_a_time_limit_is_kept_between_plans_too() -> None:
    """The clock is asked at every sequence begun or passed over, not only at those planned."""
    steps = list(enumerate_plans(paper_problem("M30_04")))
    begun = [b for a, b in pairwise(steps) if (a.planned, a.pruned) == (b.planned, b.pruned)]
    assert begun
    assert len(steps) == steps[-1].planned + steps[-1].pruned + len(begun)


@pytest.mark.parametrize("name", ["M30_01", "M30_08"])
def test_a_bound_grows_along_its_sequence(name: str) -> None:
    """What is pruned with a partial sequence could not have been better: the bound never falls as it grows."""
    problem = paper_problem(name)
    sequence = plan_paper(problem, delta_t_s=50.0).trajectory.sequence
    bounds = [sequence_bound_s(problem, sequence[:n]) for n in range(1, len(sequence) + 1)]
    assert all(later >= earlier - 1e-2 for earlier, later in pairwise(bounds))
    assert bounds[-1] < plan_paper(problem, sequence).trajectory.duration_s


@pytest.mark.parametrize("name", ["M30_01", "M30_06", "M100_03"])
def test_the_bound_holds_for_the_papers_problem_and_not_only_for_the_papers_method(name: str) -> None:
    """Positions and durations solved jointly, a piece a station, is faster than AM, and still not below the bound."""
    problem = paper_problem(name)
    sequence = shortest_sequence(problem)
    joint = plan_joint(problem, sequence, Effort(1, 1))
    assert joint is not None
    assert (len(joint.trajectory), joint.trajectory.degree) == (len(sequence), 5)
    alternating = plan_paper(problem, sequence).trajectory.duration_s
    bound = sequence_bound_s(problem, sequence, complete=True)
    assert bound < joint.duration_s < alternating
    # And close: pruning is worth its work.
    assert bound > 0.96 * joint.duration_s


@pytest.mark.parametrize(
    ("length_m", "duration_s"),
    # 50 m/s, 5 m/s2. Up to 13.3 s no control point reaches 50 m/s: T/5 (1 + 2 + 3) 5 T/4 = 1.5 T^2. From 40 s on
    # all three do: T/5 150 = 30 T. In between at 20 s: 4 (25 + 50 + 50) = 500.
    [(150.0, 10.0), (500.0, 20.0), (1200.0, 40.0), (3000.0, 100.0), (0.0, 0.0)],
)
def test_a_piece_from_rest_takes_its_time(length_m: float, duration_s: float) -> None:
    problem = make_problem([0, 0, 100], [1000, 0, 100], [[0, 0, 100, 5000]])
    assert float(shortest_from_rest_s(problem, np.array(length_m))) == pytest.approx(duration_s, abs=1e-9)


def test_the_enumeration_goes_on_where_it_was_left(ladder: Problem) -> None:
    steps = enumerate_plans(ladder, prune=False)
    first = [next(steps), next(steps)]
    rest = list(steps)
    assert [step.sequence for step in first + rest] == [s.sequence for s in enumerate_plans(ladder, prune=False)]


def test_limits_of_time_and_number() -> None:
    problem = paper_problem("M30_01")
    few = plan_by_enumeration(problem, delta_t_s=20.0, max_sequences=3)
    assert few.iterations == 3
    assert few.notes[0].endswith("cut short")
    ticks = itertools.count()
    timed = plan_by_enumeration(problem, delta_t_s=20.0, time_limit_s=4.0, clock=lambda: float(next(ticks)))
    assert 1 <= timed.iterations <= 4
    # Dijkstra's sequence comes first, so even a cut enumeration is no worse than the decoupling approach.
    assert few.trajectory.duration_s <= plan_paper(problem, delta_t_s=20.0).trajectory.duration_s


def test_handovers_may_be_limited(ladder: Problem) -> None:
    short = replace(ladder, max_handovers=3)
    assert {step.sequence for step in enumerate_plans(short, prune=False)} == {(0, 1, 2)}


def test_a_sequence_longer_in_metres_may_be_faster() -> None:
    """The enumeration finds what Dijkstra's centre distances miss.

    A(0, 0) and C(2000, 0) by way of B(1000, 0), whose overlaps are slivers far off to neither side, or of D(1000, 500)
    with a range that holds the straight line: longer from centre to centre, straighter to fly.
    """
    rows = [[0, 0, 100, 520], [1000, -60, 100, 490], [2000, 0, 100, 520], [1000, 500, 100, 1100]]
    problem = make_problem([0, 0, 100], [2000, 0, 100], rows)
    dijkstra = plan_paper(problem)
    best = plan_by_enumeration(problem)
    assert dijkstra.trajectory.sequence == (0, 1, 2)
    assert best.trajectory.sequence != (0, 1, 2)
    assert best.trajectory.duration_s < dijkstra.trajectory.duration_s - 1.0


def test_no_sequence_is_an_explained_failure() -> None:
    problem = make_problem([0, 0, 100], [2000, 0, 100], [[0, 0, 0, 600], [2000, 0, 0, 600]])
    with pytest.raises(InfeasibleError):
        next(enumerate_plans(problem))
    with pytest.raises(InfeasibleError):
        plan_by_enumeration(problem)


def test_enumerations_repeat(ladder: Problem) -> None:
    runs = [[(s.sequence, s.mission_time_s) for s in enumerate_plans(ladder)] for _ in range(2)]
    assert runs[0] == runs[1]
    assert all(np.isfinite(time) or time == np.inf for _, time in runs[0])
