"""After the C2 link was lost: silence, and re-entry on an operator's command alone.

The stream may have been missed for longer than the autopilot tolerates, or the vehicle left the mode or restarted.
Sending on as if nothing had happened would be a hazard: PX4 takes a stream that resumes as leave to go back to OFFBOARD
unasked, and ArduPilot would race after a reference that has moved on. So nothing is sent but what stops the vehicle:
where PX4 still shows OFFBOARD it is told to HOLD. No command within the limit: the autopilot's failsafe return,
or landing, as asked for.

Re-entry: a link that is proved, a station whose range holds the vehicle, HOLD first (PX4), a second of setpoints at
the place where the vehicle is, the mode, its HEARTBEAT; then a straight transit to the nearest point of the path in
that station's range.
"""

from __future__ import annotations

import math

import numpy as np

from gcs.flight import FlightState
from gcs.operator_commands import LAPSED_LIMIT_S
from link.director.operation.grounded import GroundedArmed
from link.handover.handover_chain import HandoverChain
from link.session.context import FlightContext
from link.session.coverage import choices
from link.session.procedure import Steps, wait_until
from link.setpoints.straight_line import StraightLine

REASK_S = 1.5
BETTER_LINK_S = 1.0
PROVEN_S = 1.0
SEARCH_S = 120.0
"""How far along the plan, both ways, the nearest point of the path is looked for."""
NEARER_M = 1.0
"""Another leg than the present one is joined only where it is so much nearer."""


class LostC2Link:
    """The flight while it is `FlightState.LAPSED`. `tick` gives the time of the plan to join, once it is back in."""

    def __init__(self, flight: FlightContext, chain: HandoverChain) -> None:
        self._flight = flight
        self._request = flight.request
        self._timeline = flight.timeline
        self._vehicle = flight.vehicle
        self._control = flight.control
        self._chain = chain
        self.ended: tuple[FlightState, str] | None = None
        self._plan_s = 0.0
        self._pin = False
        self._since_s = 0.0
        self._asked_s = -math.inf
        self._resort = False
        self._told = False
        self._ground = GroundedArmed(flight)
        self._entry: Steps[float] | None = None

    def begin(self, plan_s: float, *, pin: bool) -> None:
        """The link was lost at ``plan_s`` of the plan. ``pin``: by our silence, so PX4 would take a stream up again."""
        self._plan_s, self._pin, self._since_s = plan_s, pin, self._timeline.now_s
        self._asked_s, self._resort, self._entry, self.ended = -math.inf, False, None, None
        self._told = False
        self._ground.begin()

    def resume(self) -> None:
        """The operator's command: begin re-entry."""
        self._entry = self._enter()

    def last_resort(self) -> None:
        """Hand the vehicle to its failsafe return, or landing, as the request says."""
        self._resort, self._entry = True, None
        self._asked_s = -math.inf

    def tick(self) -> float | None:
        """One tick; the time of the plan to join, once back in."""
        timeline, vehicle = self._timeline, self._vehicle
        if vehicle.down_since(self._since_s):
            ended = FlightState.CONTINGENCY if vehicle.on_ground else FlightState.LOST
            self.ended = (ended, "the vehicle disarmed by itself")
            return None
        silent_s = timeline.now_s - vehicle.monitor.last_heard_s()
        if silent_s > self._request.lost_after_s:
            self.ended = (FlightState.LOST, f"nothing heard for {silent_s:.0f} s")
            return None
        if self._out_of_time():
            return None
        if self._entry is not None:
            return self._advance()
        self.use_best_link()
        if timeline.now_s - self._asked_s < REASK_S:
            return None
        drifting = vehicle.mode in (vehicle.profile.offboard_mode, vehicle.profile.hold_mode)
        if self._resort or (timeline.now_s - self._since_s >= self._request.hold_limit_s and drifting):
            self._command_last_resort()
        elif self._pin and vehicle.profile.resumes_offboard_unasked and vehicle.mode == vehicle.profile.offboard_mode:
            self._asked_s = timeline.now_s
            self._control.start_mode(vehicle.profile.hold_mode)
        return None

    def _out_of_time(self) -> bool:
        """Whether it has `ended` by its limits."""
        timeline, mode = self._timeline, self._vehicle.mode
        self._ground.update(ask=self._resort)
        if self._ground.ended:
            self.ended = (FlightState.LOST, self._ground.ended)
        elif timeline.now_s - self._since_s > LAPSED_LIMIT_S:
            self.ended = (FlightState.LOST, f"left to the autopilot after {LAPSED_LIMIT_S:g} s, which shows {mode}")
        return self.ended is not None

    @property
    def resort_s(self) -> float | None:
        """When the vehicle is told to return by itself, flight's clock; None where it is not, or has been."""
        drifting = self._vehicle.mode in (self._vehicle.profile.offboard_mode, self._vehicle.profile.hold_mode)
        return self._since_s + self._request.hold_limit_s if drifting and not self._resort else None

    @property
    def entering(self) -> bool:
        """Whether a resume is under way."""
        return self._entry is not None

    def no_way_back(self) -> str:
        """Why a resume would fail now; empty where it may succeed."""
        here = self._vehicle.position_enu_m()
        if here is None:
            return "no fresh position"
        if self._vehicle.doubt:
            return self._vehicle.doubt
        try:
            self._where(np.array(here))
        except _NoWayBack as reason:
            return str(reason)
        return ""

    def _advance(self) -> float | None:
        assert self._entry is not None
        try:
            next(self._entry)
        except StopIteration as end:
            self._entry = None
            return float(end.value)
        except _NoWayBack as reason:
            self._entry = None
            self._timeline.alarm("cannot resume", reason=str(reason))
        return None

    def use_best_link(self) -> None:
        """What little is said goes over the link proved last of those in whose range the vehicle is."""
        links, control = self._vehicle.monitor.links, self._control
        now, allowed = control.in_force.station_id, choices(self._flight)
        best = max((links[station] for station in allowed), key=lambda link: link.proven_s)
        if now not in allowed or best.proven_s > links[now].proven_s + BETTER_LINK_S:
            control.grant(best.station_id, "in range, and the link proved last")

    def _command_last_resort(self) -> None:
        timeline, vehicle = self._timeline, self._vehicle
        mode = {"return": vehicle.profile.return_mode, "land": vehicle.profile.land_mode}.get(self._request.last_resort)
        if mode is None:
            self.ended = (FlightState.LOST, f"left to the autopilot, which shows {vehicle.mode}")
        elif vehicle.mode != mode:
            if not self._told:
                self._told = True
                timeline.alarm("last resort", mode=mode)
            self._asked_s = timeline.now_s
            self._control.start_mode(mode)

    # -- back in ------------------------------------------------------------------------------------------------------

    def _enter(self) -> Steps[float]:
        timeline, vehicle, control = self._timeline, self._vehicle, self._control
        here = vehicle.position_enu_m()
        if reason := self.no_way_back():
            raise _NoWayBack(reason)
        assert here is not None
        leg, join_s = self._where(np.array(here))
        station = self._flight.plan.station_ids[leg]
        self._chain.leg = leg
        control.grant(station, "resume")
        vehicle.adopt_origin(station)
        if vehicle.profile.resumes_offboard_unasked:
            yield from self._mode(vehicle.profile.hold_mode)
        still = StraightLine(self._flight.plan, leg, here, here, speed_m_s=1.0, climb_m_s=1.0, accel_m_s2=1.0)
        if vehicle.profile.stream_before_offboard_s > 0.0:
            until_s = timeline.now_s + vehicle.profile.stream_before_offboard_s + 0.5
            while timeline.now_s < until_s:
                control.send_setpoint(still.at(0.0))
                yield
            steps = self._mode(vehicle.profile.offboard_mode)
            for _ in steps:
                control.send_setpoint(still.at(0.0))
                yield
        else:
            yield from self._mode(vehicle.profile.offboard_mode)
        return join_s

    def _mode(self, mode: str) -> Steps[None]:
        vehicle = self._vehicle
        for _ in range(3):
            if vehicle.mode == mode:
                return
            self._control.start_mode(mode)
            yield from wait_until(self._timeline, lambda: vehicle.mode == mode, 3.0)
        if vehicle.mode != mode:
            raise _NoWayBack(f"the vehicle does not enter {mode}: it shows {vehicle.mode}")

    def _where(self, here: np.ndarray) -> tuple[int, float]:
        """The leg whose station can take the vehicle now, and the nearest time of the plan in its coverage."""
        chain, plan = self._chain, self._flight.plan
        best: tuple[float, int, float] | None = None
        # The present leg first: another must be nearer to be preferred.
        legs = sorted(range(len(plan.trajectory.sequence)), key=lambda leg: abs(leg - chain.leg))
        for leg in legs:
            index = plan.trajectory.sequence[leg]
            station = plan.mission.stations[index].id
            if not self._vehicle.monitor.proven_within(self._timeline.now_s, station, PROVEN_S):
                continue
            if float(plan.geometry.outside_m(np.array([index]), here[None, :])[0]) > 0.0:
                continue
            low = chain.windows[leg - 1].open_s if leg > 0 else 0.0
            high = chain.windows[leg].limit_s if leg < len(chain.windows) else plan.mission_time_s
            low, high = max(low, self._plan_s - SEARCH_S), min(high, self._plan_s + SEARCH_S)
            if low >= high:
                continue
            times = np.linspace(low, high, max(2, int((high - low) / 0.1)))
            away = np.linalg.norm(plan.trajectory.evaluate(times) - here, axis=-1)
            k = int(away.argmin())
            if best is None or away[k] < best[0] - NEARER_M:
                best = (float(away[k]), leg, float(times[k]))
        if best is None:
            raise _NoWayBack("no station that is proved covers the vehicle near its path")
        if best[0] > self._request.max_transit_m:
            raise _NoWayBack(f"the path is {best[0]:.0f} m away, allowed is {self._request.max_transit_m:g} m")
        return best[1], best[2]


class _NoWayBack(Exception):  # noqa: N818
    """Re-entry is not possible now; we stay silent."""
