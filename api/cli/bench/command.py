"""``skyrelay bench``: the figures, measured here and now, always beside a reference in the same run."""

from __future__ import annotations

import typer

from api.cli.bench.link import bench_link
from api.cli.bench.planner import bench_planner
from api.cli.bench.service import bench_api

bench = typer.Typer(
    help="Measure: the planner beside the paper's method, the wire layer and the service beside a plain piece of work.",
    no_args_is_help=True,
)
bench.command("planner")(bench_planner)
bench.command("link")(bench_link)
bench.command("api")(bench_api)


def register(app: typer.Typer, panel: str) -> None:
    """Add the group."""
    app.add_typer(bench, name="bench", rich_help_panel=panel)


@bench.callback()
def _group() -> None:
    """Measure, here and now: every figure comes beside a reference of the same run."""
