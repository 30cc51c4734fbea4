"""The service measured from outside: keep-alive reads, submits, and pages of a long history, beside a bare server.

The service runs as a process of its own on a folder of its own; the history is copied into its database beforehand from
one planned mission, as that many missions sent one by one would have left it.
"""

from __future__ import annotations

import http.client
import json
import os
import socket
import sqlite3
import statistics
import threading
import time
import uuid
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from api.processes import Child, python_module

_START_S, _PLAN_S = 60.0, 120.0
_TABLES = ("missions", "mission_versions")
# Each row of a table has a number of its own, and these repeat the mission's.
_REPEATED = ("listed_number", "latest_number")


@dataclass(frozen=True)
class Figure:
    """Times of one kind of request, milliseconds: the middle one and the worst of a hundred."""

    name: str
    requests: int
    p50_ms: float
    p99_ms: float


def measure(folder: Path, mission: bytes, *, requests: int, history: int) -> list[Figure]:
    """Figures of a service on ``folder`` that holds ``history`` planned missions; ``mission`` is sent again and again.

    Raises `api.processes.ChildError` when the service does not start, ``TimeoutError`` when it does not plan.
    """
    with _service(folder) as port:
        first = _planned(port, mission)
    _copy(folder / "skyrelay.db", first, history)
    figures = [_bare(requests)]
    with _service(folder) as port:
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
        with closing(connection):
            figures += [
                _times("read a mission", requests, lambda _: _get(connection, f"/v1/missions/{first}")),
                _times("health", requests, lambda _: _get(connection, "/healthz")),
                _times("first page of 50, cold", 1, lambda _: _get(connection, "/v1/missions?limit=50")),
                _times("first page of 50", requests // 4, lambda _: _get(connection, "/v1/missions?limit=50")),
                _times("first page of 200", requests // 10, lambda _: _get(connection, "/v1/missions?limit=200")),
                _times("a status nobody has", requests // 4, lambda _: _get(connection, "/v1/missions?status=failed")),
                _walk(connection),
                _times("submit", requests // 4, lambda _: _post(connection, mission)),
            ]
    return figures


def _times(name: str, count: int, call: Callable[[int], object]) -> Figure:
    taken = []
    for k in range(max(1, count)):
        began = time.perf_counter()
        call(k)
        taken.append((time.perf_counter() - began) * 1e3)
    taken.sort()
    return Figure(name, len(taken), statistics.median(taken), taken[min(len(taken) - 1, len(taken) * 99 // 100)])


def _walk(connection: http.client.HTTPConnection) -> Figure:
    """Every page of 200 to the end of the history."""
    taken, path = [], "/v1/missions?limit=200"
    while True:
        began = time.perf_counter()
        page = _get(connection, path)
        taken.append((time.perf_counter() - began) * 1e3)
        if page["next"] is None:
            break
        path = f"/v1/missions?limit=200&cursor={page['next']}"
    return Figure("all pages of 200", len(taken), statistics.median(taken), max(taken))


def _bare(requests: int) -> Figure:
    """The reference: a socket that answers whatever it hears, in this process."""
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def answer() -> None:
            peer, _ = listener.accept()
            with peer:
                peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                while peer.recv(4096):
                    peer.sendall(b"HTTP/1.1 200 OK\r\ncontent-length: 2\r\n\r\n{}")

        thread = threading.Thread(target=answer, daemon=True)
        thread.start()
        with closing(http.client.HTTPConnection("127.0.0.1", listener.getsockname()[1], timeout=60)) as connection:
            figure = _times("bare socket (reference)", requests, lambda _: _get(connection, "/"))
        thread.join(5)
    return figure


def _get(connection: http.client.HTTPConnection, path: str) -> Any:
    connection.request("GET", path)
    answer = connection.getresponse()
    body = answer.read()
    if answer.status != 200:
        raise RuntimeError(f"GET {path}: {answer.status} {body[:300]!r}")
    return json.loads(body)


def _post(connection: http.client.HTTPConnection, mission: bytes) -> Any:
    connection.request("POST", "/v1/missions", mission, {"Content-Type": "application/json"})
    answer = connection.getresponse()
    body = answer.read()
    if answer.status not in (201, 429, 503):
        raise RuntimeError(f"POST: {answer.status} {body[:300]!r}")
    return json.loads(body)


class _service:  # noqa: N801 - reads as what it gives
    """``skyrelay serve`` on ``folder`` for the time of a block, which is given its port."""

    def __init__(self, folder: Path) -> None:
        with socket.create_server(("127.0.0.1", 0)) as free:
            self._port: int = free.getsockname()[1]
        command = python_module("api.cli", "serve", "--port", str(self._port), "--data", str(folder))
        self._child = Child("service", [*command, "--log-level", "error"], env=dict(os.environ))

    def __enter__(self) -> int:
        until = time.monotonic() + _START_S
        while True:
            try:
                with closing(http.client.HTTPConnection("127.0.0.1", self._port, timeout=5)) as connection:
                    _get(connection, "/readyz")
                return self._port
            except (OSError, RuntimeError):
                if time.monotonic() > until:
                    self._child.stop()
                    raise TimeoutError(f"the service did not start: {self._child.output()[-500:]}") from None
                time.sleep(0.1)

    def __exit__(self, *_: object) -> None:
        self._child.stop()


def _planned(port: int, mission: bytes) -> str:
    """A mission sent and planned; its id."""
    with closing(http.client.HTTPConnection("127.0.0.1", port, timeout=60)) as connection:
        mission_id = str(_post(connection, mission)["id"])
        until = time.monotonic() + _PLAN_S
        while _get(connection, f"/v1/missions/{mission_id}")["status"] != "planned":
            if time.monotonic() > until:
                raise TimeoutError(f"mission {mission_id} was not planned in {_PLAN_S:.0f} s")
            time.sleep(0.05)
    return mission_id


def _copy(path: Path, mission_id: str, count: int) -> None:
    """``count`` more missions like one that is there."""
    with closing(sqlite3.connect(path)) as database, database:
        highest = database.execute("SELECT max(number) FROM missions").fetchone()[0]
        ids = [(uuid.uuid4().hex, highest + 1 + k, mission_id) for k in range(count)]
        for table, key in zip(_TABLES, ("id", "mission_id"), strict=True):
            columns = [row[1] for row in database.execute(f"PRAGMA table_info({table})")]
            values = {"number": "NULL", key: "?1", **dict.fromkeys(_REPEATED, "?2")}
            if table == "missions":
                values["number"] = "?2"
            else:
                values["plan_sha256"] = "?1 || ?1"  # so that nothing kept by a plan's hash serves them all
            chosen = ", ".join(values.get(name, name) for name in columns)
            database.executemany(
                f"INSERT INTO {table} ({', '.join(columns)}) "
                f"SELECT {chosen} FROM {table} WHERE {key} = ?3 AND ?1 <> '' AND ?2 > 0",
                ids,
            )
