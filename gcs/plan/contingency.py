"""What to do when the flight cannot go on: for every span of the mission, one diversion that stays covered.

Two ways are compared. ``"divert"``: at once level and straight to a safe point, then down over it. ``"return"``: back
along the path flown, which is covered by the stations that covered it before, to the start or to where a covered way
to a safe point leaves it. The quicker covered one is taken; one that is
chosen is kept while it stays covered and is not much slower than another, so that people are not given a new order
every minute.

Coverage of a straight way is exact: each station covers one interval of it (a ball cuts a line in one piece), and the
intervals must join from end to end. A span of time is judged at its middle with every range less the way the vehicle
may be off from there, which covers all of the span. Range margins are not taken off: this is the way out, not the
plan.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gcs.layout.mission_geometry import MissionGeometry
from gcs.layout.straight_coverage import Cover
from gcs.plan.failsafe_return import MOST_CELLS, FailsafeReturn, ReturnRules, cells, cruise_speed_m_s, failsafe_returns
from planner import Trajectory
from planner.arrays import Array, Flags, Indices

_NEAREST = 8
_SLOWER, _LATER_S = 1.3, 10.0
_AT_START_M = 500.0


@dataclass(frozen=True)
class Contingency:
    """From ``from_s`` to ``to_s``: what to do, where to, and how long it takes at most.

    ``action`` is ``"divert"`` or ``"return"``; ``safe_point`` is an id, None for the place of the start itself. A
    return follows the path back to where it was at ``leave_path_s``, and goes straight to the safe point from there;
    None: back to the start. ``covered`` says that the whole way is in range. ``straight_home_covered`` says whether the
    straight line back to the start is: that is where an autopilot's own failsafe goes that knows no rally points.
    ``failsafe_return_covered`` says it of one that knows the mission's safe points (`gcs.plan.failsafe_return`, at the
    height of the path), ``failsafe_return_s`` how long that takes at most; None in plans made before these were worked
    out. The document calls them ``own_return_covered`` and ``own_return_s``.
    """

    from_s: float
    to_s: float
    action: str
    safe_point: str | None
    covered: bool
    duration_s: float
    straight_home_covered: bool
    leave_path_s: float | None = None
    failsafe_return_covered: bool | None = None
    failsafe_return_s: float | None = None

    def to_document(self) -> dict[str, object]:
        """As in the plan document."""
        own = {"own_return_covered": self.failsafe_return_covered, "own_return_s": self.failsafe_return_s}
        return {
            "from_s": self.from_s,
            "to_s": self.to_s,
            "action": self.action,
            "safe_point": self.safe_point,
            "covered": self.covered,
            "duration_s": self.duration_s,
            "straight_home_covered": self.straight_home_covered,
            "leave_path_s": self.leave_path_s,
            **{key: value for key, value in own.items() if value is not None},
        }


def contingencies(geometry: MissionGeometry, trajectory: Trajectory) -> tuple[Contingency, ...]:
    """The contingencies of a trajectory, in order of time, from 0 to the mission time without gaps."""
    mission, limits = geometry.mission, geometry.mission.limits
    points = geometry.enu_m([p.position for p in mission.safe_points])
    station_count = len(mission.stations) * (1 + min(len(points), _NEAREST))
    most = int(np.clip(400_000 // station_count, 20, MOST_CELLS))
    edges = cells(trajectory, most)
    count = len(edges) - 1
    at = trajectory.evaluate(0.5 * (edges[:-1] + edges[1:]))
    off_m = 0.5 * (edges[1] - edges[0]) * limits.max_speed_m_s

    speed = cruise_speed_m_s(limits)
    sink = min(speed, limits.max_descent_m_s or speed)
    turn_s = 2.0 * speed / limits.max_accel_m_s2  # to stop and to get going again

    # Ways: the nearest safe points of every cell, and the start (for the straight line home).
    home = np.broadcast_to(trajectory.evaluate(0.0), at.shape)[:, None]
    nearest = _nearest(at, points)
    over = np.concatenate([points[nearest], home], axis=1) if len(points) else home.copy()
    down = over.copy()
    over[..., 2] = at[:, None, 2]
    ways = Cover(geometry, off_m)
    level = ways.holds(np.broadcast_to(at[:, None], over.shape), over)
    covered = level[:, :-1] & ways.holds(over[:, :-1], down[:, :-1])
    length = np.linalg.norm(over - at[:, None], axis=-1)[:, :-1] + off_m
    duration = length / speed + np.abs(over - down)[:, :-1, 2] / sink + turn_s

    diverts = [{int(nearest[k, j]): float(duration[k, j]) for j in np.flatnonzero(covered[k])} for k in range(count)]
    returns = _returns(diverts, _flown_m(trajectory, edges) / speed, turn_s)
    chosen = _choose(diverts, returns)
    spans = _spans(geometry, edges, chosen, level[:, -1], _at_start(geometry, points, trajectory))
    start_m = trajectory.evaluate(0.0)
    rules = ReturnRules(
        home_enu_m=(float(start_m[0]), float(start_m[1]), float(start_m[2])),
        points=tuple((p.id, _tuple(at_m)) for p, at_m in zip(mission.safe_points, points, strict=True)),
        speed_m_s=speed,
        sink_m_s=sink,
    )
    by_itself = failsafe_returns(geometry, trajectory, rules, most)
    return tuple(_with_failsafe_return(span, by_itself) for span in spans)


def _tuple(at_m: Array) -> tuple[float, float, float]:
    return float(at_m[0]), float(at_m[1]), float(at_m[2])


def _with_failsafe_return(span: Contingency, by_itself: tuple[FailsafeReturn, ...]) -> Contingency:
    during = [way for way in by_itself if way.from_s < span.to_s and way.to_s > span.from_s]
    return replace(
        span,
        failsafe_return_covered=all(way.covered for way in during),
        failsafe_return_s=max(way.duration_s for way in during),
    )


def _nearest(at: Array, points: Array) -> Indices:
    """``(cells, k)``: the nearest safe points of each cell."""
    if not len(points):
        return np.empty((len(at), 0), dtype=np.int64)
    distance = np.linalg.norm(at[:, None, :2] - points[None, :, :2], axis=-1)
    return np.argsort(distance, axis=1, kind="stable")[:, :_NEAREST]


def _flown_m(trajectory: Trajectory, edges: Array) -> Array:
    """Way flown until each edge, by the trapezium rule on 16 steps a cell."""
    times = np.linspace(0.0, edges[-1], 16 * (len(edges) - 1) + 1)
    speed = np.linalg.norm(trajectory.evaluate(times, 1), axis=-1)
    steps = 0.5 * (speed[1:] + speed[:-1]) * np.diff(times)
    return np.concatenate([[0.0], np.cumsum(steps)])[::16]


def _at_start(geometry: MissionGeometry, points: Array, trajectory: Trajectory) -> str | None:
    if not len(points):
        return None
    distance = np.linalg.norm(points[:, :2] - trajectory.evaluate(0.0)[:2], axis=1)
    near = int(distance.argmin())
    return geometry.mission.safe_points[near].id if distance[near] <= _AT_START_M else None


@dataclass(frozen=True)
class _Way:
    """``point``: index of the safe point, None for the start; ``leave``: cell a return leaves the path in, if any."""

    action: str
    point: int | None
    leave: int | None = None


def _returns(diverts: list[dict[int, float]], flown_s: Array, turn_s: float) -> list[tuple[_Way, float]]:
    """The quickest return from the end of every cell; ``flown_s`` is the time at full speed from 0 to each edge."""
    best, ahead_s = _Way("return", None), 0.0
    result = []
    for k, ways in enumerate(diverts):
        result.append((best, float(flown_s[k + 1]) + ahead_s + turn_s))
        for point, seconds in sorted(ways.items()):
            if seconds - flown_s[k + 1] < ahead_s:
                best, ahead_s = _Way("return", point, k), seconds - float(flown_s[k + 1])
    return result


def _choose(diverts: list[dict[int, float]], returns: list[tuple[_Way, float]]) -> list[tuple[_Way, float]]:
    """The diversion of every cell, and how long it takes."""
    chosen: list[tuple[_Way, float]] = []
    for ways_of_cell, (back, back_s) in zip(diverts, returns, strict=True):
        ways = {_Way("divert", point): seconds for point, seconds in sorted(ways_of_cell.items())} | {back: back_s}
        best = min(ways, key=lambda way: ways[way])
        if chosen and (before := chosen[-1][0]) in ways and ways[before] <= _SLOWER * ways[best] + _LATER_S:
            best = before
        chosen.append((best, ways[best]))
    return chosen


def _spans(
    geometry: MissionGeometry,
    edges: Array,
    chosen: list[tuple[_Way, float]],
    home_covered: Flags,
    home_point: str | None,
) -> tuple[Contingency, ...]:
    result: list[Contingency] = []
    begin = 0
    for k in range(1, len(chosen) + 1):
        if k < len(chosen) and chosen[k][0] == chosen[begin][0]:
            continue
        way = chosen[begin][0]
        result.append(
            Contingency(
                from_s=float(edges[begin]),
                to_s=float(edges[k]),
                action=way.action,
                safe_point=home_point if way.point is None else geometry.mission.safe_points[way.point].id,
                covered=True,
                duration_s=max(seconds for _, seconds in chosen[begin:k]),
                straight_home_covered=bool(home_covered[begin:k].all()),
                leave_path_s=None if way.leave is None else float(edges[way.leave + 1]),
            )
        )
        begin = k
    return tuple(result)
