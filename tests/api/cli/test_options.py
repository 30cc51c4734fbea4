"""A command's options as one object: typer is shown a parameter for each field."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import pytest
import typer
from typer.testing import CliRunner

from api.cli.options import command_of


@dataclass(frozen=True)
class Wanted:
    name: Annotated[str, typer.Argument(metavar="NAME")]
    count: Annotated[int, typer.Option("--count", min=1, help="How many.")] = 2
    also: Annotated[list[str] | None, typer.Option("--also")] = None


@pytest.mark.parametrize(
    ("arguments", "wanted"),
    [
        (["x"], Wanted("x", 2, None)),
        (["x", "--count", "3", "--also", "a", "--also", "b"], Wanted("x", 3, ["a", "b"])),
    ],
)
def test_fields_are_parameters_with_their_defaults(arguments: list[str], wanted: Wanted) -> None:
    got: list[Wanted] = []

    def run(given: Wanted) -> None:
        """What it does."""
        got.append(given)

    app = typer.Typer()
    app.command()(command_of(Wanted, run))
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    assert got == [wanted]
    help_text = CliRunner().invoke(app, ["--help"]).output
    assert "What it does." in help_text
    assert "How many." in help_text
    assert CliRunner().invoke(app, []).exit_code == 2
    assert CliRunner().invoke(app, ["x", "--count", "0"]).exit_code == 2
