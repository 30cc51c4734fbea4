"""From open links to a vehicle in the air at the height of the plan's start.

connect -> identify -> preflight -> (word) -> mode, arm, take-off. Nothing is armed before every check has passed. An
ack is an answer, not a fact: modes and arming are believed from the HEARTBEAT alone.

The two autopilots take off differently. ArduPilot: GUIDED, arm, NAV_TAKEOFF, and not one setpoint during the climb (it
would abort it). PX4: a stream of setpoints for more than a second first, then OFFBOARD, arm, and the climb is flown by
setpoints.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from gcs.flight import EventKind, FlightState
from link import ownership
from link.commands import Ticket
from link.context import FlightContext
from link.dialect import mavlink
from link.ownership import Ownership
from link.parameters import ParameterClient
from link.params import Parameter, encoding_of
from link.preflight import (
    Check,
    Level,
    judge_parameters,
    judge_performance,
    judge_place,
    judge_vehicle,
    judge_way_home,
)
from link.setpoints import Setpoint
from link.steps import Refused, Steps, answered, wait_until
from link.stream import Reference, StraightLine

LINKS_WAIT_S = 8.0
"""How long the other stations' links are waited for once the vehicle is heard."""
HEARD_S = 3.0
PREFLIGHT_VALID_S = 60.0
MODE_WAIT_S = 3.0
SETTLED_M = 1.5
SETTLED_M_S = 0.7
SIMULATOR_PARAMETER = "SIM_SPEEDUP"

STREAMED_MESSAGES: tuple[tuple[int, float], ...] = (
    (mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, 10.0),
    (mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED, 10.0),
    (mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE, 2.0),
)
"""What the station in control asks the vehicle to send, and how often, in Hz."""


class Launch:
    """The procedure on the ground and the climb. ``send_hold`` streams the setpoint it is given every tick."""

    def __init__(self, context: FlightContext, parameters: ParameterClient) -> None:
        self._c = context
        self.parameters = parameters
        self.values: dict[str, Parameter | None] = {}
        self.checks: list[Check] = []
        self.simulator_speedup: float | None = None
        self.loss_timeout_s = 1.0
        self.ownership_before: Ownership | None = None
        self.ground_amsl_m = 0.0
        self.launch_word = context.request.auto_launch
        self.preflight_s = -math.inf
        self.preflight_id = 0

    def run(self) -> Steps[None]:
        """All of it. Raises `Refused` while the vehicle is on the ground."""
        yield from self._connect()
        yield from self._identify()
        yield from self._preflight()
        yield from self._wait_for_word()
        self._c.become(FlightState.ARMING, "launch")
        if self._c.profile.name == "ardupilot":
            yield from self._take_off_ardupilot()
        else:
            yield from self._take_off_px4()

    # -- connect ------------------------------------------------------------------------------------------------------

    def _connect(self) -> Steps[None]:
        c = self._c
        first = c.plan.station_ids[0]
        c.grant(first, "first station")
        heard = yield from wait_until(
            c,
            lambda: c.monitor.heartbeat is not None and c.monitor.heard_within(c.now_s, first, HEARD_S),
            c.request.connect_timeout_s,
        )
        if not heard:
            over = (
                f"no heartbeat of system {c.vehicle}, component 1 over the link of {first} ({c.request.shown(first)})"
            )
            raise Refused(
                f"{over} in {c.request.connect_timeout_s:g} s: is the vehicle there, its id and the link right?"
            )
        heartbeat = c.monitor.heartbeat
        assert heartbeat is not None
        if heartbeat.autopilot != c.profile.autopilot_id:
            raise Refused(
                f"the vehicle's autopilot is number {heartbeat.autopilot}, not {c.profile.title}: choose its own"
            )
        yield from wait_until(c, lambda: all(self._link_works(s) for s in c.monitor.links), LINKS_WAIT_S)

    def _link_works(self, station: str) -> bool:
        c = self._c
        return c.monitor.heard_within(c.now_s, station, HEARD_S) and c.monitor.proven_within(c.now_s, station, HEARD_S)

    # -- identify -----------------------------------------------------------------------------------------------------

    def _identify(self) -> Steps[None]:
        c = self._c
        c.become(FlightState.IDENTIFYING)
        yield from self._break_in()
        yield from self.request_streams()
        yield from self._request(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION, lambda: c.monitor.version is not None, 5.0)
        if c.monitor.version is not None:
            capabilities = int(c.monitor.version.capabilities)
            self.parameters.encoding = encoding_of(capabilities, c.profile.parameter_encoding)
        # The EKF lays its origin once it has a position: on a cold vehicle that takes most of a minute.
        first = c.plan.station_ids[0]
        known = yield from self._request(
            mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN,
            lambda: c.monitor.links[first].origin is not None and c.monitor.position is not None,
            c.request.arm_timeout_s,
        )
        if not known:
            raise Refused(
                f"no position and EKF origin in {c.request.arm_timeout_s:g} s: does the vehicle have satellites?"
            )
        c.origin = c.monitor.links[first].origin
        for station in dict.fromkeys(c.plan.station_ids):
            # Every link in turn, in control for a moment, still on the ground: what it will carry is tried now.
            if station != first and self._link_works(station):
                c.grant(station, "link check on the ground")
                yield from self._request(
                    mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN,
                    lambda s=station: c.monitor.links[s].origin is not None,  # type: ignore[misc]
                    3.0,
                )
        c.grant(first, "first station")

    def _break_in(self) -> Steps[None]:
        """A vehicle that enforces other stations' ids answers nothing: say so, or open it with its own id."""
        c = self._c
        ticket = yield from self._command("version", mavlink.MAV_CMD_REQUEST_MESSAGE, (148.0,))
        if ticket.result is not None or c.profile.name != "ardupilot":
            return
        hint = "it may be locked to other stations' ids (MAV_OPTIONS bit 0)"
        if not c.request.rescue:
            raise Refused(f"the vehicle is heard but answers no command: {hint}; allow the rescue to take it over")
        first = c.plan.station_ids[0]
        c.grant(first + "!", "rescue")
        yield from self._read()
        before = ownership.present(self.values)
        if before is None:
            raise Refused("the vehicle answers nothing, under its own id either")
        c.alarm("rescue", low=before.low, high=before.high, options=before.options)
        self.ownership_before = before
        after = Ownership(before.low, before.high, before.options & ~ownership.ENFORCE)
        yield from ownership.apply(c, self.parameters, self.values, before, after)
        c.grant(first, "rescued")

    def request_streams(self) -> Steps[None]:
        """Ask for the telemetry the flight is watched by, on the link of the station in control."""
        for message_id, rate_hz in STREAMED_MESSAGES:
            params = (float(message_id), 1e6 / rate_hz)
            yield from self._command("message interval", mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, params)

    def _request(self, message_id: int, arrived: Callable[[], bool], timeout_s: float) -> Steps[bool]:
        """Ask for a message until it is there."""
        c = self._c
        deadline_s = c.now_s + timeout_s
        while not arrived() and c.now_s < deadline_s:
            yield from self._command("request message", mavlink.MAV_CMD_REQUEST_MESSAGE, (float(message_id),))
            yield from wait_until(c, arrived, min(1.0, max(0.0, deadline_s - c.now_s)))
        return arrived()

    # -- preflight ----------------------------------------------------------------------------------------------------

    def _preflight(self) -> Steps[None]:
        c = self._c
        c.become(FlightState.PREFLIGHT)
        yield from self._read()
        checks = yield from self._failsafes()
        checks += judge_performance(c.profile, self.values, c.plan)
        heartbeat, position = c.monitor.heartbeat, c.position_enu_m()
        assert heartbeat is not None
        assert position is not None
        self.ground_amsl_m = position[2] + c.plan.plane.alt_amsl_m
        checks += judge_vehicle(
            armed=heartbeat.armed,
            landed_state=c.monitor.landed_state,
            battery_percent=c.monitor.battery_percent,
            simulator_speedup=self.simulator_speedup,
            speedup=c.request.speedup,
        )
        checks += judge_place(c.plan, position, self.ground_amsl_m, c.request)
        yield from wait_until(c, lambda: all(self._link_works(s) for s in c.monitor.links), LINKS_WAIT_S)
        checks += [*self._judge_links(), judge_way_home(c.plan)]
        if not any(check.level is Level.FAILURE for check in checks):
            checks += yield from self._own()
        self._tell(checks)
        failures = [check for check in checks if check.level is Level.FAILURE]
        if failures:
            yield from self.restore()
            raise Refused(
                "preflight: " + "; ".join(f"{f.name}: {f.message} (required: {f.required})" for f in failures)
            )
        timeout = self.values.get("offboard_loss_timeout")
        self.loss_timeout_s = float(timeout.value) if timeout is not None else 1.0
        self.preflight_s = c.now_s
        c.become(FlightState.READY, "preflight passed")

    def _tell(self, checks: list[Check]) -> None:
        self.checks = checks
        self.preflight_id += 1
        for check in checks:
            self._c.emit(EventKind.CHECK, preflight=self.preflight_id, **check.to_document())

    def _read(self) -> Steps[None]:
        """Read every parameter the profile knows, under whichever of its names."""
        # The newest name of each first; older ones, which most vehicles meet with silence, only where it is unknown.
        missing = list(self._c.profile.parameters)
        self.values = dict.fromkeys(p.key for p in missing)
        for generation in range(max(len(p.names) for p in missing)):
            wanted = [p for p in missing if len(p.names) > generation]
            names = [p.names[generation] for p in wanted] + ([SIMULATOR_PARAMETER] if generation == 0 else [])
            asked = self.parameters.read(names, self._c.fence)
            yield from wait_until(self._c, lambda a=asked: all(one.finished for one in a), 30.0)  # type: ignore[misc]
            answers = {one.name: one.answer for one in asked}
            self.values.update({p.key: answers[p.names[generation]] for p in wanted})
            missing = [p for p in wanted if answers[p.names[generation]] is None]
            if generation == 0:
                simulator = answers[SIMULATOR_PARAMETER]
                self.simulator_speedup = None if simulator is None else float(simulator.value)

    def _failsafes(self) -> Steps[list[Check]]:
        """Judge the parameters; set what is unsafe where that is allowed, and judge again what is read back."""
        c = self._c
        checks = judge_parameters(c.profile, self.values, c.request)
        allowed = c.request.set_parameters == "yes" or (
            c.request.set_parameters == "auto" and self.simulator_speedup is not None
        )
        unsafe = [check for check in checks if check.level is Level.FAILURE and check.set is not None]
        heartbeat = c.monitor.heartbeat
        if not unsafe or not allowed or heartbeat is None or heartbeat.armed:
            return checks
        for check in unsafe:
            assert check.set is not None
            name, value = check.set
            setting = self.parameters.set(name, value, c.fence)
            yield from wait_until(c, lambda s=setting: s.finished, 30.0)  # type: ignore[misc]
            c.emit(EventKind.PARAMETER, name=name, before=check.value, after=value if setting.confirmed else None)
        yield from self._read()
        return judge_parameters(c.profile, self.values, c.request)

    def _judge_links(self) -> list[Check]:
        """Every station's link: heard and answered. A real vehicle on the ground is out of most stations' range."""
        c, checks = self._c, []
        first = c.plan.station_ids[0]
        for station in dict.fromkeys(c.plan.station_ids):
            works = self._link_works(station)
            required = station == first or self.simulator_speedup is not None
            origin = c.monitor.links[station].origin
            same = origin is None or c.origin is None or origin == c.origin
            level = Level.PASS if works and same else Level.FAILURE if required or not same else Level.WARNING
            message = (
                "the vehicle is heard and answers over it"
                if works and same
                else "another EKF origin is told over it"
                if not same
                else "the vehicle is not heard over it (yet: it may be out of range)"
            )
            checks.append(Check(f"link {station}", level, message, c.request.shown(station), "heard and answered"))
        return checks

    def _own(self) -> Steps[list[Check]]:
        """ArduPilot: tell it to hear the plan's stations and no other."""
        c = self._c
        if c.profile.name != "ardupilot" or c.request.handover_way in ("gate", "operator_control"):
            return []
        before = ownership.present(self.values)
        if before is None:
            single = len(set(c.plan.station_ids)) == 1
            level = Level.WARNING if single else Level.FAILURE
            message = "no range of station ids on this vehicle: only one station's heartbeats would count"
            return [Check("ownership", level, message, None, "MAV_GCS_SYSID_HI (ArduPilot 4.7)")]
        used = {station: c.system_ids[station] for station in c.monitor.links}
        after = ownership.wanted(used, before)
        if self.ownership_before is None:
            self.ownership_before = before
        done = yield from ownership.apply(c, self.parameters, self.values, before, after)
        level = Level.PASS if done else Level.FAILURE
        message = f"the vehicle hears stations {after.low} to {max(after.low, after.high)} and no other"
        return [Check("ownership", level, message if done else "the vehicle did not take the range of ids", after.low)]

    def restore(self) -> Steps[None]:
        """Give the vehicle's ownership parameters back as they were; on the ground, disarmed."""
        before = self.ownership_before
        if before is None:
            return
        self.ownership_before = None
        c = self._c
        used = {station: c.system_ids[station] for station in c.monitor.links}
        done = yield from ownership.apply(c, self.parameters, self.values, ownership.wanted(used, before), before)
        if not done:
            c.alarm("ownership not restored", low=before.low, high=before.high, options=before.options)

    # -- the word -----------------------------------------------------------------------------------------------------

    def _wait_for_word(self) -> Steps[None]:
        c = self._c
        if not (yield from wait_until(c, lambda: self.launch_word, c.request.launch_timeout_s)):
            yield from self.restore()
            raise Refused(f"no word to launch in {c.request.launch_timeout_s:g} s")
        if c.now_s - self.preflight_s > PREFLIGHT_VALID_S:
            yield from self._preflight()

    # -- take-off -----------------------------------------------------------------------------------------------------

    def _take_off_ardupilot(self) -> Steps[None]:
        c = self._c
        yield from self._enter(c.profile.offboard_mode, None)
        yield from self._arm(None)
        c.become(FlightState.TAKEOFF)
        start_up_m = float(c.plan.trajectory.evaluate(0.0)[2])
        height_m = start_up_m + c.plan.plane.alt_amsl_m - self.ground_amsl_m
        # Answered "failed" when an earlier answer was lost and it climbs already: the height tells.
        yield from self._command("take-off", mavlink.MAV_CMD_NAV_TAKEOFF, (0, 0, 0, 0, 0, 0, height_m))
        limit_s = 30.0 + height_m / 0.5
        climbed = yield from wait_until(c, lambda: self._at_height(start_up_m) or not c.armed, limit_s)
        if not c.armed:
            yield from self.restore()
            raise Refused("the vehicle disarmed again instead of climbing")
        if not climbed:
            c.alarm("take-off stuck", height_m=height_m)
        # Arming lays home anew, and may tell the origin again.
        c.adopt_origin(c.plan.station_ids[0])

    def _at_height(self, up_m: float) -> bool:
        here, position = self._c.position_enu_m(), self._c.monitor.position
        if here is None or position is None:
            return False
        return abs(here[2] - up_m) <= SETTLED_M and abs(position.velocity_ned_m_s[2]) <= SETTLED_M_S

    def _take_off_px4(self) -> Steps[None]:
        c = self._c
        here = c.position_enu_m()
        assert here is not None
        up_m = float(c.plan.trajectory.evaluate(0.0)[2])
        line = StraightLine(
            c.plan,
            0,
            here,
            (here[0], here[1], up_m),
            speed_m_s=c.request.climb_m_s,
            climb_m_s=c.request.climb_m_s,
            accel_m_s2=1.0,
        )
        climb = Reference(line, accel_m_s2=1.0)
        started_s = c.now_s
        while c.now_s - started_s < c.profile.stream_before_offboard_s + 0.5:
            c.send_setpoint(climb.setpoint())
            yield
        yield from self._enter(c.profile.offboard_mode, climb.setpoint())
        yield from self._arm(climb.setpoint())
        c.become(FlightState.TAKEOFF)
        period_s = 1.0 / c.request.rate_hz
        deadline_s = c.now_s + line.duration_s + 60.0
        while not (climb.finished and self._at_height(up_m)):
            if not c.armed or not c.follows:
                return
            if c.now_s >= deadline_s:
                c.alarm("take-off stuck", height_m=up_m + c.plan.plane.alt_amsl_m - self.ground_amsl_m)
                return
            climb.step(period_s, 1.0)
            c.send_setpoint(climb.setpoint())
            yield

    def _enter(self, mode: str, streamed: Setpoint | None) -> Steps[None]:
        """Enter a mode, disarmed; believes the HEARTBEAT. Raises `Refused`."""
        c = self._c
        for _ in range(5):
            ticket = c.start_mode(mode)
            yield from self._streaming(streamed, lambda: c.mode == mode, MODE_WAIT_S)
            c.commander.cancel(ticket)
            if c.mode == mode:
                c.emit(EventKind.COMMAND, name=f"mode {mode}", result=ticket.outcome, attempts=ticket.sent)
                return
        yield from self.restore()
        raise Refused(f"the vehicle does not enter {mode}: it stays in {c.mode}")

    def _arm(self, streamed: Setpoint | None) -> Steps[None]:
        """Arm, as often as it takes until the vehicle is ready. Raises `Refused` with its own words."""
        c = self._c
        deadline_s = c.now_s + c.request.arm_timeout_s
        outcome = "no answer"
        while c.now_s < deadline_s:
            ticket = c.start_command("arm", mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (1.0,))
            yield from self._streaming(streamed, lambda t=ticket: t.finished or c.armed, MODE_WAIT_S)  # type: ignore[misc]
            outcome = ticket.outcome
            c.emit(EventKind.COMMAND, name="arm", result=outcome, attempts=ticket.sent)
            # The next beat of a 1 Hz HEARTBEAT shows it; a refusal is asked again later.
            yield from self._streaming(streamed, lambda: c.armed, 2.0)
            if c.armed:
                return
        yield from self.restore()
        raise Refused(f"the vehicle does not arm ({outcome}): its own words are in the flight's events")

    def _streaming(self, setpoint: Setpoint | None, condition: Callable[[], bool], timeout_s: float) -> Steps[None]:
        """Wait for a condition, streaming a setpoint meanwhile where one is given."""
        until_s = self._c.now_s + timeout_s
        while not condition() and self._c.now_s < until_s:
            if setpoint is not None:
                self._c.send_setpoint(setpoint)
            yield

    def _command(self, name: str, command: int, params: tuple[Any, ...]) -> Steps[Ticket]:
        ticket = yield from answered(self._c.start_command(name, command, tuple(float(p) for p in params)))
        self._c.emit(EventKind.COMMAND, name=name, result=ticket.outcome, attempts=ticket.sent)
        return ticket
