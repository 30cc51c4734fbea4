"""``skyrelay doctor``: is this machine fit to plan, serve and fly? Ports, clock, dialect, store, optional parts.

With ``--vehicle``: is a vehicle fit to fly? See `api.cli.doctor.vehicle`.
"""

from __future__ import annotations

import ctypes
import importlib
import importlib.util
import json
import os
import shutil
import socket
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import Annotated, Literal

import typer

from api.cli import inputs
from api.cli.errors import EXIT_FAULT
from gcs.timestamps import utc_for_people

Level = Literal["ok", "note", "warning", "failure"]

# Where autopilots and their simulators usually talk, and where the service listens.
_UDP_PORTS = {14540: "PX4's simulator sends here", 14550: "most autopilots and ground stations meet here"}
_SERVICE_PORT = 8000
_OPTIONAL = {
    "cvxpy": "skyrelay bench planner: the paper's method beside ours",
    "nlopt": "skyrelay bench planner: the paper's rivals",
    "matplotlib": "figures",
    "mavsdk": "skyrelay doctor --vehicle: an independent MAVLink client",
}
_TIME_ERROR = 5  # adjtimex(2): the clock is not synchronised
_MIN_FREE_BYTES = 500 * 1024 * 1024


@dataclass(frozen=True)
class Finding:
    """One check: its name, how it went, what was seen, what to do."""

    check: str
    level: Level
    found: str
    fix: str = ""


def register(app: typer.Typer, panel: str) -> None:
    """Add the command."""
    app.command("doctor", rich_help_panel=panel)(doctor)


def doctor(
    vehicle: Annotated[
        str | None,
        typer.Option(
            metavar="URL",
            help="Look at a vehicle instead: who it is, and whether its parameters are fit for a flight. "
            "udpout:HOST:PORT, udpin:HOST:PORT, tcp:HOST:PORT or serial:DEVICE:BAUD; needs MAVSDK.",
        ),
    ] = None,
    system_id: Annotated[
        int, typer.Option(min=1, max=254, help="Ask the vehicle as this station (one that it hears).")
    ] = 245,
    timeout: Annotated[float, typer.Option(min=1.0, max=600.0, help="Seconds to wait for the vehicle.")] = 15.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print the findings as JSON.")] = False,
) -> int:
    """Check this machine: ports, clock, MAVLink dialect, store, optional parts. Or a vehicle, before a flight.

    Ends with 0 unless something [bold]must[/bold] be mended before skyrelay can work (then 1). With --vehicle: 0 when
    it is fit for a flight, 4 when a preflight would refuse it, 2 when the link cannot be used or nobody answers.
    """
    if vehicle is not None:
        from api.cli.doctor.vehicle import examine as examine_vehicle

        return examine_vehicle(vehicle, system_id=system_id, timeout_s=timeout, as_json=as_json)
    findings = list(examine())
    if as_json:
        typer.echo(json.dumps({"findings": [asdict(f) for f in findings]}, indent=2))
    else:
        _print(findings)
    return EXIT_FAULT if any(f.level == "failure" for f in findings) else 0


def examine() -> Iterator[Finding]:
    """All findings, in the order shown. A check that breaks is itself a finding."""
    checks: list[Callable[[], Iterator[Finding]]] = [
        _python,
        _solvers,
        _dialect,
        _clock,
        _ticks,
        _ports,
        _store,
        _optional,
    ]
    for check in checks:
        try:
            yield from check()
        except Exception as error:
            name = check.__name__.strip("_")
            yield Finding(name, "failure", f"{type(error).__name__}: {error}", "reinstall skyrelay (`make setup`)")


def _python() -> Iterator[Finding]:
    from importlib.metadata import version

    text = ".".join(map(str, sys.version_info[:3]))
    yield Finding("program", "ok", f"skyrelay {version('skyrelay')}, Python {text}, {os.cpu_count()} processors")


def _solvers() -> Iterator[Finding]:
    for name in ("numpy", "scipy", "clarabel"):
        importlib.import_module(name)
    import clarabel

    yield Finding("solvers", "ok", f"Clarabel {clarabel.__version__}, and the planner's own")


def _dialect() -> Iterator[Finding]:
    from link.dialect import mavlink

    missing = [
        name
        for name in ("MAVLink_control_status_message", "MAVLink_set_position_target_global_int_message")
        if not hasattr(mavlink, name)
    ]
    if missing or not hasattr(mavlink, "MAV_CMD_REQUEST_OPERATOR_CONTROL"):
        yield Finding(
            "dialect", "failure", f"lacks {missing or ['command 32100']}", "reinstall skyrelay (`make setup`)"
        )
        return
    crc = mavlink.MAVLink_control_status_message.crc_extra
    yield Finding(
        "dialect", "ok", f"MAVLink {mavlink.WIRE_PROTOCOL_VERSION} with operator control (message 512, CRC extra {crc})"
    )


def _clock() -> Iterator[Finding]:
    if sys.platform != "linux":
        yield Finding("clock", "note", "synchronisation cannot be read on this system", "make sure it follows NTP")
        return
    # struct timex, modes = 0: a read; the return value is the clock's state. 512 bytes is more than it needs.
    state = ctypes.CDLL(None).adjtimex(ctypes.create_string_buffer(512))
    now = utc_for_people(datetime.now(UTC))
    if state == _TIME_ERROR or state < 0:
        yield Finding(
            "clock",
            "warning",
            f"{now}, not synchronised: handover times in UTC will be off by as much as it is",
            "turn on NTP (systemd-timesyncd, chrony) before people act on UTC times",
        )
    else:
        yield Finding("clock", "ok", f"{now}, synchronised")


def _ticks() -> Iterator[Finding]:
    period_s, late_ms = 0.02, []
    start = time.monotonic()
    for tick in range(1, 26):
        due = start + tick * period_s
        time.sleep(max(0.0, due - time.monotonic()))
        late_ms.append((time.monotonic() - due) * 1e3)
    worst = max(late_ms)
    text = f"25 ticks at 50 Hz, the latest {worst:.1f} ms late"
    if worst > 50.0:
        yield Finding("timing", "warning", text, "free a processor before a flight: PX4 gives up after 1 s of silence")
    else:
        yield Finding("timing", "ok", text)


def _ports() -> Iterator[Finding]:
    for port, use in _UDP_PORTS.items():
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            yield _bind(
                probe,
                "0.0.0.0",
                port,
                f"UDP {port}",
                use,
                "another ground station or router has it: close it, "
                "or give `fly` another port with --link udpin:0.0.0.0:PORT",
            )
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        yield _bind(
            probe,
            "127.0.0.1",
            _SERVICE_PORT,
            f"TCP {_SERVICE_PORT}",
            "skyrelay serve listens here",
            "`skyrelay serve --port 0` finds a free one",
        )


def _bind(probe: socket.socket, host: str, port: int, name: str, use: str, fix: str) -> Finding:
    try:
        probe.bind((host, port))
    except OSError as error:
        return Finding(name, "warning", f"{error.strerror} ({use})", fix)
    return Finding(name, "ok", f"free ({use})")


def _store() -> Iterator[Finding]:
    directory = inputs.settings().data_dir
    place = directory
    while not place.exists() and place.parent != place:
        place = place.parent
    try:
        with tempfile.TemporaryFile(dir=place):
            pass
    except OSError as error:
        yield Finding("store", "failure", f"{directory}: {error.strerror}", "set SKYRELAY_DATA_DIR to a writable place")
        return
    free = shutil.disk_usage(place).free
    text = f"{directory}, {free / 2**30:.1f} GiB free"
    if free < _MIN_FREE_BYTES:
        yield Finding("store", "warning", text, "free some space: logs of a flight need it")
    else:
        yield Finding("store", "ok", text)


def _optional() -> Iterator[Finding]:
    for name, use in _OPTIONAL.items():
        if importlib.util.find_spec(name) is None:
            yield Finding(name, "note", f"not installed ({use})", f"pip install {name}")
        else:
            yield Finding(name, "ok", f"installed ({use})")


def _print(findings: list[Finding]) -> None:
    from rich.table import Table
    from rich.text import Text

    from api.cli import console

    colours = {"ok": "green", "note": "cyan", "warning": "yellow", "failure": "red"}
    table = Table(box=None, pad_edge=False, show_header=False)
    for finding in findings:
        body = finding.found + (f"\n→ {finding.fix}" if finding.fix else "")
        table.add_row(Text(finding.level, style=colours[finding.level]), finding.check, Text(body))
    console.out().print(table)
