"""Safety copies: made while the database is in use, and put back whole or not at all.

SQLite is copied here; PostgreSQL by its own ``pg_dump`` and ``pg_restore``.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import sqlite3
import subprocess
from pathlib import Path

from sqlalchemy import URL, text

from gcs.errors import ConflictError, StoreUnavailable
from gcs.store.database import EARLIER, HEAD, Database, parse_address


def back_up(url: str, path: str | Path) -> None:
    """A consistent copy of the database, whole or not at all, for this user alone.

    Raises `StoreUnavailable` when the copy is damaged or cannot be made.
    """
    parsed, target = parse_address(url), Path(path)
    partial = target.with_name(target.name + ".part")
    try:
        partial.unlink(missing_ok=True)
        os.close(os.open(partial, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600))
        if parsed.get_backend_name() == "sqlite":
            _copy(Path(parsed.database or ""), partial)
        else:
            _run("pg_dump", parsed, "--format=custom", f"--file={partial}")
        with partial.open("rb") as copied:
            os.fsync(copied.fileno())
        partial.replace(target)
    except (sqlite3.Error, OSError) as error:
        raise StoreUnavailable(f"cannot copy the database to {target}: {error}") from None
    finally:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)


def restore(url: str, path: str | Path) -> None:
    """Put a copy made by `back_up` in the database's place, in one transaction; what is there now is gone.

    Raises `StoreUnavailable` for a copy that is damaged, of a newer release or no copy; `ConflictError` while a flight
    of the database that is there has not ended.
    """
    parsed, source = parse_address(url), Path(path)
    if not source.is_file():
        raise StoreUnavailable(f"there is no safety copy {source}")
    _refuse_in_flight(url, parsed)
    if parsed.get_backend_name() != "sqlite":
        _run("pg_restore", parsed, "--clean", "--if-exists", "--no-owner", "--single-transaction", str(source))
        return
    _check(source)
    try:
        target = Path(parsed.database or "")
        if not target.exists():
            os.close(os.open(target, os.O_CREAT | os.O_WRONLY, 0o600))
        _copy(source, target)
    except (sqlite3.Error, OSError) as error:
        raise StoreUnavailable(f"cannot put {source} in the place of {parsed.database}: {error}") from None


def _refuse_in_flight(url: str, parsed: URL) -> None:
    """Raises `ConflictError`; a database that cannot be read at all has no say."""
    if parsed.get_backend_name() == "sqlite" and not Path(parsed.database or "").exists():
        return
    database = Database(url)
    try:
        with database.read() as connection:
            flying = connection.execute(text("SELECT id FROM flights WHERE ended_utc IS NULL")).scalars().all()
    except StoreUnavailable:
        return
    finally:
        database.close()
    if flying:
        raise ConflictError(f"flight {flying[0]} has not ended: its history would be lost; end it first")


def _check(source: Path) -> None:
    """Raises `StoreUnavailable` for a file that is no whole SQLite copy of this or an earlier release."""
    try:
        with contextlib.closing(sqlite3.connect(f"file:{source}?mode=ro", uri=True)) as copy:
            verdict = copy.execute("PRAGMA integrity_check").fetchone()[0]
            revision = copy.execute("SELECT version_num FROM alembic_version").fetchone()[0]
    except (sqlite3.Error, TypeError) as error:
        raise StoreUnavailable(f"{source} is no safety copy: {error}") from None
    if verdict != "ok":
        raise StoreUnavailable(f"{source} is damaged: {verdict}")
    if revision not in (HEAD, *EARLIER):
        raise StoreUnavailable(f"{source} is of a newer skyrelay (revision {revision}; this one knows up to {HEAD})")


def _copy(source: Path, target: Path) -> None:
    """Page by page in one transaction of the target; the target is checked. Raises ``sqlite3.Error``."""
    if not source.is_file():
        raise StoreUnavailable(f"there is no database {source}")
    with (
        contextlib.closing(sqlite3.connect(source)) as read,
        contextlib.closing(sqlite3.connect(target, timeout=10.0)) as written,
    ):
        read.backup(written)
        if target.suffix == ".part":
            written.execute("PRAGMA journal_mode=DELETE")
        verdict = written.execute("PRAGMA integrity_check").fetchone()[0]
    if verdict != "ok":
        raise StoreUnavailable(f"the copy is damaged: {verdict}")


def _run(program: str, parsed: URL, *arguments: str) -> None:
    if shutil.which(program) is None:
        raise StoreUnavailable(f"{program} is not on this machine; it comes with PostgreSQL's client programs")
    # The password goes by the environment: arguments are for everybody on the machine to see.
    address = parsed.set(drivername="postgresql", password=None).render_as_string()
    environment = {**os.environ, **({"PGPASSWORD": str(parsed.password)} if parsed.password else {})}
    done = subprocess.run(
        [program, f"--dbname={address}", *arguments], capture_output=True, text=True, env=environment, check=False
    )
    if done.returncode:
        said = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
        raise StoreUnavailable(f"{program}: {said[0]}")
