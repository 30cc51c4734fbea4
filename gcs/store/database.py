"""The database: connections, transactions, migrations, safety copies.

SQLite by default, in write-ahead mode with ``synchronous=FULL``: what a caller was told is stored stays stored
through a kill or a power cut. A write transaction takes the write lock at its start (``BEGIN IMMEDIATE``), so that
two writers queue up instead of failing half-way. PostgreSQL needs nothing of that; its writers lock what they judge.
"""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Iterator
from datetime import UTC, datetime
from importlib import resources
from pathlib import Path
from typing import Any

from sqlalchemy import URL, Connection, create_engine, event, inspect, make_url, text
from sqlalchemy.exc import ArgumentError, DBAPIError, IntegrityError, NoSuchModuleError, SQLAlchemyError
from sqlalchemy.exc import TimeoutError as PoolTimeoutError

from gcs.errors import ConflictError, StoreUnavailable

# The newest migration in gcs/store/migrations/versions.
HEAD = "0004"
EARLIER = ("0001", "0002", "0003")
_WRITE = "skyrelay_write"
# PostgreSQL's code for a lock that was waited for too long.
_LOCK_NOT_AVAILABLE = "55P03"


class Database:
    """An engine and its transactions. Raises `StoreUnavailable` when it cannot be opened or migrated."""

    def __init__(self, url: str, *, lock_timeout_s: float = 5.0) -> None:
        try:
            parsed = parse_address(url)
            self.is_sqlite = parsed.get_backend_name() == "sqlite"
            self.engine = create_engine(parsed, **_options(parsed, lock_timeout_s))
        except (ArgumentError, NoSuchModuleError, ImportError, ValueError) as error:
            raise StoreUnavailable(f"cannot use the database address: {error}") from None
        self.path = Path(parsed.database) if self.is_sqlite and parsed.database else None
        if self.is_sqlite:
            event.listen(self.engine, "connect", _set_up_sqlite)
            event.listen(self.engine, "begin", _begin_sqlite)

    @contextlib.contextmanager
    def read(self) -> Iterator[Connection]:
        """A read transaction: one consistent view."""
        with _as_unavailable(), self.engine.connect() as connection, connection.begin():
            yield connection

    @contextlib.contextmanager
    def write(self) -> Iterator[Connection]:
        """A write transaction: committed at the end, undone when anything is raised inside.

        SQLite's writers come one after another. PostgreSQL's work side by side: `lock` what is looked at before it is
        changed. Raises ``IntegrityError`` where a rule of the tables is broken.
        """
        with _as_unavailable(), self.engine.connect() as connection:
            connection = connection.execution_options(**{_WRITE: True})
            with connection.begin():
                yield connection

    @contextlib.contextmanager
    def change(self) -> Iterator[Connection]:
        """As `write`; a broken rule, which another request must have brought about meanwhile, is a `ConflictError`."""
        try:
            with self.write() as connection:
                yield connection
        except IntegrityError as error:
            raise ConflictError("another request has changed the same meanwhile; look at it and ask again") from error

    def lock(self, connection: Connection, *name: str) -> None:
        """Until the end of a write transaction no other one locks ``name``. Nothing to do with SQLite."""
        if not self.is_sqlite:
            # Names of different things may share a number: these then wait for each other without need.
            digest = hashlib.sha256("\0".join(name).encode("utf-8", "surrogatepass")).digest()
            number = int.from_bytes(digest[:8], "big", signed=True)
            connection.execute(text("SELECT pg_advisory_xact_lock(:number)"), {"number": number})

    def migrate(self) -> None:
        """Bring the tables up to date; nothing to do costs one query.

        Raises `StoreUnavailable` for tables of a newer skyrelay, and for a PostgreSQL database that is not in UTF-8.
        """
        with self.write() as connection:
            if not self.is_sqlite:
                encoding = connection.execute(text("SHOW server_encoding")).scalar_one()
                if encoding != "UTF8":
                    raise StoreUnavailable(f"the database is in {encoding}, not UTF8: make it WITH ENCODING 'UTF8'")
                self.lock(connection, "migration")
            revision = self._revision(connection)
            if revision == HEAD:
                return
            if revision is not None and revision not in EARLIER:
                raise StoreUnavailable(
                    f"its tables are of a newer skyrelay (revision {revision}; this one knows up to {HEAD}): run that "
                    "one, or restore a safety copy made before it was installed"
                )
            # Imported here: a store that is up to date does not pay for it.
            from alembic import command
            from alembic.config import Config

            config = Config()
            config.attributes["connection"] = connection
            config.set_main_option(
                "script_location", str(resources.files("gcs.store") / "migrations").replace("%", "%%")
            )
            command.upgrade(config, "head")

    def revision(self) -> str | None:
        """The migration the tables are at; None for an empty database."""
        with self.read() as connection:
            return self._revision(connection)

    @staticmethod
    def _revision(connection: Connection) -> str | None:
        if not inspect(connection).has_table("alembic_version"):
            return None
        found = connection.execute(text("SELECT version_num FROM alembic_version")).scalar_one_or_none()
        return None if found is None else str(found)

    def check(self) -> None:
        """A write that must reach the disk, for readiness: one that can only be read is of no use to a flight.

        Raises `StoreUnavailable`.
        """
        now = datetime.now(UTC).isoformat()
        with self.write() as connection:
            connection.execute(text("UPDATE write_probe SET checked_utc = :now WHERE id = 1"), {"now": now})

    def close(self) -> None:
        """Give back every connection."""
        self.engine.dispose()


def parse_address(url: str) -> URL:
    """The parsed address, its driver named. Raises ``ArgumentError``, `StoreUnavailable`."""
    parsed = make_url("postgresql" + url.removeprefix("postgres") if url.startswith("postgres:") else url)
    backend = parsed.get_backend_name()
    if backend == "postgresql":
        return parsed.set(drivername="postgresql+psycopg")
    if backend != "sqlite":
        raise StoreUnavailable(
            f"cannot use the database address: there is no {backend!r} here; give sqlite:///FILE or "
            "postgresql://USER@HOST/DATABASE"
        )
    if parsed.database in (None, "", ":memory:"):
        raise StoreUnavailable("a SQLite database in memory is another one for every connection; give a file")
    return parsed


def _options(parsed: URL, lock_timeout_s: float) -> dict[str, Any]:
    if parsed.get_backend_name() == "sqlite":
        return {"connect_args": {"timeout": lock_timeout_s}}
    # A connection that is asked for and one that is waited for take as long as a lock at most; a commit is on disk.
    settings = {"lock_timeout": f"{lock_timeout_s * 1e3:.0f}ms", "synchronous_commit": "on", "timezone": "UTC"}
    return {
        "pool_pre_ping": True,
        "pool_size": 10,
        "max_overflow": 20,
        "pool_timeout": lock_timeout_s,
        "connect_args": {
            "connect_timeout": max(2, round(lock_timeout_s)),
            "application_name": "skyrelay",
            "options": " ".join(f"-c {name}={value}" for name, value in settings.items()),
        },
    }


@contextlib.contextmanager
def _as_unavailable() -> Iterator[None]:
    """Faults of the database itself become `StoreUnavailable`; broken rules (unique, foreign key) pass as they are."""
    try:
        yield
    except IntegrityError:
        raise
    except DBAPIError as error:
        if getattr(error.orig, "sqlstate", None) == _LOCK_NOT_AVAILABLE:
            raise StoreUnavailable("the database cannot be used: it is locked by another program") from error
        said = str(error.orig).strip().splitlines() or [type(error.orig).__name__]
        raise StoreUnavailable(f"the database cannot be used: {said[0]}") from error
    except PoolTimeoutError as error:
        raise StoreUnavailable("every connection to the database is in use") from error
    except SQLAlchemyError as error:
        raise StoreUnavailable(f"the database cannot be used: {error}") from error


def _set_up_sqlite(connection: Any, _record: Any) -> None:
    # Transactions are begun by us, below; the driver's own would begin them late and without the write lock.
    connection.isolation_level = None
    cursor = connection.cursor()
    for pragma in ("journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON"):
        cursor.execute(f"PRAGMA {pragma}")
    cursor.close()


def _begin_sqlite(connection: Connection) -> None:
    write = connection.get_execution_options().get(_WRITE, False)
    connection.exec_driver_sql("BEGIN IMMEDIATE" if write else "BEGIN")
