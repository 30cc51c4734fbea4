"""``skyrelay report``: planned against flown, from a telemetry log and the plan."""

from __future__ import annotations

import json
from pathlib import Path
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
    flight: Annotated[
        int | None, typer.Option(metavar="N", min=1, help="Which flight, where the log holds several; else the first.")
    ] = None,
    output: Annotated[
        list[str] | None,
        typer.Option("--output", "-o", metavar="FILE.html|pdf", help="Draw the flight into one file; repeatable."),
    ] = None,
    html: Annotated[str | None, typer.Option(metavar="FILE", help="The same as -o FILE.html.")] = None,
    pdf: Annotated[str | None, typer.Option(metavar="FILE", help="The same as -o FILE.pdf.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
) -> None:
    """Compare a flight with its plan: tracking, range left, handovers, links, the stream's gaps and lateness.

    Judged on the vehicle's clock; damage of the log is told. Drawn into a page with -o (needs matplotlib). Everything
    is measured from the frames in the log, unless the flight's events are given too.
    """
    from gcs.exports import write_atomic
    from link.errors import LinkError
    from link.files import draw, report_and_traces

    wanted = _wanted(output, html, pdf)
    plan = inputs.plan(plan_file)
    try:
        found, traces = report_and_traces(log_file, plan, events, flight=flight)
    except (LinkError, OSError) as error:
        raise BadInputError(
            "the log cannot be compared with the plan",
            {"where": log_file, "what": str(error), "fix": "give the log of a flight of this very plan"},
        ) from None
    for name, form in wanted:
        try:
            write_atomic(Path(name), draw(plan, found, traces, form))
        except LinkError as error:
            fix = "install matplotlib, or leave out the file and read the figures as text"
            raise BadInputError("the flight cannot be drawn", {"where": name, "what": str(error), "fix": fix}) from None
    if as_json:
        typer.echo(json.dumps(found.to_document(), indent=1, allow_nan=False))
    else:
        typer.echo(found.to_text(), nl=False)


def _wanted(output: list[str] | None, html: str | None, pdf: str | None) -> list[tuple[str, str]]:
    """The files to draw and their forms. Raises `BadInputError`."""
    wanted = [(name, form) for name, form in ((html, "html"), (pdf, "pdf")) if name is not None]
    for name in output or []:
        form = Path(name).suffix.lower().lstrip(".")
        if form not in ("html", "pdf"):
            allowed = "a name that ends in .html or .pdf"
            raise BadInputError("the report cannot be drawn", {"where": "-o", "value": name, "allowed": allowed})
        wanted.append((name, form))
    return wanted
