"""What the service remembers: missions and their plans, registries of stations, vehicles and links, flights and their
events.

`Store` opens the database, brings its tables up to date and holds the parts: ``store.missions``, ``store.planning``,
``store.flights``, ``store.registry``.
"""

from __future__ import annotations

import uuid
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

from gcs.store.database import Database
from gcs.store.flights import FlightStore
from gcs.store.missions import Clock, MissionStore
from gcs.store.planning import PlanningStore
from gcs.store.registries import RegistryStore
from gcs.store.safety_copy import back_up


class Store:
    """A database with its tables up to date.

    ``url`` is SQLAlchemy's (``sqlite:///path`` or PostgreSQL); the folder of a SQLite file must exist. ``clock`` and
    ``new_id`` are for tests. Raises `StoreUnavailable`.
    """

    def __init__(
        self,
        url: str,
        *,
        lock_timeout_s: float = 5.0,
        clock: Clock | None = None,
        new_id: Callable[[], str] | None = None,
    ) -> None:
        now = clock or (lambda: datetime.now(UTC))
        make_id = new_id or (lambda: uuid.uuid4().hex)
        self.url = url
        self.database = Database(url, lock_timeout_s=lock_timeout_s)
        self.database.migrate()
        self.missions = MissionStore(self.database, now, make_id)
        self.planning = PlanningStore(self.database, now)
        self.flights = FlightStore(self.database, now, make_id)
        self.registry = RegistryStore(self.database, now)

    def check(self) -> None:
        """Raises `StoreUnavailable` when the database cannot be used."""
        self.database.check()

    def backup_to(self, path: str | Path) -> None:
        """A safety copy; see `gcs.store.safety_copy.back_up`."""
        back_up(self.url, path)

    def close(self) -> None:
        """Give back every connection."""
        self.database.close()

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
