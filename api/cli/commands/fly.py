"""``skyrelay fly``: the plan streamed to a vehicle, handed over from station to station."""

from __future__ import annotations

import contextlib
import json
import secrets
import shutil
import signal
import sys
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from api.cli import inputs
from api.cli.console import Progress
from api.cli.errors import BadInputError, ContingencyError, FaultError, Terminated, faults_as_paragraphs
from api.cli.options import command_of

if TYPE_CHECKING:
    from api.cli.commands.flight_view import FlightView
    from gcs.flight import FlightEvent
    from gcs.plan import Plan
    from link.session import FlightRequest
    from link.streamer import FlightResult, RunningFlight

_LOOK_S = 0.2


def register(app: typer.Typer, panel: str) -> None:
    """Add the command."""
    app.command("fly", rich_help_panel=panel)(fly)


@dataclass(frozen=True)
class FlyOptions:
    """What the command is given."""

    plan_file: Annotated[str, typer.Argument(metavar="PLAN.json", help="The plan; - is standard input.")]
    autopilot: Annotated[Literal["px4", "ardupilot"], typer.Option(help="What flies the vehicle.")]
    link: Annotated[
        list[str],
        typer.Option(
            metavar="[ID=]URL",
            help="A station's C2 link to the vehicle; repeat it for each station, or give one URL without ID for all. "
            "Repeated for one station: all are listened to, and one sends until it fails. "
            "udpout:HOST:PORT, udpin:HOST:PORT, tcp:HOST:PORT or serial:DEVICE:BAUD.",
        ),
    ]
    rate: Annotated[float, typer.Option(metavar="HZ", help="Setpoints a second, 5 to 100.")] = 20.0
    speedup: Annotated[
        float, typer.Option(metavar="X", help="Fly X times as fast: our simulator at that factor, loopback links only.")
    ] = 1.0
    log: Annotated[
        str | None,
        typer.Option(
            metavar="FILE.tlog",
            help="Keep every frame sent and heard, a flight a file: where the name is taken, FILE-2.tlog, and so on.",
        ),
    ] = None
    set_parameters: Annotated[
        Literal["auto", "yes", "no"],
        typer.Option(help="Whether unsafe failsafe parameters are set on the vehicle; auto: on our simulator alone."),
    ] = "auto"
    handover_way: Annotated[
        Literal["auto", "gate", "range", "parameter", "operator_control"],
        typer.Option(
            help="How the vehicle is told of a handover; parameter: ArduPilot hears one station at a time and is told "
            "of each (before 4.7 the only way with several)."
        ),
    ] = "auto"
    rally: Annotated[
        bool,
        typer.Option("--rally/--no-rally", help="Upload the mission's safe points as rally points for the flight."),
    ] = True
    fence: Annotated[
        bool,
        typer.Option("--fence", help="Lay a geofence around the plan and every straight way home, for the flight."),
    ] = False
    signing_key: Annotated[
        str | None, typer.Option(metavar="file:PATH|env:NAME", help="Sign every frame with this 32-byte key.")
    ] = None
    allow_unsigned: Annotated[
        bool, typer.Option("--allow-unsigned", help="Fly without signing over links that leave this machine.")
    ] = False
    rescue: Annotated[
        bool,
        typer.Option(
            "--rescue",
            help="Take over an ArduPilot that is locked to other stations' ids, by its own; it gets them back after.",
        ),
    ] = False
    as_json: Annotated[
        bool, typer.Option("--json", help="Print every event as a line of JSON instead of the report.")
    ] = False


def run_fly(given: FlyOptions) -> int:
    """Fly a plan: preflight, arm, take off, follow the plan, hand over from station to station, land.

    Ctrl-C commands `abort`: on the ground motors off and everything given back, in the air the contingency procedure in
    force; a second one lets go of the vehicle, whose own failsafe then acts. Ends with 0 when the flight was flown as
    planned, or landed where an operator commanded it to; else with 4.
    """
    plan = inputs.plan(given.plan_file)
    request = request_of(
        plan,
        links=links_of(plan, given.link),
        autopilot=given.autopilot,
        rate_hz=given.rate,
        speedup=given.speedup,
        log_path=given.log,
        set_parameters=given.set_parameters,
        handover_way=given.handover_way,
        rally=given.rally,
        lay_geofence=given.fence,
        signing_key=given.signing_key,
        allow_unsigned=given.allow_unsigned,
        rescue=given.rescue,
        flight_id=f"fly-{secrets.token_hex(3)}",
    )
    with Progress() as progress:
        result, view = run(plan, request, progress, as_json=given.as_json)
    conclude(plan, result, view, log=given.log, as_json=given.as_json)
    return 0


fly = command_of(FlyOptions, run_fly)


def links_of(plan: Plan, given: list[str]) -> dict[str, list[str]]:
    """The URLs of each station the plan uses or holds in reserve, from ``ID=URL`` and bare URLs.

    Bare ones are for the plan's stations without any of their own. Raises `BadInputError`.
    """
    from link.errors import EndpointUrlError
    from link.transport import parse_url

    known = {station.id for station in plan.mission.stations}
    own: dict[str, list[str]] = {}
    everybodys: list[str] = []
    for text in given:
        try:
            parse_url(text)
            station, url = None, text
        except EndpointUrlError as error:
            station, equals, url = text.partition("=")
            if not equals:
                raise BadInputError("a link cannot be read", {"where": "--link", "what": str(error)}) from None
            if station not in known:
                raise BadInputError(
                    "a link is for a station the mission does not have",
                    {"where": "--link", "value": station, "allowed": ", ".join(dict.fromkeys(plan.station_ids))},
                ) from None
            try:
                parse_url(url)
            except EndpointUrlError as fault:
                raise BadInputError("a link cannot be read", {"where": "--link", "what": str(fault)}) from None
        (everybodys if station is None else own.setdefault(station, [])).append(url)
    if everybodys:
        for name in plan.station_ids:
            own.setdefault(name, everybodys)
    usable = {station.id for station in plan.mission.stations if station.system_id is not None}
    return {name: urls for name, urls in own.items() if name in usable}


def request_of(plan: Plan, **fields: Any) -> FlightRequest:
    """The flight asked for. Raises `BadInputError` with every reason it must not start."""
    from link.errors import FlightRequestError
    from link.session import FlightRequest

    try:
        return FlightRequest(plan=plan.to_document(), **fields)
    except FlightRequestError as error:
        raise refused(error.problems) from None


def refused(problems: Any) -> BadInputError:
    """A request the wire layer will not take."""
    return BadInputError("the flight cannot start as asked", *faults_as_paragraphs(problems))


def run(
    plan: Plan, request: FlightRequest, progress: Progress, *, as_json: bool = False
) -> tuple[FlightResult, FlightView]:
    """Fly, showing the flight: how it ended, and what was seen of it.

    Raises `BadInputError` for a flight the wire layer refuses, `FaultError` where the streamer cannot be started.
    """
    from api.cli.commands.flight_view import FlightView
    from link.errors import FlightRequestError, SupervisorError
    from link.streamer import start_flight

    view = FlightView(plan, progress)

    def on_event(event: FlightEvent) -> None:
        view(event)
        if as_json:
            sys.stdout.write(json.dumps(event.to_document(), allow_nan=False) + "\n")
            sys.stdout.flush()

    folder = Path(tempfile.mkdtemp(prefix="skyrelay-flight-"))
    try:
        flight = start_flight(request, on_event=on_event, run_dir=folder)
    except FlightRequestError as error:
        shutil.rmtree(folder, ignore_errors=True)
        raise _taken(request) or refused(error.problems) from None
    except SupervisorError as error:
        raise FaultError("the streamer could not be started", {"what": str(error)}) from None
    if not as_json:
        progress.note(f"flight {request.flight_id}; from another terminal: skyrelay flight {request.flight_id}")
    with held(flight, progress):
        result = _wait(flight, progress)
    if result.exit_code == 0 or result.state == "refused":
        # What the streamer kept of such a flight is all in the report and the log; of others it may be looked at.
        shutil.rmtree(folder, ignore_errors=True)
    else:
        progress.note(f"what the streamer kept of this flight is in {folder}")
    return result, view


def _taken(request: FlightRequest) -> BadInputError | None:
    """A flight that is under way on one of these links, and how to reach it."""
    from link.streamer import flight_on

    other = flight_on(url for urls in request.urls.values() for url in urls)
    if other is None:
        return None
    return BadInputError(
        f"flight {other.flight_id} flies over this link",
        {
            "where": "--link",
            "value": ", ".join(other.urls),
            "what": f"its streamer is process {other.pid}, begun {other.started_utc}; ending that leaves the aircraft",
            "fix": f"skyrelay flight {other.flight_id} attach, or look, hold, resume, abort, land",
        },
    )


@contextlib.contextmanager
def held(flight: RunningFlight, progress: Progress) -> Iterator[None]:
    """Whatever ends the block early, no streamer stays behind unwatched, but for one: a terminal that went away.

    A dropped connection must not drop the flight too: the streamer goes on as far as it was authorised.
    """
    try:
        yield
    except BaseException as error:
        if flight.result is None:
            if isinstance(error, Terminated) and error.signal_number == signal.SIGHUP:
                _leave(flight)
            else:
                progress.note("letting go of the vehicle: its own failsafe has it now")
                flight.kill()
        raise


def _leave(flight: RunningFlight) -> None:
    """The terminal went away: in the air the flight goes on; on the ground nobody is there for it to begin."""
    from gcs.flight import TransitionError
    from link.errors import SupervisorError

    event = flight.last_event
    if event is None or not (event.state.airborne or event.state == "arming"):
        with contextlib.suppress(TransitionError, SupervisorError):
            flight.command("abort", by="SIGHUP", reason="the terminal is gone")
    flight.detach()


def _wait(flight: RunningFlight, progress: Progress) -> FlightResult:
    """Until the flight ends. The first Ctrl-C (or SIGTERM) commands `abort`: in the air the contingency, on the ground
    the end, which waits until the vehicle has back what was changed. Any other ends this.
    """
    from gcs.flight import TransitionError
    from link.errors import SupervisorError

    asked, ending = False, None
    while True:
        try:
            while flight.result is None:
                with contextlib.suppress(TimeoutError):
                    flight.wait(_LOOK_S)
            if ending is not None:
                raise ending
            return flight.wait()
        except (KeyboardInterrupt, Terminated) as error:
            event = flight.last_event
            dropped = isinstance(error, Terminated) and error.signal_number == signal.SIGHUP
            if asked or dropped or flight.result is not None:
                raise
            asked = True
            if event is not None and event.state.airborne:
                progress.note("flying the contingency procedure; Ctrl-C again lets go of the vehicle")
            else:
                ending = error
                progress.note("ending the flight on the ground, and giving back what it changed on the vehicle")
            try:
                flight.command("abort", by="Ctrl-C")
            except (TransitionError, SupervisorError) as refusal:
                progress.note(f"refused: {refusal}")


def conclude(
    plan: Plan,
    result: FlightResult,
    view: FlightView,
    *,
    log: str | None = None,
    as_json: bool = False,
) -> None:
    """Print the report; raises `ContingencyError` or `FaultError` where the flight did not end as planned."""
    from api.cli.commands.flight_view import result_lines, state_text

    if result.exit_code == 1:
        raise FaultError("the flight ended by a fault of ours", {"what": result.reason})
    log = None if log is None else str(result.summary.get("log") or log)
    report = "\n".join(result_lines(plan, result, log, view.not_planned))
    why = view.ended_why or result.reason or f"no reason was told; its last state was {result.state.value}"
    if result.exit_code == 0:
        if not as_json:
            sys.stdout.write(report + "\n")
        return
    paragraphs: list[Mapping[str, Any]] = [
        {
            "where": f"preflight, {check['name']}",
            "what": check["message"],
            "value": check.get("value"),
            "allowed": check.get("required"),
            "fix": _fix(plan, check),
        }
        for check in view.failed_checks
    ]
    if result.state == "refused":
        raise ContingencyError("the flight was refused before take-off", *(paragraphs or [{"what": why}]))
    raise ContingencyError(f"the flight ended in {state_text(result.state)}", {"what": why, "report": report})


def _fix(plan: Plan, check: Mapping[str, Any]) -> str | None:
    """What to do about a finding of the preflight, in terms of the command line."""
    from api.processes import home_under

    if check["name"] == "transit":
        return f"{check.get('fix')}; a simulator is put there with --home {home_under(plan)}"
    if check.get("set"):
        return f"{check.get('fix')}, or let `fly` do it with --set-parameters yes"
    return check.get("fix")
