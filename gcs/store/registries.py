"""Stations, vehicles and links by name: small documents, one table."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, RowMapping, delete, insert, select, update

from gcs.errors import ConflictError, NotFoundError
from gcs.store.database import Database
from gcs.store.documents import dump, load_for_list
from gcs.store.missions import Clock, stored_utc
from gcs.store.tables import flights, registry

KINDS = ("station", "vehicle", "link")


@dataclass(frozen=True)
class Entry:
    """One thing of a registry: its document as given, and how often it was written (``revision``, from 1)."""

    kind: str
    id: str
    document: dict[str, Any]
    revision: int
    created_utc: str
    changed_utc: str


class RegistryStore:
    """Stations, vehicles and links known by name. What their documents hold is checked by whoever puts them in."""

    def __init__(self, database: Database, clock: Clock) -> None:
        self._db = database
        self._clock = clock

    def put(
        self, kind: str, entry_id: str, document: Mapping[str, Any], *, revision: int | None = None
    ) -> tuple[Entry, bool]:
        """Add or replace; and whether it is new.

        ``revision``: the one that is to be replaced (0: there must be none); `ConflictError` when another stands there.
        """
        _check_kind(kind)
        here = (registry.c.kind == kind) & (registry.c.id == entry_id)
        with self._db.change() as connection:
            self._db.lock(connection, kind, entry_id)
            found = connection.execute(select(registry).where(here)).first()
            present = 0 if found is None else int(found.revision)
            if revision is not None and revision != present:
                raise ConflictError(f"{kind} {entry_id} is at revision {present}, not {revision}")
            now = stored_utc(self._clock())
            values = {"document": dump(dict(document)), "revision": present + 1, "changed_utc": now}
            if found is None:
                connection.execute(insert(registry).values(kind=kind, id=entry_id, created_utc=now, **values))
            else:
                connection.execute(update(registry).where(here).values(**values))
            return _entry(connection.execute(select(registry).where(here)).one()._mapping), found is None

    def get(self, kind: str, entry_id: str) -> Entry:
        """One entry. Raises `NotFoundError`."""
        _check_kind(kind)
        with self._db.read() as connection:
            found = connection.execute(
                select(registry).where(registry.c.kind == kind, registry.c.id == entry_id)
            ).first()
        if found is None:
            raise NotFoundError(f"there is no {kind} {entry_id}")
        return _entry(found._mapping)

    def page(self, kind: str, *, limit: int = 50, after: str | None = None) -> list[Entry]:
        """Entries in order of id, those after ``after``."""
        _check_kind(kind)
        query = select(registry).where(registry.c.kind == kind).order_by(registry.c.id).limit(limit)
        if after is not None:
            query = query.where(registry.c.id > after)
        with self._db.read() as connection:
            return [_entry(row._mapping) for row in connection.execute(query)]

    def remove(self, kind: str, entry_id: str) -> None:
        """Forget an entry. Raises `NotFoundError`; `ConflictError` for a vehicle in flight, or one of its links."""
        _check_kind(kind)
        with self._db.change() as connection:
            _check_not_in_flight(connection, kind, entry_id)
            gone = connection.execute(
                delete(registry).where(registry.c.kind == kind, registry.c.id == entry_id)
            ).rowcount
        if not gone:
            raise NotFoundError(f"there is no {kind} {entry_id}")


def _check_kind(kind: str) -> None:
    if kind not in KINDS:
        raise ValueError(f"no registry of {kind!r}: one of {', '.join(KINDS)}")


def _check_not_in_flight(connection: Connection, kind: str, entry_id: str) -> None:
    """Raises `ConflictError`: who looks for a vehicle in flight, or how to reach it, must find it."""
    if kind not in ("vehicle", "link"):
        return
    for flight in connection.execute(select(flights.c.id, flights.c.vehicle_id).where(flights.c.ended_utc.is_(None))):
        here = (registry.c.kind == "vehicle") & (registry.c.id == flight.vehicle_id)
        vehicle = connection.execute(select(registry.c.document).where(here)).scalar()
        links = json.loads(vehicle).get("links", {}).values() if vehicle is not None and kind == "link" else ()
        if entry_id == flight.vehicle_id if kind == "vehicle" else entry_id in links:
            raise ConflictError(f"{kind} {entry_id} is in use by flight {flight.id}, which has not ended")


def _entry(row: RowMapping) -> Entry:
    values: dict[str, Any] = {str(key): value for key, value in row.items()}
    document = load_for_list(values["document"], f"{values['kind']} {values['id']}") or {}
    return Entry(**{**values, "document": document})
