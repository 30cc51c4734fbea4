"""What the tests of the command line and the service share: the command in this process or as one of its own."""

from __future__ import annotations

import io
import signal
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import httpx
import pytest

from tests.support.processes.cli_process import Outcome, Server


@pytest.fixture
def cli(
    capsysbinary: pytest.CaptureFixture[bytes], monkeypatch: pytest.MonkeyPatch
) -> Iterator[Callable[..., Outcome]]:
    """Run ``skyrelay`` in this process: ``cli("plan", "-", stdin=b"...")``."""
    from api.cli import main

    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}

    def run(*arguments: str | Path, stdin: bytes = b"") -> Outcome:
        capsysbinary.readouterr()
        monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(stdin)))
        with pytest.raises(SystemExit) as ending:
            main([str(a) for a in arguments])
        out, err = capsysbinary.readouterr()
        assert isinstance(ending.value.code, int)
        return Outcome(ending.value.code, out.decode(), err.decode())

    yield run
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A service shared by a module's tests."""
    made = Server(tmp_path_factory.mktemp("service") / "data")
    yield made
    made.stop()


@pytest.fixture(scope="module")
def server_pid(server: Server) -> int:
    """Its process."""
    return server.process.pid


@pytest.fixture(scope="module")
def client(server: Server) -> Iterator[httpx.Client]:
    """A client of it, once it is ready."""
    with httpx.Client(base_url=server.address, timeout=60) as made:
        for _ in range(400):
            if made.get("/readyz").status_code == 200:
                break
            time.sleep(0.05)
        yield made
