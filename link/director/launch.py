"""From open links to a vehicle in the air at the height of the plan's start.

connect -> identify -> preflight -> (launch command) -> mode, arm, take-off (`link.director.takeoff`). Nothing is armed
before every check has passed; what is changed in the vehicle for the flight is borrowed
(`link.director.borrowed_settings`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from gcs.flight import EventKind, FlightState
from gcs.plan import Place, failsafe_returns
from link.dialect import mavlink
from link.director.borrowed_settings import BorrowedSettings
from link.director.link_checks import LINKS_WAIT_S, judge_links
from link.director.takeoff import TakeOff
from link.handover import gcs_ids
from link.handover.gcs_ids import GcsIds
from link.microservices.command import Ticket
from link.microservices.mission_client import MissionClient
from link.microservices.parameter import ATTEMPTS, MOST_ATTEMPTS, Asked, Asking, ParameterClient
from link.microservices.parameter_value import Parameter, encoding_of
from link.monitors.one_vehicle import OneVehicle
from link.monitors.telemetry_upkeep import streams_of
from link.preflight.check import Check, Level, worst, worst_first
from link.preflight.evidence import PreflightEvidence
from link.preflight.failsafe_return import judge_failsafe_return, return_rules
from link.preflight.geofence import judge_limits
from link.preflight.identity import Identity, judge_identity
from link.preflight.route import judge_lowest, judge_stops
from link.preflight.vehicle import (
    judge_clock,
    judge_estimate,
    judge_home,
    judge_origin,
    judge_parameters,
    judge_performance,
    judge_place,
    judge_plan,
    judge_vehicle,
)
from link.session.changes import ChangeJournal
from link.session.context import FlightContext
from link.session.procedure import Refused, Steps, answered, wait_until

HEARD_S = 3.0
PREFLIGHT_VALID_S = 60.0
"""A flight is launched on a preflight younger than this, by the wall's clock: it is a person who relies on it."""
SIMULATOR_PARAMETER = "SIM_SPEEDUP"
AS_ASKED = "it is made again, as asked"


class Launch:
    """The procedure on the ground and the climb. ``commanded``: whether the operator has said to go."""

    def __init__(
        self,
        flight: FlightContext,
        parameters: ParameterClient,
        missions: MissionClient,
        one_vehicle: OneVehicle,
        journal: ChangeJournal | None = None,
    ) -> None:
        self._flight = flight
        self._request = flight.request
        self._timeline = flight.timeline
        self._vehicle = flight.vehicle
        self._control = flight.control
        self.parameters = parameters
        self._one = one_vehicle
        self.borrowed = BorrowedSettings(flight, parameters, missions, journal)
        self.values: dict[str, Parameter | None] = {}
        self.asking = Asking()
        self.checks: list[Check] = []
        self.simulator_speedup: float | None = None
        self.ground_amsl_m = 0.0
        self.commanded = flight.request.auto_launch
        self.renewed = False
        self.preflight_id = 0
        self.stuck = False  # the climb ended without its height
        self.evidence = PreflightEvidence(flight)
        self._passed_s: float | None = None  # the flight's clock when the last preflight passed

    def run(self) -> Steps[None]:
        """All of it. Raises `Refused` while the vehicle is on the ground."""
        yield from self._connect()
        self._timeline.become(FlightState.IDENTIFYING)
        yield from self._know_vehicle()
        yield from self._preflight()
        while void := (yield from self._wait_for_command()):
            if void != AS_ASKED:
                self._timeline.alarm("the preflight is void", reason=void)
            # The last launch command was given in ignorance of it.
            self.commanded, self._passed_s = self._request.auto_launch, None
            yield from self._preflight(void)
        self._timeline.become(FlightState.ARMING, "launch")
        self.stuck = yield from TakeOff(self._flight, self.restore, self.evidence).run(self.ground_amsl_m)

    # -- connect ------------------------------------------------------------------------------------------------------

    def _connect(self) -> Steps[None]:
        timeline, vehicle, monitor = self._timeline, self._vehicle, self._vehicle.monitor
        first = self._flight.plan.station_ids[0]
        self._control.grant(first, "first station")
        heard = yield from wait_until(
            timeline,
            lambda: monitor.heartbeat is not None and monitor.heard_within(timeline.now_s, first, HEARD_S),
            self._request.connect_timeout_s,
        )
        if not heard:
            over = f"over the link of {first} ({self._request.shown(first)}) in {self._request.connect_timeout_s:g} s"
            hint = self._one.heard_instead() or "is the vehicle there, its id and the link right?"
            raise Refused(f"no heartbeat of system {vehicle.system_id}, component 1 {over}: {hint}")
        heartbeat = monitor.heartbeat
        assert heartbeat is not None
        if heartbeat.autopilot != vehicle.profile.autopilot_id:
            raise Refused(
                f"the vehicle's autopilot is number {heartbeat.autopilot}, not {vehicle.profile.title}: choose its own"
            )
        yield from wait_until(timeline, lambda: all(self._link_works(s) for s in vehicle.monitor.links), LINKS_WAIT_S)

    def _link_works(self, station: str) -> bool:
        now_s, monitor = self._timeline.now_s, self._vehicle.monitor
        return monitor.heard_within(now_s, station, HEARD_S) and monitor.proven_within(now_s, station, HEARD_S)

    # -- identify -----------------------------------------------------------------------------------------------------

    def _know_vehicle(self) -> Steps[None]:
        """Whatever the vehicle tells when asked: streams, version, origin over every link, home."""
        vehicle, control = self._vehicle, self._control
        first = self._flight.plan.station_ids[0]
        control.grant(first, "first station")
        yield from self._break_in()
        yield from self._one.identify(first)
        # Before anything is changed on it: on another flight it must not notice this one.
        self._one.claim()
        yield from self.request_streams()
        if vehicle.monitor.version is not None:
            told = int(vehicle.monitor.version.capabilities)
            self.parameters.encoding = encoding_of(told, vehicle.profile.parameter_encoding)
        if (yield from self.borrowed.note.recover()):
            yield from self._break_in()
        # The EKF lays its origin once it has a position: on a cold vehicle that takes most of a minute.
        known = yield from self._ask_for_message(
            mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN,
            lambda: vehicle.monitor.links[first].origin is not None and vehicle.position is not None,
            self._request.arm_timeout_s,
        )
        if not known:
            why = vehicle.monitor.places.refused
            what = f"what it tells is not believed, {why}" if why else "does the vehicle have satellites?"
            raise Refused(f"no position and EKF origin in {self._request.arm_timeout_s:g} s: {what}")
        vehicle.origin = vehicle.monitor.links[first].origin
        for station in self._request.stations:
            # Every link in turn, in control for a moment, still on the ground: what it will carry is tried now.
            if station != first and self._link_works(station):
                control.grant(station, "link check on the ground")
                yield from self._ask_for_message(
                    mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN,
                    lambda s=station: vehicle.monitor.links[s].origin is not None,  # type: ignore[misc]
                    3.0,
                )
                yield from self._one.identify(station)
        control.grant(first, "first station")
        yield from self._ask_for_message(
            mavlink.MAVLINK_MSG_ID_HOME_POSITION, lambda: vehicle.monitor.home is not None, HEARD_S
        )

    def _break_in(self) -> Steps[None]:
        """A vehicle that enforces other stations' ids answers nothing: say so, or open it with its own id."""
        control = self._control
        ticket = yield from self._command("version", mavlink.MAV_CMD_REQUEST_MESSAGE, (148.0,))
        if ticket.result is not None or not self._vehicle.profile.filters_station_ids:
            return
        hint = self._one.heard_instead() or "it may be locked to other stations' ids (MAV_OPTIONS bit 0)"
        if not self._request.rescue:
            left = self.borrowed.note.left_by_others()
            by = f" by flight {left[-1].flight_id}" if left else ""
            fix = f"{self.borrowed.note.remedy}, or fly with --rescue (REST: rescue)"
            raise Refused(f"the vehicle is heard but answers no command: {hint}{by}; unlock it with {fix}")
        first = self._flight.plan.station_ids[0]
        control.grant(first, "rescue", as_vehicle=True)
        yield from self._command("version", mavlink.MAV_CMD_REQUEST_MESSAGE, (148.0,))
        yield from self._read()
        before = gcs_ids.present(self.values)
        if before is None:
            raise Refused("the vehicle answers nothing, under its own id either")
        self._timeline.alarm("rescue", low=before.low, high=before.high, options=before.options)
        self.borrowed.remember(self.values, before)
        after = GcsIds(before.low, before.high, before.options & ~gcs_ids.ENFORCE)
        yield from gcs_ids.apply(self._flight, self.parameters, self.values, before, after)
        control.grant(first, "rescued")

    def request_streams(self) -> Steps[None]:
        """Ask for the telemetry the flight is watched by, on the link of the station in control."""
        for message_id, rate_hz in streams_of(self._vehicle.profile):
            params = (float(message_id), 1e6 / rate_hz)
            yield from self._command("message interval", mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, params)

    def _ask_for_message(self, message_id: int, arrived: Callable[[], bool], timeout_s: float) -> Steps[bool]:
        """Ask for a message until it is there."""
        timeline = self._timeline
        deadline_s = timeline.now_s + timeout_s
        while not arrived() and timeline.now_s < deadline_s:
            yield from self._command("request message", mavlink.MAV_CMD_REQUEST_MESSAGE, (float(message_id),))
            yield from wait_until(timeline, arrived, min(1.0, max(0.0, deadline_s - timeline.now_s)))
        return arrived()

    # -- preflight ----------------------------------------------------------------------------------------------------

    def _preflight(self, void: str = "") -> Steps[None]:
        """Judge everything; ``void``: why the last preflight holds no more, then the vehicle is asked anew too."""
        timeline, vehicle = self._timeline, self._vehicle
        timeline.become(FlightState.PREFLIGHT, void)
        self.evidence.begin()
        if void:
            yield from self._know_vehicle()
        yield from self._read()
        checks = [*self._judge_vehicle(), *(yield from self._failsafes())]
        checks += judge_performance(vehicle.profile, self.values, self._flight.plan)
        position = yield from self.evidence.known_place(self._request.arm_timeout_s)
        if position is None:
            yield from self.restore()
            raise Refused(f"the vehicle's position is not known: {vehicle.monitor.places.refused or 'none is heard'}")
        checks += [
            judge_estimate(self.evidence.lacks_estimate),
            judge_home(vehicle.monitor.home, vehicle.monitor.position),
        ]
        self.ground_amsl_m = position[2] + self._flight.plan.plane.alt_amsl_m
        checks += judge_place(self._flight.plan, position, self.ground_amsl_m, self._request)
        checks.append(judge_lowest(self._flight.plan, self.ground_amsl_m))
        checks += judge_stops(self._flight.plan, self._loss_timeout_s())
        checks += judge_limits(vehicle.profile, self.values, self._flight.plan, position)
        checks += yield from self._judge_links()
        if not any(check.blocks for check in checks):
            checks += yield from self._borrow(position)
        self._tell(worst_first(checks))
        if worst(checks) >= Level.FAILURE:
            yield from self.restore()
            raise Refused("preflight: " + "; ".join(check.said for check in worst_first(checks) if check.blocks))
        vehicle.loss_timeout_s = self._loss_timeout_s()
        self._passed_s = timeline.now_s
        self._one.passed()
        timeline.become(FlightState.READY, "preflight passed")

    @property
    def preflight_age_s(self) -> float | None:
        """How long ago the last preflight passed, by the wall's clock; None where none has."""
        passed_s = self._passed_s
        return None if passed_s is None else (self._timeline.now_s - passed_s) / self._request.speedup

    def _loss_timeout_s(self) -> float:
        """How long the autopilot goes without setpoints, by what was read of it."""
        timeout = self.values.get("offboard_loss_timeout")
        return 1.0 if timeout is None else float(timeout.value)

    def _tell(self, checks: list[Check]) -> None:
        self.checks = checks
        self.preflight_id += 1
        for check in checks:
            self._timeline.emit(EventKind.CHECK, preflight=self.preflight_id, **check.to_document())

    def _judge_vehicle(self) -> list[Check]:
        """Who it is and how it stands."""
        vehicle = self._vehicle
        heartbeat, version = vehicle.monitor.heartbeat, vehicle.monitor.version
        assert heartbeat is not None
        simulated = self.simulator_speedup is not None
        identity = None if version is None else Identity.from_message(version)
        unix = vehicle.monitor.unix_s
        told = None if unix is None else (unix[0], self._timeline.utc.unix_s(unix[1]))
        return [
            *judge_identity(vehicle.profile, identity, heartbeat.vehicle_type),
            *self._one.judge(),
            *judge_vehicle(
                armed=heartbeat.armed,
                landed_state=vehicle.landed_state,
                battery_percent=vehicle.monitor.battery_percent,
                simulator_speedup=self.simulator_speedup,
                speedup=self._request.speedup,
            ),
            judge_origin(vehicle.origin),
            judge_clock(None if told is None else told[0], 0.0 if told is None else told[1], simulated=simulated),
            judge_plan(
                self._flight.plan,
                tuple(dict.fromkeys(self._flight.plan.station_ids)),
                operator_commands=self._request.operator_words,
            ),
        ]

    def _read(self) -> Steps[None]:
        """Read every parameter the profile knows, under whichever of its names; the newest that answers counts.

        On a link that may have lost every answer to a question, what is missing is asked for again.
        """
        known = self._vehicle.profile.parameters
        names = [*(name for parameter in known for name in parameter.names), SIMULATOR_PARAMETER]
        asked: dict[str, Asked] = {}
        for attempts in range(ATTEMPTS, MOST_ATTEMPTS + 1, ATTEMPTS):
            missing = [name for name in names if name not in asked or not (asked[name].answer or asked[name].denied)]
            again = self.parameters.read(missing, self._control.in_force)
            asked.update({one.name: one for one in again})
            yield from wait_until(self._timeline, lambda a=again: all(one.finished for one in a), 60.0)  # type: ignore[misc]
            denied = frozenset(one.name for one in asked.values() if one.denied)
            # Share of questions that go unanswered lately on the link of the station in control, by its probes.
            link = self._vehicle.monitor.links[self._control.in_force.station_id].active
            self.asking = Asking(attempts, link.round_loss(self._timeline.now_s), denied)
            if not self.asking.unsure:
                break
        answers = {name: one.answer for name, one in asked.items()}
        self.values = {p.key: next((answers[n] for n in p.names if answers[n] is not None), None) for p in known}
        simulator = answers[SIMULATOR_PARAMETER]
        self.simulator_speedup = None if simulator is None else float(simulator.value)

    def _failsafes(self) -> Steps[list[Check]]:
        """Judge the parameters; set what is unsafe where that is allowed, and judge again what is read back."""
        timeline, vehicle = self._timeline, self._vehicle
        checks = judge_parameters(vehicle.profile, self.values, self._request, self.asking)
        allowed = self._request.set_parameters == "yes" or (
            self._request.set_parameters == "auto" and self.simulator_speedup is not None
        )
        unsafe = [check for check in checks if check.level is not Level.PASS and check.set is not None]
        heartbeat = vehicle.monitor.heartbeat
        if not unsafe or not allowed or heartbeat is None or heartbeat.armed:
            return checks
        for check in unsafe:
            assert check.set is not None
            name, value = check.set
            setting = self.parameters.set(name, value, self._control.in_force)
            yield from wait_until(timeline, lambda s=setting: s.finished, 30.0)  # type: ignore[misc]
            timeline.emit(
                EventKind.PARAMETER, name=name, before=check.value, after=value if setting.confirmed else None
            )
        yield from self._read()
        return judge_parameters(vehicle.profile, self.values, self._request, self.asking)

    def _judge_links(self) -> Steps[list[Check]]:
        """Every station's link: heard and answered. A real vehicle on the ground is out of most stations' range."""
        simulated = self.simulator_speedup is not None
        return (yield from judge_links(self._flight, self._link_works, self._loss_timeout_s(), simulated=simulated))

    # -- what is borrowed ---------------------------------------------------------------------------------------------

    def _borrow(self, home_enu_m: Place) -> Steps[list[Check]]:
        """GCS ids, rally points and geofence for the flight; and where the vehicle would go by itself with them."""
        borrowed = self.borrowed
        checks = yield from borrowed.take_gcs_ids(self.values)
        if any(check.blocks for check in checks):
            return checks
        checks += yield from borrowed.take_rally(self.ground_amsl_m)
        checks += yield from borrowed.take_geofence(self.values, home_enu_m)
        rules = return_rules(self._vehicle.profile, self.values, self._flight.plan, home_enu_m, borrowed.points)
        returns = failsafe_returns(self._flight.plan.geometry, self._flight.plan.trajectory, rules)
        return [*checks, *judge_failsafe_return(self._flight.plan, rules, returns)]

    def restore(self) -> Steps[None]:
        """Give back what was changed in the vehicle for this flight; on the ground, disarmed."""
        yield from self.borrowed.give_back()

    def ask(self, *, again: bool) -> None:
        """The operator's command to go, or (``again``) to make the preflight again first."""
        self.renewed, self.commanded = self.renewed or again, self.commanded or not again

    # -- the launch command -------------------------------------------------------------------------------------------

    def _wait_for_command(self) -> Steps[str]:
        """Until the launch is commanded on a preflight that holds; why it holds no more, where it does not."""
        self.renewed, limit_s = False, self._request.launch_timeout_s
        ready = yield from wait_until(
            self._timeline,
            lambda: self.commanded or self.renewed or bool(self.evidence.void() or self._one.hindrance()),
            limit_s,
        )
        if void := self.evidence.void():
            return void
        if not ready:
            yield from self.restore()
            raise Refused(f"no word to launch in {limit_s:g} s")
        if not self.commanded and self.renewed:
            return AS_ASKED
        if not self.commanded:
            # Whatever woke this never launches: it refuses the flight, or where it is over the preflight is made again.
            told = self._one.hindrance() or "something spoke against the launch"
            yield from self._one.look_again(self.restore)
            return self.evidence.void() or f"{told}, for a moment"
        if (self.preflight_age_s or 0.0) >= PREFLIGHT_VALID_S:
            yield from self._preflight()
        yield from self._one.look_again(self.restore)
        return self.evidence.void()

    def _command(self, name: str, command: int, params: tuple[Any, ...]) -> Steps[Ticket]:
        ticket = yield from answered(self._control.start_command(name, command, tuple(float(p) for p in params)))
        self._timeline.emit(EventKind.COMMAND, name=name, result=ticket.outcome, attempts=ticket.sent)
        return ticket
