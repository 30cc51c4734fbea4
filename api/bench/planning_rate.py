"""How many missions a second a service plans, and how soon the first: measured from outside, over REST.

The service runs as a process of its own, its workers (PostgreSQL) too; time runs from the first mission sent to the
last one planned.
"""

from __future__ import annotations

import contextlib
import http.client
import json
import os
import socket
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from api.processes import Child, python_module

_LIMIT_S = 300.0


@dataclass(frozen=True)
class PlanningRate:
    """``first_s`` is from sending a mission to a warm, idle service to its plan; ``warm_s`` from start to readiness."""

    planners: str
    missions: int
    missions_per_s: float
    first_s: float
    warm_s: float


def measure(
    folder: Path, mission: bytes, *, planners: int, missions: int, database_url: str | None = None, workers: int = 0
) -> PlanningRate:
    """Plan ``mission`` ``missions`` times by ``planners`` processes of the service itself, or by those of each of
    ``workers`` programs beside it (PostgreSQL).

    Raises ``TimeoutError`` when the service does not start or plan, ``RuntimeError`` for an answer nobody expects.
    """
    began = time.monotonic()
    with _running(folder, planners, database_url, workers) as port:
        with closing(http.client.HTTPConnection("127.0.0.1", port, timeout=60)) as connection:
            _until(lambda: _ask(connection, "GET", "/readyz")[0] == 200)
            warm_s = time.monotonic() - began
            if workers:
                _plan(connection, mission, 2 * workers)  # until the workers are warm too
            first_s = min(_plan(connection, mission, 1) for _ in range(5))
            took_s = _plan(connection, mission, missions)
    named = f"{workers} x {planners} worker" if workers else f"{planners} of the service"
    return PlanningRate(named, missions, missions / took_s, first_s, warm_s)


def _plan(connection: http.client.HTTPConnection, mission: bytes, count: int) -> float:
    """Seconds from sending ``count`` missions to their plans."""
    began = time.monotonic()
    ids = []
    for _ in range(count):
        status, body = _ask(connection, "POST", "/v1/missions", mission)
        if status != 201:
            raise RuntimeError(f"POST /v1/missions: {status} {body}")
        ids.append(body["id"])
    # In the order they came; the last ones looked at are the last ones planned.
    for mission_id in ids:
        _until(lambda mission_id=mission_id: _ended(connection, mission_id))  # type: ignore[misc]
    return time.monotonic() - began


def _ended(connection: http.client.HTTPConnection, mission_id: str) -> bool:
    status = _ask(connection, "GET", f"/v1/missions/{mission_id}")[1]["status"]
    if status in ("failed", "infeasible"):
        raise RuntimeError(f"mission {mission_id} is {status}")
    return bool(status == "planned")


def _ask(connection: http.client.HTTPConnection, method: str, path: str, body: bytes | None = None) -> tuple[int, Any]:
    try:
        connection.request(method, path, body, {"Content-Type": "application/json"} if body else {})
        answer = connection.getresponse()
        return answer.status, json.loads(answer.read())
    except OSError:
        connection.close()
        return 0, None


def _until(what: Any) -> None:
    until = time.monotonic() + _LIMIT_S
    while not what():
        if time.monotonic() > until:
            raise TimeoutError(f"waited {_LIMIT_S:.0f} s for the service in vain")
        time.sleep(0.005)


@contextlib.contextmanager
def _running(folder: Path, planners: int, database_url: str | None, workers: int) -> Iterator[int]:
    """A service and its workers for the time of a block; the service's port."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port: int = free.getsockname()[1]
    environment = {**os.environ, "SKYRELAY_PLANNER_PROCESSES": str(0 if workers else planners)}
    if database_url is not None:
        environment["SKYRELAY_DATABASE_URL"] = database_url
    with contextlib.ExitStack() as stack:
        command = python_module("api.cli", "serve", "--port", str(port), "--data", str(folder), "--log-level", "error")
        stack.callback(Child("service", command, env=environment).stop)
        for number in range(workers):
            command = python_module("api.cli", "worker", "--processes", str(planners), "--log-level", "error")
            stack.callback(Child(f"worker {number}", command, env=environment).stop)
        yield port
