"""This planner against the paper's method, mission by mission, in the same run.

"Ours" is this planner and "fast" its fast method. The reference is the paper's decoupling approach with alternating
minimisation, written in plain cvxpy (`planner.experiments.cvxpy_reference`) with the paper's delta_T of 1 s.
``solve_s`` are processor seconds of this process, which other work on the machine does not change, from a problem to a
certified trajectory, the same span for all.
``whole_s`` goes from a mission to its plan: layout, schedule, contingencies and what the certificate says of the true
earth are in it too, which the reference does not make. ``wall_s`` is that by the watch.
"""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, TypeVar

import numpy as np

from api.bench.planner.cases import DEFAULT_OPTIONS, PAPER_OPTIONS, Case, chain, crowd, drawn, fixed
from gcs.errors import MissionInfeasible, PlanningFailed
from gcs.layout import lay_out
from gcs.mission import Mission, read_mission, with_options
from gcs.planning import default_planner, plan_mission
from planner import Method, PlannerError, Problem, Solution

__all__ = [
    "DEFAULT_OPTIONS",
    "PAPER_OPTIONS",
    "Case",
    "Result",
    "Run",
    "chain",
    "crowd",
    "drawn",
    "figures",
    "fixed",
    "mean_and_worst",
    "measure",
    "reference_available",
    "row_of",
    "timed",
    "warm_up",
]

T = TypeVar("T")


@dataclass(frozen=True)
class Run:
    """One planner's result on one mission; ``note`` is what its reader should know, e.g. that it stopped early."""

    mission_time_s: float
    solve_s: float
    handovers: int
    method: str
    whole_s: float = 0.0
    wall_s: float = 0.0
    note: str = ""


@dataclass(frozen=True)
class Result:
    """All planners on one mission. ``station_count`` is the mission's.

    ``ours`` and ``fast`` are None where this planner says that there is no plan (``infeasible`` is its reason) or fails
    (``failed`` says how); ``paper`` where the paper's method has none or was not asked.
    """

    name: str
    station_count: int
    lower_bound_s: float
    ours: Run | None
    paper: Run | None
    fast: Run | None = None
    infeasible: str | None = None
    failed: str | None = None


def reference_available() -> bool:
    """Whether cvxpy, which the reference is written in, is installed."""
    return importlib.util.find_spec("cvxpy") is not None


def timed(work: Callable[[], T]) -> tuple[T, float, float]:
    """What ``work`` returns, its processor seconds and its seconds by the watch."""
    wall, processor = time.perf_counter(), time.process_time()
    answer = work()
    return answer, time.process_time() - processor, time.perf_counter() - wall


def warm_up(*, reference: bool = True) -> None:
    """Plan a small mission every way, so that imports and first calls are not measured."""
    station = {"north_m": 0.0, "up_m": 0.0, "range_m": 1000.0}
    end = {"north_m": 0.0, "up_m": 110.0}
    document = {
        "origin": {"lat_deg": 39.96, "lon_deg": 116.32, "alt_amsl_m": 0.0},
        "start": {"east_m": 0.0, **end},
        "destination": {"east_m": 1500.0, **end},
        "stations": [{"id": "A", "east_m": 0.0, **station}, {"id": "B", "east_m": 1500.0, **station}],
        "limits": {"min_alt_amsl_m": 100.0, "max_alt_amsl_m": 120.0, "max_speed_m_s": 50.0, "max_accel_m_s2": 5.0},
    }
    measure(Case("warm-up", document), PAPER_OPTIONS, reference=reference)


def measure(case: Case, options: dict[str, Any] | None = None, *, reference: bool = True) -> Result:
    """Plan one mission every way; ``options`` go over the mission's own. ``reference``: with the paper's method.

    Raises `gcs.errors.MissionError` for a mission that cannot be read. One without a plan is a result.
    """
    mission = read_mission(case.document)
    if options is not None:
        mission = with_options(mission, options)
    count = len(mission.stations)
    try:
        ours, bound_s = _run(mission, "joint")
        fast, _ = _run(mission, "fast")
    except MissionInfeasible as error:
        return Result(case.name, count, float("nan"), None, None, infeasible=f"{error.reason}: {error.message}")
    except PlanningFailed as error:
        return Result(case.name, count, float("nan"), None, None, failed=str(error))
    return Result(case.name, count, bound_s, ours, _paper(mission) if reference else None, fast)


class _Stopwatch:
    """The shared planner; ``seconds`` is the processor time spent in it."""

    def __init__(self) -> None:
        self.seconds = 0.0

    def plan(self, problem: Problem, **how: Any) -> Solution:
        """As `planner.Planner.plan`."""
        solution, seconds, _ = timed(lambda: default_planner().plan(problem, **how))
        self.seconds += seconds
        return solution


def _run(mission: Mission, method: Method) -> tuple[Run, float]:
    """One way of ours, and the bound."""
    watch = _Stopwatch()
    plan, whole_s, wall_s = timed(lambda: plan_mission(mission, method=method, planner=watch))
    run = Run(plan.mission_time_s, watch.seconds, len(plan.handovers), plan.method, whole_s, wall_s)
    return run, plan.lower_bound_s


def _paper(mission: Mission) -> Run | None:
    from planner.experiments import plan_paper_cvxpy

    problem = lay_out(mission).problem
    try:
        solution, solve_s, wall_s = timed(lambda: plan_paper_cvxpy(problem))
    except PlannerError:
        return None
    theirs, notes = solution.trajectory, "; ".join(solution.notes)
    handovers = len(theirs.handover_times_s)
    return Run(theirs.duration_s, solve_s, handovers, solution.method, solve_s, wall_s, notes)


def figures(results: Sequence[Result]) -> dict[str, Any]:
    """All figures as JSON: each mission; mean and worst, over those that have a plan, by size and overall."""
    rows = [row_of(result) for result in results]
    counts = sorted({row["stations"] for row in rows})
    by_size = [{"stations": count, **_summary([row for row in rows if row["stations"] == count])} for count in counts]
    return {"missions": rows, "summary": by_size, "overall": _summary(rows)}


def _summary(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    entry: dict[str, Any] = {
        "missions": len(rows),
        "infeasible": sum(row["infeasible"] is not None for row in rows),
        "failed": sum(row["failed"] is not None for row in rows),
    }
    for name in ("ours", "fast", "paper"):
        runs = [row[name] for row in rows if row[name] is not None]
        entry[f"{name}_gap_percent"] = mean_and_worst([run["gap_percent"] for run in runs])
        entry[f"{name}_solve_s"] = mean_and_worst([run["solve_s"] for run in runs])
        entry[f"{name}_whole_s"] = mean_and_worst([run["whole_s"] for run in runs])
    for name in ("mission_time_ratio", "solve_time_ratio", "fast_solve_time_ratio"):
        entry[name] = mean_and_worst([row[name] for row in rows if row[name] is not None])
    return entry


def mean_and_worst(values: Sequence[float]) -> dict[str, float] | None:
    """Both, or None of no values."""
    return {"mean": float(np.mean(values)), "worst": max(values)} if values else None


def row_of(result: Result) -> dict[str, Any]:
    """One mission's figures as JSON."""

    def run(of: Run | None) -> dict[str, Any] | None:
        if of is None:
            return None
        return {**asdict(of), "gap_percent": 100.0 * (of.mission_time_s / result.lower_bound_s - 1.0)}

    def ratio(name: str, of: Run | None) -> float | None:
        return None if of is None or result.paper is None else getattr(of, name) / getattr(result.paper, name)

    return {
        "name": result.name,
        "stations": result.station_count,
        "lower_bound_s": None if result.ours is None else result.lower_bound_s,
        "ours": run(result.ours),
        "fast": run(result.fast),
        "paper": run(result.paper),
        "mission_time_ratio": ratio("mission_time_s", result.ours),
        "solve_time_ratio": ratio("solve_s", result.ours),
        "fast_solve_time_ratio": ratio("solve_s", result.fast),
        "infeasible": result.infeasible,
        "failed": result.failed,
    }
