"""A planning problem along one corridor as a scaled `Transcription`, and a first guess to start from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner.airspeed import winds_m_s
from planner.arrays import Array, Flags, Indices
from planner.corridor.corridor import Corridor
from planner.coverage.elevation_mask import ElevationMask
from planner.coverage.overlap import overlap_depth_m
from planner.joint import control_rows
from planner.joint.transcription import HeightConstraints, NormConstraints, Transcription
from planner.problem import Limits, Problem
from planner.speed_profile import speed_profile
from planner.trajectory import Trajectory

# Relative shrinking of every limit, well above the violation the solver leaves and far below anything that matters.
SHRINK = 1e-7
# Shortest piece, in the program's unit of time.
LEAST_PIECE = 0.02
# A piece from rest to rest is guessed to take so many times length over speed, or the root of length over acceleration.
REST_TIME = 2.5
# How many times the length of a piece a bend may take: the fastest curve spreads it over several. The number hardly
# matters, but with bends flown within a piece the guess is so slow that the solver takes a sixth more steps.
BEND_ROOM = 10.0


@dataclass(frozen=True)
class Scale:
    """Lengths are divided by ``length_m`` after taking ``origin_m`` ``(3,)`` off, times by ``time_s``."""

    origin_m: Array
    length_m: float
    time_s: float

    @property
    def speed_m_s(self) -> float:
        """One scaled unit of speed."""
        return self.length_m / self.time_s

    @property
    def accel_m_s2(self) -> float:
        """One scaled unit of acceleration."""
        return self.length_m / self.time_s**2


def scale_of(problem: Problem, waypoints_m: Array) -> Scale:
    """Units that make a piece about as long as 1 and as brief as 1, whatever the limits.

    A piece of typical length takes length / v where speed decides, sqrt(length / a) where acceleration does; the larger
    is the unit of time. Scaled, the limit that decides is then 1 and the other one larger.
    """
    limits = problem.limits
    origin = 0.5 * (waypoints_m.min(axis=0) + waypoints_m.max(axis=0))
    origin[2] = 0.5 * (limits.min_alt_m + limits.max_alt_m)
    flown = float(np.linalg.norm(np.diff(waypoints_m, axis=0), axis=1).sum()) / (len(waypoints_m) - 1)
    length = max(flown, 1e-3 * float(problem.ranges_m.max()), 1e-3)
    return Scale(origin, length, max(length / limits.max_speed_m_s, float(np.sqrt(length / limits.max_accel_m_s2))))


def feasibility_of(problem: Problem, corridor: Corridor, scale: Scale) -> float:
    """Violation, scaled, that the tolerance taken off every limit still covers."""
    balls = list(corridor.sequence)
    tolerance_m = float((problem.ranges_m - inner_radii_m(problem, corridor))[balls].min())
    # Near its apex a cone is flat: an error of its square shows as the root of that (see `_add_elevation`).
    finest = SHRINK if ElevationMask.of(problem) is None else 1e-11
    return max(0.1 * min(finest, tolerance_m / scale.length_m), 1e-13)


def build_program(
    problem: Problem, corridor: Corridor, scale: Scale, waypoints_m: Array, *, energy: bool = False
) -> Transcription:
    """The scaled constraints of ``problem`` along ``corridor``; ``energy`` where the objective has that term."""
    speed, accel = scale.speed_m_s, scale.accel_m_s2
    zero = np.zeros(3)
    first = np.concatenate(
        [
            (problem.start_m - scale.origin_m) / scale.length_m,
            problem.start_velocity_m_s / speed,
            problem.start_acceleration_m_s2 / accel,
        ]
    )
    last = np.concatenate([(problem.destination_m - scale.origin_m) / scale.length_m, zero, zero])
    min_durations = min_piece_durations_s(problem, corridor, scale, waypoints_m) / scale.time_s
    table = control_rows.table(jerk=problem.limits.max_jerk_m_s3 is not None, nodes=energy)
    norms, heights = _norms(problem, corridor, scale, waypoints_m), _heights(problem, corridor, scale)
    return Transcription(table, first, last, norms, heights, min_durations)


def min_piece_durations_s(problem: Problem, corridor: Corridor, scale: Scale, waypoints_m: Array) -> Array:
    """``(K,)``: least duration of every piece: what overlap asks, numbers need, and tenure shares out evenly.

    Tenure bounds a sum; bounding the leg's own pieces instead keeps the program banded, and costs nothing where the
    leg is longer anyway.
    """
    least = max(least_piece_s(problem.limits, waypoints_m), LEAST_PIECE * scale.time_s)
    shortest = np.array([max(piece.min_duration_s * (1.0 + SHRINK), least) for piece in corridor.pieces])
    for leg in range(len(corridor.sequence)):
        pieces = corridor.leg_pieces(leg)
        own = [k for k in pieces if corridor.pieces[k].min_duration_s == 0.0] or pieces
        missing = corridor.min_leg_s * (1.0 + SHRINK) - float(shortest[pieces].sum())
        if missing > 0:
            shortest[own] += missing / len(own)
    return shortest


def least_piece_s(limits: Limits, points_m: Array) -> float:
    """Shortest piece among ``points_m`` that numbers bear.

    The certificate recomputes accelerations from control points, which loses eps |P| / T^2 of them.
    """
    extent = float(np.abs(points_m).max())
    return float(np.sqrt(80.0 * np.finfo(float).eps * extent / (2.5e-10 * limits.max_accel_m_s2)))


def inner_radii_m(problem: Problem, corridor: Corridor) -> Array:
    """``(M,)``: ranges less a tolerance, less of one where that would close an overlap of the corridor."""
    shrink = SHRINK * problem.ranges_m
    if len(corridor.sequence) > 1:
        before, after = np.array(corridor.sequence[:-1]), np.array(corridor.sequence[1:])
        allowed = 0.01 * np.maximum(overlap_depth_m(problem, before, after), 0.0)
        np.minimum.at(shrink, before, allowed)
        np.minimum.at(shrink, after, allowed)
    return np.asarray(problem.ranges_m - shrink)


class _NormBuilder:
    """Collects norm constraints: each ``add`` is one control-point row for some pieces."""

    def __init__(self, pieces: int) -> None:
        self.all = np.arange(pieces)
        self.parts: list[tuple[NDArray[Any], ...]] = []

    def add(
        self,
        row: int,
        radius: Array | float,
        *,
        centre: Array | None = None,
        weight: Array | None = None,
        time_radius: float = 0.0,
        scale: Array | float | None = None,
        active: Flags | None = None,
    ) -> None:
        """All values broadcast over the pieces; ``active`` says for which of them the constraint is there."""
        chosen = self.all if active is None else np.flatnonzero(active)

        def for_each(value: Array | float, size: tuple[int, ...] = ()) -> Array:
            own = np.asarray(value, dtype=float)
            if own.ndim > len(size):
                return own[chosen]
            each = np.empty((len(chosen), *size))
            each[:] = own
            return each

        self.parts.append(
            (
                np.full(len(chosen), row),
                chosen,
                for_each(0.0 if centre is None else centre, (3,)),
                for_each(1.0 if weight is None else weight, (3,)),
                for_each(radius),
                for_each(time_radius),
                for_each(radius if scale is None else scale),
            )
        )

    def build(self) -> NormConstraints:
        """All of them, one after the other."""
        row, pieces, centre, weight, radius, time_radius, size = (
            np.concatenate(part) for part in zip(*self.parts, strict=True)
        )
        return NormConstraints(row, pieces, centre.T, weight.T, radius, time_radius, size)


def _norms(problem: Problem, corridor: Corridor, scale: Scale, waypoints_m: Array) -> NormConstraints:
    limits, pieces = problem.limits, corridor.pieces
    inside = 1.0 - SHRINK
    build = _NormBuilder(len(pieces))
    radii, mask = inner_radii_m(problem, corridor), ElevationMask.of(problem)
    for slot in range(max(len(piece.balls) for piece in pieces)):
        used = np.array([slot < len(piece.balls) for piece in pieces])
        ball = np.array([piece.balls[slot] if slot < len(piece.balls) else piece.balls[0] for piece in pieces])
        # P_0 is P_5 of the piece before: no need to say it twice.
        new = np.array([k == 0 or ball[k] not in pieces[k - 1].balls for k in range(len(pieces))])
        centre = (problem.station_positions_m[ball] - scale.origin_m) / scale.length_m
        for row in control_rows.P_ROWS:
            active = used & new if row == 0 else used
            build.add(row, radii[ball] / scale.length_m, centre=centre, active=active)
            if mask is not None:
                _add_elevation(build, problem, mask.at(ball), scale, row, ball, centre, active)
    fast = limits.max_speed_m_s / scale.speed_m_s * inside
    strong = limits.max_accel_m_s2 / scale.accel_m_s2 * inside
    for row in control_rows.Q_ROWS:
        build.add(row, fast)
    for row in control_rows.K_ROWS:
        build.add(row, strong)
    if limits.max_airspeed_m_s is not None:
        withheld = _wind_withheld_m_s(problem, waypoints_m)
        for k, row in enumerate(control_rows.Q_ROWS):
            share = (k + 1) / len(control_rows.Q_ROWS)
            at = (1.0 - share) * waypoints_m[:-1] + share * waypoints_m[1:]
            wind = winds_m_s(problem, at) / scale.speed_m_s
            build.add(row, (limits.max_airspeed_m_s - withheld) / scale.speed_m_s * inside, centre=wind)
    if limits.max_jerk_m_s3 is not None:
        # |L_j| = 3 |K_{j+1} - K_j| / T for degree 5.
        jerk = limits.max_jerk_m_s3 / (scale.accel_m_s2 / scale.time_s) * inside
        for row in control_rows.J_ROWS:
            build.add(row, 0.0, weight=np.full(3, 9.0), time_radius=jerk, scale=jerk)
    return build.build()


def _wind_withheld_m_s(problem: Problem, waypoints_m: Array) -> Array:
    """``(K,)``: airspeed kept back on each piece for a wind that is not quite what it is where the piece is expected.

    What turns out to be too fast is flown slower afterwards; a start that moves leaves no such way: more is kept back.
    """
    wind, airspeed = winds_m_s(problem, waypoints_m), problem.limits.max_airspeed_m_s or 0.0
    turned = np.linalg.norm(np.diff(wind, axis=0), axis=-1)
    room = np.maximum(airspeed - np.linalg.norm(wind[1:], axis=-1), 0.0)
    return np.asarray(np.minimum(turned * (0.1 if problem.starts_at_rest else 1.0), 0.5 * room))


def _add_elevation(
    build: _NormBuilder,
    problem: Problem,
    mask: ElevationMask,
    scale: Scale,
    row: int,
    station: Indices,
    centre: Array,
    active: Flags,
) -> None:
    """Cones above stations: tan^2(elevation) |horizontal|^2 <= height^2; `_heights` keeps the height positive."""
    slope = np.tan(mask.angle_rad * (1.0 + SHRINK))
    weight = np.stack([slope**2, slope**2, -np.ones_like(slope)], axis=1)
    height = problem.limits.max_alt_m - problem.station_positions_m[station, 2]
    size = np.maximum(height / scale.length_m, 1e-3)
    # The apex higher than it is by a tolerance, more than the root of twice the violation that may be left.
    apex = centre + np.array([0.0, 0.0, 1.0]) * (2e-6 * size)[:, None]
    build.add(row, 0.0, centre=apex, weight=weight, scale=size, active=active & mask.cone)


def _lowest_m(problem: Problem, corridor: Corridor) -> Array:
    """``(K,)``: the band's floor, or the highest antenna that hears nothing below itself."""
    lowest = np.full(len(corridor), problem.limits.min_alt_m)
    mask = ElevationMask.of(problem)
    if mask is not None:
        for k, piece in enumerate(corridor.pieces):
            masked = [b for b in piece.balls if mask.limited[b]]
            lowest[k] = max([lowest[k], *problem.station_positions_m[masked, 2]])
    return lowest


def _heights(problem: Problem, corridor: Corridor, scale: Scale) -> HeightConstraints:
    limits, count = problem.limits, len(corridor)
    band = limits.max_alt_m - limits.min_alt_m
    tolerance = min(0.05 * SHRINK * (band + 1.0), 0.01 * band)
    low = (_lowest_m(problem, corridor) + tolerance - scale.origin_m[2]) / scale.length_m
    high = np.full(count, (limits.max_alt_m - tolerance - scale.origin_m[2]) / scale.length_m)
    # P_0 is P_5 of the piece before, which may be allowed lower.
    new = np.concatenate([[False], low[1:] > low[:-1]])
    bounds = [(row, low, high, np.ones(count, dtype=bool) if row else new) for row in control_rows.P_ROWS]
    if limits.max_climb_m_s is not None or limits.max_descent_m_s is not None:
        climb = limits.max_climb_m_s if limits.max_climb_m_s is not None else 2.0 * limits.max_speed_m_s
        descent = limits.max_descent_m_s if limits.max_descent_m_s is not None else 2.0 * limits.max_speed_m_s
        inside = (1.0 - SHRINK) / scale.speed_m_s
        down, up = np.full(count, -descent * inside), np.full(count, climb * inside)
        bounds += [(row, down, up, np.ones(count, dtype=bool)) for row in control_rows.Q_ROWS]
    kept = np.concatenate([bound[3] for bound in bounds])
    row = np.repeat([bound[0] for bound in bounds], count)[kept]
    lows, highs = (np.concatenate([bound[side] for bound in bounds])[kept] for side in (1, 2))
    pieces = np.tile(np.arange(count), len(bounds))[kept]
    return HeightConstraints(row, pieces, lows, highs, np.maximum(highs - lows, 1e-12))


def first_guess(
    problem: Problem, program: Transcription, scale: Scale, waypoints_m: Array, *, at_rest: bool = False
) -> tuple[Array, Array]:
    """Unknowns for the polyline flown with a trapezoidal speed profile, slowed where it bends sharply.

    With ``at_rest`` it stops in every joint and takes so long that speed and acceleration have room: a poor flight, but
    inside every constraint.
    """
    points = (waypoints_m - scale.origin_m) / scale.length_m
    speed_limit = problem.limits.max_speed_m_s / scale.speed_m_s
    accel_limit = problem.limits.max_accel_m_s2 / scale.accel_m_s2
    step = np.diff(points, axis=0)
    length = np.maximum(np.linalg.norm(step, axis=1), 1e-9)
    heading = step / length[:, None]
    start_speed = float(np.linalg.norm(program.first[3:6]))
    if at_rest:
        speed = np.zeros(len(points))
        durations = 1.5 * np.maximum(5.0 * length / speed_limit, np.sqrt(20.0 * length / accel_limit))
    else:
        accel = 0.6 * accel_limit
        bend = np.arccos(np.clip((heading[:-1] * heading[1:]).sum(axis=1), -1.0, 1.0))
        room = np.minimum(length[:-1], length[1:])
        around = 0.95 * np.minimum(speed_limit, np.sqrt(BEND_ROOM * accel_limit * room / np.maximum(bend, 1e-6)))
        speed = speed_profile(np.concatenate([[start_speed], around, [0.0]]), length, accel)
        mean = 0.5 * (speed[:-1] + speed[1:])
        rest = REST_TIME * np.maximum(length / speed_limit, np.sqrt(length / accel))
        durations = np.minimum(length / np.maximum(mean, 1e-9), rest)
    durations = np.maximum(durations, 1.2 * program.min_durations)
    bisector = heading[:-1] + heading[1:]
    tangent = bisector / np.maximum(np.linalg.norm(bisector, axis=1), 1e-9)[:, None]
    x = np.zeros(program.unknowns)
    x[0::10] = durations
    for axis in range(3):
        x[1 + axis :: 10] = points[1:-1, axis]
        x[4 + axis :: 10] = speed[1:-1] * tangent[:, axis]
    return x, program.consistent_inner(x, 0.9 * accel_limit)


def guess_from(program: Transcription, scale: Scale, trajectory: Trajectory) -> tuple[Array, Array]:
    """Unknowns of a trajectory of degree 5 with as many pieces as the program."""
    x = np.zeros(program.unknowns)
    x[0::10] = trajectory.durations_s / scale.time_s
    position = (trajectory.control_points_m[1:, 0] - scale.origin_m) / scale.length_m
    velocity = trajectory.derivative_control_points(1)[1:, 0] / scale.speed_m_s
    accel = trajectory.derivative_control_points(2)[1:, 0] / scale.accel_m_s2
    for axis in range(3):
        x[1 + axis :: 10], x[4 + axis :: 10], x[7 + axis :: 10] = position[:, axis], velocity[:, axis], accel[:, axis]
    return x, program.consistent_inner(x)
