"""``skyrelay bench api``: how fast the service answers, and whether that depends on how much it keeps."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer

from api.processes import QUICK_MISSION

_REQUESTS, _QUICK_REQUESTS = 400, 80
_HISTORIES = (10, 20_000)
_QUICK_HISTORIES = (10, 1_000)


def bench_api(
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
    quick: Annotated[
        bool, typer.Option("--quick", help=f"Fewer requests, and {_QUICK_HISTORIES[1]} missions at most.")
    ] = False,
) -> None:
    """How long a service of its own takes to answer over one connection, with few and with many missions kept.

    Beside a bare socket that answers whatever it hears; milliseconds, the middle one and the worst of a hundred.
    """
    from api.bench import service

    body = json.dumps(QUICK_MISSION).encode()
    figures = {}
    for history in _QUICK_HISTORIES if quick else _HISTORIES:
        with TemporaryDirectory(prefix="skyrelay-bench-") as folder:
            data = Path(folder) / "data"
            requests = _QUICK_REQUESTS if quick else _REQUESTS
            figures[history] = service.measure(data, body, requests=requests, history=history)
    if as_json:
        told = {str(history): [asdict(figure) for figure in found] for history, found in figures.items()}
        typer.echo(json.dumps(told, indent=1, allow_nan=False))
        return
    typer.echo(f"{'request, ms':<26}" + "".join(f"{f'{n} kept: p50':>20}{'p99':>9}" for n in figures))
    for row in zip(*figures.values(), strict=True):
        typer.echo(f"{row[0].name:<26}" + "".join(f"{one.p50_ms:>20.2f}{one.p99_ms:>9.2f}" for one in row))
