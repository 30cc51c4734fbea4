"""Flights kept, and their history: events that are only ever added (the database itself refuses anything else)."""

from __future__ import annotations

import json
import logging
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, RowMapping, insert, select, update
from sqlalchemy.exc import IntegrityError

from gcs.errors import ConflictError, NotFoundError, StoreError
from gcs.flight import FlightEvent, FlightState
from gcs.store.database import Database
from gcs.store.documents import dump, load_for_list
from gcs.store.missions import Clock, stored_utc
from gcs.store.tables import flight_events, flights, mission_versions, missions

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class FlightRecord:
    """A flight as stored; ``document`` is what its maker keeps with it (autopilot, links, preflight)."""

    number: int
    id: str
    mission_id: str
    version: int
    plan_sha256: str
    vehicle_id: str
    state: FlightState
    document: dict[str, Any]
    created_utc: str
    changed_utc: str
    ended_utc: str | None
    vehicle_identity: str | None = None
    """Which vehicle it is by the vehicle's own word; None until it was asked."""
    owner: str | None = None
    """The service whose flight this is (`gcs.store.data_owner`)."""


class FlightStore:
    """Flights of one database. Every method raises `StoreUnavailable` when the database cannot be used."""

    def __init__(self, database: Database, clock: Clock, new_id: Callable[[], str]) -> None:
        self._db = database
        self._clock = clock
        self._new_id = new_id

    def add(
        self,
        *,
        mission_id: str,
        version: int,
        plan_sha256: str,
        vehicle_id: str,
        document: Mapping[str, Any] | None = None,
        state: FlightState = FlightState.CONNECTING,
        owner: str | None = None,
    ) -> FlightRecord:
        """A new flight of a planned version.

        Raises `NotFoundError` for an unknown version; `ConflictError` when that version has no plan, or another one
        than ``plan_sha256``, or the vehicle flies already.
        """
        with self._db.change() as connection:
            # The same names and order everywhere: what is judged here stays so until the flight is there.
            self._db.lock(connection, "mission", mission_id)
            self._db.lock(connection, "flights of", vehicle_id)
            planned = connection.execute(
                select(mission_versions.c.status, mission_versions.c.plan_sha256).where(
                    mission_versions.c.mission_id == mission_id, mission_versions.c.version == version
                )
            ).first()
            if planned is None:
                raise NotFoundError(f"there is no version {version} of mission {mission_id}")
            archived = connection.execute(select(missions.c.archived_utc).where(missions.c.id == mission_id)).scalar()
            if archived is not None:
                raise ConflictError(f"mission {mission_id} is archived: submit it again to fly it")
            if planned.status != "planned":
                raise ConflictError(f"mission {mission_id} is {planned.status}, not planned")
            if planned.plan_sha256 != plan_sha256:
                raise ConflictError(f"the plan of mission {mission_id} is {planned.plan_sha256}, not {plan_sha256}")
            busy = connection.execute(
                select(flights.c.id).where(flights.c.vehicle_id == vehicle_id, flights.c.ended_utc.is_(None))
            ).first()
            if busy is not None:
                raise ConflictError(f"vehicle {vehicle_id} is on flight {busy.id}, which has not ended")
            flight_id, now = self._new_id(), stored_utc(self._clock())
            connection.execute(
                insert(flights).values(
                    id=flight_id,
                    mission_id=mission_id,
                    version=version,
                    plan_sha256=plan_sha256,
                    vehicle_id=vehicle_id,
                    state=state.value,
                    owner=owner,
                    document=dump(dict(document or {})),
                    created_utc=now,
                    changed_utc=now,
                )
            )
            return self._get(connection, flight_id)

    def get(self, flight_id: str) -> FlightRecord:
        """A flight. Raises `NotFoundError`."""
        with self._db.read() as connection:
            return self._get(connection, flight_id)

    @staticmethod
    def _get(connection: Connection, flight_id: str) -> FlightRecord:
        found = connection.execute(select(flights).where(flights.c.id == flight_id)).first()
        if found is None:
            raise NotFoundError(f"there is no flight {flight_id}")
        return _record(found._mapping)

    def page(
        self, *, limit: int = 50, before: int | None = None, mission_id: str | None = None, active: bool = False
    ) -> list[FlightRecord]:
        """Newest first, at most ``limit``, those with ``number`` below ``before``; ``active``: not ended."""
        query = select(flights).order_by(flights.c.number.desc()).limit(limit)
        if before is not None:
            query = query.where(flights.c.number < before)
        if mission_id is not None:
            query = query.where(flights.c.mission_id == mission_id)
        if active:
            query = query.where(flights.c.ended_utc.is_(None))
        with self._db.read() as connection:
            return [_record(row._mapping) for row in connection.execute(query)]

    def claim(self, flight_id: str, vehicle_identity: str) -> None:
        """Note which vehicle a flight is of. Again the same does nothing.

        Raises `NotFoundError`, and `ConflictError` when a flight that has not ended has that vehicle.
        """
        try:
            with self._db.write() as connection:
                self._get(connection, flight_id)
                connection.execute(
                    update(flights).where(flights.c.id == flight_id).values(vehicle_identity=vehicle_identity)
                )
        except IntegrityError:
            with self._db.read() as connection:
                busy = connection.execute(
                    select(flights.c.id).where(
                        flights.c.vehicle_identity == vehicle_identity, flights.c.ended_utc.is_(None)
                    )
                ).scalar_one_or_none()
            raise ConflictError(
                f"the vehicle ({vehicle_identity}) is on flight {busy or 'another'}, which has not ended"
            ) from None

    def update(self, flight_id: str, document: Mapping[str, Any]) -> FlightRecord:
        """Replace what is kept with a flight. Raises `NotFoundError`."""
        with self._db.write() as connection:
            connection.execute(
                update(flights)
                .where(flights.c.id == flight_id)
                .values(document=dump(dict(document)), changed_utc=stored_utc(self._clock()))
            )
            return self._get(connection, flight_id)

    def append(self, flight_id: str, event: FlightEvent) -> None:
        """Add an event, and let the flight's state follow it.

        The same event again does nothing. Raises `NotFoundError` for an unknown flight, `ConflictError` for another
        event of the same sequence number.
        """
        text = dump(event.to_document())
        try:
            with self._db.write() as connection:
                flight = self._get(connection, flight_id)
                connection.execute(
                    insert(flight_events).values(
                        flight_id=flight_id,
                        sequence=event.sequence,
                        kind=event.kind.value,
                        state=event.state.value,
                        utc=event.utc,
                        document=text,
                    )
                )
                ended = stored_utc(self._clock()) if event.state.ended else None
                connection.execute(
                    update(flights)
                    .where(flights.c.id == flight_id)
                    .values(
                        state=event.state.value,
                        changed_utc=stored_utc(self._clock()),
                        ended_utc=flight.ended_utc or ended,
                    )
                )
        except IntegrityError:
            with self._db.read() as connection:
                there = connection.execute(
                    select(flight_events.c.document).where(
                        flight_events.c.flight_id == flight_id, flight_events.c.sequence == event.sequence
                    )
                ).scalar_one_or_none()
            if there != text:
                raise ConflictError(f"flight {flight_id} has another event number {event.sequence}") from None

    def events(self, flight_id: str, *, after: int = 0, limit: int = 1_000) -> list[FlightEvent]:
        """Events in order, those with a sequence number above ``after``."""
        with self._db.read() as connection:
            rows = connection.execute(
                select(flight_events.c.document)
                .where(flight_events.c.flight_id == flight_id, flight_events.c.sequence > after)
                .order_by(flight_events.c.sequence)
                .limit(limit)
            ).scalars()
            return [FlightEvent.from_document(json.loads(text)) for text in rows]

    def journal(self, flight_id: str) -> FlightJournal:
        """A `gcs.flight.Journal` for one flight."""
        return FlightJournal(self, flight_id)


class FlightJournal:
    """Writes a flight's events to the store, in order, and never raises (`gcs.flight.Journal`).

    An event is on disk when `append` returns, unless the store cannot be used just now: then it waits here, the newest
    ``keep`` at least, and goes before the next one. ``backlog`` says how many wait.
    """

    def __init__(self, store: FlightStore, flight_id: str, *, keep: int = 100_000) -> None:
        self._store = store
        self._flight_id = flight_id
        self._waiting: deque[FlightEvent] = deque(maxlen=keep)

    @property
    def backlog(self) -> int:
        """Events not on disk yet."""
        return len(self._waiting)

    def append(self, event: FlightEvent) -> None:
        """Keep ``event``."""
        self._waiting.append(event)
        self.flush()

    def flush(self) -> bool:
        """Try to write what waits; whether nothing waits any more."""
        while self._waiting:
            event = self._waiting[0]
            try:
                self._store.append(self._flight_id, event)
            except (ConflictError, NotFoundError):
                log.exception("event %d of flight %s cannot be kept", event.sequence, self._flight_id)
            except StoreError as error:
                log.warning("event %d of flight %s waits: %s", event.sequence, self._flight_id, error)
                return False
            self._waiting.popleft()
        return True


def _record(row: RowMapping) -> FlightRecord:
    values: dict[str, Any] = {str(key): value for key, value in row.items()}
    document = load_for_list(values["document"], f"what is kept with flight {values['id']}") or {}
    return FlightRecord(**{**values, "state": FlightState(values["state"]), "document": document})
