"""``skyrelay bench link``: how punctual the streamer is under load, and the wire layer's rates."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from api.cli import console
from api.processes import QUICK_MISSION

if TYPE_CHECKING:
    from api.bench.link.rates import Rate

_SECONDS, _QUICK_SECONDS = 30.0, 8.0
_RATES_HZ = (20.0, 50.0)


def bench_link(
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
    quick: Annotated[
        bool, typer.Option("--quick", help=f"{_QUICK_SECONDS:g} s a run instead of {_SECONDS:g}, and 50 Hz alone.")
    ] = False,
    seconds: Annotated[
        float | None, typer.Option(min=2.0, max=3600.0, metavar="S", help="Seconds measured in each run.")
    ] = None,
    rate: Annotated[
        list[float] | None,
        typer.Option(min=5.0, max=100.0, metavar="HZ", help="Setpoints a second; again for more. Default: 20 and 50."),
    ] = None,
    load: Annotated[
        Literal["idle", "full", "both"],
        typer.Option(help="Beside the flight: nothing, or the service and the planner kept busy."),
    ] = "both",
    only: Annotated[
        Literal["all", "rates", "lateness"], typer.Option(help="Measure one part alone; `rates` takes three seconds.")
    ] = "all",
) -> None:
    """How late the streamer process sends, beside a bare sender; what a handover costs; rates of the wire layer.

    Flies in real time against a simulated PX4 over signed links. Lateness is the kernel's receive stamp on the loopback
    link, which is taken inside the sender's own sendto, against the earliest deadline not served.
    """
    figures: dict[str, Any] = {}
    if only != "lateness":
        figures["rates"] = _rates()
    if only != "rates":
        seconds = seconds if seconds is not None else _QUICK_SECONDS if quick else _SECONDS
        rates_hz = tuple(rate) if rate else _RATES_HZ[1:] if quick else _RATES_HZ
        loads = {"idle": (False,), "full": (True,), "both": (False, True)}[load]
        figures |= _lateness(seconds, rates_hz, loads)
    if as_json:
        from dataclasses import asdict

        if "rates" in figures:
            figures["rates"] = [asdict(one) for one in figures["rates"]]
        typer.echo(json.dumps(figures, indent=1, allow_nan=False))
        return
    if "runs" in figures:
        _print_runs(figures)
    if "rates" in figures:
        _print_rates(figures["rates"])


def _rates() -> list[Rate]:
    from api.bench.link.rates import wire_rates
    from gcs.mission import read_mission
    from gcs.planning import plan_mission

    return wire_rates(plan_mission(read_mission(QUICK_MISSION), fast=True))


def _lateness(seconds: float, rates_hz: tuple[float, ...], loads: tuple[bool, ...]) -> dict[str, Any]:
    from api.bench.link import punctuality as bench_of

    plan = bench_of.bench_plan(seconds)
    runs = []
    with console.Progress(every_s=0.0) as progress:
        for rate_hz in rates_hz:
            for loaded in loads:
                name = "the service and the planner busy" if loaded else "idle"
                progress.show(f"{rate_hz:g} Hz, {name}: {seconds:g} s, and about half a minute to get there", now=True)
                runs.append(bench_of.measure(plan, rate_hz=rate_hz, seconds=seconds, loaded=loaded).to_document())
    return {"machine": bench_of.machine(), "runs": runs}


def _print_runs(figures: dict[str, Any]) -> None:
    from rich.table import Table

    to, where = console.out(), figures["machine"]
    table = Table(box=None, pad_edge=False, title_justify="left")
    table.title = f"lateness at sendto, ms, signed; {where['processors']} processors, Python {where['python']}"
    for title in ("Hz", "beside it", "sender", "scheduling", "p50", "p99", "max", "missed", "longest gap", "x p99"):
        table.add_column(title, justify="left" if title in ("beside it", "sender", "scheduling") else "right")
    for run in figures["runs"]:
        for who in ("streamer", "reference"):
            one, ours = run[who], who == "streamer"
            ratio = run["p99_ratio"] if ours else 1.0
            table.add_row(
                f"{run['rate_hz']:g}",
                run["load"],
                who,
                one["scheduling"],
                *(f"{one[key]:.2f}" for key in ("p50_ms", "p99_ms", "max_ms")),
                f"{one['missed']} of {one['sent'] + one['missed']}",
                f"{one['longest_gap_ms']:.1f}",
                "-" if ratio is None else f"{ratio:.2f}",
            )
    to.print(table)
    to.print()
    table = Table(box=None, pad_edge=False, title_justify="left", title="a flight's cost, and its handovers")
    titles = (
        "Hz",
        "beside it",
        "of a core",
        "vehicles a core",
        "handovers",
        "longest gap ms",
        "error m",
        "elsewhere m",
    )
    for title in titles:
        table.add_column(title, justify="left" if title == "beside it" else "right")
    for run in figures["runs"]:
        moved = run["handover"]
        table.add_row(
            f"{run['rate_hz']:g}",
            run["load"],
            f"{100.0 * run['core_share']:.1f} %",
            f"{run['vehicles_per_core']:.0f}",
            str(moved["count"]),
            f"{moved['longest_gap_ms']:.1f}",
            *("-" if moved[key] is None else f"{moved[key]:.2f}" for key in _TRACKING),
        )
    to.print(table)
    to.print()


_TRACKING = ("tracking_around_m", "tracking_elsewhere_m")


def _print_rates(rates: list[Rate]) -> None:
    from rich.table import Table

    table = Table(box=None, pad_edge=False, title="rates on one core", title_justify="left")
    for title in ("what", "a second", "cost, in references"):
        table.add_column(title, justify="left" if title == "what" else "right")
    for rate in rates:
        table.add_row(rate.name, f"{rate.per_second:,.0f}", f"{rate.per_reference:.1f}")
    console.out().print(table)
