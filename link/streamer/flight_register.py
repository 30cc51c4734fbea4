"""Flights that run on this machine, whoever started them: found by every terminal and service, and spoken to.

A file a flight in the state folder (`gcs.settings.default_state_dir`) names its run folder; one whose streamer is gone
is forgotten. `ask` speaks to a streamer without attending its flight, so that looking on changes nothing in it.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import socket
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from gcs.flight import TransitionError
from gcs.settings import default_state_dir
from gcs.timestamps import utc_now_text
from link.errors import SupervisorError
from link.files.change_journal import runs_in, write_durably
from link.session.request import FlightRequest
from link.streamer.control_socket import SOCKET_FILE, connect

REPLY_TIMEOUT_S = 10.0


@dataclass(frozen=True)
class RegisteredFlight:
    """A flight whose streamer runs. ``urls`` are its links."""

    flight_id: str
    run_dir: str
    pid: int
    urls: tuple[str, ...]
    autopilot: str
    plan_sha256: str
    started_utc: str


def register_flight(request: FlightRequest, run_dir: Path, pid: int) -> None:
    """Let others find a flight. Never raises: a flight that cannot be found flies all the same."""
    urls = tuple(dict.fromkeys(url for urls in request.urls.values() for url in urls))
    one = RegisteredFlight(
        request.flight_id,
        str(run_dir.absolute()),
        pid,
        urls,
        request.autopilot,
        request.flown_plan.plan_sha256,
        utc_now_text(),
    )
    folder = _folder()
    with contextlib.suppress(OSError):
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        name = hashlib.sha256(one.run_dir.encode()).hexdigest()[:32]
        write_durably(folder / f"{name}.json", json.dumps(asdict(one)).encode())


def registered_flights() -> list[RegisteredFlight]:
    """The flights whose streamers run, the oldest first."""
    found = []
    for path in _folder().glob("*.json"):
        try:
            document = json.loads(path.read_bytes())
            one = RegisteredFlight(**{**document, "urls": tuple(document["urls"])})
        except (OSError, ValueError, KeyError, TypeError):
            continue
        # As it was named to the streamer: absolute or not.
        if runs_in(one.pid, Path(one.run_dir)):
            found.append(one)
        else:
            with contextlib.suppress(OSError):
                path.unlink()
    return sorted(found, key=lambda one: one.started_utc)


def flight_on(urls: Iterable[str]) -> RegisteredFlight | None:
    """The flight that uses one of these links."""
    wanted = set(urls)
    return next((one for one in registered_flights() if wanted & set(one.urls)), None)


def ask(run_dir: str | Path, question: dict[str, Any]) -> dict[str, Any]:
    """A streamer's answer to one question (`link.streamer.process`), asked without attending its flight.

    Raises `SupervisorError` when it cannot be reached, `TransitionError` when it refuses.
    """
    try:
        with connect(Path(run_dir) / SOCKET_FILE) as connection:
            connection.settimeout(REPLY_TIMEOUT_S)
            connection.sendall(json.dumps({"id": 1, **question}).encode() + b"\n")
            answer = _line(connection)
    except (OSError, ValueError) as error:
        raise SupervisorError(f"the flight in {run_dir} cannot be reached: {error}") from None
    if "error" in answer:
        raise TransitionError(str(answer["error"]))
    return answer


def _line(connection: socket.socket) -> dict[str, Any]:
    buffer = bytearray()
    while b"\n" not in buffer:
        data = connection.recv(1 << 16)
        if not data:
            raise OSError("it closed the connection")
        buffer += data
    answer: dict[str, Any] = json.loads(buffer.split(b"\n")[0])
    return answer


def _folder() -> Path:
    return default_state_dir() / "flights"
