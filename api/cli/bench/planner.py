"""``skyrelay bench planner``: missions planned with this planner and with the paper's method."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from api.cli import console, inputs
from api.cli.errors import BadInputError, FaultError

if TYPE_CHECKING:
    from api.bench.planner.cases import Case

_MISSIONS, _WHAT, _PAPER = "Which missions", "What is measured", "The seed paper's experiments"


def bench_planner(
    missions: Annotated[
        str | None,
        typer.Option(
            metavar="DIR",
            rich_help_panel=_MISSIONS,
            help="Missions (*.json) to plan; default: the 30 drawn as in the paper's Table 2.",
        ),
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", rich_help_panel=_MISSIONS, help="One mission of each size.")
    ] = False,
    only: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME", rich_help_panel=_MISSIONS, help="Only this mission, e.g. [bold]M30_01[/bold]; repeatable."
        ),
    ] = None,
    random: Annotated[
        int,
        typer.Option(
            min=0, max=1000, metavar="K", rich_help_panel=_MISSIONS, help="Draw K new missions of each size instead."
        ),
    ] = 0,
    seed: Annotated[
        int, typer.Option(min=0, metavar="N", rich_help_panel=_MISSIONS, help="What every draw starts from.")
    ] = 1,
    as_given: Annotated[
        bool,
        typer.Option(
            "--as-given",
            rich_help_panel=_MISSIONS,
            help="Keep each mission's own options instead of the paper's (no overlap, no margin, no tenure).",
        ),
    ] = False,
    default_options: Annotated[
        bool,
        typer.Option(
            "--default-options",
            rich_help_panel=_MISSIONS,
            help="Plan with the overlap, margin and tenure a mission gets that asks for nothing.",
        ),
    ] = False,
    ours_only: Annotated[
        bool,
        typer.Option("--ours-only", rich_help_panel=_WHAT, help="Without the paper's method, for many missions."),
    ] = False,
    segments: Annotated[
        str | None,
        typer.Option(
            metavar="N,N", rich_help_panel=_WHAT, help="Instead: chains of so many stations, e.g. [bold]100,175[/bold]."
        ),
    ] = None,
    routing: Annotated[
        str | None,
        typer.Option(
            metavar="M,M",
            rich_help_panel=_WHAT,
            help="Instead: routing on maps of so many stations, e.g. [bold]1000,10000,100000[/bold].",
        ),
    ] = None,
    costs: Annotated[
        bool,
        typer.Option(
            "--costs", rich_help_panel=_WHAT, help="Instead: what each option and limit costs in seconds of flight."
        ),
    ] = False,
    everything: Annotated[
        bool,
        typer.Option("--all", rich_help_panel=_WHAT, help="All of the above, one after the other; about ten minutes."),
    ] = False,
    paper: Annotated[
        bool,
        typer.Option(
            "--paper",
            rich_help_panel=_PAPER,
            help="Instead: the paper's Tables 3 and 4 beside this planner; an hour for all 30.",
        ),
    ] = False,
    time_limit: Annotated[
        float | None,
        typer.Option("--time-limit", metavar="S", rich_help_panel=_PAPER, help="Seconds for EM on a mission [60]."),
    ] = None,
    rival_limit: Annotated[
        float | None,
        typer.Option(
            "--rival-limit", metavar="S", rich_help_panel=_PAPER, help="Seconds for each method of Table 4 [3]."
        ),
    ] = None,
    results: Annotated[
        str | None,
        typer.Option(
            metavar="FILE",
            rich_help_panel=_PAPER,
            help="Keep every measurement there, and go on from what is there already.",
        ),
    ] = None,
    redo: Annotated[
        list[str] | None,
        typer.Option(
            metavar="WHAT",
            rich_help_panel=_PAPER,
            help="Measure again in spite of --results: [bold]ours[/bold] (with DC beside it), "
            "[bold]enumeration[/bold] or [bold]rivals[/bold]; repeatable.",
        ),
    ] = None,
    kept_only: Annotated[
        bool,
        typer.Option(
            "--kept-only",
            rich_help_panel=_PAPER,
            help="Show what --results holds so far; measure nothing but what --redo names.",
        ),
    ] = False,
    figures: Annotated[
        str | None,
        typer.Option(
            metavar="DIR",
            rich_help_panel=_PAPER,
            help="Draw figures like the paper's 9 to 14 there, and write the tables as a page.",
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
) -> None:
    """Plan missions with this planner and with the paper's method (through plain cvxpy), one after the other.

    Shows mission times against the bound that nothing can beat, processor times, and their ratios. By default every
    mission is planned under the paper's own problem: no minimum overlap, no range margin, no minimum tenure.
    Ends with 1 when a mission that has a plan got none.
    """
    _check_combinations(locals())
    from api.bench.planner import cases as bench_cases
    from api.bench.planner import compare as bench_of
    from api.bench.planner.scale import SEGMENTS, STATIONS

    options: dict[str, Any] | None = bench_cases.PAPER_OPTIONS
    if default_options or as_given:
        options = bench_cases.DEFAULT_OPTIONS if default_options else None
    chains = _counts("--segments", segments, 2, 1000) or (SEGMENTS if everything else ())
    maps = _counts("--routing", routing, 2, 1_000_000) or (STATIONS if everything else ())
    chosen = [] if (chains or maps) and not everything and not costs else _cases(missions, quick, only, random, seed)
    if paper:
        from api.cli.bench.paper import run_paper, settings_of

        run_paper(
            chosen,
            settings_of(time_limit, rival_limit),
            results_file=results,
            figures_directory=figures,
            redo=redo or [],
            kept_only=kept_only,
            as_json=as_json,
            guarded=_guarded,
        )
        return
    if not ours_only and not bench_of.reference_available():
        raise BadInputError(
            "the reference is not installed",
            {"what": "the paper's method runs through cvxpy", "fix": "pip install 'skyrelay[bench]', or --ours-only"},
        )
    bench_of.warm_up(reference=not ours_only)
    document: dict[str, Any] = {}
    with console.Progress(every_s=0.0) as progress:

        def tell(text: str) -> None:
            progress.show(text, now=True)

        def plain(options: dict[str, Any] | None) -> dict[str, Any]:
            measured = []
            for number, case in enumerate(chosen, start=1):
                tell(f"{number} of {len(chosen)}: {case.name}")
                measured.append(_guarded(partial(bench_of.measure, case, options, reference=not ours_only), case.name))
            return bench_of.figures(measured)

        if everything or not (chains or maps or costs):
            document |= plain(options)
        if everything:
            document["default_options"] = plain(bench_cases.DEFAULT_OPTIONS)
        document |= _sections(chosen if costs or everything else [], chains, maps, seed, tell)
    if as_json:
        typer.echo(json.dumps(document, indent=1, allow_nan=False))
    else:
        from api.cli.bench.tables import print_planner

        print_planner(document)
    planned = [*document.get("missions", []), *document.get("default_options", {}).get("missions", [])]
    if any(row["failed"] for row in planned):
        raise typer.Exit(1)


def _sections(
    for_costs: Sequence[Case], chains: Sequence[int], maps: Sequence[int], seed: int, tell: Callable[[str], None]
) -> dict[str, Any]:
    from api.bench.planner.costs import measure_costs
    from api.bench.planner.scale import routing_row, segments_row

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


def _check_combinations(given: dict[str, Any]) -> None:
    """Refuse options that say two things at once, or nothing where they stand."""
    names = {
        "--missions": "missions",
        "--random": "random",
        "--quick": "quick",
        "--as-given": "as_given",
        "--default-options": "default_options",
        "--ours-only": "ours_only",
        "--segments": "segments",
        "--routing": "routing",
        "--costs": "costs",
        "--all": "everything",
        "--paper": "paper",
        "--time-limit": "time_limit",
        "--rival-limit": "rival_limit",
        "--results": "results",
        "--redo": "redo",
        "--kept-only": "kept_only",
        "--figures": "figures",
    }
    said = {option for option, name in names.items() if given[name] not in (None, False, 0, [])}
    of_paper = ("--time-limit", "--rival-limit", "--results", "--redo", "--kept-only", "--figures")
    for option in of_paper:
        if given[names[option]] not in (None, False) and "--paper" not in said:
            raise BadInputError(f"{option} goes with --paper", {"where": option, "fix": "add --paper, or leave it out"})
    clashes = [
        ("--missions", ("--random",)),
        ("--quick", ("--random",)),
        ("--as-given", ("--default-options", "--all", "--paper", "--costs", "--segments", "--routing")),
        ("--default-options", ("--all", "--paper", "--costs", "--segments", "--routing")),
        ("--paper", ("--all", "--costs", "--segments", "--routing", "--ours-only")),
        ("--ours-only", ("--costs", "--segments", "--routing")),
    ]
    for one, others in clashes:
        for other in others:
            if one in said and other in said:
                raise BadInputError(f"{one} and {other} do not go together", {"fix": "leave one of them out"})


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


def _cases(missions: str | None, quick: bool, only: list[str] | None, random: int, seed: int) -> list[Case]:
    from api.bench.planner.cases import drawn, fixed

    cases = drawn(random, seed) if random else fixed(_documents(missions), quick=quick)
    known = {case.name for case in cases}
    for name in only or []:
        if name not in known:
            raise BadInputError(
                "there is no such mission", {"where": "--only", "value": name, "allowed": ", ".join(sorted(known))}
            )
    return [case for case in cases if not only or case.name in only]


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
