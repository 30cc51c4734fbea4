"""Where along a polyline the joints of a corridor's pieces start out.

Pieces pay where the speed changes: one polynomial cannot both accelerate and cruise. So the polyline is flown in
thought with a trapezoidal speed profile, at rest at both ends, slowed at bends and in overlaps too short for the time
asked for in them, and each leg is cut into parts of equal time, in which time spent speeding up or braking counts
several times.
"""

from __future__ import annotations

import numpy as np

from planner.arrays import Array, Flags
from planner.corridor.corridor import Corridor, Piece
from planner.problem import Problem
from planner.speed_profile import speed_profile

# How much more an acceleration phase counts than cruising.
CHANGE_WEIGHT = 5.0
# Pieces that speeding up from rest, or braking to it, gets at least, as far as it is no more than half of the leg's.
RAMP_PIECES = 3.0
# Part of the acceleration limit that polynomials reach on average while speeding up, and while turning in a bend.
STRAIGHT_ACCEL, BEND_ACCEL = 0.5, 0.25
# Points per leg at which the profile is looked at.
SAMPLES = 128


def place_joints(problem: Problem, corridor: Corridor, polyline_m: Array) -> Array:
    """Points ``(K + 1, 3)`` for the joints of ``corridor`` along ``polyline_m`` ``(legs + 1, 3)``.

    The polyline runs from the start through one handover point per overlap to the destination. An entry or exit piece
    reaches from the handover point along its leg for as long as it lasts at full speed, but not out of the other
    station's range. Points may coincide. Raises ``ValueError`` for a polyline that does not fit the corridor.
    """
    polyline_m = np.asarray(polyline_m, dtype=float)
    legs = len(corridor.sequence)
    if polyline_m.shape != (legs + 1, 3):
        raise ValueError(f"polyline_m must be (legs + 1, 3) = ({legs + 1}, 3), not {polyline_m.shape}")
    step = np.diff(polyline_m, axis=0)
    length = np.maximum(np.linalg.norm(step, axis=1), 1e-9)
    pieces = [[corridor.pieces[k] for k in corridor.leg_pieces(leg)] for leg in range(legs)]
    inside = np.zeros((legs, 2))
    for leg, own in enumerate(pieces):
        heading = step[leg] / length[leg]
        if len(own[0].balls) > 1:
            inside[leg, 0] = _overlap_length_m(problem, own[0], polyline_m[leg], heading, length[leg])
        if len(own[-1].balls) > 1:
            inside[leg, 1] = _overlap_length_m(problem, own[-1], polyline_m[leg + 1], -heading, length[leg])
        inside[leg] *= min(1.0, length[leg] / max(float(inside[leg].sum()), 1e-12))
    asked_s = np.array(
        [pieces[k][-1].min_duration_s + pieces[k + 1][0].min_duration_s for k in range(legs - 1)], dtype=float
    )
    speed = _handover_speeds(problem, step / length[:, None], length, inside, asked_s)
    points = [polyline_m[:1]]
    for leg, own in enumerate(pieces):
        entry, leave = len(own[0].balls) > 1, len(own[-1].balls) > 1
        span = (inside[leg, 0], length[leg] - inside[leg, 1])
        at = _equal_shares(problem, span, length[leg], speed[leg : leg + 2], len(own) - entry - leave)
        at = np.concatenate([at[0 if entry else 1 :], [length[leg]] if leave else []])
        points.append(polyline_m[leg] + at[:, None] * step[leg] / length[leg])
    return np.concatenate(points)


def _overlap_length_m(problem: Problem, piece: Piece, at: Array, heading: Array, length: float) -> float:
    """How far from its handover point ``at`` an entry or exit piece gets along its leg, inside both balls."""
    other = piece.balls[1]
    offset = at - problem.station_positions_m[other]
    along = float(heading @ offset)
    room = np.sqrt(max(along**2 - float(offset @ offset) + float(problem.ranges_m[other]) ** 2, 0.0)) - along
    return max(float(min(0.99 * room, problem.limits.max_speed_m_s * piece.min_duration_s, length)), 0.0)


def _handover_speeds(problem: Problem, heading: Array, length: Array, inside: Array, asked_s: Array) -> Array:
    """``(legs + 1,)``: speed expected at the ends of the legs; ``asked_s`` to spend in each overlap."""
    limits = problem.limits
    accel = STRAIGHT_ACCEL * limits.max_accel_m_s2
    bend = np.arccos(np.clip((heading[:-1] * heading[1:]).sum(axis=1), -1.0, 1.0))
    room = np.minimum(length[:-1], length[1:])
    around = np.sqrt(BEND_ACCEL * limits.max_accel_m_s2 * room / np.maximum(bend, 1e-6))
    within = asked_s > 0.0
    around[within] = np.minimum(around, (inside[:-1, 1] + inside[1:, 0]) / np.where(within, asked_s, 1.0))[within]
    around = np.clip(around, 1e-3 * limits.max_speed_m_s, limits.max_speed_m_s)
    start = min(float(np.linalg.norm(problem.start_velocity_m_s)), limits.max_speed_m_s)
    return speed_profile(np.concatenate([[start], around, [0.0]]), length, accel)


def _equal_shares(problem: Problem, span: tuple[float, float], length: float, speed: Array, parts: int) -> Array:
    """Where to cut the ``span`` of a leg into ``parts``, both ends included: ``(parts + 1,)`` lengths along the leg."""
    limits = problem.limits
    accel = STRAIGHT_ACCEL * limits.max_accel_m_s2
    edges = np.linspace(span[0], span[1], SAMPLES + 1)
    ramp_m = limits.max_speed_m_s**2 / (2.0 * accel)
    if ramp_m < 0.25 * (span[1] - span[0]):
        # On a long leg ramps would fall between two of these points.
        fine = np.linspace(0.0, ramp_m, SAMPLES // 4 + 1)
        edges = np.unique(np.concatenate([edges, span[0] + fine, span[1] - fine]))
    middle = 0.5 * (edges[:-1] + edges[1:])
    profile = np.sqrt(np.minimum(speed[0] ** 2 + 2.0 * accel * middle, speed[1] ** 2 + 2.0 * accel * (length - middle)))
    changing = profile < limits.max_speed_m_s
    weight = np.diff(edges) / np.clip(profile, 1e-3 * limits.max_speed_m_s, limits.max_speed_m_s)
    weight[changing] *= CHANGE_WEIGHT
    _give_ramps_pieces(weight, changing, speed, parts)
    spent = np.concatenate([[0.0], np.cumsum(weight)])
    return np.interp(np.linspace(0.0, spent[-1], parts + 1), spent, edges)


def _give_ramps_pieces(weight: Array, changing: Flags, speed: Array, parts: int) -> None:
    """Raise the weights of ramps from and to rest until each has its `RAMP_PIECES` of ``parts``, however long the leg.

    On a leg of many minutes the time spent in a ramp is next to nothing, but one polynomial cannot both speed up and
    cruise: the flight would be late by half of what its longest piece takes.
    """
    steady = np.flatnonzero(~changing)
    if not len(steady):
        return
    ramps = [
        part for part, end in ((slice(0, steady[0]), speed[0]), (slice(steady[-1] + 1, None), speed[1])) if end == 0.0
    ]
    ramps = [part for part in ramps if changing[part].any()]
    if not ramps:
        return
    share = min(RAMP_PIECES / parts, 0.5 / len(ramps))
    rest = float(weight.sum()) - sum(float(weight[part].sum()) for part in ramps)
    wanted = share / (1.0 - share * len(ramps)) * rest
    for part in ramps:
        weight[part] *= max(1.0, wanted / float(weight[part].sum()))
