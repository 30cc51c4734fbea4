"""``skyrelay serve`` as a process: its port, its end, what it leaves behind."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import sqlite3
import threading
import time
from pathlib import Path

import httpx
import pytest

from tests.support.missions.malformed import GOOD
from tests.support.processes.cli_process import Server, run_process
from tests.support.processes.tree import descendants, gone


@pytest.mark.slow
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 0)])
def test_it_ends_when_asked_and_leaves_no_process(tmp_path: Path, number: int, code: int) -> None:
    server = Server(tmp_path / "data")
    with httpx.Client(base_url=server.address) as client:
        while client.get("/readyz").status_code != 200:
            time.sleep(0.05)
    workers = descendants(server.process.pid)
    assert workers
    assert server.stop(number) == code
    assert gone(workers)


@pytest.mark.slow
def test_it_ends_in_time_with_a_watcher_and_a_half_sent_request(tmp_path: Path) -> None:
    server = Server(tmp_path / "data", "--log-level", "debug")
    heard: list[bytes] = []
    with httpx.Client(base_url=server.address, timeout=60) as client:
        # Planners are not warm yet, so that this mission is still being watched when the service ends.
        mission = client.post("/v1/missions", json=GOOD).json()

        def watch() -> None:
            with contextlib.suppress(httpx.HTTPError):
                heard.append(client.get(f"/v1/missions/{mission['id']}/events").content)

        watcher = threading.Thread(target=watch)
        watcher.start()
        host, port = server.address.removeprefix("http://").split(":")
        half = socket.create_connection((host, int(port)))
        half.sendall(b"POST /v1/missions HTTP/1.1\r\nHost: localhost\r\nContent-Length: 1000\r\n\r\n{")
        time.sleep(0.3)
        started = time.monotonic()
        assert server.stop(signal.SIGTERM) == 0
        assert time.monotonic() - started < 25
        watcher.join(10)
        half.close()


@pytest.mark.slow
def test_workers_end_when_the_service_is_killed_outright(tmp_path: Path) -> None:
    server = Server(tmp_path / "data")
    with httpx.Client(base_url=server.address) as client:
        while client.get("/readyz").status_code != 200:
            time.sleep(0.05)
    workers = descendants(server.process.pid)
    server.process.kill()
    server.process.wait()
    assert gone(workers, 10.0)
    server.stop()


@pytest.mark.slow
def test_what_was_answered_survives_a_kill_and_is_planned_afterwards(tmp_path: Path) -> None:
    server = Server(tmp_path / "data")
    with httpx.Client(base_url=server.address) as client:
        ids = [client.post("/v1/missions", json=GOOD).json()["id"] for _ in range(5)]
        server.process.kill()
    server.stop()
    again = Server(tmp_path / "data")
    with httpx.Client(base_url=again.address, timeout=30) as client:
        listed = [m["id"] for m in client.get("/v1/missions").json()["items"]]
        assert listed == ids[::-1]
        until = time.monotonic() + 60
        while any(client.get(f"/v1/missions/{i}").json()["status"] != "planned" for i in ids):
            assert time.monotonic() < until
            time.sleep(0.1)
    again.stop()


def test_a_taken_port_is_bad_input_with_the_way_out(tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        outcome = run_process("serve", "--port", str(port), "--data", str(tmp_path))
    assert outcome.code == 2
    assert outcome.out == ""
    assert str(port) in outcome.err
    assert "--port 0" in outcome.err


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.0.2.1"])
def test_it_does_not_open_itself_to_the_network_unasked(tmp_path: Path, host: str) -> None:
    outcome = run_process("serve", "--host", host, "--port", "0", "--data", str(tmp_path))
    assert outcome.code == 2
    assert "--expose" in outcome.err


@pytest.mark.slow
def test_only_this_machine_can_reach_it(tmp_path: Path) -> None:
    server = Server(tmp_path / "data")
    port = int(server.address.rsplit(":", 1)[1])
    try:
        listening = {
            line.split()[1]
            for table in ("tcp", "tcp6")
            for line in Path(f"/proc/net/{table}").read_text().splitlines()[1:]
            if line.split()[3] == "0A" and line.split()[1].endswith(f":{port:04X}")
        }
        assert listening == {f"0100007F:{port:04X}"}
    finally:
        server.stop()


def test_a_store_that_cannot_be_used_is_said_at_the_start(tmp_path: Path) -> None:
    (tmp_path / "skyrelay.db").write_bytes(b"this is no database" * 1000)
    outcome = run_process("serve", "--port", "0", "--data", str(tmp_path))
    assert outcome.code != 0
    assert "Traceback" not in outcome.err
    assert "database" in outcome.err


def test_bad_settings_name_the_variable(tmp_path: Path) -> None:
    environment = {**os.environ, "SKYRELAY_PLANNER_PROCESSES": "many"}
    outcome = run_process("serve", "--port", "0", env=environment)
    assert outcome.code == 2
    assert "SKYRELAY_PLANNER_PROCESSES" in outcome.err


@pytest.mark.slow
def test_the_log_can_be_read_by_machines(tmp_path: Path) -> None:
    import json

    server = Server(tmp_path / "data", "--log-style", "json")
    httpx.get(f"{server.address}/v1/missions", headers={"X-Request-ID": "find-me"})
    server.process.send_signal(signal.SIGTERM)
    server.process.wait(30)
    lines = [json.loads(line) for line in server.said().splitlines()]
    assert any(line.get("request_id") == "find-me" and line["path"] == "/v1/missions" for line in lines)
    server.stop()


@pytest.mark.slow
def test_data_of_the_service_is_its_owners_alone(tmp_path: Path) -> None:
    server = Server(tmp_path / "data")
    server.stop()
    assert (tmp_path / "data").stat().st_mode & 0o077 == 0
    with sqlite3.connect(tmp_path / "data" / "skyrelay.db") as database:
        assert database.execute("PRAGMA journal_mode").fetchone() == ("wal",)
    database.close()


def test_answers_on_a_kept_connection_go_out_at_once() -> None:
    """asyncio sets TCP_NODELAY only on sockets whose protocol says TCP; without it each answer waits some 40 ms."""
    import asyncio

    from api.cli.commands.serve import listen

    async def accepted_without_delay() -> bool:
        seen = asyncio.get_running_loop().create_future()

        def met(_reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            option = writer.get_extra_info("socket").getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
            seen.set_result(bool(option))
            writer.close()

        with listen("127.0.0.1", 0) as listener:
            async with await asyncio.start_server(met, sock=listener):
                _, writer = await asyncio.open_connection(*listener.getsockname())
                found = await asyncio.wait_for(seen, 10)
                writer.close()
        return bool(found)

    assert asyncio.run(accepted_without_delay())
