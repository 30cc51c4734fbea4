"""From armed motors to the height of the plan's start, each autopilot its own way.

ArduPilot: GUIDED, arm, NAV_TAKEOFF, and not one setpoint during the climb (it would abort it). PX4: a stream of
setpoints for more than a second first, then OFFBOARD, arm, and the climb is flown by setpoints. An ack is an answer,
not a fact: modes and arming are believed from the HEARTBEAT alone.
"""

from __future__ import annotations

from collections.abc import Callable

from gcs.flight import EventKind, FlightState
from link.dialect import mavlink
from link.preflight.evidence import PreflightEvidence
from link.session.context import FlightContext
from link.session.procedure import Refused, Steps, answered, wait_until
from link.setpoints.reference import ReferenceTrajectory
from link.setpoints.setpoint import Setpoint
from link.setpoints.straight_line import StraightLine

MODE_WAIT_S = 3.0
SETTLED_M = 1.5
SETTLED_M_S = 0.7
UNFIT_WAIT_S = 2.0
"""What is not known for a moment is waited for so long before the launch is given up."""


class TakeOff:
    """The climb. ``restore`` gives back what was borrowed, where the vehicle stays on the ground after all;
    ``evidence`` says why nothing may be armed or climbed now."""

    def __init__(self, flight: FlightContext, restore: Callable[[], Steps[None]], evidence: PreflightEvidence) -> None:
        self._flight = flight
        self._request = flight.request
        self._timeline = flight.timeline
        self._vehicle = flight.vehicle
        self._control = flight.control
        self._restore = restore
        self._evidence = evidence

    def run(self, ground_amsl_m: float) -> Steps[bool]:
        """All of it, from the ground at that altitude; whether the vehicle is stuck on the way up.

        Raises `Refused` while the vehicle is on the ground.
        """
        if self._vehicle.profile.climbs_by_command:
            return (yield from self._climb_by_command(ground_amsl_m))
        return (yield from self._climb_by_setpoints(ground_amsl_m))

    def _climb_by_command(self, ground_amsl_m: float) -> Steps[bool]:
        timeline, vehicle = self._timeline, self._vehicle
        yield from self._enter(vehicle.profile.offboard_mode, None)
        yield from self._arm(None)
        armed_s = timeline.now_s
        timeline.become(FlightState.TAKEOFF)
        start_up_m = float(self._flight.plan.trajectory.evaluate(0.0)[2])
        height_m = start_up_m + self._flight.plan.plane.alt_amsl_m - ground_amsl_m
        # Answered "failed" when an earlier answer was lost and it climbs already: the height tells.
        climb = self._control.start_command("take-off", mavlink.MAV_CMD_NAV_TAKEOFF, (0.0,) * 6 + (height_m,))
        yield from answered(climb)
        timeline.emit(EventKind.COMMAND, name="take-off", result=climb.outcome, attempts=climb.sent)
        limit_s = 30.0 + height_m / 0.5
        climbed = yield from wait_until(
            timeline, lambda: self._at_height(start_up_m) or bool(vehicle.down_since(armed_s)), limit_s
        )
        if vehicle.down_since(armed_s):
            yield from self._restore()
            raise Refused("the vehicle disarmed again instead of climbing")
        if not climbed:
            timeline.alarm("take-off stuck", height_m=height_m)
        # Arming lays home anew, and may tell the origin again.
        vehicle.adopt_origin(self._flight.plan.station_ids[0])
        return not climbed

    def _at_height(self, up_m: float) -> bool:
        vehicle = self._vehicle
        here, position = vehicle.position_enu_m(), vehicle.position
        if here is None or position is None:
            return False
        return abs(here[2] - up_m) <= SETTLED_M and abs(position.velocity_ned_m_s[2]) <= SETTLED_M_S

    def _climb_by_setpoints(self, ground_amsl_m: float) -> Steps[bool]:
        timeline, vehicle, control = self._timeline, self._vehicle, self._control
        here = yield from self._place()
        up_m = float(self._flight.plan.trajectory.evaluate(0.0)[2])
        line = StraightLine(
            self._flight.plan,
            0,
            here,
            (here[0], here[1], up_m),
            speed_m_s=self._request.climb_m_s,
            climb_m_s=self._request.climb_m_s,
            accel_m_s2=1.0,
        )
        climb = ReferenceTrajectory(line, accel_m_s2=1.0)
        started_s = timeline.now_s
        while timeline.now_s - started_s < vehicle.profile.stream_before_offboard_s + 0.5:
            control.send_setpoint(climb.setpoint())
            yield
        yield from self._enter(vehicle.profile.offboard_mode, climb.setpoint())
        yield from self._arm(climb.setpoint())
        timeline.become(FlightState.TAKEOFF)
        period_s = 1.0 / self._request.rate_hz
        deadline_s = timeline.now_s + line.duration_s + 60.0
        while not (climb.finished and self._at_height(up_m)):
            # One HEARTBEAT alone decides nothing; what became of it is judged in the air.
            if (not vehicle.armed or not vehicle.follows) and vehicle.monitor.beats_alike >= 2:
                return False
            if timeline.now_s >= deadline_s:
                timeline.alarm("take-off stuck", height_m=up_m + self._flight.plan.plane.alt_amsl_m - ground_amsl_m)
                return True
            # Not on, while it is not known where the vehicle is.
            climb.step(period_s, 0.0 if vehicle.position is None else 1.0)
            control.send_setpoint(climb.setpoint())
            yield
        return False

    def _enter(self, mode: str, streamed: Setpoint | None) -> Steps[None]:
        """Enter a mode, disarmed; believes the HEARTBEAT. Raises `Refused`."""
        vehicle, control = self._vehicle, self._control
        for _ in range(5):
            ticket = control.start_mode(mode)
            yield from self._streaming(streamed, lambda: vehicle.mode == mode, MODE_WAIT_S)
            control.commander.cancel(ticket)
            if vehicle.mode == mode:
                self._timeline.emit(EventKind.COMMAND, name=f"mode {mode}", result=ticket.outcome, attempts=ticket.sent)
                return
        yield from self._restore()
        raise Refused(f"the vehicle does not enter {mode}: it stays in {vehicle.mode}")

    def _arm(self, streamed: Setpoint | None) -> Steps[None]:
        """Arm, as often as it takes until the vehicle is ready. Raises `Refused` with its own words."""
        timeline, vehicle = self._timeline, self._vehicle
        deadline_s = timeline.now_s + self._request.arm_timeout_s
        outcome = "no answer"
        while timeline.now_s < deadline_s:
            yield from self._stand_down_if_unfit()
            ticket = self._control.start_command("arm", mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (1.0,))
            yield from self._streaming(streamed, lambda t=ticket: t.finished or vehicle.armed, MODE_WAIT_S)  # type: ignore[misc]
            outcome = ticket.outcome
            timeline.emit(EventKind.COMMAND, name="arm", result=outcome, attempts=ticket.sent)
            # The next beat of a 1 Hz HEARTBEAT shows it; a refusal is asked again later.
            yield from self._streaming(streamed, lambda: vehicle.armed, 2.0)
            if vehicle.armed:
                self._evidence.armed()
                yield from self._stand_down_if_unfit()
                return
        yield from self._restore()
        raise Refused(f"the vehicle does not arm ({outcome}): its own words are in the flight's events")

    def _place(self) -> Steps[tuple[float, float, float]]:
        """Where the vehicle is; waited for a moment. Raises `Refused`."""
        yield from wait_until(self._timeline, lambda: self._vehicle.position is not None, UNFIT_WAIT_S)
        here = self._vehicle.position_enu_m()
        if here is None:
            yield from self._restore()
            raise Refused("nothing is armed: the vehicle's position is not known")
        return here

    def _stand_down_if_unfit(self) -> Steps[None]:
        """Motors off, and the end, where nothing may be armed any more. Raises `Refused`."""
        yield from wait_until(self._timeline, lambda: not self._evidence.unfit(), UNFIT_WAIT_S)
        why = self._evidence.unfit()
        if not why:
            return
        if self._vehicle.armed:
            yield from answered(self._control.start_command("disarm", mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (0.0,)))
        yield from self._restore()
        raise Refused(f"launch refused: {why}")

    def _streaming(self, setpoint: Setpoint | None, condition: Callable[[], bool], timeout_s: float) -> Steps[None]:
        """Wait for a condition, streaming a setpoint meanwhile where one is given."""
        timeline = self._timeline
        until_s = timeline.now_s + timeout_s
        while not condition() and timeline.now_s < until_s:
            if setpoint is not None:
                self._control.send_setpoint(setpoint)
            yield
