"""``skyrelay bench planner``: missions planned with this planner and with the paper's method."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from api.cli import console, inputs
from api.cli.bench.planner_options import PlannerBenchOptions
from api.cli.errors import BadInputError, FaultError
from api.cli.options import command_of

if TYPE_CHECKING:
    from api.bench.planner import Case


def run_bench(asked: PlannerBenchOptions) -> None:
    """Plan missions with this planner and with the paper's method (through plain cvxpy), one after the other.

    Shows mission times against the bound that nothing can beat, processor times, and their ratios. By default every
    mission is planned under the paper's own problem: no minimum overlap, no range margin, no minimum tenure.
    Ends with 1 when a mission that has a plan got none.
    """
    asked.check()
    from api.bench.planner import SEGMENTS, STATIONS

    chains = _counts("--segments", asked.segments, 2, 1000) or (SEGMENTS if asked.everything else ())
    maps = _counts("--routing", asked.routing, 2, 1_000_000) or (STATIONS if asked.everything else ())
    scale_alone = bool(chains or maps) and not asked.everything and not asked.costs
    cases = [] if scale_alone else _cases(asked)
    if asked.paper:
        _bench_paper(asked, cases)
        return
    document = _measured(asked, cases, chains, maps)
    if asked.as_json:
        typer.echo(json.dumps(document, indent=1, allow_nan=False))
    else:
        from api.cli.bench.tables import print_planner

        print_planner(document)
    planned = [*document.get("missions", []), *document.get("default_options", {}).get("missions", [])]
    if any(row["failed"] for row in planned):
        raise typer.Exit(1)


bench_planner = command_of(PlannerBenchOptions, run_bench)


# -- what is measured ----------------------------------------------------------------------------------------------


def _bench_paper(asked: PlannerBenchOptions, cases: Sequence[Case]) -> None:
    from api.cli.bench.paper import run_paper, settings_of

    run_paper(
        cases,
        settings_of(asked.time_limit, asked.rival_limit),
        results_file=asked.results,
        figures_directory=asked.figures,
        redo=asked.redo or [],
        kept_only=asked.kept_only,
        as_json=asked.as_json,
        guarded=_guarded,
    )


def _measured(
    asked: PlannerBenchOptions, cases: Sequence[Case], chains: Sequence[int], maps: Sequence[int]
) -> dict[str, Any]:
    """Every part of the figures asked for. Raises `BadInputError` where the reference is asked for and not there."""
    from api.bench.planner import DEFAULT_OPTIONS, PAPER_OPTIONS, compare

    reference = not asked.ours_only
    if reference and not compare.reference_available():
        raise BadInputError(
            "the reference is not installed",
            {"what": "the paper's method runs through cvxpy", "fix": "pip install 'skyrelay[bench]', or --ours-only"},
        )
    compare.warm_up(reference=reference)
    options: dict[str, Any] | None = PAPER_OPTIONS
    if asked.default_options or asked.as_given:
        options = DEFAULT_OPTIONS if asked.default_options else None
    document: dict[str, Any] = {}
    with console.Progress(every_s=0.0) as progress:

        def tell(text: str) -> None:
            progress.show(text, now=True)

        if asked.everything or not (chains or maps or asked.costs):
            document |= _planned(cases, options, reference, tell)
        if asked.everything:
            document["default_options"] = _planned(cases, DEFAULT_OPTIONS, reference, tell)
        for_costs = cases if asked.costs or asked.everything else []
        document |= _sections(for_costs, chains, maps, asked.seed, tell)
    return document


def _planned(
    cases: Sequence[Case], options: dict[str, Any] | None, reference: bool, tell: Callable[[str], None]
) -> dict[str, Any]:
    """Each mission planned, with ``options`` in place of its own unless None; beside the paper's if ``reference``."""
    from api.bench.planner import figures, measure

    results = []
    for number, case in enumerate(cases, start=1):
        tell(f"{number} of {len(cases)}: {case.name}")
        results.append(_guarded(partial(measure, case, options, reference=reference), case.name))
    return figures(results)


def _sections(
    for_costs: Sequence[Case], chains: Sequence[int], maps: Sequence[int], seed: int, tell: Callable[[str], None]
) -> dict[str, Any]:
    from api.bench.planner import measure_costs, routing_row, segments_row

    found: dict[str, Any] = {}
    if chains:
        found["segments"] = []
    for count in chains:
        tell(f"a chain of {count} stations")
        found["segments"].append(_guarded(partial(segments_row, count, seed)))
    if maps:
        found["routing"] = []
    for count in maps:
        tell(f"routing among {count:,} stations")
        found["routing"].append(_guarded(partial(routing_row, count, seed)))
    if for_costs:
        found["costs"] = _guarded(lambda: measure_costs(for_costs, tell=tell))
    return found


# -- what was asked for --------------------------------------------------------------------------------------------


def _counts(where: str, text: str | None, low: int, high: int) -> tuple[int, ...]:
    """Numbers of a comma-separated list. Raises `BadInputError`."""
    if text is None:
        return ()
    parts = [part.strip() for part in text.split(",")]
    if not all(part.isdecimal() and part.isascii() and low <= int(part) <= high for part in parts):
        raise BadInputError(
            "an option has a value it cannot have",
            {"where": where, "value": text, "allowed": f"numbers from {low} to {high}, with commas between"},
        )
    return tuple(int(part) for part in parts)


def _cases(asked: PlannerBenchOptions) -> list[Case]:
    from api.bench.planner import drawn, fixed

    cases = drawn(asked.random, asked.seed) if asked.random else fixed(_documents(asked.missions), quick=asked.quick)
    known = {case.name for case in cases}
    for name in asked.only or []:
        if name not in known:
            raise BadInputError(
                "there is no such mission", {"where": "--only", "value": name, "allowed": ", ".join(sorted(known))}
            )
    return [case for case in cases if not asked.only or case.name in asked.only]


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


def _guarded(work: Callable[[], Any], mission: str = "") -> Any:
    """``work()``, what it raises turned into the command line's blocks."""
    from gcs.errors import GcsError, MissionError, MissionInfeasible
    from planner import InfeasibleError, PlannerError

    name = f"the mission {mission}" if mission else "a mission"
    try:
        return work()
    except MissionError as error:
        raise BadInputError(f"{name} has a fault", *inputs.paragraphs(error)) from None
    except MissionInfeasible as error:
        raise inputs.infeasible(error) from None
    except InfeasibleError as error:
        raise BadInputError(f"{name} has no plan", {"what": str(error)}) from None
    except (GcsError, PlannerError) as error:
        raise FaultError(f"{name} could not be planned", {"what": str(error)}) from None
