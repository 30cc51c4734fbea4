"""The flight in the air: transit, the plan, holding, returning, landing.

One handler a state, called once a tick; each moves the reference and sends one setpoint (`link.director.guidance`).
Whether the vehicle is still ours is judged every tick (`link.monitors.control_loss`); when it is not, the C2 link is
lost (`link.director.link_loss`).

The contingency flown is the plan's: a diversion where the whole straight way lies in the range of the station in
control, else back along the path flown, handing over backwards, to land at the start.
"""

from __future__ import annotations

import math
from dataclasses import replace

from gcs.flight import FlightState, TransitionError
from gcs.operator_commands import SETTLE_LIMIT_S, TRANSIT_OVERTIME_S, overtime_s
from link.director.diversion import Diversion
from link.director.guidance import Course, Guidance, Hold, HoldReason
from link.director.landing import Landing
from link.director.link_loss import LostC2Link
from link.director.operation.plan_change import PlanChange
from link.director.plan_exchange import NextPlan
from link.handover.handover_chain import HandoverChain
from link.monitors.battery import BatteryWatch
from link.monitors.control_loss import ControlLossMonitor
from link.monitors.latency_compensation import LatencyCompensation
from link.monitors.motion import MotionWatch
from link.monitors.range_margin import RangeWatch
from link.monitors.tracking import LagMonitor
from link.monitors.uplink import UplinkMonitor
from link.session.context import FlightContext

NOT_FOLLOWING_S = 10.0
ARRIVED_M = 1.5
SLOW_M_S = 0.7
CREEP = 0.02
"""Rate, at least, at which a return or a wait before a limit is flown when the lag monitor asks for a stop."""


class Airborne:
    """Everything between the end of the climb and the end of the flight."""

    def __init__(self, flight: FlightContext) -> None:
        self._flight = flight
        self._request = flight.request
        self._timeline = timeline = flight.timeline
        self._vehicle = vehicle = flight.vehicle
        self._control = control = flight.control
        self.chain = HandoverChain(flight)
        self.latency = LatencyCompensation(control, vehicle.monitor, limit_s=flight.request.lead_limit_s)
        self.lag = LagMonitor(timeline, vehicle, self.latency, speedup=flight.request.speedup)
        self.uplink = UplinkMonitor(timeline, vehicle, control)
        self.range = RangeWatch(flight)
        self.motion = MotionWatch(flight, self.lag)
        self.battery = BatteryWatch(timeline, vehicle)
        self.control_loss = ControlLossMonitor(flight, self.chain, self.lag, self.uplink, self.range)
        self.guidance = Guidance(flight, self.chain, self.latency, self.lag)
        self.diversion = Diversion(flight, self.chain, self.guidance)
        self.lost_link = LostC2Link(flight, self.chain)
        self.landing = Landing(flight, self.chain, self.guidance, self.lost_link)
        self.attended = True
        self.held = Hold(HoldReason.COMMANDED, FlightState.CRUISE)
        """Why the flight stands, while it does."""
        self._since_s = 0.0
        self._at_end_s = math.inf
        """When the way came to its end; infinite before."""
        self.change = PlanChange(flight, self.chain, self.guidance)

    # -- beginning ----------------------------------------------------------------------------------------------------

    def begin(self) -> None:
        """Take over after the climb: go to the plan's start."""
        self._transit_to(0.0, "to the plan's start")

    def _transit_to(self, time_s: float, reason: str) -> None:
        """Straight to a time of the plan, from where the vehicle is."""
        here = self._vehicle.position_enu_m()
        if here is None:
            self._lose_link("where the vehicle is is not known", pin=False)
            return
        self.guidance.transit(here, time_s)
        self._control.last_setpoint_s = self._timeline.now_s
        self.control_loss.begin()
        self.uplink.restart()
        self.lag.forget()
        self._become(FlightState.TRANSIT, reason)

    def _become(self, state: FlightState, reason: str) -> None:
        self._timeline.become(state, reason)
        self._since_s, self._at_end_s = self._timeline.now_s, math.inf

    @property
    def _state_s(self) -> float:
        """How long the flight has been in its state, or has stood for its present reason."""
        return self._timeline.now_s - self._since_s

    # -- a tick -------------------------------------------------------------------------------------------------------

    def tick(self, dt_s: float) -> None:
        """One tick; ``dt_s`` since the last one, missed ticks included."""
        state = self._timeline.state
        self.lag.update()
        self.latency.update(dt_s)
        self.uplink.update()
        self.range.update()
        self.motion.update()
        self.battery.update(self.guidance.left_s)
        if state is FlightState.LAPSED:
            self._link_lost()
            return
        if not self._still_ours():
            return
        handlers = {
            FlightState.TRANSIT: self._transit,
            FlightState.CRUISE: self._cruise,
            FlightState.HOLDING: self._holding,
            FlightState.RETURNING: self._returning,
            FlightState.ARRIVED: self._arrived,
            FlightState.LANDING: self._landing,
        }
        handlers[state](dt_s)
        if state in (FlightState.CRUISE, FlightState.RETURNING) and self._timeline.state is state:
            self._end_in_time(state)

    def _end_in_time(self, state: FlightState) -> None:
        """No way goes on for ever."""
        limit_s = overtime_s(self._flight.plan.mission_time_s)
        if self._state_s <= limit_s:
            return
        reason = f"{state} is not over after {self._state_s:.0f} s"
        if state is FlightState.CRUISE:
            self.contingency(reason)
        else:
            self._lose_link(reason, pin=False)
            self.lost_link.last_resort()

    @property
    def _settled(self) -> bool:
        return self.lag.settled(ARRIVED_M, SLOW_M_S)

    @property
    def _there(self) -> bool:
        """At the end of a return, as far as can be known; one that tells no place, or does not settle, lands too."""
        return self._settled or self.lag.blind or self._waited

    @property
    def _waited(self) -> bool:
        """Whether the end of the way is `SETTLE_LIMIT_S` ago. To be asked when it has come."""
        self._at_end_s = min(self._at_end_s, self._timeline.now_s)
        return self._timeline.now_s - self._at_end_s > SETTLE_LIMIT_S

    # -- is it still ours ---------------------------------------------------------------------------------------------

    def _still_ours(self) -> bool:
        """Whether the vehicle follows our stream as far as can be known; False after acting on it not doing so."""
        guidance = self.guidance
        loss = self.control_loss.judge(guidance.reference.time_s, on_plan=guidance.on_plan, landing=self.landing.alone)
        if loss is None:
            return True
        if loss.ended is not None:
            self._become(loss.ended, loss.reason)
        else:
            self._lose_link(loss.reason, pin=loss.pin)
        return False

    def _lose_link(self, reason: str, *, pin: bool) -> None:
        """Fall silent."""
        guidance = self.guidance
        self._timeline.alarm("lapse", reason=reason)
        self.change.to_come = None
        self.chain.forget()
        self.lag.forget()
        self.lost_link.begin(guidance.reference.time_s if guidance.on_plan else guidance.join_s, pin=pin)
        self._become(FlightState.LAPSED, reason)

    def _link_lost(self) -> None:
        join_s = self.lost_link.tick()
        if join_s is not None:
            self._transit_to(join_s, "back to the path, on a person's word")
        elif self.lost_link.ended is not None:
            self._become(*self.lost_link.ended)

    # -- flying -------------------------------------------------------------------------------------------------------

    def _transit(self, dt_s: float) -> None:
        timeline, guidance = self._timeline, self.guidance
        guidance.along_line(dt_s, guidance.rate_followed)
        if not guidance.reference.finished:
            if self._state_s > overtime_s(guidance.reference.curve.duration_s, TRANSIT_OVERTIME_S):
                self.contingency(f"the transit is not over after {self._state_s:.0f} s")
            return
        if not self._settled:
            if self._state_s < guidance.reference.curve.duration_s + SETTLE_LIMIT_S:
                return
            timeline.alarm("not settled after the transit")
        first = timeline.launched_s is None
        # This tick sent the point at rest; at the first launch that is the plan's sample at T+0.
        guidance.join_plan(1.0 if first and guidance.join_s <= 0.0 else 0.0)
        if first:
            # After a lost C2 link before T+0 the plan may be joined further on, from rest.
            timeline.launched_s = timeline.now_s - guidance.join_s
        self._become(FlightState.CRUISE, "T+0" if first else "back on the path")

    def _cruise(self, dt_s: float) -> None:
        timeline, guidance = self._timeline, self.guidance
        rate = guidance.rate_followed
        if self.lag.blind:
            self._hold(HoldReason.BLIND)
        elif self.lag.lost or (guidance.reference.finished and not self.lag.near and self._waited):
            self._hold(HoldReason.NOT_FOLLOWING)
        guidance.along_plan(dt_s, rate if timeline.state is FlightState.CRUISE else 0.0)
        if timeline.state is not FlightState.CRUISE:
            return
        if guidance.reference.finished and not self.chain.moving and self.lag.near:
            self._become(FlightState.ARRIVED, "end of the plan")
        elif guidance.at_limit and not guidance.reference.finished:
            self._hold_at_limit()

    def _hold(self, reason: HoldReason, detail: str = "") -> None:
        self.held = Hold(reason, self._timeline.state, detail)
        self._become(FlightState.HOLDING, self.held.text)

    def _hold_at_limit(self) -> None:
        """Stand before the limit on the path, and say which it is."""
        handover = self.chain.handover
        if handover is not None and not handover.open:
            lacks = handover.missing() or handover.reason
            self._hold(HoldReason.STATION_NOT_READY, f"waiting for {handover.window.to_station}: {lacks}")
        else:
            until_s = self.guidance.authorised_until_s
            self._hold(HoldReason.NOT_AUTHORISED, f"authorised up to {until_s:g} s of the plan")

    def _holding(self, dt_s: float) -> None:
        held, guidance = self.held, self.guidance
        if self.change.to_come is not None:
            changed = self.change.go_back(dt_s)
            if changed:
                self._become(FlightState.CRUISE, "on by a new plan")
            elif changed is False:
                self._since_s = self._timeline.now_s
            return
        if held.reason is HoldReason.BLIND and not self.lag.blind:
            self._become(held.resumes, "its position is heard again")
            return
        waiting = held.reason is HoldReason.STATION_NOT_READY
        backwards = held.resumes is FlightState.RETURNING
        if not guidance.on_plan:
            guidance.along_line(dt_s, 0.0)
        else:
            # Waiting keeps trying the handover ahead, and goes back inside a limit that was passed.
            creep = math.copysign(CREEP, -1.0 if backwards else 1.0)
            guidance.along_plan(dt_s, creep if waiting else 0.0, backwards=backwards)
            if waiting and (self.chain.handover is None or self.chain.handover.open):
                self._become(held.resumes, "the next station is ready")
                return
        limit_s = self._request.wait_for_station_s if waiting else self._request.hold_limit_s
        if (held.reason is HoldReason.COMMANDED and self.attended) or self._state_s < limit_s:
            return
        if backwards and not waiting:
            self._become(FlightState.RETURNING, f"held for {self._state_s:.0f} s, {held.text}")
        elif backwards:
            # The way back is shut too: the autopilot's failsafe return is what is left.
            self._lose_link(f"no way back: {held.text}", pin=False)
            self.lost_link.last_resort()
        else:
            self.contingency(f"held for {self._state_s:.0f} s, {held.text}")

    def _returning(self, dt_s: float) -> None:
        guidance = self.guidance
        if not guidance.on_plan:
            guidance.along_line(dt_s, guidance.rate_followed)
            if guidance.reference.finished and self._there:
                self._land(FlightState.CONTINGENCY, "over the safe point")
            return
        if self.lag.lost_for_s > NOT_FOLLOWING_S:
            self._lose_link("the vehicle does not follow on the way back", pin=False)
            self.lost_link.last_resort()
            return
        if self.diversion.turning_off:
            guidance.along_plan(dt_s, 0.0)
            if guidance.reference.stands:
                self.diversion.turn_off()
            return
        guidance.along_plan(dt_s, -max(guidance.rate_followed, CREEP), backwards=True)
        if guidance.reference.time_s <= 0.0 and self._there:
            self._land(FlightState.CONTINGENCY, "back at the start")
        elif self.diversion.due:
            self.diversion.leave_path()
        elif guidance.at_limit:
            self._hold_at_limit()

    def _arrived(self, dt_s: float) -> None:
        self.guidance.stay()
        if self._flight.plan.mission.options.on_arrival == "hold":
            if self._state_s >= self._request.hold_limit_s:
                self._land(FlightState.COMPLETED, f"held for {self._state_s:.0f} s at the destination")
        elif self._state_s >= self._request.arrival_hold_s + (0.0 if self._settled else SETTLE_LIMIT_S):
            self._land(FlightState.COMPLETED, "at the destination")

    # -- landing ------------------------------------------------------------------------------------------------------

    def _land(self, outcome: FlightState, reason: str, *, streams: bool = True, by: str = "") -> None:
        good = outcome in (FlightState.COMPLETED, FlightState.LANDED)
        spoiled = good and self.motion.spoiled
        self.landing.begin(FlightState.CONTINGENCY if spoiled else outcome, streams=streams, reason=by)
        self._become(FlightState.LANDING, reason)

    def _landing(self, dt_s: float) -> None:
        follows = self.landing.tick(dt_s)
        if follows is not None and follows[0] is FlightState.LAPSED:
            self._lose_link(follows[1], pin=False)
        elif follows is not None:
            self._become(*follows)

    # -- contingency --------------------------------------------------------------------------------------------------

    def contingency(self, reason: str) -> None:
        """Fly the contingency in force."""
        state = self._timeline.state
        self.change.to_come = None
        self._timeline.alarm("contingency", reason=reason)
        if state is FlightState.LAPSED:
            self.lost_link.last_resort()
        elif state is FlightState.LANDING:
            self.landing.outcome = FlightState.CONTINGENCY
        elif state is FlightState.ARRIVED or self.guidance.course is Course.TRANSIT:
            self._land(FlightState.CONTINGENCY, reason)
        elif state in (FlightState.CRUISE, FlightState.HOLDING):
            if self.guidance.on_plan:
                self.diversion.choose()
            self._become(FlightState.RETURNING, reason)

    # -- operator commands --------------------------------------------------------------------------------------------

    def hold(self) -> None:
        """An operator says hold: stop on the path and stay."""
        self.change.to_come = None
        if self._timeline.state is FlightState.HOLDING:
            self.held = replace(self.held, reason=HoldReason.COMMANDED, detail="")
        else:
            self._hold(HoldReason.COMMANDED)

    def resume(self) -> None:
        """An operator says resume: on from a hold; after a lost C2 link back in, by a transit from where it is."""
        self.change.to_come = None
        if self._timeline.state is FlightState.LAPSED:
            self.lost_link.resume()
        else:
            self._become(self.held.resumes, "resume")

    def adopt(self, upcoming: NextPlan, join_s: float | None = None, leave_s: float | None = None) -> None:
        """An operator says: fly this plan from here on.

        For a flight that stands, ``join_s`` is the plan's time of standing, and ``leave_s`` the time of the present
        plan to go back to first. Raises `TransitionError`, and changes nothing, where the plan does not fit the flight.
        """
        holding = self._timeline.state is FlightState.HOLDING
        if not self.guidance.on_plan or (holding and self.held.resumes is not FlightState.CRUISE):
            raise TransitionError("the flight is not on its way along the plan")
        if not self.change.adopt(upcoming, join_s, leave_s, stands=holding):
            self.held = replace(self.held, reason=HoldReason.NEXT_PLAN, detail="")
            self._since_s = self._timeline.now_s
        elif holding:
            self._become(FlightState.CRUISE, "on by a new plan")

    def land(self, reason: str, outcome: FlightState | None = None) -> None:
        """An operator says land: where the vehicle is, at once, whatever the flight is doing."""
        state, guidance = self._timeline.state, self.guidance
        if state is FlightState.LANDING:
            return
        returning = state is FlightState.RETURNING or self._held_on_return
        if outcome is None:
            outcome = FlightState.COMPLETED if state is FlightState.ARRIVED else FlightState.LANDED
            if returning or state is FlightState.LAPSED:
                outcome = FlightState.CONTINGENCY
        streams = state not in (FlightState.TAKEOFF, FlightState.LAPSED)
        if not streams:
            # Nothing of a stream has been set up, or it has ended.
            self.change.to_come = None
            here = self._vehicle.position_enu_m()
            if state is FlightState.TAKEOFF and not self._vehicle.profile.climbs_by_command and here is not None:
                guidance.transit(here, 0.0, stay=True)
                streams = True
            self._control.last_setpoint_s = self._timeline.now_s
            self.control_loss.begin()
            self.uplink.restart()
            self.lag.forget()
        self._land(outcome, f"land: {reason}", streams=streams, by=f"by command ({reason})")

    @property
    def _held_on_return(self) -> bool:
        return self._timeline.state is FlightState.HOLDING and self.held.resumes is FlightState.RETURNING

    def authorise(self, until_s: float) -> None:
        """The flight may go on up to a time of the plan."""
        self.guidance.authorised_until_s = until_s
        if self._timeline.state is FlightState.HOLDING and self.held.reason is HoldReason.NOT_AUTHORISED:
            self._become(self.held.resumes, "authorised further")
