"""``skyrelay demo``: the whole story without hardware, through the very parts a real flight uses."""

from __future__ import annotations

import json
import os
import tempfile
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from api.cli import fly, inputs, simulator
from api.cli.console import Progress
from api.cli.errors import BadInputError, FaultError
from api.cli.plan import overview
from api.cli.processes import Children

if TYPE_CHECKING:
    from api.cli.flight_view import FlightView
    from gcs.plan import Plan
    from link.supervisor import FlightResult

AUTOPILOT = "ardupilot"
# Wall seconds the flight should take, take-off and landing included.
_FLIGHT_WALL_S = 70.0
_QUICK_WALL_S = 12.0
_GROUND_S = 120.0  # climb, descent and checks, in seconds of the vehicle
_MAX_SPEEDUP = 100.0
ATTEMPTS = 3
# Setpoints a wall second the machine is asked for at most, whatever the speed-up.
_WALL_RATE_HZ = 800.0

QUICK_MISSION: dict[str, Any] = {
    "name": "A short hop between two stations",
    "origin": {"lat_deg": 39.96, "lon_deg": 116.32, "alt_amsl_m": 0.0},
    "start": {"east_m": 0.0, "north_m": 0.0, "up_m": 110.0},
    "destination": {"east_m": 1500.0, "north_m": 300.0, "up_m": 110.0},
    "stations": [
        {"id": "west", "name": "West mast", "east_m": 0.0, "north_m": 0.0, "up_m": 0.0, "range_m": 1000.0},
        {"id": "east", "name": "East mast", "east_m": 1500.0, "north_m": 300.0, "up_m": 0.0, "range_m": 1000.0},
    ],
    "limits": {"min_alt_amsl_m": 100.0, "max_alt_amsl_m": 120.0, "max_speed_m_s": 25.0, "max_accel_m_s2": 3.0},
}


@dataclass(frozen=True)
class Pace:
    """How fast a demonstration flies, and how often it sends."""

    speedup: float
    rate_hz: float

    @classmethod
    def of(cls, mission_time_s: float, wall_s: float) -> Pace:
        """The pace at which the flight takes about ``wall_s``; never slower than real time."""
        return cls.at(min(_MAX_SPEEDUP, max(1.0, (mission_time_s + _GROUND_S) / wall_s)))

    @classmethod
    def at(cls, speedup: float) -> Pace:
        """A pace by its speed-up: 20 setpoints a second of the vehicle's, fewer where the machine could not."""
        return cls(speedup, float(max(5, min(20, int(_WALL_RATE_HZ / speedup)))))

    def slower(self) -> Pace:
        """Half as fast."""
        return self.at(max(1.0, self.speedup / 2.0))


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
    wall_s = _QUICK_WALL_S if quick else _FLIGHT_WALL_S
    if serve:
        from api.cli import demo_service

        demo_service.run(document, wall_s)
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


def say(text: str = "") -> None:
    """A line of the story, at once."""
    typer.echo(text)


def _by_itself(document: Any, name: str, wall_s: float) -> None:
    from gcs.errors import MissionInfeasible, PlanningFailed
    from gcs.planning import plan_mission

    mission = inputs.mission(document, name)
    say(f"1. Planning: {mission.name}, {len(mission.stations)} stations to choose from")
    try:
        plan = plan_mission(mission)
    except MissionInfeasible as error:
        raise inputs.infeasible(error) from None
    except PlanningFailed as error:
        raise FaultError("the planner gave up", {"what": str(error)}) from None
    say(f"\n{overview(plan)}")
    pace = Pace.of(plan.mission_time_s, wall_s)
    with tempfile.TemporaryDirectory(prefix="skyrelay-demo-") as folder, Children() as children:
        for attempt in range(1, ATTEMPTS + 1):
            log = Path(folder) / f"flight-{attempt}.tlog"
            result, view = _attempt(plan, children, pace, str(log))
            if result.exit_code == 0 or attempt == ATTEMPTS or pace.speedup <= 1.0:
                break
            say(f"\n{too_fast(pace)}")
            pace = pace.slower()
        say()
        fly.conclude(plan, result, view)
        _planned_against_flown(plan, log)
    say(f"\nArrived. {closing(plan)}")


def _attempt(plan: Plan, children: Children, pace: Pace, log: str) -> tuple[FlightResult, FlightView]:
    say(f"2. Flying it: a simulated {AUTOPILOT} vehicle, {pace.speedup:.0f} times as fast as real, a link a station")
    child, links = simulator.start(children, plan, autopilot=AUTOPILOT, speedup=pace.speedup)
    request = fly.request_of(
        plan, links=links, autopilot=AUTOPILOT, rate_hz=pace.rate_hz, speedup=pace.speedup, log_path=log
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
    from link.report import report_flight

    try:
        report = report_flight(log, plan)
    except LinkError as error:
        raise FaultError("the flight's log cannot be read", {"what": str(error)}) from None
    say("\n3. Planned against flown, from the log alone\n")
    typer.echo(report.to_text(), nl=False)


def too_fast(pace: Pace) -> str:
    """Why it is flown once more."""
    return (
        f"At {pace.speedup:.0f} times real speed this machine was too busy to keep up, and the flight ended safely "
        "instead. Once more, half as fast."
    )


def closing(plan: Plan) -> str:
    """How it goes on from here."""
    count = len(plan.handovers)
    return (
        f"{count} handover{'' if count == 1 else 's'}, never without a station in range. Next: skyrelay demo --serve, "
        "skyrelay plan MISSION.json -o PLAN.json, skyrelay --help."
    )


def environment() -> dict[str, str]:
    """The environment of programs started beside the demonstration: as it is, without our own settings."""
    return {name: value for name, value in os.environ.items() if not name.startswith("SKYRELAY_")}
