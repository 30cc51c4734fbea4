"""``skyrelay demo``: the whole story without hardware, through the very parts a real flight uses."""

from __future__ import annotations

import json
import tempfile
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from api.cli import inputs
from api.cli.commands import fly
from api.cli.commands.plan import overview
from api.cli.console import Progress
from api.cli.demo import story
from api.cli.errors import BadInputError, FaultError
from api.processes import QUICK_MISSION, Children, start_simulator

if TYPE_CHECKING:
    from api.cli.commands.flight_view import FlightView
    from gcs.plan import Plan
    from link.streamer import FlightResult


def register(app: typer.Typer, panel: str) -> None:
    """Add the command."""
    app.command("demo", rich_help_panel=panel)(demo)


def demo(
    mission_file: Annotated[
        str | None,
        typer.Option("--mission", metavar="FILE", help="Fly this mission instead of the one along the Wadden Islands."),
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="A short mission of two stations, in some 15 seconds.")
    ] = False,
    serve: Annotated[
        bool,
        typer.Option(
            "--serve", help="Through the service: fly by REST, watch in the browser, and stay up until Ctrl-C."
        ),
    ] = False,
) -> int:
    """The whole story without hardware: plan, schedule, a simulated vehicle flown from station to station, report.

    By default 150 km along the Wadden Islands, Den Helder to Borkum, in about a minute. Nothing is installed, nothing
    leaves this machine, and every process ends with the command.
    """
    document = _document(mission_file, quick)
    # Malformed missions are met before anything is started.
    inputs.mission(document, mission_file or "demonstration")
    wall_s = story.QUICK_WALL_S if quick else story.FLIGHT_WALL_S
    if serve:
        from api.cli.demo import through_service

        through_service.run(document, wall_s)
    else:
        _by_itself(document, mission_file or "demonstration", wall_s)
    return 0


def _document(mission_file: str | None, quick: bool) -> Any:
    if mission_file is not None and quick:
        raise BadInputError("--quick and --mission exclude each other", {"fix": "leave one of them out"})
    if mission_file is not None:
        return inputs.read_json(mission_file, what="mission")
    if quick:
        return QUICK_MISSION
    return json.loads(resources.files("sitl_fixtures").joinpath("missions", "wadden_relay.json").read_bytes())


def _by_itself(document: Any, name: str, wall_s: float) -> None:
    from gcs.errors import MissionInfeasible, PlanningFailed
    from gcs.planning import plan_mission

    mission = inputs.mission(document, name)
    story.say(f"1. Planning: {mission.name}, {len(mission.stations)} stations to choose from")
    try:
        plan = plan_mission(mission)
    except MissionInfeasible as error:
        raise inputs.infeasible(error) from None
    except PlanningFailed as error:
        raise FaultError("the planner gave up", {"what": str(error)}) from None
    story.say(f"\n{overview(plan)}")
    with tempfile.TemporaryDirectory(prefix="skyrelay-demo-") as folder, Children() as children:

        def attempt(pace: story.Pace, number: int) -> tuple[FlightResult, FlightView, Path]:
            log = Path(folder) / f"flight-{number}.tlog"
            return (*_attempt(plan, children, pace, str(log)), log)

        pace = story.Pace.of(plan.mission_time_s, wall_s)
        result, view, log = story.fly_until_arrival(pace, attempt, lambda flown: flown[0].exit_code == 0)
        story.say()
        fly.conclude(plan, result, view)
        _planned_against_flown(plan, log)
    story.say(f"\nArrived. {story.closing(plan)}")


def _attempt(plan: Plan, children: Children, pace: story.Pace, log: str) -> tuple[FlightResult, FlightView]:
    how = f"a simulated {story.AUTOPILOT} vehicle, {pace.speedup:.0f} times as fast as real, a link a station"
    story.say(f"2. Flying it: {how}")
    child, links = start_simulator(children, plan, autopilot=story.AUTOPILOT, speedup=pace.speedup)
    request = fly.request_of(
        plan, links=links, autopilot=story.AUTOPILOT, rate_hz=pace.rate_hz, speedup=pace.speedup, log_path=log
    )
    # A station's time in control must not fall between two lines: about twenty for a flight, one a second at most.
    wall_s = plan.mission_time_s / pace.speedup
    with Progress(every_s=min(3.0, max(1.0, wall_s / 20.0)), to_stdout=True) as progress:
        result = fly.run(plan, request, progress)
    child.stop()
    children.forget(child)
    return result


def _planned_against_flown(plan: Plan, log: Path) -> None:
    from link.errors import LinkError
    from link.files import report_flight

    try:
        report = report_flight(log, plan)
    except LinkError as error:
        raise FaultError("the flight's log cannot be read", {"what": str(error)}) from None
    story.say("\n3. Planned against flown, from the log alone\n")
    typer.echo(report.to_text(), nl=False)
