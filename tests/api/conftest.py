"""What the tests of the command line and the service share: the command in this process or as one of its own."""

from __future__ import annotations

import io
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import httpx
import pytest

SKYRELAY = [sys.executable, "-P", "-m", "api.cli"]


@dataclass(frozen=True)
class Outcome:
    """How a command ended."""

    code: int
    out: str
    err: str


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


def run_process(*arguments: str | Path, timeout_s: float = 120, **more: object) -> Outcome:
    """Run ``skyrelay`` as a process of its own."""
    done = subprocess.run(  # type: ignore[call-overload]
        [*SKYRELAY, *map(str, arguments)], capture_output=True, text=True, timeout=timeout_s, check=False, **more
    )
    return Outcome(done.returncode, done.stdout, done.stderr)


# -- a service --------------------------------------------------------------------------------------------------------


class Server:
    """``skyrelay serve`` as a process of its own."""

    def __init__(self, data: Path, *arguments: str) -> None:
        self.data = data
        self.log = (data.parent / f"{data.name}.log").open("w+b")
        self.process = subprocess.Popen(
            [*SKYRELAY, "serve", "--port", "0", "--data", str(data), *arguments],
            stdout=subprocess.PIPE,
            stderr=self.log,
            text=True,
        )
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        assert "serves at" in line, self.said()
        self.address = line.split()[-1].rstrip("/")

    def said(self) -> str:
        """Its log so far."""
        self.log.seek(0)
        return self.log.read().decode()

    def stop(self, number: int = signal.SIGTERM, timeout_s: float = 30) -> int:
        """Ask it to end; its exit code."""
        if self.process.poll() is None:
            self.process.send_signal(number)
        try:
            code = self.process.wait(timeout_s)
        finally:
            self.process.kill()
            self.process.wait()
            assert self.process.stdout is not None
            self.process.stdout.close()
            self.log.close()
        return code


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
