"""``skyrelay bench link``: rates of the wire layer on one core."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from api.cli import console
from api.cli.demo import QUICK_MISSION


def bench_link(
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
) -> None:
    """Rates of the wire layer on one core: encode, pack, sign, parse, resample; beside a reference of the same run."""
    from dataclasses import asdict

    from gcs.mission import Mission
    from gcs.planning import plan_mission
    from link.wire_bench import wire_rates

    rates = wire_rates(plan_mission(Mission.from_document(QUICK_MISSION), fast=True))
    if as_json:
        typer.echo(json.dumps({"rates": [asdict(rate) for rate in rates]}, indent=1))
        return
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for title in ("what", "a second", "cost, in references"):
        table.add_column(title, justify="left" if title == "what" else "right")
    for rate in rates:
        table.add_row(rate.name, f"{rate.per_second:,.0f}", f"{rate.per_reference:.1f}")
    console.out().print(table)
