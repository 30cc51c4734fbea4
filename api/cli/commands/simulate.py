"""``skyrelay simulate``: the simulated autopilot, which is a program of its own."""

from __future__ import annotations

import os
import sys
from typing import NoReturn

import typer

from api.processes import python_module


def register(app: typer.Typer, panel: str) -> None:
    """Add the command."""
    app.command(
        "simulate",
        rich_help_panel=panel,
        add_help_option=False,
        context_settings={"ignore_unknown_options": True, "allow_extra_args": True, "help_option_names": []},
    )(simulate)


def simulate(context: typer.Context) -> NoReturn:
    """Run the simulated autopilot (PX4 or ArduPilot) as a program of its own; --help lists its options.

    For example: skyrelay simulate --autopilot px4 --listen udpin:127.0.0.1:14540
    """
    # It becomes that program: signals, output and exit code are its own, and nothing stays between.
    sys.stdout.flush()
    command = python_module("sitl_fixtures", *context.args)
    os.execv(command[0], command)
