"""The command line, a file a command group. `main` is the ``skyrelay`` command.

Commands import what they need when they run, so that ``--help`` answers at once.
"""

from __future__ import annotations

import contextlib
import errno
import os
import signal
import sys
from types import FrameType
from typing import Annotated, Any, NoReturn

import typer

from api.cli.bench import command as bench_command
from api.cli.commands import backup, flight, fly, handovers, plan, report, serve, setpoints, simulate, vehicle
from api.cli.demo import command as demo_command
from api.cli.doctor import machine as doctor_command
from api.cli.errors import (
    EXIT_BAD_INPUT,
    EXIT_FAULT,
    EXIT_INTERRUPTED,
    EXIT_OK,
    CommandError,
    FaultError,
    Terminated,
)
from api.processes import ChildError

__all__ = ["main"]

# The base of every complaint about options and arguments; the library has no public name for it.
_USAGE_ERRORS: Any = tuple(c for c in typer.BadParameter.__mro__ if c.__name__ == "ClickException")

app = typer.Typer(
    name="skyrelay",
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="Start with [bold]skyrelay demo[/bold]: the whole story without hardware. "
    "Exit codes: 0 done, 2 bad input, 3 infeasible, 4 the flight ended in a contingency procedure, 1 a fault of ours.",
)


def _show_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        typer.echo(f"skyrelay {version('skyrelay')}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Missions relayed from ground station to ground station: planned, proved, scheduled, streamed, flown."""


for _panel, _module in (
    ("Plan", plan),
    ("Plan", handovers),
    ("Plan", setpoints),
    ("Fly", fly),
    ("Fly", flight),
    ("Fly", simulate),
    ("Fly", report),
    ("Fly", vehicle),
    ("Run", demo_command),
    ("Run", serve),
    ("Run", backup),
    ("Check", bench_command),
    ("Check", doctor_command),
):
    _module.register(app, _panel)


def _on_signal(number: int, _frame: FrameType | None) -> NoReturn:
    raise Terminated(number)


def main(arguments: list[str] | None = None) -> NoReturn:
    """Run one command and end the process with its exit code."""
    # A shell's background jobs start with SIGINT ignored; `kill -INT` is to end them all the same.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _on_signal)
    code = EXIT_FAULT
    try:
        result = app(args=arguments, standalone_mode=False, prog_name="skyrelay")
        code = result if isinstance(result, int) else EXIT_OK
        sys.stdout.flush()
    except CommandError as error:
        _complain(error.block())
        code = error.exit_code
    except ChildError as error:
        _complain(FaultError(error.what, error.details).block())
    except _USAGE_ERRORS as error:
        _complain(_usage_block(error))
        code = EXIT_BAD_INPUT
    except (KeyboardInterrupt, typer.Abort):
        code = EXIT_INTERRUPTED
    except Terminated as ending:
        code = 128 + ending.signal_number
    except OSError as error:
        if error.errno == errno.EPIPE:
            # The reader of our output went away (`| head`): nothing is wrong, and nobody is there to be told.
            code = 128 + signal.SIGPIPE
        elif error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
            _complain(f"error: the output could not be written\n  what:     {error.strerror}")
        else:
            _complain(_fault_block(error))
    except Exception as error:
        _complain(_fault_block(error))
    _leave(code)


def _leave(code: int) -> NoReturn:
    # Flushing a broken pipe at interpreter exit would print a traceback; point what is left to nowhere.
    try:
        sys.stdout.flush()
    except (OSError, ValueError):
        with contextlib.suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    sys.exit(code)


def _complain(block: str) -> None:
    with contextlib.suppress(OSError):
        if sys.stderr.isatty() and "NO_COLOR" not in os.environ:
            block = block.replace("error:", "\x1b[1;31merror:\x1b[0m", 1)
        sys.stderr.write(block + "\n")
        sys.stderr.flush()


def _usage_block(error: Any) -> str:
    context = getattr(error, "ctx", None)
    if type(error).__name__ == "NoArgsIsHelpError" and context is not None:
        return str(context.get_help())
    message = error.format_message().strip()
    command = context.command_path if context is not None else "skyrelay"
    text = message[:1].lower() + message[1:]
    return f"error: {text}\n  fix:      `{command} --help` lists what it takes"


def _fault_block(error: BaseException) -> str:
    if os.environ.get("SKYRELAY_TRACEBACK"):
        import traceback

        traceback.print_exception(error)
    text = f"{type(error).__name__}: {error}".strip()
    return (
        "error: a fault of ours, not of your input\n"
        f"  what:     {text[:2000]}\n"
        "  fix:      please report it with the output of the same command under SKYRELAY_TRACEBACK=1"
    )
