"""What each option and limit costs: mission seconds over the paper's own problem, mission by mission."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from api.bench.planner.cases import DEFAULT_OPTIONS, PAPER_OPTIONS, Case
from api.bench.planner.compare import mean_and_worst, timed
from gcs.errors import MissionError, MissionInfeasible
from gcs.mission import Mission, read_mission, with_options, write_mission
from gcs.plan import Plan
from gcs.planning import plan_mission


@dataclass(frozen=True)
class Change:
    """What is asked for on top; ``of`` makes the document's changes from the plan without it.

    Returns sections of the mission document to be updated, or None where the plan leaves nothing to ask for.
    """

    name: str
    of: Callable[[Plan], dict[str, Any] | None]


def _options(**options: Any) -> Callable[[Plan], dict[str, Any] | None]:
    return lambda plan: {"options": options}


def _limits(**limits: Any) -> Callable[[Plan], dict[str, Any] | None]:
    return lambda plan: {"limits": limits}


def _fewer_handovers(plan: Plan) -> dict[str, Any] | None:
    return {"options": {"max_handovers": len(plan.handovers) - 1}} if plan.handovers else None


def _without_longest(plan: Plan) -> dict[str, Any]:
    """Without the station in control the longest."""
    curve = plan.trajectory
    held = np.bincount(curve.station_index, weights=curve.durations_s)
    return {"options": {"excluded_stations": [plan.mission.stations[int(held.argmax())].id]}}


def _headwind(plan: Plan) -> dict[str, Any]:
    """10 m/s against the straight line, and an airspeed limit as high as the speed's."""
    first, last = plan.trajectory.control_points_m[0, 0], plan.trajectory.control_points_m[-1, -1]
    ahead = (last - first)[:2] / max(float(np.linalg.norm((last - first)[:2])), 1e-9)
    wind = {"east_m_s": -10.0 * float(ahead[0]), "north_m_s": -10.0 * float(ahead[1])}
    return {"limits": {"max_airspeed_m_s": plan.mission.limits.max_speed_m_s, "wind": wind}}


def _masks(plan: Plan) -> dict[str, Any]:
    return {"stations": {"min_elevation_deg": 5.0}}


CHANGES = (
    Change("min_overlap_s 5", _options(min_overlap_s=DEFAULT_OPTIONS["min_overlap_s"])),
    Change("range_margin_m 25", _options(range_margin_m=DEFAULT_OPTIONS["range_margin_m"])),
    Change("min_tenure_s 10", _options(min_tenure_s=DEFAULT_OPTIONS["min_tenure_s"])),
    Change("all three, the defaults", _options(**DEFAULT_OPTIONS)),
    Change("max_jerk_m_s3 5", _limits(max_jerk_m_s3=5.0)),
    Change("max_climb_m_s 1, max_descent_m_s 1", _limits(max_climb_m_s=1.0, max_descent_m_s=1.0)),
    Change("10 m/s of headwind, airspeed limited", _headwind),
    Change("min_elevation_deg 5 everywhere", _masks),
    Change("max_handovers, one less than planned", _fewer_handovers),
    Change("excluded_stations, the one longest in control", _without_longest),
    Change("objective 0.5", _options(objective=0.5)),
    Change("objective energy", _options(objective="energy")),
)


def measure_costs(cases: Sequence[Case], *, tell: Callable[[str], None] = lambda text: None) -> list[dict[str, Any]]:
    """A row a change: ``cost_s`` and ``solve_s`` with mean and worst over the missions that have a plan with it.

    Raises what planning a mission of ``cases`` without any change raises.
    """
    costs: dict[str, list[float]] = {change.name: [] for change in CHANGES}
    seconds: dict[str, list[float]] = {change.name: [] for change in CHANGES}
    infeasible, refused = dict.fromkeys(costs, 0), dict.fromkeys(costs, 0)
    for number, case in enumerate(cases, start=1):
        tell(f"{number} of {len(cases)}: {case.name}, {len(CHANGES)} options")
        plain = with_options(read_mission(case.document), PAPER_OPTIONS)
        base = plan_mission(plain)
        for change in CHANGES:
            changes = change.of(base)
            if changes is None:
                continue
            try:
                mission = _changed(plain, changes)
                plan, solve_s, _ = timed(partial(plan_mission, mission))
            except MissionInfeasible:
                infeasible[change.name] += 1
                continue
            except MissionError:  # something this version does not offer
                refused[change.name] += 1
                continue
            costs[change.name].append(plan.mission_time_s - base.mission_time_s)
            seconds[change.name].append(solve_s)
    return [
        {
            "option": name,
            "missions": len(costs[name]),
            "infeasible": infeasible[name],
            "refused": refused[name],
            "cost_s": mean_and_worst(costs[name]),
            "solve_s": mean_and_worst(seconds[name]),
        }
        for name in costs
    ]


def _changed(mission: Mission, changes: dict[str, Any]) -> Mission:
    document = write_mission(mission)
    for section, values in changes.items():
        part = document[section]
        if isinstance(part, list):
            document[section] = [{**entry, **values} for entry in part]
        else:
            assert isinstance(part, dict)
            document[section] = {**part, **values}
    return read_mission(document)
