"""What ``skyrelay bench planner`` is asked for: its options, and which of them go together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import typer

from api.cli.errors import BadInputError

_MISSIONS, _WHAT, _PAPER = "Which missions", "What is measured", "The seed paper's experiments"


@dataclass(frozen=True)
class PlannerBenchOptions:
    """Every option of the command, as given. `check` first: some exclude each other."""

    missions: Annotated[
        str | None,
        typer.Option(
            metavar="DIR",
            rich_help_panel=_MISSIONS,
            help="Missions (*.json) to plan; default: the 30 drawn as in the paper's Table 2.",
        ),
    ] = None
    quick: Annotated[bool, typer.Option("--quick", rich_help_panel=_MISSIONS, help="One mission of each size.")] = False
    only: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME", rich_help_panel=_MISSIONS, help="Only this mission, e.g. [bold]M30_01[/bold]; repeatable."
        ),
    ] = None
    random: Annotated[
        int,
        typer.Option(
            min=0, max=1000, metavar="K", rich_help_panel=_MISSIONS, help="Draw K new missions of each size instead."
        ),
    ] = 0
    seed: Annotated[
        int, typer.Option(min=0, metavar="N", rich_help_panel=_MISSIONS, help="What every draw starts from.")
    ] = 1
    as_given: Annotated[
        bool,
        typer.Option(
            "--as-given",
            rich_help_panel=_MISSIONS,
            help="Keep each mission's own options instead of the paper's (no overlap, no margin, no tenure).",
        ),
    ] = False
    default_options: Annotated[
        bool,
        typer.Option(
            "--default-options",
            rich_help_panel=_MISSIONS,
            help="Plan with the overlap, margin and tenure a mission gets that asks for nothing.",
        ),
    ] = False
    ours_only: Annotated[
        bool,
        typer.Option("--ours-only", rich_help_panel=_WHAT, help="Without the paper's method, for many missions."),
    ] = False
    segments: Annotated[
        str | None,
        typer.Option(
            metavar="N,N", rich_help_panel=_WHAT, help="Instead: chains of so many stations, e.g. [bold]100,175[/bold]."
        ),
    ] = None
    routing: Annotated[
        str | None,
        typer.Option(
            metavar="M,M",
            rich_help_panel=_WHAT,
            help="Instead: routing on maps of so many stations, e.g. [bold]1000,10000,100000[/bold].",
        ),
    ] = None
    costs: Annotated[
        bool,
        typer.Option(
            "--costs", rich_help_panel=_WHAT, help="Instead: what each option and limit costs in seconds of flight."
        ),
    ] = False
    everything: Annotated[
        bool,
        typer.Option("--all", rich_help_panel=_WHAT, help="All of the above, one after the other; about ten minutes."),
    ] = False
    paper: Annotated[
        bool,
        typer.Option(
            "--paper",
            rich_help_panel=_PAPER,
            help="Instead: the paper's Tables 3 and 4 beside this planner; an hour for all 30.",
        ),
    ] = False
    time_limit: Annotated[
        float | None,
        typer.Option("--time-limit", metavar="S", rich_help_panel=_PAPER, help="Seconds for EM on a mission [60]."),
    ] = None
    rival_limit: Annotated[
        float | None,
        typer.Option(
            "--rival-limit", metavar="S", rich_help_panel=_PAPER, help="Seconds for each method of Table 4 [3]."
        ),
    ] = None
    results: Annotated[
        str | None,
        typer.Option(
            metavar="FILE",
            rich_help_panel=_PAPER,
            help="Keep every measurement there, and go on from what is there already.",
        ),
    ] = None
    redo: Annotated[
        list[str] | None,
        typer.Option(
            metavar="WHAT",
            rich_help_panel=_PAPER,
            help="Measure again in spite of --results: [bold]ours[/bold] (with DC beside it), "
            "[bold]enumeration[/bold] or [bold]rivals[/bold]; repeatable.",
        ),
    ] = None
    kept_only: Annotated[
        bool,
        typer.Option(
            "--kept-only",
            rich_help_panel=_PAPER,
            help="Show what --results holds so far; measure nothing but what --redo names.",
        ),
    ] = False
    figures: Annotated[
        str | None,
        typer.Option(
            metavar="DIR",
            rich_help_panel=_PAPER,
            help="Draw figures like the paper's 9 to 14 there, and write the tables as a page.",
        ),
    ] = None
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False

    OF_PAPER: ClassVar = ("--time-limit", "--rival-limit", "--results", "--redo", "--kept-only", "--figures")
    CLASHES: ClassVar = (
        ("--missions", ("--random",)),
        ("--quick", ("--random",)),
        ("--as-given", ("--default-options", "--all", "--paper", "--costs", "--segments", "--routing")),
        ("--default-options", ("--all", "--paper", "--costs", "--segments", "--routing")),
        ("--paper", ("--all", "--costs", "--segments", "--routing", "--ours-only")),
        ("--ours-only", ("--costs", "--segments", "--routing")),
    )

    def check(self) -> None:
        """Raises `BadInputError` for options that say two things at once, or nothing where they stand."""
        given = {
            "--missions": self.missions,
            "--random": self.random,
            "--quick": self.quick,
            "--as-given": self.as_given,
            "--default-options": self.default_options,
            "--ours-only": self.ours_only,
            "--segments": self.segments,
            "--routing": self.routing,
            "--costs": self.costs,
            "--all": self.everything,
            "--paper": self.paper,
            "--time-limit": self.time_limit,
            "--rival-limit": self.rival_limit,
            "--results": self.results,
            "--redo": self.redo,
            "--kept-only": self.kept_only,
            "--figures": self.figures,
        }
        said = {option for option, value in given.items() if value not in (None, False, 0, [])}
        for option in self.OF_PAPER:
            if given[option] not in (None, False) and "--paper" not in said:
                raise BadInputError(
                    f"{option} goes with --paper", {"where": option, "fix": "add --paper, or leave it out"}
                )
        for one, others in self.CLASHES:
            for other in others:
                if one in said and other in said:
                    raise BadInputError(f"{one} and {other} do not go together", {"fix": "leave one of them out"})
