"""The planner's remedies as remedies of the mission: stations by id, places on the earth, ranges as they are given.

The planner speaks of balls in the plane; a change here is one of the mission document, so that doing what it says makes
the mission feasible: ranges grow by what the projection's correction will take off again. Every remedy is carried out
on a copy of the mission before it is offered, and the smallest comes first.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

import planner.remedy as plane
from gcs.geodesy.range_bounds import planning_elevation_deg, range_needed_m
from gcs.layout.mission_geometry import MissionGeometry
from gcs.layout.planning_problem import PlanningProblem
from gcs.mission.model import GeoPosition, LocalPosition, Mission, amsl_m
from gcs.remedies.application import applied
from gcs.remedies.changes import (
    AddStation,
    Change,
    IncludeStation,
    Location,
    LowerElevation,
    LowerElevations,
    LowerMargin,
    Move,
    RaiseAllRanges,
    RaiseLimit,
    RaiseRange,
    SetAltitude,
    WidenBand,
)
from gcs.remedies.remedy import Remedy, cost_order
from gcs.remedies.trial import is_linked
from planner import Infeasibility, Problem
from planner.arrays import Array

# Shares by which a remedy is made larger until it holds: the earth's plane shifts a little with what it moves.
PADS = (0.0, 1e-9, 1e-6, 1e-4, 2e-3)
# Above this many stations remedies are not tried.
MAX_TRIED = 2_000
# Excluded stations tried one by one, and together.
MAX_INCLUDED = 20
# A floor so far below every antenna is no flight over the ground they stand on.
GROUND_DEPTH_M = 150.0
# Parts of a metre and of a degree that are printed, and how far off a printed place may be.
TENTH, HUNDREDTH = 10.0, 100.0
PLACE_M = 0.3


def mission_remedies(laid: PlanningProblem, finding: Infeasibility) -> list[Remedy]:
    """The finding's remedies as those of the mission that hold; sorted. Figures are rounded as they are printed, and
    tried so.
    """
    mission, translate = laid.geometry.mission, _Translation(laid)
    if len(mission.stations) > MAX_TRIED:
        return [translate(remedy) for remedy in finding.remedies]
    found = [held for remedy in finding.remedies if (held := _holding(translate, remedy)) is not None]
    included = included_again(mission)
    plausible = [remedy for remedy in dict.fromkeys(found) if not sinks_the_floor(mission, remedy)]
    return [*([included] if included else []), *sorted(plausible, key=cost_order)]


def alone(laid: PlanningProblem, cause: Infeasibility) -> Remedy:
    """What mends one cause by itself, as a remedy of the mission; empty when nothing does."""
    return _Translation(laid)(cause.remedies[0]) if cause.remedies else ()


def included_again(mission: Mission) -> Remedy:
    """The excluded station, or all of them, with which there is a way; empty when they do not help."""
    excluded = mission.options.excluded_stations
    for station in excluded[:MAX_INCLUDED]:
        include: Remedy = (IncludeStation(station),)
        if is_linked(applied(mission, include)):
            return include
    every: Remedy = tuple(IncludeStation(station) for station in excluded)
    return every if 1 < len(every) <= MAX_INCLUDED and is_linked(applied(mission, every)) else ()


def sinks_the_floor(mission: Mission, remedy: Remedy) -> bool:
    """Whether a remedy lowers the floor of the band far below every antenna: into the ground, as likely as not."""
    lowest = min(amsl_m(mission, station.position) for station in mission.stations)
    floors = [c.min_alt_amsl_m for c in remedy if isinstance(c, WidenBand) and c.min_alt_amsl_m is not None]
    return any(floor < lowest - GROUND_DEPTH_M for floor in floors)


def location_of(geometry: MissionGeometry, position_m: Sequence[float]) -> Location:
    """A plane point in every frame the mission has."""
    east, north, up = (float(x) for x in position_m)
    return Location(
        geometry.geo(np.array([east, north, up])), LocalPosition(east, north, up) if geometry.is_local else None
    )


def rounded_location(
    geometry: MissionGeometry, position_m: Sequence[float], band_m: tuple[float, float] | None = None
) -> Location:
    """`location_of`, rounded as it is printed: a micro-degree, a decimetre; inside the altitudes ``band_m``."""
    exact = location_of(geometry, position_m)

    def height(value: float, zero: float) -> float:
        """``value``, which counts from ``zero`` of the plane's up."""
        if band_m is None:
            return round(value, 1)
        choices = (round(value, 1), down_to(value, TENTH), up_to(value, TENTH))
        return next((one for one in choices if band_m[0] <= one - zero <= band_m[1]), value)

    geo = GeoPosition(
        round(exact.geo.lat_deg, 6),
        round(exact.geo.lon_deg, 6),
        height(exact.geo.alt_amsl_m, geometry.plane.alt_amsl_m),
    )
    if exact.local is None:
        return Location(geo)
    east, north, up = exact.local.east_m, exact.local.north_m, exact.local.up_m
    return Location(geo, LocalPosition(round(east, 1), round(north, 1), height(up, 0.0)))


def up_to(value: float, parts: float) -> float:
    """``value`` rounded up to a whole of ``parts`` a unit."""
    return math.ceil(value * parts - 1e-9) / parts


def down_to(value: float, parts: float) -> float:
    """Likewise rounded down."""
    return math.floor(value * parts + 1e-9) / parts


def _holding(translate: _Translation, remedy: plane.Remedy) -> Remedy | None:
    """A remedy that cures the mission, made a little larger where rounding and the earth ask for it."""
    for pad in PADS:
        translated = translate(tuple(_padded(translate.laid.problem, change, pad) for change in remedy))
        if is_linked(applied(translate.laid.geometry.mission, translated)):
            return translated
    return None


def _padded(problem: Problem, change: plane.Change, pad: float) -> plane.Change:
    """A change larger by a share ``pad``."""
    more = 1.0 + pad
    match change:
        case plane.RaiseRange() | plane.RaiseAllRanges() | plane.SetAltitude():
            return replace(change, by_m=change.by_m * more)
        case plane.Move(of, position_m, by_m):
            # Further the same way: into the range, by more than a printed place is rounded to.
            further = pad and max(more, 1.0 + PLACE_M / max(by_m, 1.0)) - 1.0
            origin = problem.start_m if of == "start" else problem.destination_m
            east, north, up = (p + further * (p - o) for p, o in zip(position_m, origin.tolist(), strict=True))
            up = min(max(up, problem.limits.min_alt_m), problem.limits.max_alt_m)
            return plane.Move(of, (east, north, up), by_m * (1.0 + further))
        case plane.WidenBand(by_m, low_m, high_m):
            low_m = None if low_m is None else low_m - pad * by_m
            high_m = None if high_m is None else high_m + pad * by_m
            return plane.WidenBand(by_m * more, low_m, high_m)
        case plane.LowerElevation(station, to_deg, by_deg):
            return plane.LowerElevation(station, to_deg - pad, by_deg * more)
        case plane.LowerElevations(by_deg):
            return plane.LowerElevations(by_deg * more)
        case plane.AddStation(position_m, range_m):
            return plane.AddStation(position_m, range_m * more)
        case plane.RaiseLimit() | plane.LowerStartSpeed():
            return change


@dataclass(frozen=True)
class _Translation:
    """Turns remedies of a problem into remedies of the mission it was laid out from."""

    laid: PlanningProblem

    def __call__(self, remedy: plane.Remedy) -> Remedy:
        return tuple(self._change(change) for change in remedy)

    def _change(self, change: plane.Change) -> Change:
        geometry = self.laid.geometry
        match change:
            case plane.RaiseRange(station, by_m):
                return self._raise_range(station, by_m)
            case plane.RaiseAllRanges(by_m):
                return self._raise_all_ranges(by_m)
            case plane.SetAltitude(of, alt_m, by_m):
                return SetAltitude(of, float(geometry.plane.altitude_amsl_m(alt_m)), by_m)
            case plane.WidenBand():
                return self._widen_band(change)
            case plane.LowerElevation(station, to_deg):
                return self._lower_elevation(station, to_deg)
            case plane.LowerElevations(by_deg):
                return LowerElevations(up_to(by_deg, HUNDREDTH))
            case plane.Move(of, position_m, by_m):
                limits = self.laid.problem.limits
                place = rounded_location(geometry, position_m, (limits.min_alt_m, limits.max_alt_m))
                return Move(of, place, up_to(by_m, TENTH))
            case plane.AddStation(position_m, range_m):
                return self._add_station(position_m, range_m)
            case plane.RaiseLimit(limit, to):
                return self._raise_limit(limit, to)
            case plane.LowerStartSpeed():
                # Sought by planning, in `gcs.remedies.search`: the planner knows of no start that would do.
                raise ValueError("how slow a start has to be is not the planner's to say")

    def _needed_m(self, planned_m: Array) -> Array:
        """``(M,)``: ranges to give for these planned ones of all the mission's stations, margin included."""
        geometry = self.laid.geometry
        return geometry.needed_ranges_m(planned_m) + geometry.mission.options.range_margin_m

    def _raise_range(self, k: int, by_m: float) -> RaiseRange:
        mission, station = self.laid.geometry.mission, int(self.laid.stations[k])
        planned = np.zeros(len(mission.stations))
        planned[station] = self.laid.problem.ranges_m[k] + by_m
        given = mission.stations[station].range_m
        # A billionth of the range more, so that the sum does not fall short in its last digits.
        needed = max(float(self._needed_m(planned)[station]), given) * (1.0 + 1e-9)
        return RaiseRange(mission.stations[station].id, needed - given, needed)

    def _raise_all_ranges(self, by_m: float) -> RaiseAllRanges | LowerMargin:
        geometry, stations = self.laid.geometry, self.laid.stations
        planned = np.zeros(len(geometry.mission.stations))
        planned[stations] = self.laid.problem.ranges_m + by_m
        more = (self._needed_m(planned) - geometry.full_ranges_m)[stations]
        by = float(more.max()) + 1e-9 * float(geometry.full_ranges_m.max())
        margin = geometry.mission.options.range_margin_m
        return LowerMargin(by, margin - by) if by <= margin else RaiseAllRanges(by)

    def _widen_band(self, change: plane.WidenBand) -> WidenBand:
        limits, altitude_amsl_m = self.laid.geometry.mission.limits, self.laid.geometry.plane.altitude_amsl_m
        if change.min_alt_m is not None:
            to = down_to(float(altitude_amsl_m(change.min_alt_m)), TENTH)
            return WidenBand(min_alt_amsl_m=to, by_m=limits.min_alt_amsl_m - to)
        assert change.max_alt_m is not None
        to = up_to(float(altitude_amsl_m(change.max_alt_m)), TENTH)
        return WidenBand(max_alt_amsl_m=to, by_m=to - limits.max_alt_amsl_m)

    def _lower_elevation(self, k: int, to_deg: float) -> LowerElevation:
        """The angle to give, so that what the projection's correction adds to it again still leaves enough."""
        geometry, station = self.laid.geometry, int(self.laid.stations[k])
        if not geometry.is_local:
            to_deg -= float(planning_elevation_deg(0.0, geometry.full_ranges_m[station]))
        to_deg = down_to(to_deg, HUNDREDTH) if to_deg >= 0.0 else to_deg
        by = geometry.elevation_mask.lowest_deg[station] - max(to_deg, 0.0)
        return LowerElevation(geometry.mission.stations[station].id, to_deg if to_deg >= 0.0 else None, float(by))

    def _add_station(self, position_m: plane.Point, range_m: float) -> AddStation:
        geometry = self.laid.geometry
        limits = geometry.mission.limits
        location = rounded_location(geometry, position_m)
        # The place is the one that is written: a range that reaches as far from there.
        range_m += float(np.linalg.norm(geometry.enu_m([location.position])[0] - np.array(position_m)))
        if not geometry.is_local:
            highest = max(location.geo.alt_amsl_m, limits.max_alt_amsl_m)
            lowest = min(location.geo.alt_amsl_m, limits.min_alt_amsl_m)
            range_m = float(range_needed_m(range_m + 0.001, highest, highest - lowest))
        return AddStation(location, up_to(range_m + geometry.mission.options.range_margin_m, TENTH))

    def _raise_limit(self, limit: str, to: float) -> RaiseLimit:
        """Limits of the problem that are several, or other, in the mission."""
        if limit == "max_duration_s":
            return RaiseLimit("endurance_s", None, to + (self.laid.geometry.mission.limits.reserve_s or 0.0) + 1e-6)
        return RaiseLimit(limit, None, int(to) if limit == "max_handovers" else to)
