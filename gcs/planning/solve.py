"""A mission solved: its objective, endurance and arrival met, or why not and what would help, in its own words."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

import numpy as np

from gcs.errors import MissionInfeasible, PlanningFailed
from gcs.geodesy.plane import Plane
from gcs.layout.planning_problem import PlanningProblem, lay_out
from gcs.mission.model import Mission
from gcs.remedies.actions import Fix, apply_fix, chains
from gcs.remedies.search import Search, lower_margin
from gcs.remedies.wording import explain, words
from planner import InfeasibleError, Method, Problem, Solution, SolverError, Trajectory
from planner.infeasibility import diagnose_ranges
from planner.infeasibility import explain as explain_problem
from planner.joint import Effort, plan_joint
from planner.routing import candidate_routes, lower_bound

# Plans tried where a flight that starts moving is to arrive later than it could, and how near is near enough.
SLOWER_TRIES = 5
SOON_S = 2.0
# In search of a start state that can be taken up; one that can takes the solver twenty or thirty steps.
START_PLANS = 40
START_EFFORT = Effort(1, 4, max_iterations=60)
# A margin is found to this many halvings of the one asked for.
MARGIN_BISECTIONS = 40


class PlannerLike(Protocol):
    """What planning needs of a planner: `planner.Planner`."""

    def plan(
        self,
        problem: Problem,
        *,
        method: Method = "joint",
        time_limit_s: float | None = None,
        energy_weight: float = 0.0,
    ) -> Solution:
        """A certified solution; raises `planner.InfeasibleError` or `planner.SolverError`."""
        ...


Run = Callable[[Problem, float], Solution]


def laid_out(mission: Mission, plane: Plane | None = None) -> PlanningProblem:
    """As `gcs.layout.planning_problem.lay_out`; a margin that leaves no range comes with the largest one that does."""
    try:
        return lay_out(mission, plane)
    except MissionInfeasible as error:
        if error.fix is not None:
            raise
        raise _margin_refused(mission, error) from None


def solve(laid: PlanningProblem, planner: PlannerLike, method: Method, time_limit_s: float | None) -> Solution:
    """The solution of a mission's problem, certified by the caller; its ``trajectory`` arrives when asked.

    Raises `MissionInfeasible`, with the least that would help, and `PlanningFailed`.
    """

    def run(problem: Problem, energy_weight: float) -> Solution:
        return planner.plan(problem, method=method, time_limit_s=time_limit_s, energy_weight=energy_weight)

    mission = laid.geometry.mission
    _refuse_late_arrival(mission)
    try:
        solution = _cheapest(laid, run) or run(_unhurried(laid.problem), 0.0)
    except InfeasibleError as error:
        finding = error.infeasibility
        if finding.reason == "limits" and mission.options.start_state is not None and finding.fix is not None:
            limit = finding.fix.get("limit")
            if limit != "max_handovers":
                raise _start_refused(mission, run, finding.message, limit) from error
        raise explain(laid.geometry, laid.stations, finding, laid.problem.ranges_m) from error
    except SolverError as error:
        raise PlanningFailed(f"every planning method gave up: {error}") from error
    allowed, arrival = _allowed_s(mission), mission.options.arrival_s
    if solution.trajectory.duration_s > min(t for t in (allowed, arrival, math.inf) if t is not None):
        # No time to give up for fewer handovers.
        solution = run(_hurried(laid.problem), 0.0)
    duration = solution.trajectory.duration_s
    if allowed is not None and duration > allowed:
        raise _endurance_refused(mission, run, solution, allowed)
    if arrival is not None and duration > arrival:
        raise _arrival_refused(mission, run, solution, arrival)
    if arrival is None:
        return solution
    # Durations add up with roundings, which an endurance of just that time would not bear.
    latest = arrival if allowed is None else min(arrival, allowed * (1.0 - 1e-12))
    return _arriving(laid, run, solution, max(latest, duration))


def _allowed_s(mission: Mission) -> float | None:
    limits = mission.limits
    return None if limits.endurance_s is None else limits.endurance_s - (limits.reserve_s or 0.0)


def _unhurried(problem: Problem) -> Problem:
    """Without its endurance: how long a flight takes is only known when there is one."""
    return replace(problem, limits=replace(problem.limits, max_duration_s=None))


def _hurried(problem: Problem) -> Problem:
    """As `_unhurried`, and the fastest plan whatever its handovers."""
    return replace(_unhurried(problem), handover_tolerance=0.0, overlap_after_target_s=0.0)


def _cheapest(laid: PlanningProblem, run: Run) -> Solution | None:
    """The plan of least cost that keeps endurance and arrival; None where time is all that counts, or too short."""
    mission = laid.geometry.mission
    weight = mission.options.energy_weight
    if weight == 0.0:
        return None
    given = [t for t in (_allowed_s(mission), mission.options.arrival_s) if t is not None]
    limits = replace(laid.problem.limits, max_duration_s=min(given, default=None))
    try:
        return run(replace(laid.problem, limits=limits), weight)
    except InfeasibleError as error:
        fix = error.infeasibility.fix
        if fix is not None and fix.get("limit") == "max_duration_s":
            return None
        raise
    except SolverError:
        return None


def _planned_s(mission: Mission, run: Run) -> float:
    """How long the fastest plan of a mission takes; infinite when it has none."""
    try:
        return run(_hurried(lay_out(mission).problem), 0.0).trajectory.duration_s
    except (InfeasibleError, SolverError):
        return math.inf


def _with_alternatives(fix: Fix, alternatives: list[Fix]) -> Fix:
    return {**fix, "alternatives": alternatives} if alternatives else fix


def _endurance_refused(mission: Mission, run: Run, solution: Solution, allowed_s: float) -> MissionInfeasible:
    duration, reserve = solution.trajectory.duration_s, mission.limits.reserve_s or 0.0
    missing = duration - allowed_s
    search = Search(mission, lambda m: _planned_s(m, run) - allowed_s, missing)
    needed = duration + reserve + 1e-6
    fix: Fix = {"action": "raise_limit", "limit": "endurance_s", "by": missing, "to": needed}
    alternatives: list[Fix] = []
    if reserve > missing:
        lowered = reserve - missing - 1e-6
        alternatives.append({"action": "lower_limit", "limit": "reserve_s", "by": missing, "to": lowered})
    fix = _with_alternatives(fix, [*alternatives, *search.time_fixes()])
    proven = f"; no flight takes less than {solution.lower_bound_s:.1f} s" if solution.lower_bound_s > allowed_s else ""
    less = f" less the reserve of {reserve:g} s" if reserve else ""
    return MissionInfeasible(
        "limits",
        f"The endurance{less} allows {allowed_s:.1f} s and the fastest plan takes {duration:.1f} s, "
        f"{missing:.1f} s too long{proven}.",
        fix=fix,
        fix_text=words(fix),
    )


def _arrival_refused(mission: Mission, run: Run, solution: Solution, arrival_s: float) -> MissionInfeasible:
    duration = solution.trajectory.duration_s
    missing = duration - arrival_s
    search = Search(mission, lambda m: _planned_s(m, run) - arrival_s, missing)
    fix: Fix = {"action": "later_arrival", "by_s": missing, "arrival_s": duration + 1e-6}
    fix = _with_alternatives(fix, search.time_fixes())
    return MissionInfeasible(
        "arrival",
        f"The fastest plan takes {duration:.1f} s, but arrival is asked for at {arrival_s:g} s, "
        f"{missing:.1f} s earlier.",
        fix=fix,
        fix_text=words(fix),
    )


def _margin_refused(mission: Mission, error: MissionInfeasible) -> MissionInfeasible:
    margin = mission.options.range_margin_m
    fix: Fix = lower_margin(margin, 0.0)
    bare = apply_fix(mission, fix)
    if chains(bare):
        low, high = 0.0, margin
        for _ in range(MARGIN_BISECTIONS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if chains(apply_fix(mission, lower_margin(margin, middle))) else (low, middle)
        fix = lower_margin(margin, low)
    else:
        # Not even no margin would do: what else is wrong comes on top.
        laid = lay_out(bare)
        finding = diagnose_ranges(laid.problem)
        more = None if finding is None else explain(laid.geometry, laid.stations, finding, laid.problem.ranges_m).fix
        if more is not None:
            further = more.pop("also", [])
            more.pop("alternatives", None)
            fix["also"] = [more, *(further if isinstance(further, list) else [])]
    return MissionInfeasible(
        error.reason, error.message, stations=error.stations, gap_m=error.gap_m, fix=fix, fix_text=words(fix)
    )


def _refuse_late_arrival(mission: Mission) -> None:
    arrival, allowed = mission.options.arrival_s, _allowed_s(mission)
    if arrival is None or allowed is None or arrival <= allowed:
        return
    missing, reserve = arrival - allowed, mission.limits.reserve_s or 0.0
    fix: Fix = {"action": "earlier_arrival", "by_s": missing, "arrival_s": allowed}
    needed = arrival + reserve
    alternatives: list[Fix] = [{"action": "raise_limit", "limit": "endurance_s", "by": missing, "to": needed}]
    if reserve > missing:
        alternatives.append({"action": "lower_limit", "limit": "reserve_s", "by": missing, "to": reserve - missing})
    fix = _with_alternatives(fix, alternatives)
    raise MissionInfeasible(
        "endurance",
        f"Arrival at {arrival:g} s is {missing:.1f} s later than the {allowed:g} s that endurance less reserve allow.",
        fix=fix,
        fix_text=words(fix),
    )


def _start_refused(mission: Mission, run: Run, message: str, limit: object) -> MissionInfeasible:
    def possible(changed: Mission) -> bool:
        # What breaks a limit is seen at once, and what does not is soon planned; else a quick look has to do.
        return _can_start(changed) if limit is None else math.isfinite(_planned_s(changed, run))

    search = Search(mission, lambda m: -1.0 if possible(m) else math.inf, math.inf, plans=START_PLANS)
    fixes = search.start_fixes(None if limit is None else str(limit))
    fix = _with_alternatives(fixes[0], fixes[1:]) if fixes else None
    start = mission.start
    where = {name: float(value) for name, value in vars(start).items()}
    if mission.origin is not None:
        place = lay_out(mission).geometry.geo(np.array([where["east_m"], where["north_m"], where["up_m"]]))
        where |= {name: float(value) for name, value in vars(place).items()}
    return MissionInfeasible(
        "limits",
        message[:1].upper() + message[1:].rstrip(".") + ".",
        where=where,
        fix=fix,
        fix_text="" if fix is None else words(fix),
    )


def _can_start(mission: Mission) -> bool:
    """Whether a quick look finds a way to take up the start state, along the sequence that looks best.

    Finding none takes a solver far longer than finding one: it is given few steps, and one try.
    """
    problem = _unhurried(lay_out(mission).problem)
    bound = lower_bound(problem)
    if explain_problem(problem, bound) is not None:
        return False
    (route,) = candidate_routes(problem, 1, bound=bound)
    return plan_joint(problem, route.sequence, START_EFFORT, starts=1) is not None


def _arriving(laid: PlanningProblem, run: Run, solution: Solution, arrival_s: float) -> Solution:
    """Slowed to arrive when asked. From rest: the same path, all limits kept with more to spare.

    A start that moves fixes the speed, and with it the time scale: such a flight is planned again to save energy, by
    as much as gets it there just in time, and waits over the destination for what is left.
    """
    trajectory = solution.trajectory
    problem = laid.problem
    if not (problem.start_velocity_m_s.any() or problem.start_acceleration_m_s2.any()):
        return replace(solution, trajectory=trajectory.scale_time(arrival_s / trajectory.duration_s))
    trajectory = _slower(problem, run, trajectory, arrival_s)
    left_s = arrival_s - trajectory.duration_s
    if left_s <= 1e-9:
        return replace(solution, trajectory=trajectory)
    waiting = Trajectory(
        np.concatenate([trajectory.control_points_m, np.tile(problem.destination_m, (1, trajectory.degree + 1, 1))]),
        np.append(trajectory.durations_s, left_s),
        np.append(trajectory.station_index, trajectory.station_index[-1]),
    )
    note = f"waits {left_s:.1f} s over the destination to arrive when asked"
    return replace(solution, trajectory=waiting, notes=(*solution.notes, note))


def _slower(problem: Problem, run: Run, fastest: Trajectory, arrival_s: float) -> Trajectory:
    """The slowest plan found that is not later than ``arrival_s``: one that saves energy cruises slower.

    At v_max (2 w)^(-1/3) for a weight w above 1/2 (`planner.energy`), so the weight follows from the speed wanted.
    """
    best, top = fastest, problem.limits.max_speed_m_s
    length, lost_s = fastest.path_length_m(), 0.0
    for _ in range(SLOWER_TRIES):
        if arrival_s - best.duration_s < SOON_S:
            break
        speed = min(length / max(arrival_s - lost_s - 0.5 * SOON_S, 1e-3), top)
        try:
            trial = run(_hurried(problem), 0.5 * (top / speed) ** 3).trajectory
        except (InfeasibleError, SolverError):
            break
        # What is lost at ends and handovers; the rest is the way over the speed.
        length = trial.path_length_m()
        lost_s = trial.duration_s - length / speed
        if best.duration_s < trial.duration_s <= arrival_s:
            best = trial
    return best
