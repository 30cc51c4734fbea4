"""``skyrelay plan``: a mission in, a certified plan out."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated

import typer

from api.cli import files, inputs
from api.cli.errors import BadInputError, FaultError

if TYPE_CHECKING:
    from gcs.plan import Plan


def register(app: typer.Typer, panel: str) -> None:
    """Add the command."""
    app.command("plan", rich_help_panel=panel)(plan)


def plan(
    mission_file: Annotated[str, typer.Argument(metavar="MISSION.json", help="The mission; - is standard input.")],
    output: Annotated[
        str | None, typer.Option("--output", "-o", metavar="PLAN.json", help="Write the plan there.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the plan document instead of the summary.")] = False,
    fast: Annotated[bool, typer.Option("--fast", help="Plan quicker, for a slower flight.")] = False,
    costs: Annotated[
        bool,
        typer.Option("--costs", help="Plan again without each option and limit, and say how many seconds it costs."),
    ] = False,
    option: Annotated[
        list[str] | None,
        typer.Option(
            "--option",
            metavar="NAME=VALUE",
            help="Set an option of the mission, over what its file says; may be repeated. "
            "E.g. [bold]min_overlap_s=8[/bold], [bold]max_handovers=4[/bold].",
        ),
    ] = None,
) -> None:
    """Plan a mission: which stations, which curve, who hands over to whom and when.

    Prints a summary; with [bold]-o[/bold] keeps the plan, which is all the other commands need.
    Ends with 2 when the mission is malformed, with 3 when no flight can fulfil it (and says the smallest fix).
    """
    from gcs.errors import MissionInfeasible, PlanningFailed
    from gcs.planning import plan_mission

    document = inputs.read_json(mission_file, what="mission")
    overrides = inputs.option_values(option or [])
    if overrides and isinstance(document, dict):
        options = document.setdefault("options", {})
        if not isinstance(options, dict):
            raise BadInputError("the mission has a fault", {"where": "options", "what": "must be an object"})
        options.update(overrides)
    mission = inputs.mission(document, mission_file)
    try:
        result = plan_mission(mission, fast=fast)
        if costs:
            from gcs.planning import with_costs

            result = with_costs(result, method="fast" if fast else "joint")
    except MissionInfeasible as error:
        raise inputs.infeasible(error) from None
    except PlanningFailed as error:
        raise FaultError("the planner gave up", {"what": str(error)}) from None
    to_stdout = as_json or output == "-"
    text = json.dumps(result.to_document(), indent=1, ensure_ascii=False, allow_nan=False) + "\n"
    if output not in (None, "-"):
        files.write_text(text, output)
    if to_stdout:
        files.write_text(text, None)
    else:
        typer.echo(overview(result), nl=False)
        if output is None:
            typer.echo("\nkeep it with -o PLAN.json; then: skyrelay handovers, setpoints, fly")
        else:
            typer.echo(f"\nwritten to {output}")


def overview(plan: Plan) -> str:
    """What a person wants to know of a plan: the summary and the handover table."""
    from gcs.exports import export_handovers, summary

    # The table's own headline repeats the summary's.
    table = export_handovers(plan, "table").split("\n\n", 1)[-1]
    return f"{summary(plan)}\n{table}"
