"""Connections with limits: slow ones are cut off, too many are turned away, and those who behave notice nothing."""

from __future__ import annotations

import contextlib
import socket
import time
from collections.abc import Iterator

import httpx
import pytest

from tests.support.missions.malformed import GOOD
from tests.support.processes.cli_process import Server
from tests.support.processes.rest_client import assert_problem

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def strict(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    with pytest.MonkeyPatch.context() as patch:
        for name, value in (
            ("HEADERS_TIMEOUT_S", "1"),
            ("BODY_TIMEOUT_S", "1.5"),
            ("READING_TIMEOUT_S", "1"),
            ("MAX_CONNECTIONS", "20"),
            ("MAX_BODY_BYTES", "20000"),
            ("ALLOWED_HOSTS", "ops.example.org, *.field.example"),
        ):
            patch.setenv(f"SKYRELAY_{name}", value)
        server = Server(tmp_path_factory.mktemp("strict") / "data")
    yield server
    server.stop()


def connected(server: Server) -> socket.socket:
    host, port = server.address.removeprefix("http://").split(":")
    made = socket.create_connection((host, int(port)), timeout=10)
    made.settimeout(10)
    return made


def cut_off_after(connection: socket.socket, *, dripping: bytes = b"") -> float:
    """Seconds until the other side closes, while a byte at a time goes there."""
    began = time.monotonic()
    connection.settimeout(0.2)
    while time.monotonic() - began < 10:
        try:
            if dripping:
                connection.sendall(dripping)
            if not connection.recv(100):
                break
        except TimeoutError:
            continue
        except OSError:
            break
    return time.monotonic() - began


@pytest.mark.parametrize(
    ("said", "dripping", "allowed_s"),
    [
        (b"", b"", 1.0),
        (b"GET /healthz HTTP/1.1\r\n", b"", 1.0),
        (b"GET /healthz HTTP/1.1\r\nX-A: ", b"a", 1.0),
        (b"POST /v1/missions HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100000\r\n\r\n", b" ", 1.5),
    ],
    ids=["silent", "half a head", "a dripping head", "a dripping body"],
)
def test_a_request_that_does_not_arrive_is_cut_off(
    strict: Server, said: bytes, dripping: bytes, allowed_s: float
) -> None:
    with connected(strict) as connection:
        if said:
            connection.sendall(said)
        assert allowed_s * 0.8 <= cut_off_after(connection, dripping=dripping) < allowed_s + 4


def test_too_many_connections_are_turned_away_and_the_service_answers_again(strict: Server) -> None:
    with contextlib.ExitStack() as stack:
        for _ in range(60):
            stack.enter_context(connected(strict))
        time.sleep(0.3)
    until = time.monotonic() + 10
    while True:
        with contextlib.suppress(httpx.HTTPError):
            if httpx.get(f"{strict.address}/healthz", timeout=5).status_code == 200:
                break
        assert time.monotonic() < until
    assert "Traceback" not in strict.said()
    assert len(strict.said()) < 100_000


def test_an_answer_nobody_reads_is_given_up(strict: Server) -> None:
    with httpx.Client(base_url=strict.address, timeout=30) as client:
        mission = client.post("/v1/missions", json=GOOD).json()
        with client.stream("GET", f"/v1/missions/{mission['id']}/events") as answer:
            answer.read()
    with connected(strict) as connection:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        path = f"/v1/missions/{mission['id']}/setpoints?rate=50"
        connection.sendall(f"GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
        time.sleep(4)
        # A server that had not given it up would send on now; one that has sends what the kernel holds, or nothing.
        connection.settimeout(5)
        received = 0
        with contextlib.suppress(OSError):
            while piece := connection.recv(1_000_000):
                received += len(piece)
        whole = len(httpx.get(strict.address + path, timeout=60).content)
        assert received < whole * 0.9


def test_one_who_behaves_keeps_the_connection(strict: Server) -> None:
    with httpx.Client(base_url=strict.address, timeout=10) as client:
        for _ in range(4):
            assert client.get("/healthz").status_code == 200
            time.sleep(0.5)


def test_a_body_where_none_is_so_large_is_refused(strict: Server) -> None:
    with httpx.Client(base_url=strict.address, timeout=10) as client:
        large = {"by": "x" * 30_000}
        problem = assert_problem(client.post("/v1/flights/a/hold", json=large), 413)
        assert "20000" in problem["errors"][0]["allowed"]
        assert client.post("/v1/missions", json={**GOOD, "name": "x" * 30_000}).status_code == 422


@pytest.mark.parametrize(
    ("host", "status"),
    [("ops.example.org", 200), ("OPS.example.org:8000", 200), ("a.field.example", 200), ("[::1]:8000", 200),
     ("127.0.0.1", 200), ("localhost:1", 200), ("field.example", 403), ("example.org", 403),
     ("ops.example.org.evil", 403), ("", 403)],
)  # fmt: skip
def test_names_the_service_is_called_by_are_a_setting(strict: Server, host: str, status: int) -> None:
    answer = httpx.get(f"{strict.address}/healthz", headers={"Host": host})
    assert answer.status_code == status
    if status == 403:
        assert "SKYRELAY_ALLOWED_HOSTS" in assert_problem(answer, 403)["detail"]


def test_two_lengths_of_one_body_are_refused(strict: Server) -> None:
    with connected(strict) as connection:
        connection.sendall(
            b"POST /v1/missions HTTP/1.1\r\nHost: localhost\r\nContent-Length: 5\r\n"
            b"Transfer-Encoding: chunked\r\n\r\n2\r\n{}\r\n0\r\n\r\n"
        )
        assert connection.recv(100).startswith(b"HTTP/1.1 400")


def test_an_upload_that_is_given_up_is_no_fault_of_ours(strict: Server) -> None:
    for _ in range(3):
        with connected(strict) as connection:
            connection.sendall(b"POST /v1/missions HTTP/1.1\r\nHost: localhost\r\nContent-Length: 1000\r\n\r\n{")
            time.sleep(0.2)
    time.sleep(0.3)
    assert "Traceback" not in strict.said()


def test_head_is_get_without_its_body(strict: Server) -> None:
    with httpx.Client(base_url=strict.address, timeout=20) as client:
        mission = client.post("/v1/missions", json=GOOD).json()
        with client.stream("GET", f"/v1/missions/{mission['id']}/events") as answer:
            answer.read()
        base = f"/v1/missions/{mission['id']}"
        for path in ("/", "/healthz", "/metrics", "/v1/missions", base, f"{base}/plan", f"{base}/handovers"):
            got, head = client.get(path), client.head(path)
            assert (head.status_code, head.content) == (200, b""), path
            assert head.headers["content-type"] == got.headers["content-type"]
            if path not in ("/metrics",):
                assert head.headers["content-length"] == got.headers["content-length"]
        for path in (f"{base}/setpoints?rate=50", f"{base}/events"):
            assert client.head(path).status_code == 200
        assert client.head("/v1/missions/nowhere").status_code == 404
        assert client.head(f"{base}/versions/x").status_code == 404
        assert "Traceback" not in strict.said()
