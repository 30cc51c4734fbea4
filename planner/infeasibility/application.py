"""Remedies carried out: a problem as it would be after the changes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from planner.arrays import Array
from planner.problem import UNMASKED_DEG, Problem
from planner.remedy import (
    AddStation,
    Change,
    LowerElevation,
    LowerElevations,
    LowerStartSpeed,
    Move,
    RaiseAllRanges,
    RaiseLimit,
    RaiseRange,
    Remedy,
    SetAltitude,
    WidenBand,
)


def remedied(problem: Problem, remedy: Remedy) -> Problem:
    """``problem`` with every change of ``remedy`` made, in order. Bounds on ranges go with the ranges they bounded."""
    for change in remedy:
        problem = _changed(problem, change)
    return problem


def _changed(problem: Problem, change: Change) -> Problem:
    match change:
        case RaiseRange(station, by_m):
            ranges = problem.ranges_m.copy()
            ranges[station] += by_m
            return replace(problem, ranges_m=ranges, bound_ranges_m=None)
        case RaiseAllRanges(by_m):
            return replace(problem, ranges_m=problem.ranges_m + by_m, bound_ranges_m=None)
        case SetAltitude(of, alt_m):
            point = (problem.start_m if of == "start" else problem.destination_m).copy()
            point[2] = alt_m
            return _end_moved(problem, of, point)
        case Move(of, position_m):
            return _end_moved(problem, of, np.array(position_m))
        case WidenBand(_, low_m, high_m):
            band: dict[str, Any] = {
                name: value for name, value in (("min_alt_m", low_m), ("max_alt_m", high_m)) if value is not None
            }
            return replace(problem, limits=replace(problem.limits, **band))
        case LowerElevation(station, to_deg):
            angles = _masks_deg(problem).copy()
            angles[station] = to_deg
            return replace(problem, min_elevation_deg=angles)
        case LowerElevations(by_deg):
            angles = _masks_deg(problem)
            lowered = np.where(angles < 0.0, angles, np.maximum(angles - by_deg, 0.0))
            return replace(problem, min_elevation_deg=lowered)
        case AddStation(position_m, range_m):
            masks = problem.min_elevation_deg
            return replace(
                problem,
                station_positions_m=np.vstack([problem.station_positions_m, position_m]),
                ranges_m=np.append(problem.ranges_m, range_m),
                bound_ranges_m=None,
                min_elevation_deg=None if masks is None else np.append(masks, UNMASKED_DEG),
            )
        case RaiseLimit("max_handovers", to):
            return replace(problem, max_handovers=int(to))
        case RaiseLimit(limit, to):
            raised: dict[str, Any] = {limit: to}
            return replace(problem, limits=replace(problem.limits, **raised))
        case LowerStartSpeed(below_m_s, vertical_to_m_s):
            velocity = problem.start_velocity_m_s.copy()
            if vertical_to_m_s is not None:
                velocity[2] = np.clip(velocity[2], -vertical_to_m_s, vertical_to_m_s)
            if below_m_s is not None:
                velocity *= min(1.0, below_m_s / max(float(np.linalg.norm(velocity)), 1e-12))
            return replace(problem, start_velocity_m_s=velocity)


def _end_moved(problem: Problem, of: str, to_m: Array) -> Problem:
    return replace(problem, start_m=to_m) if of == "start" else replace(problem, destination_m=to_m)


def _masks_deg(problem: Problem) -> Array:
    assert problem.min_elevation_deg is not None
    return problem.min_elevation_deg
