"""What a fix does to a mission, and the search for fixes that only planning can find.

A fix is data (``{"action": "raise_range", ...}``, see `gcs.infeasible`). `apply_fix` carries one out, so that every fix
offered is one that was tried. Where ranges are at fault the planner itself solves for the least change. Where a flight
takes too long, or cannot take up its start state, nothing but planning again tells: every option that costs time is
given up as far as it takes, and no further (`Search`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gcs.errors import GcsError, MissionInfeasible
from gcs.layout import lay_out
from gcs.mission import GeoPosition, LocalPosition, Mission, Position, StartState, Station
from planner.diagnosis import diagnose

Fix = dict[str, object]

# Plans made in search of fixes for one mission, at most, and how near a fix comes to the least one that will do.
MAX_PLANS = 24
NEARNESS = 0.008
# Limits of the vehicle that cost time, and how far a fix may raise each.
_RAISABLE = {
    "max_speed_m_s": 4.0,
    "max_accel_m_s2": 10.0,
    "max_jerk_m_s3": 100.0,
    "max_climb_m_s": 10.0,
    "max_descent_m_s": 10.0,
    "max_airspeed_m_s": 4.0,
}
ADDED_STATION = "added"


def number(value: object) -> float:
    """A number out of a fix."""
    assert isinstance(value, int | float | np.integer | np.floating)
    return float(value)


def apply_fix(mission: Mission, fix: Mapping[str, object]) -> Mission:
    """The mission with a fix, and what it names under ``also``, carried out. ``ValueError`` for an unknown action."""
    also = fix.get("also")
    for step in (fix, *(also if isinstance(also, list | tuple) else ())):
        mission = _applied(mission, step)
    return mission


def _applied(mission: Mission, fix: Mapping[str, object]) -> Mission:
    options, limits = mission.options, mission.limits
    match fix["action"]:
        case "raise_range":
            return _with_station(mission, fix, lambda s: replace(s, range_m=s.range_m + number(fix["by_m"])))
        case "raise_all_ranges":
            by = number(fix["by_m"])
            return replace(mission, stations=tuple(replace(s, range_m=s.range_m + by) for s in mission.stations))
        case "lower_margin":
            return replace(mission, options=replace(options, range_margin_m=number(fix["range_margin_m"])))
        case "lower_option":
            return replace(mission, options=replace(options, **{str(fix["option"]): number(fix["to"])}))  # type: ignore[arg-type]
        case "lower_elevation":
            to = fix["to_deg"]
            return _with_station(
                mission, fix, lambda s: replace(s, min_elevation_deg=None if to is None else number(to))
            )
        case "lower_elevations":
            lowered = tuple(
                replace(s, min_elevation_deg=_lowered(s.min_elevation_deg, number(fix["by_deg"])))
                for s in mission.stations
            )
            return replace(mission, stations=lowered)
        case "widen_band":
            return replace(
                mission,
                limits=replace(
                    limits,
                    min_alt_amsl_m=number(fix.get("min_alt_amsl_m", limits.min_alt_amsl_m)),
                    max_alt_amsl_m=number(fix.get("max_alt_amsl_m", limits.max_alt_amsl_m)),
                ),
            )
        case "set_altitude":
            return _with_end(mission, str(fix["of"]), _at_altitude(mission, str(fix["of"]), number(fix["alt_amsl_m"])))
        case "move":
            return _with_end(mission, str(fix["of"]), _position(mission, fix["position"]))
        case "add_station":
            name = ADDED_STATION
            while any(s.id == name for s in mission.stations):
                name += "-x"
            added = Station(name, _position(mission, fix["position"]), number(fix["range_m"]), name)
            return replace(mission, stations=(*mission.stations, added))
        case "include_station":
            kept = tuple(one for one in options.excluded_stations if one != fix["station"])
            return replace(mission, options=replace(options, excluded_stations=kept))
        case "raise_limit" if fix["limit"] == "max_handovers":
            return replace(mission, options=replace(options, max_handovers=int(number(fix["to"]))))
        case "raise_limit" | "lower_limit":
            return replace(mission, limits=replace(limits, **{str(fix["limit"]): number(fix["to"])}))  # type: ignore[arg-type]
        case "lower_wind":
            wind = (number(fix["east_m_s"]), number(fix["north_m_s"]))
            return replace(mission, limits=replace(limits, wind_m_s=wind))
        case "lower_start_speed":
            state = StartState(_triple(fix["velocity_m_s"]), _triple(fix["acceleration_m_s2"]))
            return replace(mission, options=replace(options, start_state=state))
        case "later_arrival" | "earlier_arrival":
            return replace(mission, options=replace(options, arrival_s=number(fix["arrival_s"])))
    raise ValueError(f"no such fix: {fix['action']!r}")


def _with_station(mission: Mission, fix: Mapping[str, object], change: Callable[[Station], Station]) -> Mission:
    return replace(mission, stations=tuple(change(s) if s.id == fix["station"] else s for s in mission.stations))


def _lowered(angle_deg: float | None, by_deg: float) -> float | None:
    return None if angle_deg is None or angle_deg <= by_deg else angle_deg - by_deg


def _with_end(mission: Mission, end: str, position: Position) -> Mission:
    return replace(mission, start=position) if end == "start" else replace(mission, destination=position)


def _at_altitude(mission: Mission, end: str, amsl_m: float) -> Position:
    position = mission.start if end == "start" else mission.destination
    if isinstance(position, GeoPosition):
        return replace(position, alt_amsl_m=amsl_m)
    assert mission.origin is not None
    return replace(position, up_m=amsl_m - mission.origin.alt_amsl_m)


def _position(mission: Mission, place: object) -> Position:
    """The place a fix names, in the mission's own frame."""
    assert isinstance(place, Mapping)
    if mission.origin is None:
        return GeoPosition(number(place["lat_deg"]), number(place["lon_deg"]), number(place["alt_amsl_m"]))
    return LocalPosition(number(place["east_m"]), number(place["north_m"]), number(place["up_m"]))


def _triple(values: object) -> tuple[float, float, float]:
    assert isinstance(values, Sequence)
    east, north, up = (number(x) for x in values)
    return east, north, up


def chains(mission: Mission) -> bool:
    """Whether ranges, band, elevations and handovers allowed leave a way from start to destination."""
    try:
        return diagnose(lay_out(mission).problem) is None
    except MissionInfeasible:
        return False


def cost_order(fix: Mapping[str, object]) -> tuple[int, float]:
    """What fixes are sorted by: what is asked of the mission, then metres in all, then what asks for many or a new one.

    An option or an angle first; one place's metres next; a station that was left out on purpose, every station's
    range, and at last a station more.
    """
    late = ("include_station", "raise_all_ranges", "add_station")
    if fix["action"] in late:
        return 2 + late.index(str(fix["action"])), 0.0
    also = fix.get("also")
    steps = [fix, *(also if isinstance(also, list | tuple) else ())]
    if not all("by_m" in step for step in steps):
        return 0, 0.0
    return 1, sum(abs(number(step["by_m"])) for step in steps)


Excess = Callable[[Mission], float]


@dataclass(frozen=True)
class _Knob:
    """Something that can be given up in part: ``fix(share)`` for shares from 0 (nothing) to 1 (all of it).

    ``offset`` is what stays however much is given up, in shares: what a share is measured against (`NEARNESS`).
    """

    fix: Callable[[float], Fix]
    offset: float = 0.0


class Search:
    """Looks for the least changes after which ``excess`` of a mission is at most zero.

    ``excess``: how much a mission misses what is asked, e.g. seconds too many; infinite when it has no plan at all.
    ``now`` is that of ``mission`` as it is; ``plans`` how many may be made.
    """

    def __init__(self, mission: Mission, excess: Excess, now: float, *, plans: int = MAX_PLANS) -> None:
        self._mission = mission
        self._excess = excess
        self._now = now
        self._left = plans

    def time_fixes(self) -> list[Fix]:
        """What can be given up to be sooner: overlap, tenure, margin, handovers, limits; the cheapest to try first."""
        options, limits = self._mission.options, self._mission.limits
        knobs: list[_Knob] = []
        for name in ("min_overlap_s", "min_tenure_s"):
            given = getattr(options, name)
            if given > 0.0:
                knobs.append(_Knob(_lowering_option(name, given)))
        margin = options.range_margin_m
        if margin > 0.0:
            knobs.append(_Knob(lambda x: lower_margin(margin, (1.0 - x) * margin)))
        knobs += [_raising(n, v) for n in _RAISABLE if (v := getattr(limits, n)) is not None]
        fixes = [fix for knob in knobs if (fix := self._least(knob)) is not None]
        if options.max_handovers is not None:
            fixes += self._first([{"action": "raise_limit", "limit": "max_handovers", "to": options.max_handovers + 1}])
        return fixes + self._first([{"action": "include_station", "station": s} for s in options.excluded_stations[:4]])

    def start_fixes(self, limit: str | None = None) -> list[Fix]:
        """What lets a start state be taken up: less of it, or more of what stops it, ``limit`` if that is known."""
        state = self._mission.options.start_state
        assert state is not None
        velocity, acceleration = np.array(state.velocity_m_s), np.array(state.acceleration_m_s2)

        def slower(share: float) -> Fix:
            left = (1.0 - share) * velocity
            return {
                "action": "lower_start_speed",
                "below_m_s": float(np.linalg.norm(left)),
                "velocity_m_s": [float(x) for x in left],
                "acceleration_m_s2": [float(x) for x in (1.0 - share) * acceleration],
            }

        limits = self._mission.limits
        knobs = [_Knob(slower, offset=0.5)]
        for name in ("max_accel_m_s2", "max_jerk_m_s3") if limit is None else (limit,):
            given = getattr(limits, name)
            if given is not None:
                knobs.append(_raising(name, given))
        if velocity[2] != 0.0 and limit is None:
            room = float(velocity[2]) ** 2 / limits.max_accel_m_s2 + 10.0
            knobs.append(_Knob(_widening(self._mission, room, up=bool(velocity[2] > 0.0))))
        return [fix for knob in knobs if (fix := self._least(knob)) is not None]

    def _first(self, fixes: list[Fix]) -> list[Fix]:
        """The first of several fixes that will do, if any."""
        for fix in fixes:
            if self._left > 0 and self._try(fix) <= 0.0:
                return [fix]
        return []

    def _least(self, knob: _Knob) -> Fix | None:
        """The smallest share of a knob that will do, as its fix; None when all of it would not.

        Times do not always grow with what is asked (another sequence may suddenly be better), so less may do at times.
        The excess is interpolated between what is too little and what is enough (regula falsi), every step a little
        to the safe side; where that does not halve what is open, the next step does.
        """
        if self._left <= 0:
            return None
        low, high = 0.0, 1.0
        before, after = self._now, self._try(knob.fix(1.0))
        if after > 0.0:
            return None
        halve = False
        near = NEARNESS * knob.offset
        while high - low > near + NEARNESS * high and self._left > 0:
            open_part = high - low
            middle = 0.5 * (low + high)
            if not halve and math.isfinite(before) and math.isfinite(after):
                root = low + open_part * before / max(before - after, 1e-12) + 0.3 * (near + NEARNESS * high)
                # Close to what is enough already: is a little less too little?
                middle = min(max(root, low + 0.01 * open_part), high - 0.9 * (near + NEARNESS * high))
                middle = max(middle, low + 0.01 * open_part)
            excess = self._try(knob.fix(middle))
            if excess <= 0.0:
                high, after = middle, excess
            else:
                low, before = middle, excess
            halve = high - low > 0.5 * open_part
        return knob.fix(high)

    def _try(self, fix: Fix) -> float:
        self._left -= 1
        try:
            return self._excess(apply_fix(self._mission, fix))
        except GcsError:
            return math.inf


def lower_margin(given_m: float, to_m: float) -> Fix:
    """The fix that takes ``to_m`` off every range instead of ``given_m``."""
    return {"action": "lower_margin", "by_m": given_m - to_m, "range_margin_m": to_m}


def _lowering_option(name: str, given_s: float) -> Callable[[float], Fix]:
    return lambda x: {"action": "lower_option", "option": name, "by_s": x * given_s, "to": (1.0 - x) * given_s}


def _raising(name: str, given: float) -> _Knob:
    most = (_RAISABLE[name] - 1.0) * given
    return _Knob(
        lambda x: {"action": "raise_limit", "limit": name, "by": x * most, "to": given + x * most},
        offset=given / most,
    )


def _widening(mission: Mission, room_m: float, *, up: bool) -> Callable[[float], Fix]:
    limits = mission.limits
    if up:
        return lambda x: {
            "action": "widen_band",
            "max_alt_amsl_m": limits.max_alt_amsl_m + x * room_m,
            "by_m": x * room_m,
        }
    return lambda x: {"action": "widen_band", "min_alt_amsl_m": limits.min_alt_amsl_m - x * room_m, "by_m": x * room_m}
