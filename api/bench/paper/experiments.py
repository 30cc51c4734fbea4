"""The experiments of the seed paper (Qi, Dou and Xin 2023), mission by mission, with our planner beside them.

Table 3: the decoupling approach DC (Dijkstra's sequence, then alternating minimisation AM with delta_T = 1 s) against
EM, the enumeration of all sequences. Table 4: AM against seven other optimisers over the durations, each given the
same time.

Work comes in units that are measured, kept and skipped one by one (`api.bench.paper.results`): ``plans`` is this
planner and DC beside each other, ``enumeration`` is EM, ``allocation`` is one method of Table 4. All times are
processor seconds of one process, so that other work on the machine does not shorten a time limit; the limits of EM and
of Table 4's methods are processor seconds too.
"""

from __future__ import annotations

import importlib.util
import os
import platform
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from api.bench.paper.results import Results, fingerprint
from api.bench.planner import PAPER_OPTIONS, Case, mean_and_worst
from gcs.layout import lay_out
from gcs.mission import Mission, read_mission, with_options
from gcs.planning import plan_mission, product_version
from planner import Problem, SolverError, Trajectory
from planner.experiments import Evaluation, enumerate_plans
from planner.paper import Iteration, plan_paper

# The order of the paper's Table 4.
RIVALS = ("COBYLA", "BOBYQA", "NEWUOA-BOUND", "PRAXIS", "NELDERMEAD", "SBPLX", "BGD")
ALLOCATIONS = (*RIVALS, "AM")
DELTA_T_S = 1.0
DEGREE = 5
# How EM goes through the sequences; what was measured with another order is not taken for this one's.
EM_ORDER = "best first"


@dataclass(frozen=True)
class Settings:
    """``time_limit_s`` bounds EM on one mission, ``rival_limit_s`` each method of Table 4, both processor seconds."""

    time_limit_s: float = 60.0
    rival_limit_s: float = 3.0


@dataclass(frozen=True)
class Unit:
    """One measurement of one mission; ``name`` and ``settings`` are its key in the results."""

    name: str
    settings: dict[str, Any]
    title: str
    measure: Callable[[Mission, Problem], dict[str, Any]]


def nlopt_available() -> bool:
    """Whether NLopt, which six of the rivals come from, is installed."""
    return importlib.util.find_spec("nlopt") is not None


def machine() -> dict[str, Any]:
    """Where measurements were made, as far as times depend on it."""
    return {
        "cores": os.cpu_count(),
        "architecture": platform.machine(),
        "processor": _processor(),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "skyrelay": product_version(),
    }


def units(settings: Settings) -> list[Unit]:
    """All measurements of one mission, in the order they are made."""
    found = [
        Unit("plans", {"delta_t_s": DELTA_T_S}, "this planner and DC", _plans),
        Unit(
            "enumeration",
            {"time_limit_s": settings.time_limit_s, "delta_t_s": DELTA_T_S, "order": EM_ORDER},
            f"EM, {settings.time_limit_s:g} s",
            lambda _, problem: _enumeration(problem, settings.time_limit_s),
        ),
    ]
    for method in ALLOCATIONS:

        def measure(_: Mission, problem: Problem, method: str = method) -> dict[str, Any]:
            return _allocation(problem, method, settings.rival_limit_s)

        own = {"method": method, "time_limit_s": settings.rival_limit_s}
        found.append(Unit("allocation", own, f"{method}, {settings.rival_limit_s:g} s", measure))
    return found


def run(
    cases: Sequence[Case],
    settings: Settings,
    results: Results,
    *,
    again: Sequence[str] = (),
    kept_only: bool = False,
    tell: Callable[[str], None] = lambda text: None,
) -> list[dict[str, Any]]:
    """Measure what ``results`` lacks, and units named in ``again`` anew; a row of everything for each mission.

    ``kept_only``: measure nothing but ``again``. Missions of which Table 4 is not complete are then left out, and
    ``enumeration`` is None where there is none yet. ``longer`` is the enumeration under the longest limit, if longer
    than asked.

    Raises what `read_mission` and the planners raise for a mission that cannot be used.
    """
    here = machine()
    rows = []
    for number, case in enumerate(cases, start=1):
        key = fingerprint(case.document)
        mission = with_options(read_mission(case.document), PAPER_OPTIONS)
        problem = lay_out(mission).problem
        measured: dict[str, Any] = {"name": case.name, "stations": len(mission.stations), "allocations": {}}
        measured["enumeration"] = measured["longer"] = None
        lacking = set()
        for unit in units(settings):
            found = results.get(unit.name, key, unit.settings)
            if found is None and unit.name == "enumeration":
                found = _finished(results, key)
            if found is None and kept_only and unit.name not in again:
                lacking.add(unit.name)
                continue
            if found is None or unit.name in again:
                tell(f"{number} of {len(cases)}: {case.name}, {unit.title}")
                found = unit.measure(mission, problem)
                results.add(unit.name, key, unit.settings, found, name=case.name, machine=here)
            if unit.name == "allocation":
                measured["allocations"][unit.settings["method"]] = found
            else:
                measured[unit.name] = found
        if not (measured["enumeration"] or {}).get("complete"):
            measured["longer"] = _longest(results, key, settings.time_limit_s)
        if lacking <= {"enumeration"}:
            rows.append(measured)
    return rows


def _finished(results: Results, mission: str) -> dict[str, Any] | None:
    """An enumeration that came to its end under another time limit is the same under every limit it kept."""
    return next((measured for _, measured in _enumerations(results, mission) if measured["complete"]), None)


def _enumerations(results: Results, mission: str) -> list[tuple[float, dict[str, Any]]]:
    """The enumerations made as today's are, each with its time limit."""
    return [
        (settings["time_limit_s"], measured)
        for settings, measured in results.of("enumeration", mission)
        if (settings["delta_t_s"], settings.get("order")) == (DELTA_T_S, EM_ORDER)
    ]


def _longest(results: Results, mission: str, time_limit_s: float) -> dict[str, Any] | None:
    """The enumeration under the longest limit of those longer than ``time_limit_s``, and that ``time_limit_s``."""
    longer = [(limit_s, measured) for limit_s, measured in _enumerations(results, mission) if limit_s > time_limit_s]
    if not longer:
        return None
    limit_s, measured = max(longer, key=lambda one: one[0])
    return {**measured, "time_limit_s": limit_s}


# -- the measurements --------------------------------------------------------------------------------------------------


def _plans(mission: Mission, problem: Problem) -> dict[str, Any]:
    started = time.process_time()
    plan = plan_mission(mission)
    seconds = time.process_time() - started
    started = time.process_time()
    decoupled = plan_paper(problem, delta_t_s=DELTA_T_S)
    paper_seconds = time.process_time() - started
    return {
        "lower_bound_s": plan.lower_bound_s,
        "ours": _run(plan.trajectory, seconds, plan.method),
        "decoupling": _run(decoupled.trajectory, paper_seconds, "paper"),
    }


def _run(trajectory: Trajectory, seconds: float, method: str) -> dict[str, Any]:
    return {
        "mission_time_s": trajectory.duration_s,
        "cpu_s": seconds,
        "method": method,
        "sequence": list(trajectory.sequence),
        "curve": _curve(trajectory),
    }


def _enumeration(problem: Problem, time_limit_s: float) -> dict[str, Any]:
    """EM up to the limit. ``found_s`` are the mission times of all sequences planned, DC's first, in their order."""
    found: list[float] = []
    last: Evaluation | None = None
    complete = True
    for last in enumerate_plans(problem, delta_t_s=DELTA_T_S, clock=time.process_time):
        if np.isfinite(last.mission_time_s):
            found.append(last.mission_time_s)
        if last.elapsed_s >= time_limit_s:
            complete = False
            break
    if last is None or last.best is None:
        raise SolverError("no sequence of stations was planned")
    return {
        "mission_time_s": last.best.trajectory.duration_s,
        "sequence": list(last.best.trajectory.sequence),
        "cpu_s": last.elapsed_s,
        "planned": last.planned,
        "pruned": last.pruned,
        "complete": complete,
        "rank_dc": 1 + sum(seconds < found[0] for seconds in found),
        "found_s": [round(seconds, 3) for seconds in found],
    }


def _allocation(problem: Problem, method: str, time_limit_s: float) -> dict[str, Any]:
    from planner.experiments import plan_by_rival

    record: list[Iteration] = []
    started = time.process_time()
    if method == "AM":
        # Threshold zero: an iteration that gains nothing would only repeat itself.
        solution = plan_paper(
            problem, delta_t_s=0.0, max_runtime_s=time_limit_s, record=record, clock=time.process_time
        )
    else:
        solution = plan_by_rival(problem, method, time_limit_s=time_limit_s, record=record, clock=time.process_time)
    return {
        "mission_time_s": solution.trajectory.duration_s,
        "cpu_s": time.process_time() - started,
        "evaluations": solution.iterations,
        "convergence": thinned([[round(entry.elapsed_s, 4), round(entry.mission_time_s, 4)] for entry in record]),
        # Seldom less than a second a piece: centimetres draw an acceleration well.
        "curve": _curve(solution.trajectory, decimals=2),
    }


def thinned(convergence: list[list[float]], gain_s: float = 0.01) -> list[list[float]]:
    """Points (elapsed, mission time) that gain at least ``gain_s`` over the one kept before, and the last."""
    kept = convergence[:1]
    for point in convergence[1:]:
        if kept[-1][1] - point[1] >= gain_s or point is convergence[-1]:
            kept.append(point)
    return kept


def _curve(trajectory: Trajectory, decimals: int = 5) -> dict[str, Any]:
    """A trajectory for drawing, its numbers rounded."""
    return {
        "control_points_m": np.round(trajectory.control_points_m, decimals).tolist(),
        "durations_s": np.round(trajectory.durations_s, max(3, decimals)).tolist(),
        "stations": trajectory.station_index.tolist(),
    }


def curve_of(document: dict[str, Any]) -> Trajectory:
    """The trajectory of a kept curve, as it was rounded."""
    return Trajectory(
        np.array(document["control_points_m"]),
        np.array(document["durations_s"]),
        np.array(document["stations"], dtype=np.int64),
    )


def _processor() -> str:
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as file:
            return next(line.split(":", 1)[1].strip() for line in file if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor()


# -- the tables --------------------------------------------------------------------------------------------------------


def table_3(rows: Sequence[dict[str, Any]], which: str = "enumeration") -> list[dict[str, Any]]:
    """Rows of Table 3: decoupling against enumeration (None where it was not measured), and this planner.

    ``which``: ``"longer"`` for the enumerations under a longer limit, of the missions that have one.
    """
    found = []
    for row in rows:
        if which == "longer" and row["longer"] is None:
            continue
        plans, em = row["plans"], row[which] or {}
        found.append(
            {
                "name": row["name"],
                "stations": row["stations"],
                "lower_bound_s": plans["lower_bound_s"],
                "sequences": {"em": em.get("planned"), "em_pruned": em.get("pruned"), "dc": 1},
                "mission_time_s": {
                    "em": em.get("mission_time_s"),
                    "dc": plans["decoupling"]["mission_time_s"],
                    "ours": plans["ours"]["mission_time_s"],
                },
                "rank_dc": em.get("rank_dc"),
                "complete": em.get("complete"),
                "time_limit_s": em.get("time_limit_s"),
                "cpu_s": {
                    "em": em.get("cpu_s"),
                    "dc": plans["decoupling"]["cpu_s"],
                    "ours": plans["ours"]["cpu_s"],
                },
            }
        )
    return found


def table_4(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows of Table 4: the lower level's mission times by eight methods, and this planner's."""
    found = []
    for row in rows:
        segments = len(row["plans"]["decoupling"]["sequence"])
        times = {method: row["allocations"][method]["mission_time_s"] for method in ALLOCATIONS}
        found.append(
            {
                "name": row["name"],
                "stations": row["stations"],
                # Durations, and three coordinates of six control points a segment.
                "variables": {"T": segments, "P": 3 * (DEGREE + 1) * segments},
                "lower_bound_s": row["plans"]["lower_bound_s"],
                "mission_time_s": {**times, "ours": row["plans"]["ours"]["mission_time_s"]},
                "ours_cpu_s": row["plans"]["ours"]["cpu_s"],
            }
        )
    return found


def summary(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Mean gap to the bound in per cent of every method, by number of stations."""
    found = []
    for count in sorted({row["stations"] for row in rows}):
        mine = [row for row in rows if row["stations"] == count]

        def gap(name: str, mine: list[dict[str, Any]] = mine) -> dict[str, float] | None:
            times = [(mission_times(row).get(name), row["plans"]["lower_bound_s"]) for row in mine]
            return mean_and_worst([100.0 * (time / bound - 1.0) for time, bound in times if time is not None])

        found.append(
            {
                "stations": count,
                "missions": len(mine),
                "gap_percent": {name: gap(name) for name in ("ours", "EM", "DC", *ALLOCATIONS)},
                "complete_enumerations": sum(
                    bool(row["enumeration"] and row["enumeration"]["complete"]) for row in mine
                ),
            }
        )
    return found


def mission_times(row: dict[str, Any]) -> dict[str, float]:
    """Every method's mission time of one mission in seconds; without EM where that was not measured."""
    times = {
        "ours": row["plans"]["ours"]["mission_time_s"],
        "DC": row["plans"]["decoupling"]["mission_time_s"],
        **{method: found["mission_time_s"] for method, found in row["allocations"].items()},
    }
    return times if row["enumeration"] is None else {**times, "EM": row["enumeration"]["mission_time_s"]}
