"""A mission's problem solved: its objective, endurance and arrival met, or a finding raised that says why not."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from gcs.errors import PlanningFailed
from gcs.layout.planning_problem import PlanningProblem, in_a_hurry, without_endurance
from gcs.layout.problem_planner import ProblemPlanner
from gcs.mission.model import Mission
from gcs.remedies.findings import ArrivalAfterEndurance, ArrivalTooEarly, EnduranceTooShort, NoTrajectory
from planner import InfeasibleError, Problem, Solution, SolverError, Trajectory

# Plans tried where a flight that starts moving is to arrive later than it could, and how near is near enough.
SLOWER_TRIES = 5
SOON_S = 2.0


def solve(laid: PlanningProblem, planner: ProblemPlanner) -> Solution:
    """The solution of a mission's problem, certified by the caller; its ``trajectory`` arrives when asked.

    Raises the findings of `gcs.remedies.findings`, and `PlanningFailed`.
    """
    mission = laid.geometry.mission
    _check_arrival(mission)
    try:
        solution = _cheapest(laid, planner) or planner.plan(without_endurance(laid.problem))
    except InfeasibleError as error:
        raise NoTrajectory(laid, error.infeasibility) from error
    except SolverError as error:
        raise PlanningFailed(f"every planning method gave up: {error}") from error
    allowed, arrival = mission.limits.allowed_s, mission.options.arrival_s
    late = solution.trajectory.duration_s > min(t for t in (allowed, arrival, math.inf) if t is not None)
    if late and (solution.fastest_s is not None or solution.overlap_cost_s > 0.0):
        # No time to give up for fewer handovers or wider overlaps.
        solution = planner.plan(in_a_hurry(laid.problem))
    duration = solution.trajectory.duration_s
    if allowed is not None and duration > allowed:
        raise EnduranceTooShort(mission, allowed_s=allowed, duration_s=duration, lower_bound_s=solution.lower_bound_s)
    if arrival is None:
        return solution
    if duration > arrival:
        raise ArrivalTooEarly(mission, arrival_s=arrival, duration_s=duration)
    # Durations add up with roundings, which an endurance of just that time would not bear.
    latest = arrival if allowed is None else min(arrival, allowed * (1.0 - 1e-12))
    return _arriving(laid, planner, solution, max(latest, duration))


def _check_arrival(mission: Mission) -> None:
    arrival, allowed = mission.options.arrival_s, mission.limits.allowed_s
    if arrival is not None and allowed is not None and arrival > allowed:
        raise ArrivalAfterEndurance(mission, arrival_s=arrival, allowed_s=allowed)


def _cheapest(laid: PlanningProblem, planner: ProblemPlanner) -> Solution | None:
    """The plan of least cost that keeps endurance and arrival; None where time is all that counts, or too short."""
    mission = laid.geometry.mission
    weight = mission.options.energy_weight
    if weight == 0.0:
        return None
    given = [t for t in (mission.limits.allowed_s, mission.options.arrival_s) if t is not None]
    limits = replace(laid.problem.limits, max_duration_s=min(given, default=None))
    try:
        return planner.plan(replace(laid.problem, limits=limits), weight)
    except InfeasibleError as error:
        if error.infeasibility.limit == "max_duration_s":
            return None
        raise
    except SolverError:
        return None


def _arriving(laid: PlanningProblem, planner: ProblemPlanner, solution: Solution, arrival_s: float) -> Solution:
    """Slowed to arrive when asked. From rest: the same path, all limits kept with more to spare.

    A start that moves fixes the speed, and with it the time scale: such a flight is planned again to save energy, by
    as much as gets it there just in time, and waits over the destination for what is left.
    """
    trajectory = solution.trajectory
    problem = laid.problem
    if not (problem.start_velocity_m_s.any() or problem.start_acceleration_m_s2.any()):
        return replace(solution, trajectory=trajectory.scale_time(arrival_s / trajectory.duration_s))
    trajectory = _slower(problem, planner, trajectory, arrival_s)
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


def _slower(problem: Problem, planner: ProblemPlanner, fastest: Trajectory, arrival_s: float) -> Trajectory:
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
            trial = planner.plan(in_a_hurry(problem), 0.5 * (top / speed) ** 3).trajectory
        except (InfeasibleError, SolverError):
            break
        # What is lost at ends and handovers; the rest is the way over the speed.
        length = trial.path_length_m()
        lost_s = trial.duration_s - length / speed
        if best.duration_s < trial.duration_s <= arrival_s:
            best = trial
    return best
