"""Findings explained: what is wrong with a mission in an operator's words, and what would help.

Planning raises findings and looks for nothing; here, after it has given up, remedies are sought, by the planner where
ranges are at fault and by planning again where time or the start state is.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from gcs.errors import Finding, MissionInfeasible
from gcs.layout.findings import NoAirspeed, NoRangeLeft
from gcs.layout.planning_problem import lay_out
from gcs.layout.problem_planner import ProblemPlanner
from gcs.mission.model import Mission
from gcs.remedies.application import apply
from gcs.remedies.causes import place_of, sentence, told
from gcs.remedies.changes import (
    Change,
    EarlierArrival,
    IncludeStation,
    LaterArrival,
    LowerLimit,
    LowerWind,
    RaiseLimit,
)
from gcs.remedies.findings import (
    ArrivalAfterEndurance,
    ArrivalTooEarly,
    EnduranceTooShort,
    NoTrajectory,
    TooManyStations,
)
from gcs.remedies.remedy import Remedy, document_of
from gcs.remedies.search import Search, lower_margin
from gcs.remedies.translation import TENTH, mission_remedies, up_to
from gcs.remedies.trial import can_start, is_linked, planned_s, prices_s
from gcs.remedies.wording import words_of
from planner.infeasibility import diagnose_ranges

# A margin is found to this many halvings of the one asked for.
MARGIN_BISECTIONS = 40
# Plans made in search of a start state that can be taken up.
START_PLANS = 40
# Airspeed over the wind's that is asked for, as a part of it: with none to spare the vehicle hardly moves.
WIND_SPARE = 0.005


def explain(finding: Finding, planner: ProblemPlanner) -> MissionInfeasible:
    """``finding`` as the mission's people are told it, with every remedy that was found to help.

    ``planner`` plans the problems of changed missions.
    """
    match finding:
        case NoRangeLeft():
            return _no_range_left(finding, planner)
        case NoAirspeed():
            return _no_airspeed(finding, planner)
        case NoTrajectory():
            return _no_trajectory(finding, planner)
        case TooManyStations():
            return _too_many_stations(finding, planner)
        case EnduranceTooShort():
            return _endurance_too_short(finding, planner)
        case ArrivalTooEarly():
            return _arrival_too_early(finding, planner)
        case ArrivalAfterEndurance():
            return _arrival_after_endurance(finding)
    raise TypeError(f"no explanation of {type(finding).__name__}")


def _refused(
    reason: str,
    message: str,
    remedies: Sequence[Remedy],
    *,
    stations: Sequence[str] = (),
    where: Mapping[str, float] | None = None,
    gap_m: float | None = None,
    causes: Sequence[Mapping[str, object]] = (),
    times_s: Mapping[Remedy, float] | None = None,
) -> MissionInfeasible:
    return MissionInfeasible(
        reason,
        message,
        stations=stations,
        where=where,
        gap_m=gap_m,
        fix=document_of(remedies, times_s),
        fix_text=words_of(remedies, times_s),
        causes=causes,
    )


def _alone(*changes: Change) -> list[Remedy]:
    return [(change,) for change in changes]


# --- as the mission is laid out ---------------------------------------------------------------------------------------


def _no_range_left(finding: NoRangeLeft, planner: ProblemPlanner) -> MissionInfeasible:
    """With the largest margin that leaves a way; where no margin does, with what else has to be changed."""
    mission = finding.mission
    margin = mission.options.range_margin_m
    if is_linked(apply(mission, lower_margin(margin, 0.0))):
        low, high = 0.0, margin
        for _ in range(MARGIN_BISECTIONS):
            middle = 0.5 * (low + high)
            linked = is_linked(apply(mission, lower_margin(margin, middle)))
            low, high = (middle, high) if linked else (low, middle)
        return _no_range_refused(mission, _alone(lower_margin(margin, low)))
    try:
        laid = lay_out(apply(mission, lower_margin(margin, 0.0)))
    except NoRangeLeft as still:
        return _no_range_refused(still.mission, [])
    except Finding as other:
        return explain(other, planner)
    found = diagnose_ranges(laid.problem)
    more = [] if found is None else mission_remedies(laid, found)
    return _no_range_refused(mission, [(lower_margin(margin, 0.0), *(more[0] if more else ()))])


def _no_range_refused(mission: Mission, remedies: Sequence[Remedy]) -> MissionInfeasible:
    margin = mission.options.range_margin_m
    widest = max(mission.stations, key=lambda station: station.range_m)
    return _refused(
        "start_uncovered",
        f"The range margin of {margin:g} m leaves no station any range.",
        remedies,
        stations=[widest.id],
        gap_m=float(margin - widest.range_m),
    )


def _no_airspeed(finding: NoAirspeed, planner: ProblemPlanner) -> MissionInfeasible:
    mission, limits = finding.mission, finding.mission.limits
    assert limits.max_airspeed_m_s is not None
    assert limits.wind_m_s is not None
    needed = up_to((1.0 + WIND_SPARE) * finding.standing_m_s, TENTH)
    part = limits.max_airspeed_m_s / needed
    wind = float(np.hypot(*limits.wind_m_s))
    east, north = (part * x for x in limits.wind_m_s)
    raised = RaiseLimit("max_airspeed_m_s", needed - limits.max_airspeed_m_s, needed)
    remedies = _alone(raised, LowerWind(part * wind, east, north))
    return _refused(
        "limits",
        f"The wind of {wind:.1f} m/s leaves nothing of the airspeed limit of {limits.max_airspeed_m_s:g} m/s: "
        "the vehicle cannot hold its place, nor start or end at rest.",
        remedies,
        times_s=prices_s(mission, remedies, planner),
    )


# --- as it is planned -------------------------------------------------------------------------------------------------


def _no_trajectory(finding: NoTrajectory, planner: ProblemPlanner) -> MissionInfeasible:
    laid, found = finding.laid, finding.infeasibility
    geometry = laid.geometry
    moving = geometry.mission.options.start_state is not None
    if found.reason == "limits" and moving and found.remedies and found.limit != "max_handovers":
        return _no_start(geometry.mission, planner, found.message, found.limit)
    remedies = mission_remedies(laid, found)
    message, causes = told(laid, found)
    included = [change.station for change in remedies[0] if isinstance(change, IncludeStation)] if remedies else []
    if included:
        are = "is" if len(included) == 1 else "are"
        message += f" {' and '.join(included)} {are} excluded (excluded_stations); otherwise there is a way."
    return _refused(
        found.reason,
        message,
        remedies,
        stations=[geometry.mission.stations[int(laid.stations[k])].id for k in found.stations],
        where=place_of(geometry, found),
        gap_m=found.gap_m,
        causes=causes,
        times_s=prices_s(geometry.mission, remedies, planner),
    )


def _no_start(mission: Mission, planner: ProblemPlanner, message: str, limit: str | None) -> MissionInfeasible:
    """The start state cannot be taken up: it breaks ``limit``, or there is no way on from it (None)."""

    def possible(changed: Mission) -> bool:
        # What breaks a limit is seen at once, and what does not is soon planned; else a quick look has to do.
        return can_start(changed) if limit is None else math.isfinite(planned_s(changed, planner))

    search = Search(mission, lambda m: -1.0 if possible(m) else math.inf, math.inf, plans=START_PLANS)
    where = {name: float(value) for name, value in vars(mission.start).items()}
    if mission.origin is not None:
        place = lay_out(mission).geometry.geo(np.array([where["east_m"], where["north_m"], where["up_m"]]))
        where |= {name: float(value) for name, value in vars(place).items()}
    return _refused("limits", sentence(message), _alone(*search.start_changes(limit)), where=where)


def _too_many_stations(finding: TooManyStations, planner: ProblemPlanner) -> MissionInfeasible:
    """With what leaves a way past fewer stations; none of it is more handovers."""
    mission, most = finding.mission, finding.most
    laid = lay_out(replace(mission, options=replace(mission.options, max_handovers=most - 1)))
    found = diagnose_ranges(laid.problem)
    offered = [] if found is None else mission_remedies(laid, found)
    remedies = [r for r in offered if not any(isinstance(c, RaiseLimit) and c.limit == "max_handovers" for c in r)]
    message = (
        f"{finding.count} stations are needed on the way, and MAVLink system ids tell no more than {most} apart in one "
        "flight. Fly it as several missions that meet at a landing place, or with fewer stations of larger range."
    )
    return _refused("limits", message, remedies)


def _endurance_too_short(finding: EnduranceTooShort, planner: ProblemPlanner) -> MissionInfeasible:
    mission, duration, allowed_s = finding.mission, finding.duration_s, finding.allowed_s
    reserve, missing = mission.limits.reserve_s or 0.0, duration - allowed_s
    search = Search(mission, lambda m: planned_s(m, planner) - allowed_s, missing)
    changes: list[Change] = [RaiseLimit("endurance_s", missing, duration + reserve + 1e-6)]
    if reserve > missing:
        changes.append(LowerLimit("reserve_s", missing, reserve - missing - 1e-6))
    bound_s = finding.lower_bound_s
    proven = f"; no flight takes less than {bound_s:.1f} s" if bound_s > allowed_s else ""
    less = f" less the reserve of {reserve:g} s" if reserve else ""
    return _refused(
        "limits",
        f"The endurance{less} allows {allowed_s:.1f} s and the fastest plan takes {duration:.1f} s, "
        f"{missing:.1f} s too long{proven}.",
        _alone(*changes, *search.time_changes()),
    )


def _arrival_too_early(finding: ArrivalTooEarly, planner: ProblemPlanner) -> MissionInfeasible:
    duration, arrival_s = finding.duration_s, finding.arrival_s
    missing = duration - arrival_s
    search = Search(finding.mission, lambda m: planned_s(m, planner) - arrival_s, missing)
    return _refused(
        "arrival",
        f"The fastest plan takes {duration:.1f} s, but arrival is asked for at {arrival_s:g} s, "
        f"{missing:.1f} s earlier.",
        _alone(LaterArrival(missing, duration + 1e-6), *search.time_changes()),
    )


def _arrival_after_endurance(finding: ArrivalAfterEndurance) -> MissionInfeasible:
    arrival, allowed = finding.arrival_s, finding.allowed_s
    missing, reserve = arrival - allowed, finding.mission.limits.reserve_s or 0.0
    changes: list[Change] = [
        EarlierArrival(missing, allowed),
        RaiseLimit("endurance_s", missing, arrival + reserve),
    ]
    if reserve > missing:
        changes.append(LowerLimit("reserve_s", missing, reserve - missing))
    return _refused(
        "endurance",
        f"Arrival at {arrival:g} s is {missing:.1f} s later than the {allowed:g} s that endurance less reserve allow.",
        _alone(*changes),
    )
