"""``skyrelay handovers``: the schedule for the crews of the remote pilot stations."""

from __future__ import annotations

from typing import Annotated

import typer

from api.cli import files, inputs
from api.cli.errors import BadInputError


def register(app: typer.Typer, panel: str) -> None:
    """Add the command."""
    app.command("handovers", rich_help_panel=panel)(handovers)


def handovers(
    plan_file: Annotated[str, typer.Argument(metavar="PLAN.json", help="The plan; - is standard input.")],
    file_format: Annotated[str, typer.Option("--format", metavar="FORMAT", help="table, json or csv.")] = "table",
    station: Annotated[
        str | None, typer.Option(metavar="ID", help="Only the handovers this station transfers or receives.")
    ] = None,
    launch: Annotated[
        str | None,
        typer.Option(metavar="UTC", help="Time of T+0, e.g. 2026-11-22T09:00:00Z: times are given in UTC too."),
    ] = None,
    output: Annotated[str | None, typer.Option("--output", "-o", metavar="FILE", help="Write there.")] = None,
) -> None:
    """Show the handover schedule: when, where, from whom to whom, how long both cover the vehicle.

    Whole, or one station's part of it.
    """
    from gcs.errors import ExportError
    from gcs.exports import FORMATS, export_handovers

    if file_format not in FORMATS:
        raise BadInputError(
            "there is no such format",
            {"where": "--format", "value": file_format, "allowed": ", ".join(FORMATS), "fix": "choose one of these"},
        )
    at = inputs.utc_time(launch)
    plan = inputs.plan(plan_file)
    try:
        text = export_handovers(plan, file_format, station=station, launch=at)
    except ExportError as error:
        raise BadInputError("the schedule cannot be made so", {"what": str(error)}) from None
    files.write_text(text, output)
