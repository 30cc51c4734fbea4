"""The paper's upper level: which stations, in which order."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import networkx as nx
import numpy as np
import pytest

from planner import InfeasibleError, Problem, ProblemError
from planner.coverage.disc import covering_stations
from planner.coverage.overlap import adjacent_pairs
from planner.paper.station_graph import check_sequence, shortest_sequence, weighted_edges
from tests.support.missions.problems import make_problem, paper_problem


def as_networkx(problem: Problem) -> nx.Graph:
    """The graph of paper equations (25) to (28), ends included."""
    graph = nx.Graph()
    graph.add_nodes_from(range(problem.station_count))
    pairs, lengths = weighted_edges(problem)
    graph.add_weighted_edges_from((int(i), int(j), float(w)) for (i, j), w in zip(pairs, lengths, strict=True))
    for name, position in (("start", problem.start_m), ("end", problem.destination_m)):
        graph.add_weighted_edges_from((name, int(s), 0.0) for s in covering_stations(problem, position))
    return graph


@pytest.mark.parametrize("name", ["M30_01", "M30_09", "M100_04", "M100_08", "M300_02", "M300_10"])
def test_dijkstra_agrees_with_networkx(name: str) -> None:
    problem = paper_problem(name)
    sequence = shortest_sequence(problem)
    ground = problem.station_positions_m[:, :2]
    length = sum(float(np.hypot(*(ground[a] - ground[b]))) for a, b in pairwise(sequence))
    assert length == pytest.approx(nx.dijkstra_path_length(as_networkx(problem), "start", "end"))
    assert check_sequence(problem, sequence) == sequence


def test_the_ends_weigh_nothing() -> None:
    """The start is in A and B; A is nearer to it, but by way of B there is less between station centres.

    A(0) B(300) C(1000): start at 0, range 600 all: A to C do not meet, A-B-C or B-C.
    """
    problem = make_problem([0, 0, 100], [1200, 0, 100], [[0, 0, 0, 600], [300, 0, 0, 600], [1000, 0, 0, 600]])
    assert shortest_sequence(problem) == (1, 2)


def test_one_station_for_both_ends() -> None:
    problem = make_problem([0, 0, 100], [50, 0, 100], [[-900, 0, 0, 950], [0, 0, 0, 600], [900, 0, 0, 900]])
    assert shortest_sequence(problem) == (1,)


def test_coincident_stations_are_no_obstacle() -> None:
    rows = [[0, 0, 0, 600], [0, 0, 0, 600], [900, 0, 0, 600], [900, 0, 0, 600]]
    problem = make_problem([0, 0, 100], [900, 0, 100], rows)
    first, last = shortest_sequence(problem)
    assert first in (0, 1)
    assert last in (2, 3)
    # Even a way through both costs nothing, and zero metres are an edge like any other.
    apart = make_problem([-550, 0, 100], [900, 0, 100], [[0, 0, 0, 600], [0, 0, 0, 590], [900, 0, 0, 330]])
    assert shortest_sequence(apart) == (0, 2)
    assert [0, 1] in adjacent_pairs(apart).pairs.tolist()


def test_stations_that_cannot_help_are_left_out() -> None:
    """In a row A, B, C with B out of reach of the band: the way goes round by D."""
    rows = [[0, 0, 0, 600], [900, 0, 0, 99], [1800, 0, 0, 600], [900, 700, 0, 700]]
    problem = make_problem([0, 0, 100], [1800, 0, 100], rows)
    assert shortest_sequence(problem) == (0, 3, 2)


def test_hills_meet_in_their_own_plane() -> None:
    # Antennas at 300 m, band 100 to 120 m: the discs are largest at 120 m, 572.4 m against 565.7 m at the floor.
    rows = [[0, 0, 300, 600], [1140, 0, 300, 600]]
    problem = make_problem([0, 0, 110], [1140, 0, 110], rows)
    assert 2 * np.sqrt(600**2 - 200**2) < 1140 < 2 * np.sqrt(600**2 - 180**2)
    assert shortest_sequence(problem) == (0, 1)


@pytest.mark.parametrize("name", ["M30_01", "M30_07", "M100_01"])
def test_fewer_handovers_when_asked(name: str) -> None:
    problem = paper_problem(name)
    free = shortest_sequence(problem)
    graph = as_networkx(problem)
    fewest = nx.shortest_path_length(graph, "start", "end") - 2
    ground = problem.station_positions_m[:, :2]
    previous = None
    for limit in range(len(free) - 1, fewest - 1, -1):
        sequence = shortest_sequence(replace(problem, max_handovers=limit))
        assert len(sequence) - 1 <= limit
        assert len(set(sequence)) == len(sequence)
        check_sequence(problem, sequence)
        length = sum(float(np.hypot(*(ground[a] - ground[b]))) for a, b in pairwise(sequence))
        assert previous is None or length >= previous - 1e-9
        previous = length
    with pytest.raises(InfeasibleError, match=f"at least {fewest} handovers") as caught:
        shortest_sequence(replace(problem, max_handovers=fewest - 1))
    assert caught.value.infeasibility.reason == "limits"


def test_fewest_handovers_by_hand() -> None:
    """Along the row 0-1-2-3 is straight; 0-4-3 is longer and hands over once less."""
    rows = [[0, 0, 0, 520], [900, 0, 0, 520], [1800, 0, 0, 520], [2700, 0, 0, 520], [1350, 600, 0, 1100]]
    problem = make_problem([0, 0, 100], [2700, 0, 100], rows)
    assert shortest_sequence(problem) == (0, 1, 2, 3)
    assert shortest_sequence(replace(problem, max_handovers=2)) == (0, 4, 3)


def test_a_broken_chain_is_explained() -> None:
    problem = make_problem([0, 0, 100], [2000, 0, 100], [[0, 0, 0, 600], [2000, 0, 0, 600]])
    with pytest.raises(InfeasibleError) as caught:
        shortest_sequence(problem)
    assert caught.value.infeasibility.stations == (0, 1)


@pytest.mark.parametrize(
    ("sequence", "error", "said"),
    [
        ([], ProblemError, "indices from 0 to 1"),
        ([0, 2], ProblemError, "indices from 0 to 1"),
        ([-1], ProblemError, "indices from 0 to 1"),
        ([0, 0, 1], ProblemError, "cannot hand over to itself"),
        ([1], InfeasibleError, "the start is not covered by station 1"),
        ([0], InfeasibleError, "the destination is not covered by station 0"),
    ],
)
def test_sequences_that_make_no_sense(
    two_stations: Problem, sequence: list[int], error: type[Exception], said: str
) -> None:
    with pytest.raises(error, match=said):
        check_sequence(two_stations, sequence)


def test_an_end_out_of_range_says_by_how_much(two_stations: Problem) -> None:
    with pytest.raises(InfeasibleError) as caught:
        check_sequence(two_stations, [1])
    assert caught.value.infeasibility.gap_m == pytest.approx(np.hypot(1600, 100) - 1000)
    high = replace(two_stations, start_m=np.array([0, 0, 130.0]))
    with pytest.raises(InfeasibleError) as caught:
        check_sequence(high, [0, 1])
    assert caught.value.infeasibility.reason == "start_altitude"


def test_an_overlap_too_thin_to_use_has_no_gap_and_is_none() -> None:
    problem = make_problem([0, 0, 100], [1000, 0, 100], [[0, 0, 100, 500], [1000 - 5e-4, 0, 100, 500]])
    with pytest.raises(InfeasibleError, match="an overlap of less than 1 mm") as caught:
        check_sequence(problem, [0, 1])
    assert caught.value.infeasibility.gap_m == 0.0
    assert caught.value.infeasibility.position_m == pytest.approx((500.0, 0.0, 100.0), abs=1e-3)


def test_a_sequence_whose_stations_do_not_meet() -> None:
    rows = [[0, 0, 0, 600], [900, 0, 0, 600], [1800, 0, 0, 600]]
    problem = make_problem([0, 0, 100], [1800, 0, 100], rows)
    assert adjacent_pairs(problem).pairs.tolist() == [[0, 1], [1, 2]]
    with pytest.raises(InfeasibleError, match="station 0 to station 2, whose ranges are 616") as caught:
        check_sequence(problem, [0, 2])
    assert caught.value.infeasibility.gap_m == pytest.approx(1800 - 2 * np.sqrt(600**2 - 100**2))
