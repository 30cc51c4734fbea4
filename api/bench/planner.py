"""Planner against the paper's method, mission by mission, in the same run.

"Ours" is `gcs.planning.plan_mission`, timed as plans report it (from a validated mission to a certified plan). The
reference is the paper's decoupling approach with alternating minimisation, written in plain cvxpy
(`planner.paper.reference`) with the paper's delta_T of 1 s, timed over the same span.
"""

from __future__ import annotations

import importlib.util
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gcs.errors import MissionInfeasible
from gcs.mission import Mission
from gcs.planning import lay_out, plan_mission

PAPER_OPTIONS = {"min_overlap_s": 0, "range_margin_m": 0, "min_tenure_s": 0}
# Table 2 of Qi, Dou and Xin 2023: stations and side of the square.
SIZES = ((30, 10_000.0), (100, 20_000.0), (300, 30_000.0))
_RANGES_M = (500.0, 1500.0)
_ALTITUDES_M = (100.0, 120.0)
_MAX_DRAWS = 10_000


@dataclass(frozen=True)
class Case:
    """One mission to measure."""

    name: str
    document: Any


@dataclass(frozen=True)
class Run:
    """One planner's result on one mission."""

    mission_time_s: float
    solve_s: float
    handovers: int
    method: str


@dataclass(frozen=True)
class Result:
    """Both planners on one mission. ``station_count`` is the mission's."""

    name: str
    station_count: int
    lower_bound_s: float
    ours: Run
    paper: Run


def reference_available() -> bool:
    """Whether cvxpy, which the reference is written in, is installed."""
    return importlib.util.find_spec("cvxpy") is not None


def fixed(documents: Sequence[tuple[str, Any]], *, quick: bool = False) -> list[Case]:
    """Missions as given; ``quick``: the first of each number of stations."""
    cases = [Case(name.removesuffix(".json"), document) for name, document in documents]
    cases.sort(key=lambda case: (_station_count(case.document), case.name))
    if not quick:
        return cases
    firsts = {_station_count(case.document): case for case in reversed(cases)}
    return [firsts[count] for count in sorted(firsts)]


def _station_count(document: Any) -> int:
    stations = document.get("stations") if isinstance(document, dict) else None
    return len(stations) if isinstance(stations, list) else 0


def drawn(count: int, seed: int) -> list[Case]:
    """``count`` new missions of each size of the paper's Table 2, the same for the same seed.

    Stations uniform in the square, ranges in [500, 1500] m, antennas on the ground, altitude 100 to 120 m, 50 m/s,
    5 m/s^2; start and destination uniform in the ranges of two stations at least half the square apart. Draws whose
    ranges do not chain together are drawn again, as a mission of the paper has a plan.
    """
    rng = np.random.default_rng(seed)
    cases = []
    for stations, side_m in SIZES:
        for number in range(1, count + 1):
            for _ in range(_MAX_DRAWS):
                document = _draw(rng, f"R{stations}_{number:02d}", stations, side_m)
                if document is not None and _has_a_way(document):
                    cases.append(Case(str(document["name"]), document))
                    break
            else:
                raise RuntimeError(f"no feasible mission of {stations} stations in {_MAX_DRAWS} draws")
    return cases


def _draw(rng: np.random.Generator, name: str, count: int, side_m: float) -> dict[str, Any] | None:
    at = rng.uniform(0.0, side_m, (count, 2))
    ranges = rng.uniform(*_RANGES_M, count)
    first, last = rng.choice(count, 2, replace=False)
    if not _chained(at, ranges, first, last):
        return None
    ends = []
    for station in (first, last):
        angle, up = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(*_ALTITUDES_M)
        radius = math.sqrt(rng.uniform() * max(0.0, ranges[station] ** 2 - up**2))
        place = at[station] + radius * np.array([math.cos(angle), math.sin(angle)])
        ends.append({"east_m": float(place[0]), "north_m": float(place[1]), "up_m": float(up)})
    apart = math.hypot(ends[0]["east_m"] - ends[1]["east_m"], ends[0]["north_m"] - ends[1]["north_m"])
    if apart < 0.5 * side_m:
        return None
    return {
        "name": name,
        "origin": {"lat_deg": 39.96, "lon_deg": 116.32, "alt_amsl_m": 0.0},
        "start": ends[0],
        "destination": ends[1],
        "stations": [
            {"id": f"S{k + 1:03d}", "east_m": float(e), "north_m": float(n), "up_m": 0.0, "range_m": float(r)}
            for k, ((e, n), r) in enumerate(zip(at, ranges, strict=True))
        ],
        "limits": {
            "min_alt_amsl_m": _ALTITUDES_M[0],
            "max_alt_amsl_m": _ALTITUDES_M[1],
            "max_speed_m_s": 50.0,
            "max_accel_m_s2": 5.0,
        },
        "options": dict(PAPER_OPTIONS),
    }


def _chained(at: Any, ranges: Any, first: int, last: int) -> bool:
    """Whether overlapping discs lead from one station to the other: most draws are sorted out here, quickly."""
    from scipy.sparse.csgraph import connected_components

    reach = np.sqrt(ranges**2 - _ALTITUDES_M[0] ** 2)
    apart = np.linalg.norm(at[:, None] - at[None], axis=-1)
    _, group = connected_components(apart < reach[:, None] + reach[None], directed=False)
    return bool(group[first] == group[last])


def _has_a_way(document: dict[str, Any]) -> bool:
    from planner.errors import InfeasibleError
    from planner.paper.station_graph import shortest_sequence

    try:
        shortest_sequence(lay_out(Mission.from_document(document)).problem)
    except (InfeasibleError, MissionInfeasible):
        return False
    return True


def warm_up() -> None:
    """Plan a small mission both ways, so that imports and first calls are not measured."""
    station = {"north_m": 0.0, "up_m": 0.0, "range_m": 1000.0}
    end = {"north_m": 0.0, "up_m": 110.0}
    document = {
        "origin": {"lat_deg": 39.96, "lon_deg": 116.32, "alt_amsl_m": 0.0},
        "start": {"east_m": 0.0, **end},
        "destination": {"east_m": 1500.0, **end},
        "stations": [{"id": "A", "east_m": 0.0, **station}, {"id": "B", "east_m": 1500.0, **station}],
        "limits": {"min_alt_amsl_m": 100.0, "max_alt_amsl_m": 120.0, "max_speed_m_s": 50.0, "max_accel_m_s2": 5.0},
    }
    measure(Case("warm-up", document))


def measure(case: Case, *, paper_options: bool = True) -> Result:
    """Plan one mission both ways.

    Raises `gcs.errors.MissionError` or `gcs.errors.MissionInfeasible` for a mission that has no plan.
    """
    from planner.paper.reference import plan_paper_cvxpy

    mission = Mission.from_document(case.document)
    if paper_options:
        mission = mission.with_options(PAPER_OPTIONS)
    plan = plan_mission(mission)
    ours = Run(plan.mission_time_s, plan.solve_time_s, len(plan.handovers), plan.method)
    started = time.perf_counter()
    solution = plan_paper_cvxpy(lay_out(mission).problem)
    seconds = time.perf_counter() - started
    theirs = solution.trajectory
    paper = Run(theirs.duration_s, seconds, len(theirs.handover_times_s), solution.method)
    return Result(case.name, len(mission.stations), plan.lower_bound_s, ours, paper)


def figures(results: Sequence[Result]) -> dict[str, Any]:
    """All figures as JSON: each mission, and mean and worst by number of stations."""
    rows = [_row(result) for result in results]
    summary = []
    for count in sorted({row["stations"] for row in rows}):
        of_size = [row for row in rows if row["stations"] == count]

        def both(values: list[float]) -> dict[str, float]:
            return {"mean": float(np.mean(values)), "worst": max(values)}

        summary.append(
            {
                "stations": count,
                "missions": len(of_size),
                "ours_gap_percent": both([r["ours"]["gap_percent"] for r in of_size]),
                "paper_gap_percent": both([r["paper"]["gap_percent"] for r in of_size]),
                "ours_solve_s": both([r["ours"]["solve_s"] for r in of_size]),
                "paper_solve_s": both([r["paper"]["solve_s"] for r in of_size]),
                "mission_time_ratio": both([r["mission_time_ratio"] for r in of_size]),
                "solve_time_ratio": both([r["solve_time_ratio"] for r in of_size]),
            }
        )
    return {"missions": rows, "summary": summary}


def _row(result: Result) -> dict[str, Any]:
    def run(of: Run) -> dict[str, Any]:
        return {
            "mission_time_s": of.mission_time_s,
            "gap_percent": 100.0 * (of.mission_time_s / result.lower_bound_s - 1.0),
            "solve_s": of.solve_s,
            "handovers": of.handovers,
            "method": of.method,
        }

    return {
        "name": result.name,
        "stations": result.station_count,
        "lower_bound_s": result.lower_bound_s,
        "ours": run(result.ours),
        "paper": run(result.paper),
        "mission_time_ratio": result.ours.mission_time_s / result.paper.mission_time_s,
        "solve_time_ratio": result.ours.solve_s / result.paper.solve_s,
    }
