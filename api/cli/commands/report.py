"""``skyrelay report``: planned against flown, from a telemetry log and the plan."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from api.cli import inputs
from api.cli.errors import BadInputError


def register(app: typer.Typer, panel: str) -> None:
    """Add the command."""
    app.command("report", rich_help_panel=panel)(report)


def report(
    log_file: Annotated[str, typer.Argument(metavar="FLIGHT.tlog", help="What `skyrelay fly --log` kept.")],
    plan_file: Annotated[str, typer.Argument(metavar="PLAN.json", help="The plan it was a flight of.")],
    events: Annotated[
        str | None,
        typer.Option(
            metavar="EVENTS.jsonl",
            help="The flight's events, a line each (the service keeps them beside the log; `fly --json` prints them): "
            "adds how often another link path of a station came to send, and the streamer's own count of lateness.",
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
) -> None:
    """Compare a flight with its plan: tracking, range left, handovers, links, the stream's gaps and lateness.

    Everything is measured from the frames in the log, unless the flight's events are given too.
    """
    from link.errors import LinkError
    from link.files import report_flight

    plan = inputs.plan(plan_file)
    try:
        found = report_flight(log_file, plan, events)
    except (LinkError, OSError) as error:
        raise BadInputError(
            "the log cannot be compared with the plan",
            {"where": log_file, "what": str(error), "fix": "give the log of a flight of this very plan"},
        ) from None
    if as_json:
        typer.echo(json.dumps(found.to_document(), indent=1, allow_nan=False))
    else:
        typer.echo(found.to_text(), nl=False)
