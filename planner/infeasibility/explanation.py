"""Why a problem has no plan, and what would give it one.

`planner.infeasibility.diagnosis.diagnose` says what is wrong with the ranges and the one station to change. Here stand
the limits (wind, start state, endurance) and, beside the first remedy, others of a different kind, each found by
solving for the least change after which nothing is wrong any more:

    raise_range        of the one station with which it is least, where that is not the first remedy
    raise_all_ranges   every range by so much: what a smaller range margin would give
    widen_band         a lower floor or a higher ceiling of the altitude band
    lower_elevations   every lowest elevation by so much, where antennas have one
    move               an end that is out of range, to the nearest place in range
    add_station        one more station, in the middle of the gap
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from planner.arrays import Array
from planner.coverage.disc import altitude_span_m, covering_stations, disc_radius_m, range_to_meet_m
from planner.coverage.grid_zoom import least_by_zooming
from planner.coverage.overlap import MIN_OVERLAP_M, adjacent_pairs
from planner.errors import Infeasibility
from planner.infeasibility.diagnosis import diagnose
from planner.problem import UNMASKED_DEG, Limits, Problem
from planner.routing.bound import LowerBound

# Above this many stations only the first remedy is worked out: the others take some dozens of diagnoses each.
MAX_STATIONS = 2_000
# Above this many no station is looked for that would save handovers with a larger range.
MAX_SINGLE = 300
BISECTIONS = 24
# Faults followed one behind the other.
MAX_FAULTS = 4


def explain(problem: Problem, bound: LowerBound, *, chained: bool = False) -> Infeasibility | None:
    """Why no trajectory of ``problem`` exists; None when neither ranges nor limits speak against one.

    ``chained``: a chain of stations is known (`planner.routing.station_sequence.geodesic_route`), so the ranges need no
    second look.
    ``fix`` is the smallest remedy of its kind, ``fix["also"]`` what more is needed beside it, and
    ``fix["alternatives"]`` remedies of other kinds, each of which cures everything.
    """
    return (
        (None if chained else diagnose_ranges(problem))
        or _wind(problem.limits)
        or _start_state(problem)
        or _endurance(problem, bound.time_s, proven=True)
    )


def diagnose_ranges(problem: Problem) -> Infeasibility | None:
    """As `explain`, of ranges, altitude band and handovers alone."""
    found = diagnose(problem)
    return None if found is None else _with_alternatives(problem, found)


def too_long(problem: Problem, duration_s: float) -> Infeasibility | None:
    """The endurance is too short for the fastest plan found, ``duration_s``; None when it is not."""
    return _endurance(problem, duration_s, proven=False)


def no_way_from_moving_start(problem: Problem) -> Infeasibility:
    """Nothing found that takes up the start's velocity and acceleration and stays in range and limits."""
    speed = float(np.linalg.norm(problem.start_velocity_m_s))
    return Infeasibility(
        "limits",
        f"no trajectory found that takes up the start velocity of {speed:.2f} m/s and stays in range, band and limits; "
        "start slower, or from a place with more room ahead",
        position_m=(float(problem.start_m[0]), float(problem.start_m[1]), float(problem.start_m[2])),
        fix={"action": "lower_start_speed", "below_m_s": speed},
    )


def _wind(limits: Limits) -> Infeasibility | None:
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
        fix={"action": "raise_limit", "limit": "max_airspeed_m_s", "to": wind * (1.0 + 1e-5)},
    )


def _start_state(problem: Problem) -> Infeasibility | None:
    limits = problem.limits
    velocity, accel = problem.start_velocity_m_s, problem.start_acceleration_m_s2
    air = velocity - np.array([*limits.wind_m_s, 0.0])
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
                fix={"action": "raise_limit", "limit": name, "to": value},
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
            fix={"action": "lower_start_speed", "vertical_to_m_s": float(np.sqrt(2.0 * limits.max_accel_m_s2 * room))},
        )
    return None


def _endurance(problem: Problem, duration_s: float, *, proven: bool) -> Infeasibility | None:
    allowed = problem.limits.max_duration_s
    if allowed is None or duration_s <= allowed:
        return None
    what = "no trajectory takes less than" if proven else "the fastest plan found takes"
    return Infeasibility(
        "limits",
        f"{what} {duration_s:.1f} s and {allowed:.1f} s are allowed, {duration_s - allowed:.1f} s too few",
        fix={"action": "raise_limit", "limit": "max_duration_s", "to": duration_s},
    )


def _all_faults(problem: Problem, found: Infeasibility) -> list[Infeasibility]:
    """``found`` and what would still be wrong after its remedy, and so on: an end out of range hides a broken chain."""
    faults = [found]
    for _ in range(MAX_FAULTS - 1):
        remedied = _remedied(problem, faults[-1].fix)
        if remedied is None:
            break
        problem = remedied
        further = diagnose(problem)
        if further is None:
            break
        faults.append(further)
    return faults


def _remedied(problem: Problem, fix: dict[str, object] | None) -> Problem | None:
    """The problem after a remedy of `planner.infeasibility.diagnosis.diagnose`; None for one that cannot be carried out
    here.
    """
    if fix is None:
        return None
    if fix["action"] == "raise_range":
        also = fix.get("also", [])
        assert isinstance(also, list)
        ranges = problem.ranges_m.copy()
        for step in (fix, *also):
            ranges[step["station"]] += step["by_m"]
        return replace(problem, ranges_m=ranges, bound_ranges_m=None)
    if fix["action"] == "lower_elevation":
        assert problem.min_elevation_deg is not None
        angles = problem.min_elevation_deg.copy()
        lowered: dict[str, Any] = fix
        angles[lowered["station"]] = lowered["to_deg"]
        return replace(problem, min_elevation_deg=angles)
    if fix["action"] == "set_altitude":
        name = "start_m" if fix["of"] == "start" else "destination_m"
        point = getattr(problem, name).copy()
        point[2] = fix["alt_m"]
        changes: dict[str, Any] = {name: point}
        return replace(problem, **changes)
    return None


def _together(fixes: list[dict[str, object] | None]) -> dict[str, object] | None:
    """One remedy out of several, carried out one after the other: the first one, and ``also`` the rest.

    Ranges of one station raised twice are raised once by the sum.
    """
    steps: list[dict[str, Any]] = []
    for fix in fixes:
        if fix is None:
            continue
        also = fix.get("also", [])
        assert isinstance(also, list)
        for step in ({key: value for key, value in fix.items() if key != "also"}, *also):
            same = [
                s for s in steps if s["action"] == step["action"] == "raise_range" and s["station"] == step["station"]
            ]
            if same:
                same[0]["by_m"] += step["by_m"]
            else:
                steps.append(dict(step))
    if not steps:
        return None
    return {**steps[0], "also": steps[1:]} if len(steps) > 1 else steps[0]


def _with_alternatives(problem: Problem, found: Infeasibility) -> Infeasibility:
    if problem.station_count > MAX_STATIONS:
        return found
    faults = _all_faults(problem, found)
    if len(faults) > 1:
        message = found.message + "".join(f"; besides, {fault.message}" for fault in faults[1:])
        found = replace(found, message=message, fix=_together([fault.fix for fault in faults]))
    crowded = any(fault.reason == "limits" for fault in faults)
    # More handovers than allowed: one range from end to end is the most it can take.
    span = float(np.linalg.norm(problem.destination_m - problem.start_m)) + float(problem.ranges_m.max())
    widest = span if crowded else 2.0 * max(fault.gap_m or 0.0 for fault in faults) + 1.0
    remedies = [_all_ranges(problem, widest), _band(problem), _elevations(problem)]
    if crowded:
        remedies.append(_one_range(problem, widest))
    elif len(faults) == 1 and found.reason.endswith("_uncovered"):
        remedies.append(_move(problem, found))
    if len(faults) == 1 and not crowded:
        remedies.append(_station(problem, found))
    alternatives = [remedy for remedy in remedies if remedy is not None]
    if not alternatives:
        return found
    fix = dict(found.fix) if found.fix is not None else dict(alternatives.pop(0))
    if alternatives:
        fix["alternatives"] = alternatives
    return replace(found, fix=fix)


def _least(cured: Callable[[float], bool], most: float, needed: float = 0.0) -> float | None:
    """The least ``x`` up to ``most`` for which ``cured(x)``, at most a ten-millionth of it above; None when none is.

    It is known not to be less than ``needed``.
    """
    if not cured(most):
        return None
    if needed > 0.0 and cured(needed):
        return needed
    low, high = max(needed, 0.0), most
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if cured(middle) else (middle, high)
    return high


def _linked(problem: Problem) -> bool:
    """True when `planner.infeasibility.diagnosis.diagnose` would find nothing wrong; cheaper where it would."""
    if not problem.ends_in_band():
        return False
    sources = covering_stations(problem, problem.start_m)
    targets = covering_stations(problem, problem.destination_m)
    if not len(sources) or not len(targets):
        return False
    pairs = adjacent_pairs(problem).pairs
    count = problem.station_count
    graph = csr_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    labels = connected_components(graph, directed=False)[1]
    if not np.isin(labels[sources], labels[targets]).any():
        return False
    return problem.max_handovers is None or diagnose(problem) is None


def _all_ranges(problem: Problem, most_m: float) -> dict[str, object] | None:
    """Every range raised; by the widest gap of the narrowest chain would do but for slant, twice that is plenty."""

    def cured(by_m: float) -> bool:
        return _linked(replace(problem, ranges_m=problem.ranges_m + by_m, bound_ranges_m=None))

    by_m = _least(cured, most_m)
    return None if by_m is None else {"action": "raise_all_ranges", "by_m": by_m}


def _one_range(problem: Problem, most_m: float) -> dict[str, object] | None:
    """The one station whose range has to be raised least, and by how much."""
    if problem.station_count > MAX_SINGLE:
        return None

    def cured(station: int, by_m: float) -> bool:
        ranges = problem.ranges_m.copy()
        ranges[station] += by_m
        return _linked(replace(problem, ranges_m=ranges, bound_ranges_m=None))

    best: tuple[int, float] | None = None
    for station in range(problem.station_count):
        # Only a station that does with less than the best so far is worth working out.
        most = most_m if best is None else best[1] * (1.0 - 1e-3)
        by_m = _least(partial(cured, station), most)
        if by_m is not None:
            best = station, by_m
    return None if best is None else {"action": "raise_range", "station": best[0], "by_m": best[1]}


def _elevations(problem: Problem) -> dict[str, object] | None:
    """Every lowest elevation lowered by so much, down to the horizon at most."""
    angles = problem.min_elevation_deg
    if angles is None or angles.max() <= 0.0:
        return None

    def cured(by_deg: float) -> bool:
        lowered = np.where(angles < 0.0, angles, np.maximum(angles - by_deg, 0.0))
        return _linked(replace(problem, min_elevation_deg=lowered))

    by_deg = _least(cured, float(angles.max()))
    return None if by_deg is None else {"action": "lower_elevations", "by_deg": by_deg}


def _move(problem: Problem, found: Infeasibility) -> dict[str, object] | None:
    """The end that is out of range moved to the nearest place in the band that a station covers.

    At every altitude the way to a disc is known, and the distance of the two together is convex.
    """
    assert found.position_m is not None
    point = np.array(found.position_m)
    low, high = altitude_span_m(problem)
    usable = np.flatnonzero(low <= high)
    if not len(usable):
        return None
    low, high = low[usable], high[usable]
    masts = problem.station_positions_m[usable, :2]
    away = np.linalg.norm(masts - point[:2], axis=1)

    def aside_m(altitude: Array) -> Array:
        return np.asarray(np.maximum(away[:, None] - disc_radius_m(problem, usable[:, None], altitude), 0.0))

    altitude, distance = least_by_zooming(lambda z: np.hypot(aside_m(z), z - point[2]), low, high)
    best = int(np.argmin(distance))
    by_m, up, aside = float(distance[best]), float(altitude[best]), float(aside_m(altitude[:, None])[best, 0])
    # A billionth further in, so that rounding leaves it covered.
    inwards = min(1.0, (aside + 1e-9 * float(problem.ranges_m.max())) / max(float(away[best]), 1e-9))
    to = np.array([*(point[:2] + inwards * (masts[best] - point[:2])), up])
    of = found.reason.partition("_")[0]
    moved: dict[str, Any] = {f"{of}_m": to}
    if not _linked(replace(problem, **moved)):
        return None
    return {"action": "move", "of": of, "position_m": tuple(float(x) for x in to), "by_m": by_m}


def _band(problem: Problem) -> dict[str, object] | None:
    """The smaller of: the floor lowered towards the antennas, the ceiling raised towards them."""
    limits, heights = problem.limits, problem.station_positions_m[:, 2]
    choices: list[tuple[float, dict[str, object]]] = []
    ends = sorted((float(problem.start_m[2]), float(problem.destination_m[2])))
    down = limits.min_alt_m - min(float(heights.min()), ends[0])
    if down > 0.0:
        by_m = _least(lambda by: _linked(_band_moved(problem, -by, 0.0)), down, limits.min_alt_m - ends[0])
        if by_m is not None:
            choices.append((by_m, {"action": "widen_band", "min_alt_m": limits.min_alt_m - by_m, "by_m": by_m}))
    up = max(float(heights.max()), ends[1]) - limits.max_alt_m
    if up > 0.0:
        by_m = _least(lambda by: _linked(_band_moved(problem, 0.0, by)), up, ends[1] - limits.max_alt_m)
        if by_m is not None:
            choices.append((by_m, {"action": "widen_band", "max_alt_m": limits.max_alt_m + by_m, "by_m": by_m}))
    return min(choices, key=lambda choice: choice[0])[1] if choices else None


def _band_moved(problem: Problem, floor_m: float, ceiling_m: float) -> Problem:
    limits = problem.limits
    return replace(
        problem,
        limits=replace(limits, min_alt_m=limits.min_alt_m + floor_m, max_alt_m=limits.max_alt_m + ceiling_m),
    )


def _station(problem: Problem, found: Infeasibility) -> dict[str, object] | None:
    """A station in the middle of the gap, as high as its neighbours' mean, with the least range that joins them."""
    if found.position_m is None or not found.stations:
        return None
    neighbours = np.array(found.stations)
    point = np.array([*found.position_m[:2], float(problem.station_positions_m[neighbours, 2].mean())])
    angles = problem.min_elevation_deg
    extended = replace(
        problem,
        station_positions_m=np.vstack([problem.station_positions_m, point]),
        ranges_m=np.append(problem.ranges_m, 1.0),
        bound_ranges_m=None,
        min_elevation_deg=None if angles is None else np.append(angles, UNMASKED_DEG),
    )
    new = np.full(len(neighbours), problem.station_count)
    needed = float(range_to_meet_m(extended, new, neighbours, MIN_OVERLAP_M).max())
    if found.reason != "broken_chain":
        needed = max(needed, float(np.linalg.norm(point - np.array(found.position_m))))
    if not np.isfinite(needed):
        return None
    range_m = needed * (1.0 + 1e-9) + 1e-6
    if not _linked(replace(extended, ranges_m=np.append(problem.ranges_m, range_m))):
        return None
    return {"action": "add_station", "position_m": tuple(float(x) for x in point), "range_m": range_m}
