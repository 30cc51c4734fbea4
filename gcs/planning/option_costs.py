"""What every option of a plan costs in seconds, found by planning again without it.

Options and limits are given up one at a time, the rest kept; what the flight is faster by is the cost. Where the
shortest time is asked for it is never negative: the plan at hand is one of the mission without the option, too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from gcs.errors import Finding, PlanningFailed
from gcs.layout.problem_planner import PlannerLike
from gcs.mission.model import Mission, MissionLimits, MissionOptions, overlap_after_target_s
from gcs.plan.model import TOGETHER, OptionCost, Plan
from gcs.planning.mission_planning import PlanningMethod, find_plan, problem_planner
from planner import Method

Step = Callable[[int, int], None]

# What may save time as well: a wind from behind, a start that moves already.
_BOTH_WAYS = ("wind", "start_state")


@dataclass(frozen=True)
class _Given:
    """An option in force, its value in words, and how to do without it."""

    option: str
    value: str
    drop: Callable[[Mission], Mission]


def with_costs(
    plan: Plan, *, method: Method = "joint", planner: PlannerLike | None = None, step: Step | None = None
) -> Plan:
    """The plan with ``costs``: one entry an option in force, and one for all of them where there are several.

    ``method`` is the one the plan was made by. ``step`` is called before every planning with how many are done and how
    many there are. The document is another one than without costs, and so is its hash.
    """
    mission, given = plan.mission, _in_force(plan.mission)
    how = PlanningMethod(problem_planner(planner, method))
    # What slows the fastest flight down hides what the others cost: they are held against the flight without it.
    slowing = [one for one in given if one.option in ("arrival_s", "overlap_target_s", "handover_tolerance")]
    others = [one for one in given if one not in slowing]
    total = len(given) + (len(given) > 1)
    done = 0

    def seconds(of: Mission) -> float | None:
        nonlocal done
        if step is not None:
            step(done, total)
        done += 1
        try:
            return find_plan(of, how).mission_time_s
        except (Finding, PlanningFailed):
            return None

    base_s: float | None = plan.mission_time_s
    costs, hurried = [], mission
    for one in slowing:
        hurried, with_s = one.drop(hurried), base_s
        base_s = seconds(hurried)
        costs.append(OptionCost(one.option, one.value, _cost_s(with_s, base_s, helps=False)))
    saving = mission.options.energy_weight > 0.0
    found: list[float] = []
    for one in others:
        helps = saving or one.option in _BOTH_WAYS
        without_s = seconds(one.drop(hurried))
        costs.append(OptionCost(one.option, one.value, _cost_s(base_s, without_s, helps=helps)))
        found += [without_s] if without_s is not None and not helps else []
    if len(given) > 1:
        free = mission
        for one in given:
            free = one.drop(free)
        helps = any(one.option in _BOTH_WAYS for one in given)
        free_s = seconds(free)
        if free_s is not None and not helps:
            # A flight without one of them is one without any.
            free_s = min([free_s, *found])
        costs.append(OptionCost(TOGETHER, "", _cost_s(plan.mission_time_s, free_s, helps=helps)))
    return replace(plan, costs=tuple(costs))


def _cost_s(with_s: float | None, without_s: float | None, *, helps: bool) -> float | None:
    """The difference; where the option cannot help, less than nothing is the planner's own error, and nothing."""
    if with_s is None or without_s is None:
        return None
    return with_s - without_s if helps else max(with_s - without_s, 0.0)


def _in_force(mission: Mission) -> list[_Given]:
    options, limits = mission.options, mission.limits
    given: list[_Given] = []

    def add(holds: object, option: str, value: str, drop: Callable[[Mission], Mission]) -> None:
        if holds:
            given.append(_Given(option, value, drop))

    add(options.min_overlap_s, "min_overlap_s", f"{options.min_overlap_s:g} s", _options(min_overlap_s=0.0))
    add(options.range_margin_m, "range_margin_m", f"{options.range_margin_m:g} m", _options(range_margin_m=0.0))
    add(options.min_tenure_s, "min_tenure_s", f"{options.min_tenure_s:g} s", _options(min_tenure_s=0.0))
    tolerance = options.handover_tolerance
    add(options.arrival_s, "arrival_s", f"{options.arrival_s} s", _options(arrival_s=None))
    target = options.overlap_target_s
    aimed = overlap_after_target_s(options, limits) > 0.5 * options.min_overlap_s
    add(aimed, "overlap_target_s", f"{target}", _options(overlap_target_s=0.0))
    add(tolerance, "handover_tolerance", f"{tolerance:g}", _options(handover_tolerance=0.0))
    for name, unit in (("max_jerk_m_s3", "m/s^3"), ("max_climb_m_s", "m/s"), ("max_descent_m_s", "m/s")):
        value = getattr(limits, name)
        add(value, name, f"{value} {unit}", _limits(**{name: None}))
    air, wind = limits.max_airspeed_m_s, limits.wind_m_s
    add(air, "max_airspeed_m_s", f"{air} m/s", _limits(max_airspeed_m_s=None, wind_m_s=None))
    if wind is not None and any(wind):
        add(air, "wind", f"{wind[0]:g} m/s east, {wind[1]:g} m/s north", _limits(wind_m_s=None))
    endurance = limits.endurance_s
    add(endurance, "endurance_s", f"{endurance} s", _limits(endurance_s=None, reserve_s=None))
    angles = [s.min_elevation_deg for s in mission.stations if s.min_elevation_deg is not None]
    add(angles, "min_elevation_deg", f"of {len(angles)} stations", _without_elevations)
    most = options.max_handovers
    add(most is not None, "max_handovers", f"{most}", _options(max_handovers=None))
    excluded = options.excluded_stations
    add(excluded, "excluded_stations", ", ".join(excluded), _options(excluded_stations=()))
    add(options.energy_weight, "objective", f"{options.objective}", _options(objective="time"))
    add(options.start_state, "start_state", "moving", _options(start_state=None))
    return given


def _options(**changes: object) -> Callable[[Mission], Mission]:
    def drop(mission: Mission) -> Mission:
        options: MissionOptions = replace(mission.options, **changes)  # type: ignore[arg-type]
        return replace(mission, options=options)

    return drop


def _limits(**changes: object) -> Callable[[Mission], Mission]:
    def drop(mission: Mission) -> Mission:
        limits: MissionLimits = replace(mission.limits, **changes)  # type: ignore[arg-type]
        return replace(mission, limits=limits)

    return drop


def _without_elevations(mission: Mission) -> Mission:
    return replace(mission, stations=tuple(replace(s, min_elevation_deg=None) for s in mission.stations))
