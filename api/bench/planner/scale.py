"""How the planner grows: long chains of stations, and routing on large maps."""

from __future__ import annotations

from typing import Any

import numpy as np

from api.bench.planner.cases import PAPER_OPTIONS, chain, crowd
from api.bench.planner.compare import measure, row_of, timed
from gcs.layout import lay_out
from gcs.mission import read_mission, with_options
from planner import Problem
from planner.corridor import build_corridor, polyline_length_m, shortest_polyline
from planner.paper import plan_paper, shortest_sequence
from planner.routing import candidate_routes, lower_bound

# What the issue of scale is usually asked with.
SEGMENTS = (100, 175)
STATIONS = (1_000, 10_000, 100_000)


def segments_row(segments: int, seed: int) -> dict[str, Any]:
    """A chain of so many stations planned every way; fields as a mission's, and ``segments``.

    ``paper_direct`` is the paper's method once more, its programs assembled without cvxpy, which fails on long chains.
    """
    case = chain(segments, seed)
    result = measure(case)
    mission = with_options(read_mission(case.document), PAPER_OPTIONS)
    row = row_of(result)
    problem = lay_out(mission).problem
    solution, solve_s, wall_s = timed(lambda: plan_paper(problem))
    duration_s = solution.trajectory.duration_s
    direct = {
        "mission_time_s": duration_s,
        "gap_percent": 100.0 * (duration_s / result.lower_bound_s - 1.0),
        "solve_s": solve_s,
        "wall_s": wall_s,
        "note": "; ".join(solution.notes),
    }
    return {"segments": segments, **row, "paper_direct": direct}


def routing_row(stations: int, seed: int) -> dict[str, Any]:
    """The best sequence through a map of so many stations.

    ``solve_s``: bound and sequence together. ``paper_solve_s``: the paper's own routing, Dijkstra on the station graph.
    ``excess_percent`` and ``paper_excess_percent``: shortest polyline along the sequence over the exact shortest path
    through the union of ranges; None where that was not found exactly.
    """
    problem = crowd(stations, seed)
    route, solve_s, wall_s = timed(lambda: candidate_routes(problem, 1)[0])
    theirs, paper_solve_s, _ = timed(lambda: shortest_sequence(problem))
    bound = lower_bound(problem)

    def excess(sequence: tuple[int, ...]) -> float | None:
        return 100.0 * (_length_m(problem, sequence) / bound.length_m - 1.0) if bound.exact else None

    return {
        "stations": stations,
        "solve_s": solve_s,
        "wall_s": wall_s,
        "paper_solve_s": paper_solve_s,
        "solve_time_ratio": solve_s / paper_solve_s,
        "handovers": len(route.sequence) - 1,
        "paper_handovers": len(theirs) - 1,
        "length_m": bound.length_m,
        "excess_percent": excess(route.sequence),
        "paper_excess_percent": excess(theirs),
    }


def _length_m(problem: Problem, sequence: tuple[int, ...]) -> float:
    return float(np.float64(polyline_length_m(shortest_polyline(problem, build_corridor(problem, sequence)))))
