"""``skyrelay bench planner``: missions planned with this planner and with the paper's method."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from api.cli import console, inputs
from api.cli.errors import BadInputError, FaultError

if TYPE_CHECKING:
    from api.bench.planner import Case, Result


def bench_planner(
    missions: Annotated[
        str | None,
        typer.Option(metavar="DIR", help="Missions (*.json) to plan; default: the 30 drawn as in the paper's Table 2."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
    quick: Annotated[bool, typer.Option("--quick", help="One mission of each size.")] = False,
    random: Annotated[
        int, typer.Option(min=0, max=1000, metavar="K", help="Draw K new missions of each size instead.")
    ] = 0,
    seed: Annotated[int, typer.Option(min=0, metavar="N", help="What the draw starts from.")] = 1,
    as_given: Annotated[
        bool,
        typer.Option(
            "--as-given", help="Keep each mission's own options instead of the paper's (no overlap, no margin)."
        ),
    ] = False,
    paper: Annotated[
        bool, typer.Option("--paper", help="The seed paper's Tables 3 and 4 instead; an hour for all 30.")
    ] = False,
    time_limit: Annotated[
        float | None,
        typer.Option("--time-limit", metavar="S", help="With --paper: seconds for EM on a mission [60]."),
    ] = None,
    rival_limit: Annotated[
        float | None,
        typer.Option("--rival-limit", metavar="S", help="With --paper: seconds for each method of Table 4 [3]."),
    ] = None,
    results: Annotated[
        str | None,
        typer.Option(metavar="FILE", help="With --paper: keep every measurement there, and go on from what is there."),
    ] = None,
    redo: Annotated[
        list[str] | None,
        typer.Option(
            metavar="WHAT",
            help="With --results: measure [bold]ours[/bold] (with DC), [bold]enumeration[/bold] or "
            "[bold]rivals[/bold] anew.",
        ),
    ] = None,
    figures: Annotated[
        str | None, typer.Option(metavar="DIR", help="With --paper: draw figures like the paper's 9 to 14 there.")
    ] = None,
    only: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Only missions of this name, e.g. [bold]M30_01[/bold]; may be repeated."),
    ] = None,
) -> None:
    """Plan missions with this planner and with the paper's method (through plain cvxpy), one after the other.

    Shows both mission times against the bound that nothing can beat, both solve times, and their ratios. By default
    every mission is planned under the paper's own problem: no minimum overlap, no range margin, no minimum tenure.
    """
    from api.bench import planner as bench_of

    if not bench_of.reference_available():
        raise BadInputError(
            "the reference is not installed",
            {"what": "the paper's method runs through cvxpy", "fix": "pip install 'skyrelay[bench]'"},
        )
    _refuse_without(
        "--paper",
        paper,
        {
            "--time-limit": time_limit,
            "--rival-limit": rival_limit,
            "--results": results,
            "--redo": redo,
            "--figures": figures,
        },
    )
    cases = bench_of.drawn(random, seed) if random else bench_of.fixed(_documents(missions), quick=quick)
    cases = _only(cases, only or [])
    bench_of.warm_up()
    if paper:
        from api.bench.paper import Settings
        from api.cli.bench_paper import REDO, run_paper

        for what in redo or []:
            if what not in REDO:
                raise BadInputError(
                    "an option has a value it cannot have",
                    {"where": "--redo", "value": what, "allowed": ", ".join(REDO)},
                )
        settings = Settings(_seconds("--time-limit", time_limit, 60.0), _seconds("--rival-limit", rival_limit, 3.0))
        run_paper(
            cases,
            settings,
            results_file=results,
            figures_directory=figures,
            redo=redo or [],
            as_json=as_json,
            guarded=lambda work: _guarded(work, "a mission"),
        )
        return
    measured: list[Result] = []
    with console.Progress(every_s=0.0) as progress:
        for number, case in enumerate(cases, start=1):
            progress.show(f"{number} of {len(cases)}: {case.name}", now=True)
            measured.append(_measure(case, as_given))
    document = bench_of.figures(measured)
    if as_json:
        typer.echo(json.dumps(document, indent=1, allow_nan=False))
    else:
        _print(document)


def _refuse_without(what: str, given: bool, options: dict[str, object]) -> None:
    for name, value in options.items():
        if value is not None and not given:
            raise BadInputError(f"{name} goes with {what}", {"where": name, "fix": f"add {what}, or leave it out"})


def _seconds(name: str, value: float | None, default: float) -> float:
    if value is None:
        return default
    if not 0.0 < value <= 86_400.0:  # NaN fails too
        raise BadInputError(
            "an option has a value it cannot have",
            {"where": name, "value": f"{value:g}", "allowed": "more than 0, at most 86400 s"},
        )
    return value


def _only(cases: list[Case], names: list[str]) -> list[Case]:
    known = {case.name for case in cases}
    for name in names:
        if name not in known:
            raise BadInputError(
                "there is no such mission",
                {"where": "--only", "value": name, "allowed": ", ".join(sorted(known))},
            )
    return [case for case in cases if not names or case.name in names]


def _measure(case: Case, as_given: bool) -> Result:
    from api.bench.planner import measure

    found: Result = _guarded(lambda: measure(case, paper_options=not as_given), f"the mission {case.name}")
    return found


def _guarded(work: Callable[[], Any], name: str) -> Any:
    """``work()``, what it raises turned into the command line's blocks."""
    from gcs.errors import GcsError, MissionError, MissionInfeasible
    from planner.errors import PlannerError

    try:
        return work()
    except MissionError as error:
        raise BadInputError(f"{name} has a fault", *inputs.paragraphs(error)) from None
    except MissionInfeasible as error:
        raise inputs.infeasible(error) from None
    except PlannerError as error:
        raise BadInputError(f"the paper's method cannot plan {name}", {"what": str(error)}) from None
    except GcsError as error:
        raise FaultError(f"{name} could not be planned", {"what": str(error)}) from None


def _documents(directory: str | None) -> list[tuple[str, Any]]:
    if directory is None:
        from importlib import resources

        place = resources.files("sitl_fixtures").joinpath("missions", "paper_like")
        names = sorted(entry.name for entry in place.iterdir() if entry.name.endswith(".json"))
        return [(name, json.loads(place.joinpath(name).read_bytes())) for name in names]
    paths = sorted(Path(directory).glob("*.json"))
    if not paths:
        raise BadInputError(
            "there are no missions",
            {"where": "--missions", "value": directory, "allowed": "a folder with *.json files"},
        )
    return [(path.name, inputs.read_json(str(path), what="mission")) for path in paths]


def _print(figures: dict[str, Any]) -> None:
    from rich.table import Table

    to = console.out()
    table = Table(box=None, pad_edge=False)
    for title in (
        "mission",
        "stations",
        "bound s",
        "ours s",
        "over bound",
        "solved in",
        "paper's s",
        "over bound",
        "solved in",
        "flight time",
        "solve time",
    ):
        table.add_column(title, justify="left" if title == "mission" else "right", no_wrap=True)
    for row in figures["missions"]:
        ours, paper = row["ours"], row["paper"]
        table.add_row(
            row["name"],
            str(row["stations"]),
            f"{row['lower_bound_s']:.1f}",
            f"{ours['mission_time_s']:.1f}",
            f"{ours['gap_percent']:.2f} %",
            f"{ours['solve_s']:.2f} s",
            f"{paper['mission_time_s']:.1f}",
            f"{paper['gap_percent']:.1f} %",
            f"{paper['solve_s']:.2f} s",
            f"x {row['mission_time_ratio']:.3f}",
            f"x {row['solve_time_ratio']:.3f}",
        )
    to.print(table)
    to.print()
    table = Table(box=None, pad_edge=False, title="mean / worst by size", title_justify="left")
    for title in (
        "stations",
        "missions",
        "ours over bound",
        "paper's over bound",
        "ours solved in",
        "paper's solved in",
        "flight time ratio",
        "solve time ratio",
    ):
        table.add_column(title, justify="right", no_wrap=True)
    for row in figures["summary"]:

        def pair(name: str, form: str, row: dict[str, Any] = row) -> str:
            return f"{row[name]['mean']:{form}} / {row[name]['worst']:{form}}"

        table.add_row(
            str(row["stations"]),
            str(row["missions"]),
            pair("ours_gap_percent", ".2f") + " %",
            pair("paper_gap_percent", ".1f") + " %",
            pair("ours_solve_s", ".2f") + " s",
            pair("paper_solve_s", ".2f") + " s",
            pair("mission_time_ratio", ".3f"),
            pair("solve_time_ratio", ".3f"),
        )
    to.print(table)
    sys.stdout.flush()
