"""The joint position-and-time planner on one station sequence.

sequence ──► corridor ──► polyline, a point per joint ──► interior point ──► scaled to the limits ──► certificate
                               ▲                               │
                               └── another start, when that ───┘ fails or looks bad

Where no start leads anywhere, `planner.planner` falls back to alternating minimisation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil

import numpy as np

from planner.certificate import Certificate, certify
from planner.corridor.corridor import Corridor, build_corridor
from planner.corridor.handover_polyline import polyline_along
from planner.corridor.joint_placement import place_joints
from planner.corridor.limit_check import CorridorCheck
from planner.coverage.disc import disc_radius_m, usable_stations
from planner.energy import cost_s
from planner.errors import SolverError
from planner.joint.solver import solve_corridor
from planner.joint.straight_flight import straight_flight
from planner.problem import Problem
from planner.trajectory import Trajectory


@dataclass(frozen=True)
class Effort:
    """How much work to put into a sequence.

    ``pieces_per_leg`` own pieces a station, ``pieces_at_ends`` in the first and last leg, where the speed changes; more
    where the stations are so few that there would not be ``least_pieces`` in all. ``max_iterations`` and ``tolerance``
    are the interior-point method's.
    """

    pieces_per_leg: int
    pieces_at_ends: int
    least_pieces: int = 0
    max_iterations: int = 200
    tolerance: float = 1e-4


@dataclass(frozen=True)
class Attempt:
    """A certified trajectory along ``sequence``, by ``method`` ("joint" or "alternating minimisation").

    ``cost_s`` is what attempts are compared by: the mission time, plus weighted energy where that is asked for.
    """

    sequence: tuple[int, ...]
    trajectory: Trajectory
    certificate: Certificate
    method: str
    iterations: int
    converged: bool
    cost_s: float

    @property
    def duration_s(self) -> float:
        """Its mission time."""
        return self.trajectory.duration_s


# Most pieces a leg gets for lack of stations.
MAX_EXTRA = 3
# Altitudes this close to the band are in it.
ROUNDING_M = 1e-9
# Relative change of durations a moving start bears: well below what counts as a jump.
ROUNDING = 1e-10
# Starts tried in turn: how far handovers are moved inwards, and pieces added per leg.
STARTS = ((0.0, 0), (0.4, 0), (0.2, 1))


def plan_joint(
    problem: Problem,
    sequence: Sequence[int],
    effort: Effort,
    *,
    energy_weight: float = 0.0,
    starts: int = len(STARTS),
    after_s: Sequence[float] = (),
) -> Attempt | None:
    """The first certified and converged answer of up to ``starts`` starts, else the best certified one; None when none.

    ``after_s`` as for `build_corridor`. Deterministic. Costs one solve in nearly every case.
    """
    if len(sequence) == 1 and energy_weight == 0.0:
        straight = _straight(problem, sequence[0])
        if straight is not None:
            return straight
    best: Attempt | None = None
    iterations = 0
    half_s = 0.5 * problem.min_overlap_s
    wider = replace(problem, min_overlap_s=half_s + max(half_s, *after_s)) if after_s else problem
    flat = problem.limits.min_alt_m == problem.limits.max_alt_m
    solvable = planar_problem(problem) if flat else problem
    extra = min(MAX_EXTRA, max(0, ceil(effort.least_pieces / len(sequence)) - effort.pieces_per_leg))
    # A station alone is first and last at once.
    at_ends = effort.pieces_at_ends * (2 if len(sequence) == 1 else 1)
    for inwards, more in STARTS[:starts]:
        corridor = build_corridor(
            problem,
            sequence,
            pieces_per_leg=effort.pieces_per_leg + extra + more,
            pieces_at_ends=at_ends + extra + more,
            after_s=after_s,
        )
        polyline, _ = polyline_along(wider, sequence, inwards=inwards)
        try:
            solved = solve_corridor(
                solvable,
                corridor,
                place_joints(problem, corridor, polyline),
                energy_weight=energy_weight,
                tolerance=effort.tolerance,
                max_iterations=effort.max_iterations,
            )
        except SolverError:
            continue
        iterations += solved.iterations
        trajectory = within_limits(problem, corridor, without_rounding(problem, solved.trajectory))
        certificate = certify(problem, trajectory)
        if not certificate.feasible:
            continue
        cost = cost_s(problem, trajectory, energy_weight)
        attempt = Attempt(tuple(sequence), trajectory, certificate, "joint", iterations, solved.converged, cost)
        if best is None or attempt.cost_s < best.cost_s:
            best = attempt
        if solved.converged:
            break
    return best


def _straight(problem: Problem, station: int) -> Attempt | None:
    """The fastest flight under one station in closed form, where it keeps every limit."""
    trajectory = straight_flight(problem, station)
    if trajectory is None:
        return None
    certificate = certify(problem, trajectory)
    if not certificate.feasible:
        return None
    time_s = trajectory.duration_s
    return Attempt((station,), trajectory, certificate, "joint", 0, converged=True, cost_s=time_s)


def planar_problem(problem: Problem) -> Problem:
    """The planar problem: one whose altitude band has no height, as the same problem in the plane.

    Every range becomes its disc at that altitude, centred in it, and the band opens: with all forces in the plane, a
    solver that starts in it stays there, and has the room around it that interior-point methods need.
    """
    altitude = problem.limits.min_alt_m
    stations = np.arange(problem.station_count)
    positions = problem.station_positions_m.copy()
    positions[:, 2] = altitude
    radii = disc_radius_m(problem, stations, altitude)
    room = float(problem.ranges_m.max())
    return replace(
        problem,
        station_positions_m=positions,
        ranges_m=np.where(usable_stations(problem), radii, 0.0),
        min_elevation_deg=None,
        limits=replace(problem.limits, min_alt_m=altitude - room, max_alt_m=altitude + room),
    )


def without_rounding(problem: Problem, trajectory: Trajectory) -> Trajectory:
    """The ends exactly where they are given, and what is a rounding outside the band back in it.

    A start may lie on the very edge of range or band, and scaling there and back moves it by a few units in the last
    place, which a certificate at zero tolerance sees.
    """
    points = trajectory.control_points_m.copy()
    points[0, : 3 if problem.starts_at_rest else 1] = problem.start_m
    points[-1, -3:] = problem.destination_m
    altitude = points[..., 2]
    inside = np.clip(altitude, problem.limits.min_alt_m, problem.limits.max_alt_m)
    near = np.abs(inside - altitude) <= ROUNDING_M
    # In a band without height everything is at that height, wherever the solver's wider band let it be.
    flat = problem.limits.min_alt_m == problem.limits.max_alt_m
    points[..., 2] = np.where(near | flat, inside, altitude)
    return replace(trajectory, control_points_m=points)


def within_limits(problem: Problem, corridor: Corridor, trajectory: Trajectory) -> Trajectory:
    """The same path flown just as much slower as its limits of speed, acceleration and jerk ask, if at all.

    Slowing every piece by one factor keeps the joints continuous (speeds divide by it, accelerations by its square)
    and only lengthens overlap and tenure. A moving start fixes the speed but for roundings: no more than those can
    be done away with there.
    """
    check = CorridorCheck(problem, corridor)
    slowest = float(check.slowdown(trajectory.control_points_m, trajectory.durations_s).max())
    moving = not problem.starts_at_rest
    if slowest <= 1.0 or not np.isfinite(slowest) or (moving and slowest > 1.0 + ROUNDING):
        return trajectory
    return trajectory.scale_time(slowest * (1.0 + (0.5 * ROUNDING if moving else 1e-9)))
