"""The database: connections, transactions, migrations, safety copies.

SQLite by default, in write-ahead mode with ``synchronous=FULL``: what a caller was told is stored stays stored
through a kill or a power cut. A write transaction takes the write lock at its start (``BEGIN IMMEDIATE``), so that
two writers queue up instead of failing half-way. PostgreSQL needs nothing of that.
"""

from __future__ import annotations

import contextlib
import sqlite3
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, create_engine, event, inspect, make_url, text
from sqlalchemy.exc import ArgumentError, DBAPIError, IntegrityError, NoSuchModuleError, SQLAlchemyError
from sqlalchemy.exc import TimeoutError as PoolTimeoutError

from gcs.errors import StoreUnavailable

# The newest migration in gcs/store/migrations/versions.
HEAD = "0003"
_WRITE = "skyrelay_write"


class Database:
    """An engine and its transactions. Raises `StoreUnavailable` when it cannot be opened or migrated."""

    def __init__(self, url: str, *, lock_timeout_s: float = 5.0) -> None:
        try:
            parsed = make_url(url)
            self.is_sqlite = parsed.get_backend_name() == "sqlite"
            options: dict[str, Any] = {"pool_pre_ping": not self.is_sqlite}
            if self.is_sqlite:
                options["connect_args"] = {"timeout": lock_timeout_s}
                if parsed.database in (None, "", ":memory:"):
                    raise StoreUnavailable(
                        "a SQLite database in memory is another one for every connection; give a file"
                    )
            self.engine = create_engine(parsed, **options)
        except (ArgumentError, NoSuchModuleError, ImportError) as error:
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
        """A write transaction: committed at the end, undone when anything is raised inside."""
        with _as_unavailable(), self.engine.connect() as connection:
            connection = connection.execution_options(**{_WRITE: True})
            with connection.begin():
                yield connection

    def migrate(self) -> None:
        """Bring the tables up to date; nothing to do costs one query."""
        with self.write() as connection:
            if self._revision(connection) == HEAD:
                return
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
        """A query that must work, for readiness. Raises `StoreUnavailable`."""
        with self.read() as connection:
            connection.execute(text("SELECT 1 FROM missions LIMIT 1")).first()

    def backup_to(self, path: str | Path) -> None:
        """A consistent copy of a SQLite database, made while it is in use, whole or not at all.

        Raises `StoreUnavailable` for other databases (use their own tools) and when the copy is damaged or cannot be
        written.
        """
        if self.path is None:
            raise StoreUnavailable("only SQLite is copied from here; use pg_dump for PostgreSQL")
        target = Path(path)
        partial = target.with_name(target.name + ".part")
        partial.unlink(missing_ok=True)
        try:
            with (
                contextlib.closing(sqlite3.connect(self.path)) as source,
                contextlib.closing(sqlite3.connect(partial)) as copy,
            ):
                source.backup(copy)
                copy.execute("PRAGMA journal_mode=DELETE")
                verdict = copy.execute("PRAGMA integrity_check").fetchone()[0]
            if verdict != "ok":
                raise StoreUnavailable(f"the copy is damaged: {verdict}")
            partial.replace(target)
        except (sqlite3.Error, OSError) as error:
            raise StoreUnavailable(f"cannot copy the database to {target}: {error}") from None
        finally:
            partial.unlink(missing_ok=True)

    def close(self) -> None:
        """Give back every connection."""
        self.engine.dispose()


@contextlib.contextmanager
def _as_unavailable() -> Iterator[None]:
    """Faults of the database itself become `StoreUnavailable`; broken rules (unique, foreign key) pass as they are."""
    try:
        yield
    except IntegrityError:
        raise
    except DBAPIError as error:
        raise StoreUnavailable(f"the database cannot be used: {error.orig}") from error
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
