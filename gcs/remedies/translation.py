"""The planner's remedies as remedies of the mission: stations by id, places on the earth, ranges as they are given.

The planner speaks of balls in the plane; a change here is one of the mission document, so that doing what it says makes
the mission feasible: ranges grow by what the projection's correction will take off again. Every remedy is carried out
on a copy of the mission before it is offered, and the smallest comes first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

import planner.remedy as plane
from gcs.geodesy.range_bounds import planning_elevation_deg, range_needed_m
from gcs.layout.mission_geometry import MissionGeometry
from gcs.layout.planning_problem import PlanningProblem
from gcs.mission.model import LocalPosition
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
from planner import Infeasibility
from planner.arrays import Array

# Shares by which a remedy is made larger until it holds: the earth's plane shifts a little with what it moves.
PADS = (0.0, 1e-9, 1e-6, 1e-4, 2e-3)
# Above this many stations remedies are not tried.
MAX_TRIED = 2_000


def mission_remedies(laid: PlanningProblem, finding: Infeasibility) -> list[Remedy]:
    """The finding's remedies as those of the mission that hold, and a station that need not be left out; sorted."""
    if not finding.remedies:
        return []
    mission, translate = laid.geometry.mission, _Translation(laid)
    if len(mission.stations) > MAX_TRIED:
        return [translate(remedy) for remedy in finding.remedies]
    holding = [held for remedy in finding.remedies if (held := _holding(translate, remedy)) is not None]
    for station in mission.options.excluded_stations:
        include: Remedy = (IncludeStation(station),)
        if is_linked(applied(mission, include)):
            holding.append(include)
            break
    return sorted(holding, key=cost_order)


def location_of(geometry: MissionGeometry, position_m: Sequence[float]) -> Location:
    """A plane point in every frame the mission has."""
    east, north, up = (float(x) for x in position_m)
    return Location(
        geometry.geo(np.array([east, north, up])), LocalPosition(east, north, up) if geometry.is_local else None
    )


def _holding(translate: _Translation, remedy: plane.Remedy) -> Remedy | None:
    """A remedy that cures the mission, made a little larger where rounding and the earth ask for it."""
    for pad in PADS:
        translated = translate(tuple(_padded(change, pad) for change in remedy))
        if is_linked(applied(translate.laid.geometry.mission, translated)):
            return translated
    return None


def _padded(change: plane.Change, pad: float) -> plane.Change:
    """A change larger by a share ``pad``."""
    more = 1.0 + pad
    match change:
        case plane.RaiseRange() | plane.RaiseAllRanges() | plane.SetAltitude() | plane.Move():
            return replace(change, by_m=change.by_m * more)
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
                return LowerElevations(by_deg)
            case plane.Move(of, position_m, by_m):
                return Move(of, location_of(geometry, position_m), by_m)
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
            to = float(altitude_amsl_m(change.min_alt_m))
            return WidenBand(min_alt_amsl_m=to, by_m=limits.min_alt_amsl_m - to)
        assert change.max_alt_m is not None
        to = float(altitude_amsl_m(change.max_alt_m))
        return WidenBand(max_alt_amsl_m=to, by_m=to - limits.max_alt_amsl_m)

    def _lower_elevation(self, k: int, to_deg: float) -> LowerElevation:
        """The angle to give, so that what the projection's correction adds to it again still leaves enough."""
        geometry, station = self.laid.geometry, int(self.laid.stations[k])
        if not geometry.is_local:
            to_deg -= float(planning_elevation_deg(0.0, geometry.full_ranges_m[station]))
        by = geometry.elevation_mask.lowest_deg[station] - max(to_deg, 0.0)
        return LowerElevation(geometry.mission.stations[station].id, to_deg if to_deg >= 0.0 else None, float(by))

    def _add_station(self, position_m: plane.Point, range_m: float) -> AddStation:
        geometry = self.laid.geometry
        location, limits = location_of(geometry, position_m), geometry.mission.limits
        if not geometry.is_local:
            highest = max(location.geo.alt_amsl_m, limits.max_alt_amsl_m)
            lowest = min(location.geo.alt_amsl_m, limits.min_alt_amsl_m)
            # The place is written in degrees and read back: a millimetre is more than that can lose.
            range_m = float(range_needed_m(range_m + 0.001, highest, highest - lowest))
        return AddStation(location, range_m + geometry.mission.options.range_margin_m)

    def _raise_limit(self, limit: str, to: float) -> RaiseLimit:
        """Limits of the problem that are several, or other, in the mission."""
        if limit == "max_duration_s":
            return RaiseLimit("endurance_s", None, to + (self.laid.geometry.mission.limits.reserve_s or 0.0) + 1e-6)
        return RaiseLimit(limit, None, int(to) if limit == "max_handovers" else to)
