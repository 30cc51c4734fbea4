"""The databases the store is tested on, each with what the tests do to it from outside."""

from __future__ import annotations

import contextlib
import sqlite3
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import psycopg


@dataclass(frozen=True)
class Backend:
    """A new, empty database: its kind (``sqlite``, ``postgresql``) and its address."""

    kind: str
    url: str

    @contextlib.contextmanager
    def held(self) -> Iterator[None]:
        """Another program holds everything for the time of a block: reading goes on, nothing can be written."""
        if self.kind == "sqlite":
            with contextlib.closing(sqlite3.connect(self.path, isolation_level=None)) as holder:
                holder.execute("BEGIN IMMEDIATE")
                yield
                holder.execute("ROLLBACK")
            return
        with psycopg.connect(self.url) as connection:
            tables = connection.execute("SELECT tablename FROM pg_tables WHERE schemaname = 'public'").fetchall()
            names = ", ".join(name for (name,) in tables)
            connection.execute(f"LOCK TABLE {names} IN EXCLUSIVE MODE".encode())
            yield
            connection.rollback()

    @property
    def path(self) -> Path:
        """The file of a SQLite database."""
        return Path(self.url.removeprefix("sqlite:///"))
