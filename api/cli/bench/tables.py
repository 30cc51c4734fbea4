"""How the planner's figures are printed."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from api.cli import console

if TYPE_CHECKING:
    from rich.table import Table


def columns(first: str, *others: str) -> Table:
    """A plain table, its first column to the left and the others to the right."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    table.add_column(first, no_wrap=True)
    for title in others:
        table.add_column(title, justify="right", no_wrap=True)
    return table


def print_planner(document: dict[str, Any]) -> None:
    """Every part of the figures that is there."""
    parts: list[tuple[str, Table]] = []
    if "missions" in document:
        parts += _planned(document, "")
    if "default_options" in document:
        parts += _planned(document["default_options"], "with the default overlap, margin and tenure: ")
    if "segments" in document:
        parts.append(("long chains", _segments(document["segments"])))
    if "routing" in document:
        parts.append(("routing on large maps, beside Dijkstra on the stations", _routing(document["routing"])))
    if "costs" in document:
        parts.append(("what is asked for on top of the paper's problem, and its cost", _costs(document["costs"])))
    to = console.out()
    rows = [*document.get("missions", []), *document.get("segments", [])]
    rows += document.get("default_options", {}).get("missions", [])
    for number, (title, table) in enumerate(parts):
        if number:
            to.print()
        if title:
            to.print(title, style="bold")
        to.print(table)
    for row in rows:
        if row["paper"] is not None and row["paper"]["note"]:
            to.print(f"* {row['name']}: {row['paper']['note']}")
    sys.stdout.flush()


def _planned(document: dict[str, Any], prefix: str) -> list[tuple[str, Table]]:
    sizes = [*document["summary"], {"stations": "all", **document["overall"]}]
    parts = [
        (prefix + "each mission" if prefix else "", _missions(document["missions"])),
        (prefix + "mean / worst by size; solved in processor time", _sizes(sizes)),
    ]
    told = [row for row in document["missions"] if row["infeasible"] or row["failed"]]
    if told:
        table = columns("without a plan", "why")
        table.columns[1].justify = "left"
        for row in told:
            table.add_row(row["name"], row["infeasible"] or "FAILED: " + row["failed"])
        parts.append(("", table))
    return parts


def _missions(rows: Sequence[dict[str, Any]]) -> Table:
    table = columns(
        "mission",
        "stations",
        "bound s",
        "ours s",
        "over bound",
        "solved in",
        "fast",
        "solved in",
        "paper's s",
        "over bound",
        "solved in",
        "flight time",
        "solve time",
    )
    for row in rows:
        if row["ours"] is None:
            continue
        table.add_row(
            row["name"],
            str(row["stations"]),
            f"{row['lower_bound_s']:.1f}",
            *_run(row["ours"]),
            *_run(row["fast"])[1:],
            *_run(row["paper"], ".1f"),
            _number(row["mission_time_ratio"], "x {:.3f}"),
            _number(row["solve_time_ratio"], "x {:.3f}"),
        )
    return table


def _run(run: dict[str, Any] | None, gap: str = ".2f") -> tuple[str, str, str]:
    if run is None:
        return ("-", "-", "-")
    early = "*" if run["note"] else ""
    return (
        f"{run['mission_time_s']:.1f}{early}",
        f"{run['gap_percent']:{gap}}{early} %",
        f"{run['solve_s']:.2f}{early} s",
    )


def _sizes(rows: Sequence[dict[str, Any]]) -> Table:
    table = columns(
        "stations",
        "planned",
        "ours over bound",
        "fast",
        "paper's",
        "ours solved in",
        "whole plan",
        "fast",
        "paper's",
        "flight time ratio",
        "solve time ratio",
        "fast",
    )
    for row in rows:
        planned = row["missions"] - row["infeasible"] - row["failed"]
        table.add_row(
            str(row["stations"]),
            f"{planned} of {row['missions']}",
            _pair(row["ours_gap_percent"], ".2f", " %"),
            _pair(row["fast_gap_percent"], ".2f", " %"),
            _pair(row["paper_gap_percent"], ".1f", " %"),
            _pair(row["ours_solve_s"], ".3f", " s"),
            _pair(row["ours_whole_s"], ".2f", " s"),
            _pair(row["fast_solve_s"], ".3f", " s"),
            _pair(row["paper_solve_s"], ".2f", " s"),
            _pair(row["mission_time_ratio"], ".3f"),
            _pair(row["solve_time_ratio"], ".3f"),
            _pair(row["fast_solve_time_ratio"], ".3f"),
        )
    return table


def _segments(rows: Sequence[dict[str, Any]]) -> Table:
    titles = ["ours over bound", "solved in", "fast", "solved in", "paper's", "solved in", "without cvxpy", "solved in"]
    table = columns("stations in a row", *titles, "solve time", "fast")
    for row in rows:
        table.add_row(
            str(row["segments"]),
            *_run(row["ours"])[1:],
            *_run(row["fast"])[1:],
            *_run(row["paper"], ".1f")[1:],
            *_run(row["paper_direct"], ".1f")[1:],
            _number(row["solve_time_ratio"], "x {:.3f}"),
            _number(row["fast_solve_time_ratio"], "x {:.3f}"),
        )
    return table


def _routing(rows: Sequence[dict[str, Any]]) -> Table:
    table = columns(
        "stations", "solved in", "Dijkstra in", "ratio", "handovers", "over shortest", "Dijkstra's", "over shortest"
    )
    for row in rows:
        table.add_row(
            f"{row['stations']:,}",
            f"{row['solve_s']:.2f} s",
            f"{row['paper_solve_s']:.2f} s",
            f"x {row['solve_time_ratio']:.2f}",
            str(row["handovers"]),
            _number(row["excess_percent"], "{:.4f} %"),
            str(row["paper_handovers"]),
            _number(row["paper_excess_percent"], "{:.2f} %"),
        )
    return table


def _costs(rows: Sequence[dict[str, Any]]) -> Table:
    table = columns("asked for", "planned", "no plan", "flight longer, mean / worst", "solved in, mean / worst")
    for row in rows:
        table.add_row(
            row["option"],
            str(row["missions"]),
            "refused" if row["refused"] else str(row["infeasible"]),
            _pair(row["cost_s"], "z.1f", " s"),
            _pair(row["solve_s"], ".2f", " s"),
        )
    return table


def _pair(value: dict[str, float] | None, form: str, unit: str = "") -> str:
    return "-" if value is None else f"{value['mean']:{form}} / {value['worst']:{form}}{unit}"


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else form.format(value)
