"""``skyrelay bench planner --paper``: the seed paper's tables and figures."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from api.cli import console, files
from api.cli.bench.tables import columns
from api.cli.errors import BadInputError, FaultError

if TYPE_CHECKING:
    from rich.table import Table

    from api.bench.paper import Results, Settings
    from api.bench.planner import Case

EXTRA = {"fix": "pip install 'skyrelay[bench]'"}
REDO = {"ours": ("plans",), "enumeration": ("enumeration",), "rivals": ("allocation",)}


def run_paper(
    cases: Sequence[Case],
    settings: Settings,
    *,
    results_file: str | None,
    figures_directory: str | None,
    redo: Sequence[str],
    kept_only: bool,
    as_json: bool,
    guarded: Callable[[Callable[[], Any]], Any],
) -> None:
    """Measure what is missing, print the tables, draw the figures. ``guarded`` turns planners' errors into blocks."""
    from api.bench.paper import ResultsError, nlopt_available, tables_page
    from api.bench.paper import run as run_experiments

    if not nlopt_available():
        raise BadInputError("the paper's rivals are not installed", {"what": "six of them run in NLopt", **EXTRA})
    for what in redo:
        if what not in REDO:
            raise BadInputError(
                "an option has a value it cannot have", {"where": "--redo", "value": what, "allowed": ", ".join(REDO)}
            )
    folder = None if figures_directory is None else _folder(figures_directory)
    again = [unit for what in redo for unit in REDO[what]]

    def measure(results: Results, tell: Callable[[str], None]) -> list[dict[str, Any]]:
        run = partial(run_experiments, cases, settings, results, again=again, kept_only=kept_only, tell=tell)
        return list(guarded(run))

    try:
        document = _measured(cases, settings, results_file, folder, measure)
    except ResultsError as error:
        raise BadInputError("the results file cannot be used", {"where": "--results", "what": str(error)}) from None
    if folder is not None:
        files.write_text(tables_page(document), str(folder / "tables.md"))
    if as_json:
        typer.echo(json.dumps(document, indent=1, allow_nan=False))
    else:
        _print(document)


def _measured(
    cases: Sequence[Case],
    settings: Settings,
    results_file: str | None,
    folder: Path | None,
    measure: Callable[[Results, Callable[[str], None]], list[dict[str, Any]]],
) -> dict[str, Any]:
    """The tables' and figures' data, from what ``results_file`` holds and what ``measure`` adds to it."""
    from api.bench.paper import Results, summary, table_3, table_4
    from api.bench.planner import warm_up

    results = Results(None if results_file is None else Path(results_file))
    # The reference in cvxpy has no part in this.
    warm_up(reference=False)
    with console.Progress(every_s=0.0) as progress:
        if results_file is not None and len(results):
            progress.note(f"{len(results)} measurements found in {results_file}")
        if results.dropped_torn_line:
            progress.note("the last line there was cut short; that measurement is made again")

        def tell(text: str) -> None:
            progress.show(text, now=True)

        rows = measure(results, tell)
        if not rows:
            raise BadInputError(
                "there is nothing to show yet",
                {"where": "--results", "what": "no mission has all of Table 4", "fix": "leave out --kept-only"},
            )
        shown = {row["name"] for row in rows}
        drawn = [] if folder is None else _draw([c for c in cases if c.name in shown], rows, folder, tell)
    return {
        "machines": results.machines(),
        "settings": {"time_limit_s": settings.time_limit_s, "rival_limit_s": settings.rival_limit_s},
        "table_3": table_3(rows),
        "table_3_longer": table_3(rows, "longer"),
        "table_4": table_4(rows),
        "summary": summary(rows),
        "figures": drawn,
    }


def settings_of(time_limit_s: float | None, rival_limit_s: float | None) -> Settings:
    """The experiments' settings; None is the default. Raises `BadInputError`."""
    from api.bench.paper import Settings

    given = {"time_limit_s": time_limit_s, "rival_limit_s": rival_limit_s}
    for name, value in given.items():
        if value is not None and not 0.0 < value <= 86_400.0:  # NaN fails too
            where = "--" + name.removesuffix("_s").replace("_", "-")
            raise BadInputError(
                "an option has a value it cannot have",
                {"where": where, "value": f"{value:g}", "allowed": "more than 0, at most 86400 s"},
            )
    return Settings(**{name: value for name, value in given.items() if value is not None})


def _folder(name: str) -> Path:
    """The folder of the figures, made when it is not there; matplotlib is asked for before hours are spent."""
    from api.bench.paper import matplotlib_available

    if not matplotlib_available():
        raise BadInputError("the figures cannot be drawn", {"what": "matplotlib is not installed", **EXTRA})
    folder = Path(name)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInputError(
            "the figures cannot be written there",
            {"where": "--figures", "value": name, "what": error.strerror, "allowed": "a folder, or where one can be"},
        ) from None
    return folder


def _draw(
    cases: Sequence[Case], rows: list[dict[str, Any]], folder: Path, tell: Callable[[str], None]
) -> list[dict[str, str]]:
    from api.bench.paper import draw_all

    tell("figures")
    try:
        return [{"file": str(path), "title": title} for path, title in draw_all(cases, rows, folder)]
    except OSError as error:
        raise FaultError("a figure could not be written", {"where": str(folder), "what": str(error)}) from None


def _print(document: dict[str, Any]) -> None:
    to = console.out()
    for title, table in (
        (
            "Table 3: enumeration (EM) against decoupling (DC), and this planner; times in s",
            _table_3(document["table_3"]),
        ),
        ("Table 3 under a longer limit, where one was measured", _table_3(document["table_3_longer"])),
        ("Table 4: mission time in s along Dijkstra's sequence, by method", _table_4(document["table_4"])),
        ("mean gap to the bound in %, by number of stations", _summary(document["summary"])),
    ):
        if not table.row_count:
            continue
        to.print(title, style="bold")
        to.print(table)
        to.print()
    if document["figures"]:
        for figure in document["figures"]:
            to.print(f"{figure['file']}: {figure['title']}")


def _table_3(rows: Sequence[dict[str, Any]]) -> Table:
    from api.bench.paper import TABLE_3, cells_3

    table = columns(*TABLE_3)
    for row in rows:
        table.add_row(*cells_3(row))
    return table


def _table_4(rows: Sequence[dict[str, Any]]) -> Table:
    from api.bench.paper import ALLOCATIONS

    table = columns("mission", "T", "P", *ALLOCATIONS, "ours")
    for row in rows:
        variables = row["variables"]
        times = [f"{row['mission_time_s'][name]:.2f}" for name in (*ALLOCATIONS, "ours")]
        table.add_row(row["name"], str(variables["T"]), str(variables["P"]), *times)
    return table


def _summary(rows: Sequence[dict[str, Any]]) -> Table:
    from api.bench.paper import mean

    names = list(rows[0]["gap_percent"]) if rows else []
    table = columns("stations", *names)
    for row in rows:
        table.add_row(str(row["stations"]), *(mean(row["gap_percent"][name]) for name in names))
    return table
