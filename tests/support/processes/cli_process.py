"""The command as a process of its own, and a service of its own."""

from __future__ import annotations

import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

SKYRELAY = [sys.executable, "-P", "-m", "api.cli"]


@dataclass(frozen=True)
class Outcome:
    """How a command ended."""

    code: int
    out: str
    err: str


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
