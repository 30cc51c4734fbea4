"""Flights of this machine spoken to directly: those of ``skyrelay fly``, and those of a service that does not answer.

Over the streamer's own socket: nothing is sent to the vehicle but what the flight itself sends.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from api.cli.console import Progress
from api.cli.errors import BadInputError, FaultError

if TYPE_CHECKING:
    from gcs.flight import FlightEvent
    from gcs.plan import Plan
    from link.streamer import RegisteredFlight

_ENDS = ("completed", "refused", "contingency", "lost")
COMMANDS = ("hold", "resume", "abort", "land")


def find(flight_id: str | None) -> RegisteredFlight | None:
    """The flight of that id that runs on this machine."""
    from link.streamer import registered_flights

    return next((one for one in registered_flights() if one.flight_id == flight_id), None)


def listed(known: set[str]) -> list[dict[str, Any]]:
    """Flights that run here and are not among ``known`` ids: id, phase, links, run folder."""
    from link.errors import SupervisorError
    from link.streamer import ask, registered_flights

    found = []
    for one in registered_flights():
        if one.flight_id in known:
            continue
        try:
            phase = str(ask(one.run_dir, {"status": True})["status"]["state"])
        except SupervisorError:
            phase = "not answering"
        if phase in _ENDS:
            continue
        found.append({"id": one.flight_id, "phase": phase, "links": list(one.urls), "run_dir": one.run_dir})
    return found


def command(one: RegisteredFlight, word: str, given: Mapping[str, Any]) -> tuple[dict[str, Any], str]:
    """Look at a flight or command it: its status, and that in words. Raises `BadInputError`, `FaultError`."""
    from gcs.flight import TransitionError
    from link.errors import SupervisorError
    from link.streamer import ask

    if word not in ("look", *COMMANDS):
        raise BadInputError(
            f"'{word}' needs a service",
            {
                "where": one.flight_id,
                "what": "it was started by `skyrelay fly`, without one",
                "allowed": ", ".join(("look", "attach", *COMMANDS)),
            },
        )
    try:
        if word != "look":
            ask(one.run_dir, {"word": word, "by": given.get("by") or "terminal", "reason": given.get("reason") or ""})
        status = ask(one.run_dir, {"status": True})["status"]
    except TransitionError as refusal:
        raise BadInputError("the flight refuses", {"where": one.flight_id, "what": str(refusal)}) from None
    except SupervisorError as error:
        raise FaultError("the flight cannot be reached", {"where": one.run_dir, "what": str(error)}) from None
    return status, shown(one, status)


def shown(one: RegisteredFlight, status: Mapping[str, Any]) -> str:
    """A flight now, in a line."""
    from api.cli.commands.flight_view import FlightView

    view = FlightView(_plan(one), Progress())
    return f"flight {one.flight_id}: {view.where(status['t_plus_s'], status['state'], status)}"


def attend(one: RegisteredFlight | None, flight_id: str | None, *, as_json: bool) -> int:
    """Show a flight until it ends; Ctrl-C or a lost terminal leaves it, and it flies on. Its own exit code."""
    from api.cli.commands.flight_view import FlightView
    from api.cli.errors import Terminated
    from link.errors import SupervisorError
    from link.streamer import attach

    if one is None:
        raise BadInputError(
            "no such flight runs on this machine",
            {"where": "FLIGHT", "value": flight_id, "fix": "`skyrelay flight` lists those under way"},
        )
    with Progress() as progress:
        view = FlightView(_plan(one), progress)

        def on_event(event: FlightEvent) -> None:
            view(event)
            if as_json:
                sys.stdout.write(json.dumps(event.to_document(), allow_nan=False) + "\n")
                sys.stdout.flush()

        try:
            flight = attach(Path(one.run_dir), on_event=on_event)
        except SupervisorError as error:
            raise FaultError("the flight cannot be reached", {"what": str(error)}) from None
        try:
            progress.note(f"attending flight {one.flight_id}; Ctrl-C leaves it, and it flies on")
            return flight.wait().exit_code
        except (KeyboardInterrupt, Terminated):
            flight.detach()
            progress.note(f"left; it flies on. Command it with: skyrelay flight {one.flight_id} {'|'.join(COMMANDS)}")
            return 0


def _plan(one: RegisteredFlight) -> Plan:
    from gcs.plan import read_plan

    return read_plan(json.loads((Path(one.run_dir) / "request.json").read_bytes())["plan"])
