"""What is asked of the vehicle, tick by tick: a place on the plan, or on a straight line to it or away from it.

The reference never runs beyond what is proved: until the next station is ready, or up to the time authorised, it meets
a limit on the path and brakes before it (`link.setpoints.reference`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum, auto

from gcs.flight import FlightState
from link.director.plan_exchange import NextPlan
from link.handover.handover_chain import HandoverChain
from link.monitors.latency_compensation import LatencyCompensation
from link.monitors.tracking import LagMonitor
from link.session.context import FlightContext
from link.setpoints.reference import ReferenceTrajectory
from link.setpoints.sampler import SetpointSampler
from link.setpoints.setpoint import Vector
from link.setpoints.straight_line import StraightLine

AT_LIMIT_M = 0.5
"""Standing this close before a limit is standing at it."""
MOST_TRANSIT_ACCEL_M_S2 = 1.5
DIVERSION_ACCEL_SHARE = 0.5


class HoldReason(Enum):
    """Why a flight stands; the value is what people are told."""

    COMMANDED = "word"
    """An operator said so."""
    NEXT_PLAN = "a new plan"
    """Another plan begins at rest here, or a little way back."""
    BLIND = "the vehicle's position is not heard"
    NOT_FOLLOWING = "the vehicle does not follow"
    STATION_NOT_READY = "waiting"
    """The handover ahead cannot be made yet."""
    NOT_AUTHORISED = "authorised"
    """The flight has come as far as it may."""


@dataclass(frozen=True, slots=True)
class Hold:
    """A flight that stands. ``resumes`` is the state it goes on in, ``detail`` the reason in more words."""

    reason: HoldReason
    resumes: FlightState
    detail: str = ""

    @property
    def text(self) -> str:
        """For people."""
        return self.detail or self.reason.value


class Course(Enum):
    """What the reference is on."""

    PLAN = auto()
    TRANSIT = auto()
    """A straight line from where the vehicle is to a place on the plan."""
    DIVERSION = auto()
    """A straight line from the plan to a safe point."""


class Guidance:
    """Where the reference is, and the setpoint of each tick. `along_plan` or `along_line` once a tick."""

    def __init__(
        self, flight: FlightContext, chain: HandoverChain, latency: LatencyCompensation, lag: LagMonitor
    ) -> None:
        self._flight = flight
        self._request = flight.request
        self._control = flight.control
        self._chain = chain
        self._latency = latency
        self._lag = lag
        self.stream = SetpointSampler(flight.plan, flight.request.rate_hz)
        # Tables are made now, on the ground: later they would cost ticks.
        self.stream.at(0.0)
        self._accel_m_s2 = flight.plan.mission.limits.max_accel_m_s2
        self._on_plan = ReferenceTrajectory(self.stream, accel_m_s2=self._accel_m_s2)
        self.reference = self._on_plan
        self.course = Course.PLAN
        self.join_s = 0.0
        """The time of the plan a transit leads to."""
        until_s = flight.request.authorised_until_s
        self.authorised_until_s = math.inf if until_s is None else until_s
        self.at_limit = False
        """Whether the reference stands before a limit on the plan."""

    @property
    def on_plan(self) -> bool:
        """Whether the reference is on the plan."""
        return self.course is Course.PLAN

    @property
    def left_s(self) -> float | None:
        """Time of the plan still to fly; None off it."""
        return self.stream.duration_s - self.reference.time_s if self.on_plan else None

    # -- where to -----------------------------------------------------------------------------------------------------

    def transit(self, from_enu_m: Vector, time_s: float, *, stay: bool = False) -> None:
        """Straight to a time of the plan, from a place in its plane; ``stay``: no further than that place."""
        limits, join = self._flight.plan.mission.limits, self.stream.at(time_s)
        accel_m_s2 = min(MOST_TRANSIT_ACCEL_M_S2, self._accel_m_s2)
        line = StraightLine(
            self._flight.plan,
            self._chain.leg,
            from_enu_m,
            from_enu_m if stay else join.position_enu_m,
            speed_m_s=min(self._request.transit_speed_m_s, limits.max_speed_m_s),
            climb_m_s=self._request.climb_m_s,
            accel_m_s2=accel_m_s2,
            yaw_deg=join.yaw_deg,
        )
        self.join_s = time_s
        self.reference, self.course = ReferenceTrajectory(line, accel_m_s2=accel_m_s2), Course.TRANSIT

    def join_plan(self, rate: float) -> None:
        """On the plan from here on, at the place the transit led to."""
        self.reference, self.course = self._on_plan.placed(self.join_s, rate), Course.PLAN

    def divert(self, to_enu_m: Vector) -> None:
        """Straight to a place, from here."""
        here = self.reference.setpoint()
        line = StraightLine(
            self._flight.plan,
            self._chain.leg,
            here.position_enu_m,
            to_enu_m,
            speed_m_s=self._flight.plan.mission.limits.max_speed_m_s,
            climb_m_s=self._request.climb_m_s,
            accel_m_s2=DIVERSION_ACCEL_SHARE * self._accel_m_s2,
            yaw_deg=here.yaw_deg,
        )
        self.reference, self.course = ReferenceTrajectory(line, accel_m_s2=self._accel_m_s2), Course.DIVERSION

    def take_plan(self, upcoming: NextPlan, time_s: float) -> None:
        """On by another plan, at the same place, which has this time on it, and at the same rate."""
        present = self.reference
        self.stream, self._on_plan = upcoming.stream, upcoming.reference
        self.reference = self._on_plan.placed(time_s, present.rate)
        self.reference.rate_change_per_s = present.rate_change_per_s
        self._accel_m_s2, self.at_limit = upcoming.plan.mission.limits.max_accel_m_s2, False

    @property
    def stop_enu_m(self) -> Vector:
        """Where on the plan the flight would stand if it stopped now."""
        reference = self.reference
        stop_s = min(max(reference.time_s + reference.stopping_s(), 0.0), self.stream.duration_s)
        return self.stream.at(stop_s).position_enu_m

    # -- a tick -------------------------------------------------------------------------------------------------------

    @property
    def rate_followed(self) -> float:
        """The largest rate the vehicle follows."""
        return self._lag.rate(self.reference.speed_m_s(self.reference.time_s))

    def along_line(self, dt_s: float, wanted: float) -> None:
        """One tick along whatever the reference is on, at a rate, limits or not."""
        self.reference.step(dt_s, wanted)
        self._send()

    def along_plan(self, dt_s: float, wanted: float, *, backwards: bool = False, until_s: float = math.inf) -> None:
        """One tick along the plan, not beyond ``until_s`` of it: limits, handover, setpoint."""
        reference = self.reference
        low_s, high_s = self._chain.limits(backwards=backwards)
        high_s = min(high_s, self.authorised_until_s, until_s)
        reference.step(dt_s, wanted, low_s=low_s, high_s=high_s)
        limit_s = low_s if backwards else high_s
        self.at_limit = (
            0.0 < limit_s < self.stream.duration_s
            and abs(reference.way_m(reference.time_s, limit_s)) < AT_LIMIT_M
            and reference.stands
        )
        self._chain.step(reference.time_s, backwards=backwards)
        self._send()

    def stay(self) -> None:
        """One tick at rest where the reference is."""
        hold = self.reference.setpoint().hold()
        self._control.send_setpoint(hold)
        self._lag.note(hold)

    def _send(self) -> None:
        """The reference as it will be when this setpoint arrives; the vehicle is judged by what it is now."""
        now, ahead_s = self.reference.setpoint(), self._latency.ahead_s
        self._control.send_setpoint(self.reference.setpoint(ahead_s) if ahead_s > 0.0 else now)
        self._lag.note(now)
