"""Programs a command starts beside itself: the simulator, the service. None may outlive the command.

Each is started in a session of its own, so that Ctrl-C in a terminal reaches the command alone, which then ends the
others in order. On Linux the kernel also ends them when the command itself is killed outright.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from types import TracebackType

_PR_SET_PDEATHSIG = 1
_LIBC = ctypes.CDLL(None) if sys.platform == "linux" else None


class ChildError(Exception):
    """A program beside us did not do its part: ``what`` happened, and ``details`` of it by name (exit code, output)."""

    def __init__(self, what: str, details: dict[str, object] | None = None) -> None:
        super().__init__(what)
        self.what = what
        self.details = details or {}


def python_module(module: str, *arguments: str) -> list[str]:
    """The command line of a module of ours; ``-P`` keeps like-named folders of the current directory out of the way."""
    return [sys.executable, "-P", "-m", module, *arguments]


def _die_with_parent() -> None:  # pragma: no cover, runs in the child between fork and exec
    if _LIBC is not None:
        _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


class Child:
    """One program started by a command. Its standard error is kept, to be quoted when it fails."""

    def __init__(self, name: str, command: Sequence[str], *, env: dict[str, str] | None = None) -> None:
        self.name = name
        self._output = tempfile.TemporaryFile()  # noqa: SIM115 - closed in stop
        self.process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=self._output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            env=env,
            preexec_fn=_die_with_parent,
        )

    def output(self) -> str:
        """What it has printed so far."""
        size = os.fstat(self._output.fileno()).st_size
        return os.pread(self._output.fileno(), size, 0).decode("utf-8", "replace").strip()

    def check(self) -> None:
        """Raises `ChildError` when it has ended."""
        code = self.process.poll()
        if code is not None:
            raise ChildError(f"the {self.name} ended by itself", {"exit": code, "said": self.output()[-2000:]})

    def stop(self, timeout_s: float = 10.0) -> None:
        """Ask it to end, then insist: its whole process group is gone afterwards."""
        if self.process.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                self.process.send_signal(signal.SIGTERM)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.process.wait(timeout_s)
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()
        self._output.close()


class Children:
    """The programs a command started, ended in reverse order when the context is left, whatever the reason."""

    def __init__(self) -> None:
        self._children: list[Child] = []

    def __enter__(self) -> Children:
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, tb: TracebackType | None) -> None:
        # A second Ctrl-C must not leave one of them running.
        before = signal.signal(signal.SIGINT, signal.SIG_IGN)
        try:
            for child in reversed(self._children):
                child.stop()
        finally:
            signal.signal(signal.SIGINT, before)

    def start(self, name: str, command: Sequence[str], *, env: dict[str, str] | None = None) -> Child:
        """Start ``command``; ``name`` is how messages call it."""
        child = Child(name, command, env=env)
        self._children.append(child)
        return child

    def forget(self, child: Child) -> None:
        """No longer watch over a child that was stopped on purpose."""
        self._children.remove(child)

    def check(self) -> None:
        """Raises `ChildError` when one of them has ended."""
        for child in self._children:
            child.check()

    def sleep(self, seconds: float) -> None:
        """Wait, looking after the children."""
        until = time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0:
            self.check()
            time.sleep(min(left, 0.2))
