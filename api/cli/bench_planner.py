"""``skyrelay bench planner``: missions planned with this planner and with the paper's method."""

from __future__ import annotations

import json
import sys
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
    cases = bench_of.drawn(random, seed) if random else bench_of.fixed(_documents(missions), quick=quick)
    bench_of.warm_up()
    results: list[Result] = []
    with console.Progress(every_s=0.0) as progress:
        for number, case in enumerate(cases, start=1):
            progress.show(f"{number} of {len(cases)}: {case.name}", now=True)
            results.append(_measure(case, as_given))
    figures = bench_of.figures(results)
    if as_json:
        typer.echo(json.dumps(figures, indent=1, allow_nan=False))
    else:
        _print(figures)


def _measure(case: Case, as_given: bool) -> Result:
    from api.bench.planner import measure
    from gcs.errors import GcsError, MissionError, MissionInfeasible
    from planner.errors import PlannerError

    try:
        return measure(case, paper_options=not as_given)
    except MissionError as error:
        raise BadInputError(f"the mission {case.name} has a fault", *inputs.paragraphs(error)) from None
    except MissionInfeasible as error:
        raise inputs.infeasible(error) from None
    except PlannerError as error:
        raise BadInputError(f"the paper's method cannot plan {case.name}", {"what": str(error)}) from None
    except GcsError as error:
        raise FaultError(f"the mission {case.name} could not be planned", {"what": str(error)}) from None


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
