"""Missions kept: versions, planning status, plans, idempotency keys. What planners do to them is
`gcs.store.planning`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import Connection, RowMapping, func, insert, select, update

from gcs.errors import ConflictError, NotFoundError, QueueFullError
from gcs.store.database import Database
from gcs.store.documents import dump, load, load_for_list
from gcs.store.tables import flights, idempotency_keys, mission_versions, missions
from gcs.timestamps import utc_text

Clock = Callable[[], datetime]
# Told of a version, inside the transaction that changes it.
OnVersion = Callable[[Connection, str, int], None]
STATUSES = ("queued", "planning", "planned", "infeasible", "failed")


@dataclass(frozen=True)
class MissionRecord:
    """One version of a mission, as stored; ``number`` orders missions by their making.

    ``phase`` is a word about the status (e.g. ``"scheduling"``), ``progress`` from 0 to 1. ``mission_time_s`` and
    ``handover_count`` are the plan's. ``infeasibility`` is `MissionInfeasible.to_document`; ``error`` says what failed.
    """

    number: int
    id: str
    name: str
    version: int
    latest_version: int
    status: str
    phase: str
    progress: float
    plan_sha256: str | None
    mission_time_s: float | None
    handover_count: int | None
    infeasibility: dict[str, Any] | None
    error: str | None
    created_utc: str
    changed_utc: str
    archived_utc: str | None


@dataclass(frozen=True)
class Idempotency:
    """A caller's key within a scope (who, and which call), and the hash of what was asked."""

    scope: str
    key: str
    request_sha256: str


def stored_utc(moment: datetime) -> str:
    """A time as the tables keep it, which sorts as text as it does as time."""
    return utc_text(moment, "microseconds")


_RECORD = (
    missions.c.number,
    missions.c.id,
    missions.c.name,
    mission_versions.c.version,
    missions.c.latest_version,
    mission_versions.c.status,
    mission_versions.c.phase,
    mission_versions.c.progress,
    mission_versions.c.plan_sha256,
    mission_versions.c.mission_time_s,
    mission_versions.c.handover_count,
    mission_versions.c.infeasibility,
    mission_versions.c.error,
    mission_versions.c.created_utc,
    mission_versions.c.changed_utc,
    missions.c.archived_utc,
)
# More than any number of a row.
_NEWEST = 2**63 - 1
_JOINED = missions.join(mission_versions, missions.c.id == mission_versions.c.mission_id)


class MissionStore:
    """Missions of one database. Every method raises `StoreUnavailable` when the database cannot be used.

    ``on_queued`` and ``on_given_up`` are for a queue kept beside these tables, in the same database.
    """

    on_queued: OnVersion | None = None
    on_given_up: OnVersion | None = None

    def __init__(self, database: Database, clock: Clock, new_id: Callable[[], str]) -> None:
        self._db = database
        self._clock = clock
        self._new_id = new_id

    # --- making ---------------------------------------------------------------------------------------------

    def add(
        self,
        document: Mapping[str, Any],
        *,
        idempotency: Idempotency | None = None,
        max_queued: int | None = None,
    ) -> tuple[MissionRecord, bool]:
        """Store a validated mission document as version 1, queued; and whether it is new.

        With a key seen before, the record made then. Raises `ConflictError` when that was for another request, and
        `QueueFullError` when ``max_queued`` missions wait already.
        """
        with self._db.change() as connection:
            known = self._known(connection, idempotency)
            if known is not None:
                return known, False
            self._check_queue(connection, max_queued)
            mission_id, now = self._new_id(), stored_utc(self._clock())
            made = connection.execute(
                insert(missions)
                .values(id=mission_id, name=str(document["name"]), latest_version=1, created_utc=now)
                .returning(missions.c.number)
            )
            self._add_version(connection, (mission_id, 1, made.scalar_one()), document, now, idempotency)
            return self._get(connection, mission_id, None), True

    def add_version(
        self,
        mission_id: str,
        document: Mapping[str, Any],
        *,
        idempotency: Idempotency | None = None,
        max_queued: int | None = None,
    ) -> tuple[MissionRecord, bool]:
        """A new version of a mission, queued; otherwise as `add`. Raises `ConflictError` when it is archived."""
        with self._db.change() as connection:
            known = self._known(connection, idempotency)
            if known is not None:
                return known, False
            self._db.lock(connection, "mission", mission_id)
            record = self._get(connection, mission_id, None)
            if record.archived_utc is not None:
                raise ConflictError(f"mission {mission_id} is archived; make a new mission")
            self._check_queue(connection, max_queued)
            version, now = record.latest_version + 1, stored_utc(self._clock())
            connection.execute(
                update(missions)
                .where(missions.c.id == mission_id)
                .values(latest_version=version, name=str(document["name"]))
            )
            connection.execute(
                update(mission_versions)
                .where(mission_versions.c.latest_number == record.number)
                .values(latest_number=None, listed_number=None)
            )
            self._add_version(connection, (mission_id, version, record.number), document, now, idempotency)
            return self._get(connection, mission_id, None), True

    def _add_version(
        self,
        connection: Connection,
        latest: tuple[str, int, int],
        document: Mapping[str, Any],
        now: str,
        idempotency: Idempotency | None,
    ) -> None:
        mission_id, version, number = latest
        connection.execute(
            insert(mission_versions).values(
                mission_id=mission_id,
                version=version,
                document=dump(document),
                status="queued",
                phase="queued",
                progress=0.0,
                created_utc=now,
                changed_utc=now,
                latest_number=number,
                listed_number=number,
            )
        )
        if self.on_queued is not None:
            self.on_queued(connection, mission_id, version)
        if idempotency is not None:
            connection.execute(
                insert(idempotency_keys).values(
                    scope=idempotency.scope,
                    key=idempotency.key,
                    request_sha256=idempotency.request_sha256,
                    mission_id=mission_id,
                    version=version,
                    created_utc=now,
                )
            )

    def _known(self, connection: Connection, idempotency: Idempotency | None) -> MissionRecord | None:
        if idempotency is None:
            return None
        self._db.lock(connection, "idempotency", idempotency.scope, idempotency.key)
        found = connection.execute(
            select(idempotency_keys).where(
                idempotency_keys.c.scope == idempotency.scope, idempotency_keys.c.key == idempotency.key
            )
        ).first()
        if found is None:
            return None
        if found.request_sha256 != idempotency.request_sha256:
            raise ConflictError(f"the idempotency key {idempotency.key!r} was used for another request")
        return self._get(connection, found.mission_id, found.version)

    @staticmethod
    def _check_queue(connection: Connection, max_queued: int | None) -> None:
        if max_queued is None:
            return
        waiting = connection.execute(
            select(func.count()).select_from(mission_versions).where(mission_versions.c.status == "queued")
        ).scalar_one()
        if waiting >= max_queued:
            raise QueueFullError(f"{waiting} missions wait for a planner already; try again later")

    # --- reading --------------------------------------------------------------------------------------------

    def get(self, mission_id: str, version: int | None = None) -> MissionRecord:
        """A version, by default the latest. Raises `NotFoundError`."""
        with self._db.read() as connection:
            return self._get(connection, mission_id, version)

    def _get(self, connection: Connection, mission_id: str, version: int | None) -> MissionRecord:
        wanted = missions.c.latest_version if version is None else version
        found = connection.execute(
            select(*_RECORD)
            .select_from(_JOINED)
            .where(missions.c.id == mission_id, mission_versions.c.version == wanted)
        ).first()
        if found is None:
            what = f"mission {mission_id}" if version is None else f"version {version} of mission {mission_id}"
            raise NotFoundError(f"there is no {what}")
        return _record(found._mapping)

    def document(self, mission_id: str, version: int | None = None) -> dict[str, Any]:
        """The mission document of a version. Raises `NotFoundError`."""
        return self._json(mission_id, version, "document") or {}

    def plan(self, mission_id: str, version: int | None = None) -> dict[str, Any] | None:
        """The plan document of a version, None while it has none. Raises `NotFoundError`."""
        return self._json(mission_id, version, "plan")

    def _json(self, mission_id: str, version: int | None, column: str) -> dict[str, Any] | None:
        with self._db.read() as connection:
            record = self._get(connection, mission_id, version)
            text = connection.execute(
                select(mission_versions.c[column]).where(
                    mission_versions.c.mission_id == mission_id, mission_versions.c.version == record.version
                )
            ).scalar_one()
        return None if text is None else load(text, f"the {column} of mission {mission_id}")

    def page(
        self, *, limit: int = 50, before: int | None = None, archived: bool = False, status: str | None = None
    ) -> list[MissionRecord]:
        """Latest versions, newest mission first, at most ``limit``, those with ``number`` below ``before``."""
        order = mission_versions.c.latest_number if archived else mission_versions.c.listed_number
        query = select(*_RECORD).select_from(_JOINED).where(order < (_NEWEST if before is None else before))
        if status is not None:
            query = query.where(mission_versions.c.status == status)
        with self._db.read() as connection:
            return [_record(row._mapping) for row in connection.execute(query.order_by(order.desc()).limit(limit))]

    def versions(self, mission_id: str) -> list[MissionRecord]:
        """Every version of a mission, oldest first. Raises `NotFoundError`."""
        with self._db.read() as connection:
            rows = connection.execute(
                select(*_RECORD)
                .select_from(_JOINED)
                .where(missions.c.id == mission_id)
                .order_by(mission_versions.c.version)
            ).all()
        if not rows:
            raise NotFoundError(f"there is no mission {mission_id}")
        return [_record(row._mapping) for row in rows]

    def counts(self) -> dict[str, int]:
        """How many versions there are in every status."""
        with self._db.read() as connection:
            rows = connection.execute(
                select(mission_versions.c.status, func.count()).group_by(mission_versions.c.status)
            ).all()
        return {**dict.fromkeys(STATUSES, 0), **{str(status): int(count) for status, count in rows}}

    # --- ending ---------------------------------------------------------------------------------------------

    def archive(self, mission_id: str) -> MissionRecord:
        """Put a mission away; what still waited for a plan is given up. Twice does no harm.

        Raises `NotFoundError`, and `ConflictError` while a flight that has not ended uses it.
        """
        with self._db.change() as connection:
            self._db.lock(connection, "mission", mission_id)
            record = self._get(connection, mission_id, None)
            if record.archived_utc is not None:
                return record
            using = connection.execute(
                select(flights.c.id).where(flights.c.mission_id == mission_id, flights.c.ended_utc.is_(None))
            ).first()
            if using is not None:
                raise ConflictError(f"flight {using.id} uses mission {mission_id} and has not ended")
            now = stored_utc(self._clock())
            connection.execute(update(missions).where(missions.c.id == mission_id).values(archived_utc=now))
            connection.execute(
                update(mission_versions)
                .where(mission_versions.c.latest_number == record.number)
                .values(listed_number=None)
            )
            self._give_up(connection, mission_id, None, "archived", now)
            return self._get(connection, mission_id, None)

    def cancel(self, mission_id: str, version: int | None = None) -> bool:
        """Give up the planning of a version that is not done yet; whether there was anything to give up."""
        with self._db.change() as connection:
            record = self._get(connection, mission_id, version)
            return self._give_up(connection, mission_id, record.version, "cancelled", stored_utc(self._clock())) > 0

    def plan_again(
        self, mission_id: str, version: int | None = None, *, max_queued: int | None = None
    ) -> MissionRecord:
        """Queue a version whose planning failed or was cancelled once more.

        Raises `ConflictError` for one in another state or of an archived mission, `QueueFullError` as `add`.
        """
        with self._db.change() as connection:
            self._db.lock(connection, "mission", mission_id)
            record = self._get(connection, mission_id, version)
            if record.archived_utc is not None:
                raise ConflictError(f"mission {mission_id} is archived; make a new mission")
            if record.status != "failed":
                raise ConflictError(f"mission {mission_id} is {record.status}; only a planning that failed is repeated")
            self._check_queue(connection, max_queued)
            connection.execute(
                update(mission_versions)
                .where(mission_versions.c.mission_id == mission_id, mission_versions.c.version == record.version)
                .values(
                    status="queued",
                    phase="queued",
                    progress=0.0,
                    error=None,
                    owner=None,
                    changed_utc=stored_utc(self._clock()),
                )
            )
            if self.on_queued is not None:
                self.on_queued(connection, mission_id, record.version)
            return self._get(connection, mission_id, record.version)

    def _give_up(self, connection: Connection, mission_id: str, version: int | None, why: str, now: str) -> int:
        query = update(mission_versions).where(
            mission_versions.c.mission_id == mission_id, mission_versions.c.status.in_(("queued", "planning"))
        )
        if version is not None:
            query = query.where(mission_versions.c.version == version)
        values = {"status": "failed", "phase": why, "error": f"planning was {why}", "owner": None, "changed_utc": now}
        given_up = connection.execute(query.values(values).returning(mission_versions.c.version)).scalars().all()
        for one in given_up:
            if self.on_given_up is not None:
                self.on_given_up(connection, mission_id, int(one))
        return len(given_up)


def _record(row: RowMapping) -> MissionRecord:
    values: dict[str, Any] = {str(key): value for key, value in row.items()}
    found = values["infeasibility"]
    if found is not None:
        kept = load_for_list(found, f"why mission {values['id']} has no plan")
        values["infeasibility"] = kept or {"message": "why there is no plan cannot be read any more; plan it again"}
    return MissionRecord(**values)
