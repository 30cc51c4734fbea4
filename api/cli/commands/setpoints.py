"""``skyrelay setpoints``: the plan as the stream a vehicle is sent."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

import typer

from api.cli import files, inputs
from api.cli.errors import BadInputError

if TYPE_CHECKING:
    from collections.abc import Iterator


def register(app: typer.Typer, panel: str) -> None:
    """Add the command."""
    app.command("setpoints", rich_help_panel=panel)(setpoints)


def setpoints(
    plan_file: Annotated[str, typer.Argument(metavar="PLAN.json", help="The plan; - is standard input.")],
    rate: Annotated[float, typer.Option(metavar="HZ", help="Samples a second, 0.1 to 200.")] = 20.0,
    file_format: Annotated[
        Literal["csv", "jsonl", "tlog"],
        typer.Option("--format", help="csv, one JSON object a line, or a telemetry log that mavlogdump opens."),
    ] = "csv",
    autopilot: Annotated[
        Literal["px4", "ardupilot"], typer.Option(help="Whose message and axes a tlog is in.")
    ] = "px4",
    launch: Annotated[
        str | None,
        typer.Option(metavar="UTC", help="Time of T+0 in a tlog, e.g. 2026-11-22T09:00:00Z; else 2000-01-01."),
    ] = None,
    output: Annotated[str | None, typer.Option("--output", "-o", metavar="FILE", help="Write there.")] = None,
) -> None:
    """Resample a plan into position, velocity and acceleration setpoints.

    The stream starts at T+0, steps by 1/rate and ends exactly at the mission time. CSV and JSON are in metres of the
    plan's own plane (north, east, down); a tlog holds what would go on the wire, each setpoint from the
    system id of the station in control.
    """
    from link.files import setpoint_file

    at = inputs.utc_time(launch)
    plan = inputs.plan(plan_file)
    try:
        pieces: Iterator[bytes] = setpoint_file(plan, rate, file_format, autopilot=autopilot, launch=at)
    except ValueError as error:
        raise BadInputError("the stream cannot be made so", {"what": str(error)}) from None
    files.write_chunks(pieces, output)
