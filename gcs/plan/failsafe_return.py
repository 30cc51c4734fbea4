"""Where an autopilot's own failsafe takes the vehicle, from every moment of a flight: straight, and whether covered.

An autopilot that hears nobody climbs to its return altitude where it is, flies straight to the nearest of home and its
rally points, and comes down there. It knows nothing of ranges. So the way is worked out before the flight for what
the vehicle is set to, and people are told when it leaves every range.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gcs.layout.mission_geometry import MissionGeometry
from gcs.layout.straight_coverage import Cover
from gcs.mission.model import MissionLimits
from planner import Trajectory
from planner.arrays import Array

Place = tuple[float, float, float]
Target = tuple[float, str | None, Place]
"""Distance over ground, a rally point's id (None: home), its place."""

CELL_S = 2.0
MOST_CELLS = 200
_NEAREST = 3


@dataclass(frozen=True)
class ReturnRules:
    """What an autopilot does when it returns by itself. Places are east, north, up in the plan's plane.

    ``climb_to_up_m``: it flies no lower than this (minus infinity: at the height it has). ``limit_m``: rally points
    farther away do not count, None: all do. ``home_counts``: whether home is chosen where it is the nearest.
    """

    home_enu_m: Place
    points: tuple[tuple[str, Place], ...] = ()
    climb_to_up_m: float = -math.inf
    limit_m: float | None = None
    home_counts: bool = True
    speed_m_s: float = 10.0
    climb_m_s: float = 2.5
    sink_m_s: float = 1.5


@dataclass(frozen=True)
class FailsafeReturn:
    """A return begun between ``from_s`` and ``to_s``: where to (a rally point's id, None: home), how long it takes.

    ``covered``: the whole way is in somebody's range. ``duration_s`` is the longest from anywhere in the span.
    """

    from_s: float
    to_s: float
    to: str | None
    covered: bool
    duration_s: float


def cruise_speed_m_s(limits: MissionLimits) -> float:
    """Speed over ground that can be flown in any direction: the wind against it where an airspeed is the limit."""
    if limits.max_airspeed_m_s is None:
        return limits.max_speed_m_s
    wind = float(np.hypot(*(limits.wind_m_s or (0.0, 0.0))))
    return min(limits.max_speed_m_s, max(limits.max_airspeed_m_s - wind, 0.05 * limits.max_airspeed_m_s))


def cells(trajectory: Trajectory, most: int = MOST_CELLS) -> Array:
    """Edges of the spans a trajectory is judged in."""
    count = int(np.clip(np.ceil(trajectory.duration_s / CELL_S), 1, most))
    return np.linspace(0.0, trajectory.duration_s, count + 1)


def failsafe_returns(
    geometry: MissionGeometry, trajectory: Trajectory, rules: ReturnRules, most: int = MOST_CELLS
) -> tuple[FailsafeReturn, ...]:
    """The returns of a flight, in order of time, from 0 to the mission time without gaps.

    A span is judged at its middle with every range less the way the vehicle may be off from there, and for every place
    that may be the nearest somewhere in it.
    """
    edges = cells(trajectory, most)
    at = trajectory.evaluate(0.5 * (edges[:-1] + edges[1:]))
    off_m = 0.5 * float(edges[1] - edges[0]) * geometry.mission.limits.max_speed_m_s
    cover = Cover(geometry, off_m)
    turn_s = 2.0 * rules.speed_m_s / geometry.mission.limits.max_accel_m_s2
    ways = [_ways(here, off_m, rules) for here in at]
    legs = np.concatenate([way for of_cell in ways for _, way in of_cell])
    first = np.cumsum([0] + [3 * len(of_cell) for of_cell in ways[:-1]])
    covered = np.logical_and.reduceat(cover.holds(legs[:, :3], legs[:, 3:]), first)
    result = []
    for k, of_cell in enumerate(ways):
        longest_s = max(_duration_s(way, off_m, rules) for _, way in of_cell) + turn_s
        result.append(FailsafeReturn(float(edges[k]), float(edges[k + 1]), of_cell[0][0], bool(covered[k]), longest_s))
    return tuple(_merged(result))


def _ways(here: Array, off_m: float, rules: ReturnRules) -> list[tuple[str | None, Array]]:
    """The ways that may be taken from within ``off_m`` of a place, its own first: up, across, down."""

    def away_m(place: Place) -> float:
        return math.hypot(float(place[0] - here[0]), float(place[1] - here[1]))

    reach_m = math.inf if rules.limit_m is None else rules.limit_m
    points: list[Target] = [(away_m(place), name, place) for name, place in rules.points]
    points = sorted(points, key=lambda t: t[0])[:_NEAREST]
    home: Target = (away_m(rules.home_enu_m), None, rules.home_enu_m)
    # What counts wherever exactly the vehicle is: nothing farther by more than twice the doubt is chosen.
    surely = [t for t in points if t[0] <= reach_m - off_m] + ([home] if rules.home_counts else [])
    most_m = min((t[0] for t in surely), default=math.inf) + 2.0 * off_m
    maybe = [t for t in points if t[0] <= min(reach_m + off_m, most_m)]
    if home[0] <= most_m if rules.home_counts else not surely:
        maybe.append(home)
    here_counts = [t for t in points if t[0] <= reach_m] + ([home] if rules.home_counts else [])
    first = min(here_counts, key=lambda t: t[0], default=home)
    above = np.array([here[0], here[1], max(float(here[2]), rules.climb_to_up_m)])
    return [(t[1], _way(here, above, np.array(t[2]))) for t in [first, *(t for t in maybe if t is not first)]]


def _way(here: Array, above: Array, place: Array) -> Array:
    over = np.array([place[0], place[1], max(above[2], place[2])])
    return np.array([[*here, *above], [*above, *over], [*over, *place]])


def _duration_s(way: Array, off_m: float, rules: ReturnRules) -> float:
    length_m = np.linalg.norm(way[:, 3:] - way[:, :3], axis=1)
    across_s = (float(length_m[1]) + off_m) / rules.speed_m_s
    return float(length_m[0]) / rules.climb_m_s + across_s + float(length_m[2]) / rules.sink_m_s


def _merged(returns: Sequence[FailsafeReturn]) -> list[FailsafeReturn]:
    """Neighbours that lead to the same place, alike covered, as one."""
    merged: list[FailsafeReturn] = []
    for one in returns:
        last = merged[-1] if merged else None
        if last is not None and (last.to, last.covered) == (one.to, one.covered):
            longest_s = max(last.duration_s, one.duration_s)
            merged[-1] = FailsafeReturn(last.from_s, one.to_s, one.to, one.covered, longest_s)
        else:
            merged.append(one)
    return merged
