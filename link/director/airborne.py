"""The flight in the air: transit, the plan, holding, returning, landing.

One handler a state, called once a tick; each moves the reference, lets the handover ahead act, and sends one setpoint
through the gate. The flight never runs beyond what is proved: until the next station is ready, or up to the time
authorised, the reference meets a limit on the path and brakes before it (`link.setpoints.reference`). Whether the
vehicle is still ours is judged every tick (`link.monitors.control_loss`); when it is not, the flight has lapsed
(`link.director.link_loss`).

The contingency flown is the plan's: a diversion where the whole straight way lies in the range of the station in
control, else back along the path flown, handing over backwards, to land at the start.
"""

from __future__ import annotations

import math

from gcs.flight import EventKind, FlightState, TransitionError
from link.director.diversion import over_safe_point, way_out
from link.director.landing import Landing
from link.director.launch import Launch
from link.director.link_loss import Lapse
from link.director.plan_exchange import STANDING_M, NextPlan, time_and_leg
from link.handover.handover_chain import Relay
from link.monitors.battery import BatteryWatch
from link.monitors.control_loss import Custody
from link.monitors.latency_lead import Lead
from link.monitors.range_margin import RangeWatch
from link.monitors.tracking import LagMonitor
from link.monitors.uplink import UplinkMonitor
from link.session.context import FlightContext
from link.setpoints.reference import ReferenceTrajectory
from link.setpoints.sampler import SetpointSampler
from link.setpoints.straight_line import StraightLine

Vector = tuple[float, float, float]

NOT_FOLLOWING_S = 10.0
ARRIVED_M = 1.5
SLOW_M_S = 0.7
SETTLE_WAIT_S = 20.0
BLIND = "the vehicle's position is not heard"
AT_LIMIT_M = 0.5
"""Standing this close before a limit is standing at it."""
AT_PLACE_M = 0.005
"""Standing this close to where a new plan begins is standing there."""
CREEP = 0.02
"""Rate, at least, at which a return or a wait before a limit is flown when the lag monitor asks for a stop."""


class Airborne:
    """Everything between the end of the climb and the end of the flight."""

    def __init__(self, context: FlightContext, launch: Launch) -> None:
        self._c = context
        self._launch = launch
        self.stream = SetpointSampler(context.plan, context.request.rate_hz)
        self.relay = Relay(context)
        self.lead = Lead(context)
        self.lag = LagMonitor(context, self.lead)
        self.uplink = UplinkMonitor(context)
        self.range = RangeWatch(context)
        self.battery = BatteryWatch(context)
        self.custody = Custody(context, launch, self.relay, self.lag, self.uplink, self.range)
        self.lapse = Lapse(context, self.relay, self.stream)
        self.landing = Landing(context)
        self.attended = True
        until_s = context.request.authorised_until_s
        self.authorised_until_s = math.inf if until_s is None else until_s
        # Tables are made now, on the ground: later they would cost ticks.
        self.stream.at(0.0)
        self._on_plan = ReferenceTrajectory(self.stream, accel_m_s2=context.plan.mission.limits.max_accel_m_s2)
        self.reference = self._on_plan
        """On the plan, or on the straight line named by `line`."""
        self.line = ""
        self.held_for = ""
        self._accel = context.plan.mission.limits.max_accel_m_s2
        self._since_s = 0.0
        self._held_state = FlightState.CRUISE
        self._join_s = 0.0
        self._divert_to: Vector | None = None
        self._leave_for: tuple[float, str] | None = None
        self._at_limit = False
        self._upcoming: tuple[NextPlan, float, float] | None = None
        """A plan to go on by from rest, its time then, and the time of the present plan to go back to first."""

    # -- beginning ----------------------------------------------------------------------------------------------------

    def begin(self) -> None:
        """Take over after the climb: go to the plan's start."""
        self.relay.loss_timeout_s = self._launch.loss_timeout_s
        self._transit_to(0.0, "to the plan's start")

    def _transit_to(self, time_s: float, reason: str) -> None:
        """Straight to a time of the plan, from where the vehicle is."""
        c = self._c
        here = c.position_enu_m()
        assert here is not None
        join = self.stream.at(time_s)
        line = StraightLine(
            c.plan,
            self.relay.leg,
            here,
            join.position_enu_m,
            speed_m_s=min(c.request.transit_speed_m_s, c.plan.mission.limits.max_speed_m_s),
            climb_m_s=c.request.climb_m_s,
            accel_m_s2=min(1.5, self._accel),
            yaw_deg=join.yaw_deg,
        )
        self._join_s = time_s
        self.reference, self.line = ReferenceTrajectory(line, accel_m_s2=min(1.5, self._accel)), "transit"
        c.last_setpoint_s = c.now_s
        self.custody.begin()
        self.uplink.restart()
        self.lag.forget()
        self._become(FlightState.TRANSIT, reason)

    def _become(self, state: FlightState, reason: str) -> None:
        self._c.become(state, reason)
        self._since_s = self._c.now_s

    # -- a tick -------------------------------------------------------------------------------------------------------

    def tick(self, dt_s: float) -> None:
        """One tick; ``dt_s`` since the last one, missed ticks included."""
        state = self._c.state
        self.lag.update()
        self.lead.update(dt_s)
        self.uplink.update()
        self.range.update()
        self.battery.update(None if self.line else self.stream.duration_s - self.reference.time_s)
        if state is FlightState.LAPSED:
            self._lapsed()
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

    def _send(self) -> None:
        """The reference as it will be when this setpoint arrives; the vehicle is judged by what it is now."""
        now = self.reference.setpoint()
        led_s = self.lead.seconds
        self._c.send_setpoint(self.reference.setpoint(led_s) if led_s > 0.0 else now)
        self.lag.note(now)

    def _along_line(self, dt_s: float, wanted: float) -> None:
        self.reference.step(dt_s, wanted)
        self._send()

    def _along_plan(self, dt_s: float, wanted: float, *, backwards: bool = False, until_s: float = math.inf) -> None:
        """One tick along the plan, not beyond ``until_s`` of it: limits, handover, setpoint."""
        low_s, high_s = self.relay.limits(backwards=backwards)
        high_s = min(high_s, self.authorised_until_s, until_s)
        self.reference.step(dt_s, wanted, low_s=low_s, high_s=high_s)
        limit_s = low_s if backwards else high_s
        self._at_limit = (
            0.0 < limit_s < self.stream.duration_s
            and abs(self.reference.way_m(self.reference.time_s, limit_s)) < AT_LIMIT_M
            and self.reference.stands
        )
        self.relay.step(self.reference.time_s, backwards=backwards)
        self._send()

    def _keep_up(self) -> float:
        """The largest rate the vehicle follows."""
        return self.lag.rate(self.reference.speed_m_s(self.reference.time_s))

    @property
    def _settled(self) -> bool:
        tracking, position = self.lag.tracking, self._c.monitor.position
        if tracking is None or position is None:
            return False
        return tracking.error_m <= ARRIVED_M and position.speed_m_s <= SLOW_M_S

    @property
    def _there(self) -> bool:
        """At the end of a way out, as far as can be known: a vehicle that does not tell its place lands where it is."""
        return self._settled or self.lag.blind

    # -- is it still ours ---------------------------------------------------------------------------------------------

    def _still_ours(self) -> bool:
        """Whether the vehicle follows our stream as far as can be known; False after acting on it not doing so."""
        loss = self.custody.judge(self.reference.time_s, on_plan=not self.line, landing=self.landing.seen)
        if loss is None:
            return True
        if loss.ended is not None:
            self._become(loss.ended, loss.reason)
        else:
            self._lapse(loss.reason, pin=loss.pin)
        return False

    def _lapse(self, reason: str, *, pin: bool) -> None:
        """Fall silent."""
        self._c.alarm("lapse", reason=reason)
        self._upcoming = None
        self.relay.forget()
        self.lag.forget()
        self.lapse.begin(self.reference.time_s if not self.line else self._join_s, pin=pin)
        self._become(FlightState.LAPSED, reason)

    def _lapsed(self) -> None:
        join_s = self.lapse.tick()
        if join_s is not None:
            self._transit_to(join_s, "back to the path, on a person's word")
        elif self.lapse.ended is not None:
            self._become(*self.lapse.ended)

    # -- flying -------------------------------------------------------------------------------------------------------

    def _transit(self, dt_s: float) -> None:
        self._along_line(dt_s, self._keep_up())
        if not self.reference.finished:
            return
        c = self._c
        if not self._settled:
            if c.now_s - self._since_s < self.reference.curve.duration_s + SETTLE_WAIT_S:
                return
            c.alarm("not settled after the transit")
        first = c.launched_s is None
        # This tick sent the point at rest; at the first launch that is the plan's sample at T+0.
        self.reference, self.line = self._on_plan.placed(self._join_s, 1.0 if first else 0.0), ""
        if first:
            c.launched_s = c.now_s
        self._become(FlightState.CRUISE, "T+0" if first else "back on the path")

    def _cruise(self, dt_s: float) -> None:
        rate = self._keep_up()
        if self.lag.blind:
            self._c.alarm(BLIND)
            self._hold(BLIND)
        elif self.lag.lost:
            self._hold("the vehicle does not follow")
        self._along_plan(dt_s, rate if self._c.state is FlightState.CRUISE else 0.0)
        if self._c.state is not FlightState.CRUISE:
            return
        if self.reference.finished and not self.relay.moving:
            self._become(FlightState.ARRIVED, "end of the plan")
        elif self._at_limit and not self.reference.finished:
            self._hold(self._why_standing())

    def _why_standing(self) -> str:
        handover = self.relay.handover
        if handover is not None and not handover.open:
            return f"waiting for {handover.border.to_station}: {handover.missing() or handover.reason}"
        return f"authorised up to {self.authorised_until_s:g} s of the plan"

    def _hold(self, reason: str) -> None:
        self._held_state, self.held_for = self._c.state, reason
        self._become(FlightState.HOLDING, reason)

    def _holding(self, dt_s: float) -> None:
        c = self._c
        if self._upcoming is not None:
            self._go_back(dt_s)
            return
        if self.held_for == BLIND and not self.lag.blind:
            self._become(self._held_state, "its position is heard again")
            return
        waiting = self.held_for.startswith("waiting")
        backwards = self._held_state is FlightState.RETURNING
        if self.line:
            self._along_line(dt_s, 0.0)
        else:
            # Waiting keeps trying the handover ahead, and goes back inside a limit that was passed.
            self._along_plan(
                dt_s, math.copysign(CREEP, -1.0 if backwards else 1.0) if waiting else 0.0, backwards=backwards
            )
            if waiting and (self.relay.handover is None or self.relay.handover.open):
                self._become(self._held_state, "the next station is ready")
                return
        waited_s = c.now_s - self._since_s
        limit_s = c.request.wait_for_station_s if waiting else c.request.hold_limit_s
        if (self.held_for == "word" and self.attended) or waited_s < limit_s:
            return
        if backwards:
            # The way back is shut too: the autopilot's own return is what is left.
            self._lapse(f"no way back: {self.held_for}", pin=False)
            self.lapse.last_resort()
        else:
            self.contingency(f"held for {waited_s:.0f} s, {self.held_for}")

    def _go_back(self, dt_s: float) -> None:
        """To the place on the path where the plan to come begins at rest, and on by it."""
        assert self._upcoming is not None
        upcoming, join_s, leave_s = self._upcoming
        # Forward but a little, where the place was told a millimetre ahead of here; else back.
        self._along_plan(dt_s, CREEP, until_s=leave_s)
        there = abs(self.reference.way_m(self.reference.time_s, leave_s)) < AT_PLACE_M
        if not there or not self.reference.stands or self.relay.moving:
            return
        self._upcoming = None
        try:
            self._exchange(upcoming, join_s)
        except TransitionError as refusal:
            self._c.alarm("the new plan no longer fits", reason=str(refusal))
            self._since_s = self._c.now_s

    def _returning(self, dt_s: float) -> None:
        if self.line:
            self._along_line(dt_s, self._keep_up())
            if self.reference.finished and self._there:
                self._land(FlightState.CONTINGENCY, "over the safe point")
            return
        if self.lag.lost_for_s > NOT_FOLLOWING_S:
            self._lapse("the vehicle does not follow on the way back", pin=False)
            self.lapse.last_resort()
            return
        if self._divert_to is not None:
            self._along_plan(dt_s, 0.0)
            if self.reference.stands:
                self._begin_diversion(self._divert_to)
            return
        self._along_plan(dt_s, -max(self._keep_up(), CREEP), backwards=True)
        if self.reference.time_s <= 0.0 and self._there:
            self._land(FlightState.CONTINGENCY, "back at the start")
        elif self._leave_for is not None and self.reference.time_s <= self._leave_for[0]:
            # Where the way to a safe point leaves the path; on along the path where it is not covered from here.
            self._divert_to, self._leave_for = self._over(self._leave_for[1]), None
        elif self._at_limit:
            self._hold(self._why_standing())

    def _arrived(self, dt_s: float) -> None:
        c = self._c
        hold = self.reference.setpoint().hold()
        c.send_setpoint(hold)
        self.lag.note(hold)
        waited_s = c.now_s - self._since_s
        if c.plan.mission.options.on_arrival == "hold":
            if waited_s >= c.request.hold_limit_s:
                self._land(FlightState.COMPLETED, f"held for {waited_s:.0f} s at the destination")
        elif waited_s >= c.request.arrival_hold_s + (0.0 if self._settled else SETTLE_WAIT_S):
            self._land(FlightState.COMPLETED, "at the destination")

    # -- landing ------------------------------------------------------------------------------------------------------

    def _land(self, outcome: FlightState, reason: str) -> None:
        self.landing.begin(outcome)
        self._become(FlightState.LANDING, reason)

    def _landing(self, dt_s: float) -> None:
        if self.landing.down:
            self._become(self.landing.outcome, "landed and disarmed")
            return
        self.landing.ask()
        if not self.landing.seen:
            # Until it shows LAND the vehicle must not miss us.
            self._along_line(dt_s, 0.0)
        if self.landing.overdue:
            self._become(FlightState.LOST, "no landing was seen")

    # -- ways out -----------------------------------------------------------------------------------------------------

    def contingency(self, reason: str) -> None:
        """Fly the way out in force."""
        c = self._c
        self._upcoming = None
        c.alarm("contingency", reason=reason)
        if c.state is FlightState.LAPSED:
            self.lapse.last_resort()
        elif c.state is FlightState.ARRIVED or self.line == "transit":
            self._land(FlightState.CONTINGENCY, reason)
        elif c.state in (FlightState.CRUISE, FlightState.HOLDING):
            self._choose_way_out()
            self._become(FlightState.RETURNING, reason)

    def _choose_way_out(self) -> None:
        way = way_out(self._c.plan, self.reference.time_s)
        self._divert_to = None if way.divert_to is None else self._over(way.divert_to)
        self._leave_for = way.leave_for

    def _over(self, safe_point: str) -> Vector | None:
        """The place over a safe point; None where the way there from the stop is not in the range of this station."""
        stop_s = min(max(self.reference.time_s + self.reference.stopping_s(), 0.0), self.stream.duration_s)
        stop = self.stream.at(stop_s).position_enu_m
        return over_safe_point(self._c.plan, self._c.plan.trajectory.sequence[self.relay.leg], stop, safe_point)

    def _begin_diversion(self, over: Vector) -> None:
        here = self.reference.setpoint()
        line = StraightLine(
            self._c.plan,
            self.relay.leg,
            here.position_enu_m,
            over,
            speed_m_s=self._c.plan.mission.limits.max_speed_m_s,
            climb_m_s=self._c.request.climb_m_s,
            accel_m_s2=0.5 * self._accel,
            yaw_deg=here.yaw_deg,
        )
        self.reference, self.line, self._divert_to = ReferenceTrajectory(line, accel_m_s2=self._accel), "divert", None
        self._c.emit(EventKind.STATE, **{"from": "returning", "to": "returning", "reason": "to the safe point"})

    # -- words --------------------------------------------------------------------------------------------------------

    def hold(self) -> None:
        """A person says hold: stop on the path and stay."""
        self._upcoming = None
        if self._c.state is FlightState.HOLDING:
            self.held_for = "word"
        else:
            self._hold("word")

    def resume(self) -> None:
        """A person says resume: on from a hold; from a lapse back in, by a transit from where the vehicle is."""
        self._upcoming = None
        if self._c.state is FlightState.LAPSED:
            self.lapse.resume()
        else:
            self._become(self._held_state, "resume")

    def adopt(self, upcoming: NextPlan, join_s: float | None = None, leave_s: float | None = None) -> None:
        """A person says: fly this plan from here on.

        For a flight that stands, ``join_s`` is the plan's time of standing, and ``leave_s`` the time of the present
        plan to go back to first. Raises `TransitionError`, and changes nothing, where the plan does not fit the flight.
        """
        c, reference = self._c, self.reference
        holding = c.state is FlightState.HOLDING
        if self.line or (holding and self._held_state is not FlightState.CRUISE):
            raise TransitionError("the flight is not on its way along the plan")
        if self.relay.moving:
            raise TransitionError("control is being moved just now; say it again in a moment")
        if join_s is None:
            self._exchange(upcoming, None)
            return
        if not holding or not reference.stands:
            raise TransitionError("the new plan begins at rest, and the flight does not stand")
        leave_s = reference.time_s if leave_s is None else leave_s
        if leave_s > reference.time_s and reference.way_m(reference.time_s, leave_s) > STANDING_M:
            raise TransitionError("the new plan begins at rest further on than the flight stands")
        time_and_leg(upcoming, self.stream, leave_s, c.plan.station_ids[self.relay.leg], join_s)
        self._upcoming = (upcoming, join_s, leave_s)
        self.held_for, self._since_s = "a new plan", c.now_s

    def _exchange(self, upcoming: NextPlan, join_s: float | None) -> None:
        c, present = self._c, self.reference
        station = c.plan.station_ids[self.relay.leg]
        time_s, leg = time_and_leg(upcoming, self.stream, present.time_s, station, join_s)
        before = c.plan.plan_sha256
        c.plan, self.stream = upcoming.plan, upcoming.stream
        self.relay.adopt(leg)
        self.lapse.adopt(upcoming.stream)
        self._on_plan = upcoming.reference
        self.reference = self._on_plan.placed(time_s, present.rate)
        self.reference.rate_change_per_s = present.rate_change_per_s
        self._accel, self._at_limit = upcoming.plan.mission.limits.max_accel_m_s2, False
        c.emit(
            EventKind.REPLANNED,
            plan_sha256=c.plan.plan_sha256,
            before=before,
            plan_s=round(time_s, 3),
            mission_time_s=c.plan.mission_time_s,
            handovers_done=leg,
        )
        if c.state is FlightState.HOLDING:
            self._become(FlightState.CRUISE, "on by a new plan")

    def land(self) -> None:
        """A person says land: where the vehicle is."""
        arrived = self._c.state is FlightState.ARRIVED
        if self._c.state is not FlightState.LANDING:
            self._land(FlightState.COMPLETED if arrived else FlightState.CONTINGENCY, "word")

    def authorise(self, until_s: float) -> None:
        """The flight may go on up to a time of the plan."""
        self.authorised_until_s = until_s
        if self._c.state is FlightState.HOLDING and self.held_for.startswith("authorised"):
            self._become(self._held_state, "authorised further")
