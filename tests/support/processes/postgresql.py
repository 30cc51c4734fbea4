"""A PostgreSQL server of the tests' own, from the system's packages: on a Unix socket, in a folder that goes with it.

``python -m tests.support.processes.postgresql`` installs the package where that is possible (Debian, as root) and
needed; anywhere else it says in one line what will be skipped. PostgreSQL refuses to run as root: then it runs as
``postgres`` or ``nobody``.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import pwd
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

MISSING = "PostgreSQL is not on this machine: the store is tested on SQLite alone (Debian: apt-get install postgresql)"
_START_S = 60.0
_PR_SET_PDEATHSIG = 1
# Speed over safety: these servers are thrown away.
_SETTINGS = ("listen_addresses=", "fsync=off", "full_page_writes=off", "max_connections=200", "shared_buffers=32MB")


def programs() -> Path | None:
    """The newest server's folder of programs; None where there is none."""
    found = [p.parent for p in Path("/usr/lib/postgresql").glob("*/bin/initdb")]
    if found:
        return max(found, key=lambda folder: float(folder.parent.name))
    named = shutil.which("initdb")
    return Path(named).resolve().parent if named else None


def _runner() -> dict[str, Any]:
    """Whom the server runs as, as arguments of ``subprocess``: this user, unless that is root."""
    if os.getuid() != 0:
        return {}
    for name in ("postgres", "nobody"):
        with contextlib.suppress(KeyError):
            entry = pwd.getpwnam(name)
            return {"user": entry.pw_uid, "group": entry.pw_gid, "extra_groups": []}
    raise RuntimeError("there is neither a postgres nor a nobody user to run PostgreSQL as")


def _end_with_parent() -> None:  # runs in the child, after it has changed its user
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGQUIT)


@dataclass(frozen=True)
class PostgreSql:
    """A running server."""

    bin: Path
    socket: Path
    process: subprocess.Popen[bytes]

    def url(self, database: str) -> str:
        """The address of one of its databases."""
        return f"postgresql://postgres@/{database}?host={self.socket}"

    def execute(self, command: str) -> None:
        """One SQL command outside of any transaction."""
        import psycopg

        with psycopg.connect(host=str(self.socket), user="postgres", dbname="postgres", autocommit=True) as connection:
            connection.execute(command.encode())

    @contextlib.contextmanager
    def database(self, name: str) -> Iterator[str]:
        """A new database's address; it is dropped afterwards, whoever is connected."""
        self.execute(f'CREATE DATABASE "{name}"')
        try:
            yield self.url(name)
        finally:
            self.execute(f'DROP DATABASE "{name}" WITH (FORCE)')


@contextlib.contextmanager
def running() -> Iterator[PostgreSql]:
    """A server for the time of a block. Raises ``RuntimeError`` with what it said when it does not start."""
    folder = programs()
    if folder is None:
        raise RuntimeError(MISSING)
    who = _runner()
    home = Path(tempfile.mkdtemp(prefix="skyrelay-pg-"))
    home.chmod(0o755)  # its socket is for this user, who need not be the server's
    data, log = home / "data", home / "log"
    try:
        data.mkdir(mode=0o700)
        if who:
            for path in (home, data):
                os.chown(path, who["user"], who["group"])
        made = subprocess.run(
            [folder / "initdb", "-D", data, "-U", "postgres", "-A", "trust", "-E", "UTF8", "--locale=C.UTF-8", "-N"],
            capture_output=True, text=True, check=False, cwd="/", **who,
        )  # fmt: skip
        if made.returncode:
            raise RuntimeError(f"initdb: {made.stdout[-1000:]}{made.stderr[-1000:]}")
        options = [part for setting in _SETTINGS for part in ("-c", setting)]
        with log.open("wb") as said:
            process = subprocess.Popen(
                [folder / "postgres", "-D", data, "-k", home, *options],
                stdin=subprocess.DEVNULL, stdout=said, stderr=said, cwd="/", preexec_fn=_end_with_parent, **who,
            )  # fmt: skip
        try:
            _wait(folder, home, process, log)
            yield PostgreSql(folder, home, process)
        finally:
            process.send_signal(signal.SIGINT)
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.send_signal(signal.SIGQUIT)
                process.wait()
    finally:
        shutil.rmtree(home, ignore_errors=True)


def _wait(folder: Path, home: Path, process: subprocess.Popen[bytes], log: Path) -> None:
    until = time.monotonic() + _START_S
    while subprocess.run([folder / "pg_isready", "-q", "-h", home], check=False).returncode:
        if process.poll() is not None or time.monotonic() > until:
            process.kill()
            raise RuntimeError(f"PostgreSQL did not start: {log.read_text(errors='replace')[-2000:]}")
        time.sleep(0.05)


def main() -> None:
    """Install the package where it is missing and may be installed."""
    apt = shutil.which("apt-get")
    if programs() is None and apt is not None and os.getuid() == 0:
        print("installing PostgreSQL for the tests (apt-get install postgresql)", flush=True)
        environment = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
        for arguments in (("update", "-qq"), ("install", "-qq", "-y", "--no-install-recommends", "postgresql")):
            subprocess.run([apt, *arguments], env=environment, check=False, stdout=subprocess.DEVNULL)
    if programs() is None:
        print(f"NOTE: {MISSING}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
