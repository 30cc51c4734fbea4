"""The paper's tables as a page of Markdown, beside the figures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from api.bench.paper.experiments import ALLOCATIONS


def tables_page(document: dict[str, Any]) -> str:
    """The page of the document that ``skyrelay bench planner --paper`` prints as JSON."""
    settings = document["settings"]
    limits = f"--time-limit {settings['time_limit_s']:g} --rival-limit {settings['rival_limit_s']:g}"
    lines = [
        "# Tables 3 and 4",
        "",
        "Written by the command below; [what they mean](../paper-experiments.md).",
        "",
        f"    skyrelay bench planner --paper {limits} --results FILE --figures DIR",
        "",
        *(f"Measured on: {_machine(machine)}." for machine in document["machines"]),
        "",
        "## Mean gap to the lower bound in %",
        "",
        *_summary(document["summary"]),
        "",
        "## Table 3: enumeration (EM) and decoupling (DC)",
        "",
        "Sequences EM planned, and branches it passed over; +: it was cut short. Mission and processor times in s.",
        "",
        *_table_3(document["table_3"]),
        "",
        *_longer(document["table_3_longer"]),
        "## Table 4: mission time in s along Dijkstra's sequence",
        "",
        "T, P: unknowns. In bold: the best of the paper's eight methods. Last: this planner, on its own sequence.",
        "",
        *_table_4(document["table_4"]),
        "",
    ]
    return "\n".join(lines)


def _machine(machine: dict[str, Any]) -> str:
    return (
        f"{machine['processor'] or machine['architecture']}, {machine['cores']} cores, Python {machine['python']}, "
        f"numpy {machine['numpy']}, skyrelay {machine['skyrelay']}"
    )


def _summary(rows: Sequence[dict[str, Any]]) -> list[str]:
    names = list(rows[0]["gap_percent"]) if rows else []
    body = [
        [str(row["stations"]), str(row["missions"]), *(mean(row["gap_percent"][name]) for name in names)]
        for row in rows
    ]
    return _table(["stations", "missions", *names], body)


def _longer(rows: Sequence[dict[str, Any]]) -> list[str]:
    if not rows:
        return []
    limits = " or ".join(f"{limit:g} s" for limit in sorted({row["time_limit_s"] for row in rows}))
    return ["Where that was too short, once more, for " + limits + ":", "", *_table_3(rows), ""]


TABLE_3 = ("mission", "planned", "passed over", "bound", "EM", "DC", "ours", "rank of DC", "EM in", "DC in", "ours in")


def cells_3(row: dict[str, Any]) -> list[str]:
    """A row of Table 3 under the titles `TABLE_3`, times in s; + after what an enumeration cut short says."""
    times, seconds = row["mission_time_s"], row["cpu_s"]
    more = "+" if row["complete"] is False else ""
    return [
        row["name"],
        number(row["sequences"]["em"], "d", more),
        number(row["sequences"]["em_pruned"], "d"),
        f"{row['lower_bound_s']:.2f}",
        number(times["em"], ".2f"),
        f"{times['dc']:.2f}",
        f"{times['ours']:.2f}",
        number(row["rank_dc"], "d", more),
        number(seconds["em"], ".1f"),
        f"{seconds['dc']:.2f}",
        f"{seconds['ours']:.2f}",
    ]


def _table_3(rows: Sequence[dict[str, Any]]) -> list[str]:
    ours = TABLE_3.index("ours")
    body = [cells_3(row) for row in rows]
    return _table(TABLE_3, [[f"**{cell}**" if k == ours else cell for k, cell in enumerate(cells)] for cells in body])


def _table_4(rows: Sequence[dict[str, Any]]) -> list[str]:
    body = []
    for row in rows:
        times = row["mission_time_s"]
        best = min(times[name] for name in ALLOCATIONS)
        shown = [f"**{times[name]:.2f}**" if times[name] == best else f"{times[name]:.2f}" for name in ALLOCATIONS]
        body.append(
            [row["name"], str(row["variables"]["T"]), str(row["variables"]["P"]), *shown, f"{times['ours']:.2f}"]
        )
    return _table(["mission", "T", "P", *ALLOCATIONS, "ours"], body)


def mean(value: dict[str, float] | None) -> str:
    """The mean of a pair of mean and worst."""
    return number(None if value is None else value["mean"], ".1f")


def number(value: float | None, form: str, more: str = "") -> str:
    """A number as it is shown, and a dash where there is none."""
    return "-" if value is None else f"{value:{form}}{more}"


def _table(titles: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    lines = [titles, ["---", *["---:"] * (len(titles) - 1)], *rows]
    return [f"| {' | '.join(line)} |" for line in lines]
