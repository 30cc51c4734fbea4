"""From a corridor and a polyline through it to the fastest curve.

`solve_corridor` wraps `planner.joint.program` (scaling, constraints, first guess) and `planner.joint.interior_point`.
Its answer is a local optimum of the joint problem over positions and times, with a tolerance taken off every limit, so
that the certificate holds at zero tolerance in spite of rounding.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from planner.arrays import Array
from planner.corridor.corridor import Corridor
from planner.errors import SolverError
from planner.joint import control_rows
from planner.joint.interior_point import CAREFUL, InteriorPointResult, Start, minimise_duration
from planner.joint.objective import Objective
from planner.joint.program import Scale, build_program, feasibility_of, first_guess, guess_from, scale_of
from planner.joint.transcription import Transcription
from planner.problem import Problem
from planner.trajectory import Trajectory


@dataclass(frozen=True)
class CorridorSolution:
    """``trajectory`` in metres and seconds; ``converged`` says whether it is a local optimum within the tolerance.

    An unconverged answer may still pass `planner.certify`: let that decide. ``iterations`` counts all attempts'.
    """

    trajectory: Trajectory
    iterations: int
    converged: bool


def solve_corridor(
    problem: Problem,
    corridor: Corridor,
    waypoints_m: Array | None = None,
    *,
    start_trajectory: Trajectory | None = None,
    energy_weight: float = 0.0,
    tolerance: float = 1e-4,
    max_iterations: int = 150,
) -> CorridorSolution:
    """The fastest curve of degree 5 along ``corridor``, one piece per piece of it, near the polyline given.

    ``waypoints_m`` ``(K + 1, 3)`` has one point per joint, both ends included, each inside its joint's balls
    (`place_joints` makes them). ``start_trajectory`` is a curve of degree up to 5 with as many pieces to start from
    instead: a plan to refine, or to adapt to changed limits. If that leads nowhere, the polyline flown at speed is
    tried, with much room at first, then with little, then carefully, and at last the polyline flown from rest to rest.

    With ``energy_weight`` w, the time plus w times the integral of |a|^2 / a_max^2 + |v|^3 / v_max^3 is minimised: a
    vehicle that needs as much power again for full acceleration and for drag at full speed as it needs to stay aloft
    has w = 1.

    Raises `SolverError` when the numbers break down in every attempt, ``ValueError`` for a start that does not fit. An
    infeasible or unconverged answer is returned as it is, the least violated one.
    """
    if start_trajectory is not None:
        start_trajectory = _as_start(corridor, start_trajectory)
    waypoints_m = _as_waypoints(corridor, waypoints_m, start_trajectory)
    scale = scale_of(problem, waypoints_m)
    program = build_program(problem, corridor, scale, waypoints_m, energy=energy_weight > 0.0)
    feasibility = feasibility_of(problem, corridor, scale)
    best: InteriorPointResult | None = None
    iterations = 0
    for start in _starts(problem, program, scale, waypoints_m, start_trajectory):
        objective = _objective(problem, program, scale, start, energy_weight)
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            result = minimise_duration(
                program, objective, start, tolerance=tolerance, feasibility=feasibility, max_iterations=max_iterations
            )
        iterations += result.iterations
        if not np.isfinite(result.violation):
            continue
        if best is None or result.converged or result.violation < best.violation:
            best = result
        if result.converged:
            break
    if best is None:
        raise SolverError("the joint problem diverged from every start")
    return CorridorSolution(_trajectory(problem, corridor, program, scale, best), iterations, best.converged)


def _starts(
    problem: Problem, program: Transcription, scale: Scale, waypoints_m: Array, trajectory: Trajectory | None
) -> Iterator[Start]:
    """Where to start from, in this order; the more trusted a start is, the closer to the constraints it may begin."""
    if trajectory is not None:
        yield Start(*guess_from(program, scale, trajectory), barrier=1e-3, slack=1e-3)
    at_speed = first_guess(problem, program, scale, waypoints_m)
    yield Start(*at_speed, barrier=3e-3, slack=0.1)
    yield Start(*at_speed, barrier=0.01, slack=1e-2)
    yield Start(*at_speed, barrier=0.01, slack=1e-2, rule=CAREFUL)
    at_rest = first_guess(problem, program, scale, waypoints_m, at_rest=True)
    yield Start(*at_rest, barrier=0.2, slack=1e-2, rule=CAREFUL)


def _objective(problem: Problem, program: Transcription, scale: Scale, start: Start, energy_weight: float) -> Objective:
    """What is minimised from ``start``, whose durations set the pace."""
    return Objective(
        program.table,
        start.x[0::10],
        energy_weight=energy_weight,
        speed=problem.limits.max_speed_m_s / scale.speed_m_s,
        accel=problem.limits.max_accel_m_s2 / scale.accel_m_s2,
    )


def _as_waypoints(corridor: Corridor, waypoints_m: Array | None, trajectory: Trajectory | None) -> Array:
    """One point per joint ``(K + 1, 3)``: those given, or the joints of the trajectory to start from."""
    if waypoints_m is None:
        if trajectory is None:
            raise ValueError("waypoints_m or start_trajectory must be given")
        waypoints_m = np.concatenate([trajectory.control_points_m[:, 0], trajectory.control_points_m[-1:, -1]])
    waypoints_m = np.asarray(waypoints_m, dtype=float)
    if waypoints_m.shape != (len(corridor) + 1, 3):
        raise ValueError(f"waypoints_m must be ({len(corridor) + 1}, 3), not {waypoints_m.shape}")
    return waypoints_m


def _as_start(corridor: Corridor, trajectory: Trajectory) -> Trajectory:
    if len(trajectory) != len(corridor) or trajectory.degree > 5:
        raise ValueError(
            f"a start must have {len(corridor)} pieces of degree up to 5, not {len(trajectory)} of {trajectory.degree}"
        )
    return trajectory.elevate(5)


def _trajectory(
    problem: Problem, corridor: Corridor, program: Transcription, scale: Scale, result: InteriorPointResult
) -> Trajectory:
    """Control points rebuilt from the joint states, which neighbours share, so that joints are continuous."""
    durations, vectors = program.vectors(result.x, result.inner)
    table = program.table.coefficients[:, list(control_rows.P_ROWS)].reshape(-1, control_rows.VECTORS)
    constant, linear, square = control_rows.product(table, vectors).reshape(3, 6, 3, -1)
    points = (constant + durations * (linear + durations * square)).transpose(2, 0, 1)
    points = points * scale.length_m + scale.origin_m
    # Scaling there and back moves the ends by a few units in the last place, which shows at the edge of a band.
    points[0, : 3 if problem.starts_at_rest else 1] = problem.start_m
    points[-1, 3:] = problem.destination_m
    stations = np.array([piece.station for piece in corridor.pieces])
    return Trajectory(points, durations * scale.time_s, stations)
