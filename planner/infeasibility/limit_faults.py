"""What speaks against a plan beside the ranges: wind, start state, endurance."""

from __future__ import annotations

import numpy as np

from planner.airspeed import winds_m_s
from planner.errors import Infeasibility
from planner.problem import Limits, Problem
from planner.remedy import LowerStartSpeed, RaiseLimit


def too_long(problem: Problem, duration_s: float) -> Infeasibility | None:
    """The endurance is too short for the fastest plan found, ``duration_s``; None when it is not."""
    return endurance_fault(problem, duration_s, proven=False)


def no_way_from_moving_start(problem: Problem) -> Infeasibility:
    """Nothing found that takes up the start's velocity and acceleration and stays in range and limits."""
    speed = float(np.linalg.norm(problem.start_velocity_m_s))
    return Infeasibility(
        "limits",
        f"no trajectory found that takes up the start velocity of {speed:.2f} m/s and stays in range, band and limits; "
        "start slower, or from a place with more room ahead",
        position_m=(float(problem.start_m[0]), float(problem.start_m[1]), float(problem.start_m[2])),
        remedies=((LowerStartSpeed(below_m_s=speed),),),
    )


def wind_fault(limits: Limits) -> Infeasibility | None:
    """The wind leaves no airspeed to stop with."""
    if limits.max_airspeed_m_s is None:
        return None
    wind = float(np.hypot(*limits.wind_m_s))
    if wind <= limits.max_airspeed_m_s * (1.0 - 1e-6):
        return None
    return Infeasibility(
        "limits",
        f"wind of {wind:.2f} m/s leaves no airspeed to stop with: max_airspeed_m_s is {limits.max_airspeed_m_s:.2f}; "
        f"wait for less wind or allow more than {wind:.2f} m/s",
        gap_m=None,
        remedies=((RaiseLimit("max_airspeed_m_s", wind * (1.0 + 1e-5)),),),
    )


def start_state_fault(problem: Problem) -> Infeasibility | None:
    """The start moves faster than a limit allows, or cannot stop its climb or descent inside the altitude band."""
    limits = problem.limits
    velocity, accel = problem.start_velocity_m_s, problem.start_acceleration_m_s2
    air = velocity - winds_m_s(problem, problem.start_m)
    measured = (
        ("max_speed_m_s", float(np.linalg.norm(velocity)), limits.max_speed_m_s),
        ("max_accel_m_s2", float(np.linalg.norm(accel)), limits.max_accel_m_s2),
        ("max_climb_m_s", float(velocity[2]), limits.max_climb_m_s),
        ("max_descent_m_s", -float(velocity[2]), limits.max_descent_m_s),
        ("max_airspeed_m_s", float(np.linalg.norm(air)), limits.max_airspeed_m_s),
    )
    for name, value, limit in measured:
        if limit is not None and value > limit:
            return Infeasibility(
                "limits",
                f"the start state breaks {name}: {value:.3f}, allowed {limit:.3f}; start slower or raise the limit",
                remedies=((RaiseLimit(name, value),),),
            )
    # However it brakes, a vertical speed of s is carried on for s^2 / 2a.
    sinking = float(velocity[2]) < 0.0
    room = float(problem.start_m[2]) - limits.min_alt_m if sinking else limits.max_alt_m - float(problem.start_m[2])
    needed = float(velocity[2]) ** 2 / (2.0 * limits.max_accel_m_s2)
    if needed > room * (1.0 + 1e-9):
        way = "sinks" if sinking else "climbs"
        return Infeasibility(
            "limits",
            f"the start {way} at {abs(velocity[2]):.3f} m/s and needs {needed:.3f} m to stop that; {room:.3f} m are "
            "left in the altitude band: start level or further inside",
            gap_m=needed - room,
            position_m=(float(problem.start_m[0]), float(problem.start_m[1]), float(problem.start_m[2])),
            remedies=((LowerStartSpeed(vertical_to_m_s=float(np.sqrt(2.0 * limits.max_accel_m_s2 * room))),),),
        )
    return None


def endurance_fault(problem: Problem, duration_s: float, *, proven: bool) -> Infeasibility | None:
    """The endurance is shorter than ``duration_s``, which no flight beats (``proven``) or the best one found takes."""
    allowed = problem.limits.max_duration_s
    if allowed is None or duration_s <= allowed:
        return None
    what = "no trajectory takes less than" if proven else "the fastest plan found takes"
    return Infeasibility(
        "limits",
        f"{what} {duration_s:.1f} s and {allowed:.1f} s are allowed, {duration_s - allowed:.1f} s too few",
        remedies=((RaiseLimit("max_duration_s", duration_s),),),
    )
