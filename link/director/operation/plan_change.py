"""A plan exchanged in flight: at once where both plans agree, or from rest where the flight stands."""

from __future__ import annotations

from dataclasses import dataclass

from gcs.flight import EventKind, TransitionError
from link.director.guidance import Guidance
from link.director.plan_exchange import STANDING_M, NextPlan, time_and_leg
from link.handover.handover_chain import HandoverChain
from link.session.context import FlightContext

AT_PLACE_M = 0.005
"""Standing this close to where a new plan begins is standing there."""
CREEP = 0.02
"""Rate at which the place is gone back to."""


@dataclass(frozen=True)
class PlanToCome:
    """A plan to go on by from rest, its time then, and the time of the present plan to go back to first."""

    plan: NextPlan
    join_s: float
    leave_s: float


class PlanChange:
    """`adopt` a plan; while one is `to_come`, `go_back` every tick."""

    def __init__(self, flight: FlightContext, chain: HandoverChain, guidance: Guidance) -> None:
        self._flight = flight
        self._timeline = flight.timeline
        self._chain = chain
        self._guidance = guidance
        self.to_come: PlanToCome | None = None

    def adopt(self, upcoming: NextPlan, join_s: float | None, leave_s: float | None, *, stands: bool) -> bool:
        """Whether the plan is flown from now on; else it is `to_come`. ``stands``: the flight holds on its plan.

        Raises `TransitionError`, and changes nothing, where the plan does not fit the flight.
        """
        guidance, reference = self._guidance, self._guidance.reference
        if self._chain.moving:
            raise TransitionError("control is being moved just now; say it again in a moment")
        if join_s is None:
            self._exchange(upcoming, None)
            return True
        if not stands or not reference.stands:
            raise TransitionError("the new plan begins at rest, and the flight does not stand")
        leave_s = reference.time_s if leave_s is None else leave_s
        if leave_s > reference.time_s and reference.way_m(reference.time_s, leave_s) > STANDING_M:
            raise TransitionError("the new plan begins at rest further on than the flight stands")
        time_and_leg(upcoming, guidance.stream, leave_s, self._flight.plan.station_ids[self._chain.leg], join_s)
        self.to_come = PlanToCome(upcoming, join_s, leave_s)
        return False

    def go_back(self, dt_s: float) -> bool | None:
        """To the place where the plan to come begins: True once it is flown, False where it no longer fits."""
        assert self.to_come is not None
        upcoming, guidance = self.to_come, self._guidance
        # Forward but a little, where the place was told a millimetre ahead of here; else back.
        guidance.along_plan(dt_s, CREEP, until_s=upcoming.leave_s)
        reference = guidance.reference
        there = abs(reference.way_m(reference.time_s, upcoming.leave_s)) < AT_PLACE_M
        if not there or not reference.stands or self._chain.moving:
            return None
        self.to_come = None
        try:
            self._exchange(upcoming.plan, upcoming.join_s)
        except TransitionError as refusal:
            self._timeline.alarm("the new plan no longer fits", reason=str(refusal))
            return False
        return True

    def _exchange(self, upcoming: NextPlan, join_s: float | None) -> None:
        flight, guidance = self._flight, self._guidance
        station, before = flight.plan.station_ids[self._chain.leg], flight.plan.plan_sha256
        time_s, leg = time_and_leg(upcoming, guidance.stream, guidance.reference.time_s, station, join_s)
        flight.plan = upcoming.plan
        self._chain.adopt(leg)
        guidance.take_plan(upcoming, time_s)
        self._timeline.emit(
            EventKind.REPLANNED,
            plan_sha256=flight.plan.plan_sha256,
            before=before,
            plan_s=round(time_s, 3),
            mission_time_s=flight.plan.mission_time_s,
            handovers_done=leg,
        )
