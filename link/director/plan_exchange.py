"""Another plan for a flight in the air: made ready beside the flight, then taken over between two ticks.

A plan may be exchanged for another only where both ask for the same position, velocity and acceleration, and by the
station in control (`gcs.planning.replanning` makes such plans). So nothing of a join is left to do: the reference goes
on at the same place, at the same rate, on another curve. A plan that came too late, or is for another moment, does not
fit and is refused; the flight goes on as it was.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from gcs.errors import PlanError
from gcs.flight import TransitionError
from gcs.plan import Plan, read_plan
from link.handover.handover import handover_windows
from link.preflight.check import Check, Level, worst_first
from link.preflight.route import judge_stops
from link.preflight.vehicle import judge_performance
from link.session.context import FlightContext
from link.session.request import FlightRequest, launch_problems
from link.setpoints.reference import ReferenceTrajectory
from link.setpoints.sampler import SetpointSampler

SAME_M, SAME_M_S, SAME_M_S2 = 0.01, 0.01, 0.01
"""Two plans ask for the same when they differ by no more."""
AHEAD_S = 1.0
"""For so long ahead they must still do so."""
STANDING_M, STANDING_M_S = 0.1, 0.05
COVER_GUARD_S = 0.5


@dataclass(frozen=True)
class NextPlan:
    """A plan with all its tables, fit to be flown by this flight."""

    plan: Plan
    stream: SetpointSampler
    reference: ReferenceTrajectory


def make_ready(document: Mapping[str, Any], flight: FlightContext, values: Mapping[str, Any]) -> NextPlan:
    """Read and judge a plan for a flight under way, and make its tables; takes a while, and touches nothing.

    ``values`` are the vehicle's parameters as read before the flight. Raises `TransitionError` with every reason why
    this flight cannot fly it.
    """
    try:
        plan = read_plan(document)
    except PlanError as error:
        raise TransitionError(f"this is no plan: {error}") from None
    reasons = _unfit(plan, flight)
    reasons += [str(problem) for problem in launch_problems(plan, flight.request)]
    for check in judge_performance(flight.vehicle.profile, values, plan):
        if check.blocks:
            reasons.append(f"{check.name}: {check.message}")
    if reasons:
        raise TransitionError("the new plan cannot be flown: " + "; ".join(reasons))
    stream = SetpointSampler(plan, flight.request.rate_hz)
    stream.at(0.0)
    return NextPlan(plan, stream, ReferenceTrajectory(stream, accel_m_s2=plan.mission.limits.max_accel_m_s2))


def judge_next(plan: Plan, request: FlightRequest, *, loss_timeout_s: float, after_s: float) -> list[Check]:
    """A plan for a flight under way by the rules of its launch, for a person to decide on; the worst first.

    Overlaps, margin and certificate (which `make_ready` refuses it for), and room to stop at the handovers later than
    ``after_s`` of it. ``loss_timeout_s``: how long the autopilot goes without setpoints.
    """
    problems = [
        Check(fault.where, Level.FAILURE, fault.what, fault.value, fault.allowed, fix=fault.fix)
        for fault in launch_problems(plan, request)
    ]
    return worst_first([*problems, *judge_stops(plan, loss_timeout_s, after_s=after_s)])


def _unfit(plan: Plan, flight: FlightContext) -> list[str]:
    reasons = []
    if plan.plane != flight.plan.plane:
        reasons.append("it is laid out in another plane than the one being flown")
    vehicle = plan.mission.options.vehicle_system_id
    if vehicle != flight.vehicle.system_id:
        reasons.append(f"it is for vehicle {vehicle}, this is {flight.vehicle.system_id}")
    ids = {station.id: station.system_id for station in plan.mission.stations}
    for station in dict.fromkeys(plan.station_ids):
        if station not in flight.vehicle.monitor.links:
            reasons.append(f"{station} has no link in this flight")
        elif ids[station] != flight.control.system_ids[station]:
            reasons.append(
                f"{station} has id {ids[station]} in it and {flight.control.system_ids[station]} in this flight"
            )
    return reasons


def time_and_leg(
    upcoming: NextPlan, stream: SetpointSampler, leave_s: float, station: str, join_s: float | None
) -> tuple[float, int]:
    """Where on the new plan a flight goes on that is at ``leave_s`` of the old one, and on which leg.

    ``station`` is in control. ``join_s`` is given for a flight that stands. Raises `TransitionError` where the plans do
    not meet.
    """
    if join_s is None:
        time_s = leave_s
        _same(upcoming, stream, time_s)
    else:
        time_s = join_s
        there, here = upcoming.stream.at(time_s), stream.at(leave_s)
        away_m = float(np.linalg.norm(np.subtract(there.position_enu_m, here.position_enu_m)))
        if away_m > STANDING_M or float(np.linalg.norm(there.velocity_enu_m_s)) > STANDING_M_S:
            raise TransitionError("the new plan begins at rest in another place than where the flight stands")
    ids, windows = upcoming.plan.station_ids, handover_windows(upcoming.plan)
    planned = upcoming.stream.leg_at(time_s)
    # A handover may have come a little later, or sooner, than planned.
    for leg in (planned, planned - 1, planned + 1):
        if not 0 <= leg < len(ids) or ids[leg] != station:
            continue
        begins_s = windows[leg - 1].open_s if leg > 0 else 0.0
        ends_s = windows[leg].limit_s - COVER_GUARD_S if leg < len(windows) else upcoming.stream.duration_s
        if begins_s <= time_s <= ends_s:
            return time_s, leg
    raise TransitionError(f"the new plan has {ids[planned]} in control here, and {station} is")


def _same(upcoming: NextPlan, stream: SetpointSampler, time_s: float) -> None:
    for ahead_s in (0.0, 0.5 * AHEAD_S, AHEAD_S):
        at_s = min(time_s + ahead_s, stream.duration_s)
        there, here = upcoming.stream.at(at_s), stream.at(at_s)
        pairs = (
            (there.position_enu_m, here.position_enu_m, SAME_M),
            (there.velocity_enu_m_s, here.velocity_enu_m_s, SAME_M_S),
            (there.acceleration_enu_m_s2, here.acceleration_enu_m_s2, SAME_M_S2),
        )
        if any(float(np.linalg.norm(np.subtract(a, b))) > allowed for a, b, allowed in pairs):
            raise TransitionError(
                "the new plan leaves the one being flown before this moment: it is too late for it, or it is not for "
                "this flight"
            )
