"""The queue planners take missions from.

A version goes queued -> planning -> planned | infeasible | failed. A planner owns a version by a lease it renews;
what is still ``planning`` when its lease has run out belonged to a planner that died, and is queued again.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import timedelta
from typing import Any

from sqlalchemy import select, update

from gcs.errors import MissionInfeasible, StoreUnavailable
from gcs.store.database import Database
from gcs.store.documents import dump, load
from gcs.store.missions import Clock, stored_utc
from gcs.store.tables import mission_versions


@dataclass(frozen=True)
class Claim:
    """A version taken for planning."""

    mission_id: str
    version: int
    document: dict[str, Any]


class PlanningQueue:
    """Versions that wait for a planner. Every method raises `StoreUnavailable` when the database cannot be used."""

    def __init__(self, database: Database, clock: Clock) -> None:
        self._db = database
        self._clock = clock

    def claim(self, owner: str, lease_s: float) -> Claim | None:
        """Take the version that has waited longest, for ``lease_s`` seconds; None when none waits.

        One whose document cannot be read has failed: it must not stand in the way of those behind it.
        """
        while (found := self._take(owner, lease_s)) is not None:
            mission_id, version, text = found
            try:
                return Claim(mission_id, version, load(text, f"the document of mission {mission_id}"))
            except StoreUnavailable as error:
                self.finish_failed(Claim(mission_id, version, {}), owner, str(error))
        return None

    def _take(self, owner: str, lease_s: float) -> tuple[str, int, str] | None:
        with self._db.change() as connection:
            found = connection.execute(
                select(
                    mission_versions.c.number,
                    mission_versions.c.mission_id,
                    mission_versions.c.version,
                    mission_versions.c.document,
                )
                .where(mission_versions.c.status == "queued")
                .order_by(mission_versions.c.number)
                .limit(1)
                # Several planners on PostgreSQL pass each other; SQLite holds its write lock already.
                .with_for_update(skip_locked=True)
            ).first()
            if found is None:
                return None
            now = self._clock()
            connection.execute(
                update(mission_versions)
                .where(mission_versions.c.number == found.number)
                .values(
                    status="planning",
                    phase="preparing",
                    progress=0.0,
                    owner=owner,
                    lease_utc=stored_utc(now + timedelta(seconds=lease_s)),
                    changed_utc=stored_utc(now),
                )
            )
            return str(found.mission_id), int(found.version), str(found.document)

    def renew(self, owner: str, lease_s: float) -> int:
        """Lengthen every lease of ``owner``; how many there are."""
        until = stored_utc(self._clock() + timedelta(seconds=lease_s))
        with self._db.change() as connection:
            return connection.execute(
                update(mission_versions)
                .where(mission_versions.c.owner == owner, mission_versions.c.status == "planning")
                .values(lease_utc=until)
            ).rowcount

    def owners(self) -> list[str]:
        """Who is planning something."""
        with self._db.read() as connection:
            query = select(mission_versions.c.owner).where(mission_versions.c.status == "planning").distinct()
            return [str(owner) for owner in connection.execute(query).scalars() if owner is not None]

    def release(self, *, owner: str | None = None) -> int:
        """Queue again what ``owner`` was planning; without an owner, what leases have run out on. How many."""
        now = stored_utc(self._clock())
        whose = mission_versions.c.owner == owner if owner is not None else mission_versions.c.lease_utc < now
        with self._db.change() as connection:
            return connection.execute(
                update(mission_versions)
                .where(mission_versions.c.status == "planning", whose)
                .values(status="queued", phase="queued", progress=0.0, owner=None, lease_utc=None, changed_utc=now)
            ).rowcount

    def set_progress(self, claim: Claim, owner: str, phase: str, progress: float) -> bool:
        """Note how far the planning is; False when it is no longer ``owner``'s (cancelled, or the lease ran out)."""
        return self._settle(claim, owner, phase=phase, progress=progress)

    def finish(self, claim: Claim, owner: str, plan: Mapping[str, Any]) -> bool:
        """Store the plan; False when the planning is no longer ``owner``'s."""
        handovers = plan.get("handovers")
        return self._settle(
            claim,
            owner,
            status="planned",
            phase="planned",
            progress=1.0,
            plan=dump(plan),
            plan_sha256=str(plan["plan_sha256"]),
            mission_time_s=plan.get("mission_time_s"),
            handover_count=None if handovers is None else len(handovers),
            owner=None,
        )

    def finish_infeasible(self, claim: Claim, owner: str, found: MissionInfeasible) -> bool:
        """Store why there is no plan; as `finish`."""
        return self._settle(
            claim,
            owner,
            status="infeasible",
            phase="infeasible",
            progress=1.0,
            infeasibility=dump(found.to_document()),
            owner=None,
        )

    def finish_failed(self, claim: Claim, owner: str, error: str) -> bool:
        """Store what failed; as `finish`."""
        return self._settle(claim, owner, status="failed", phase="failed", error=error[:10_000], owner=None)

    def _settle(self, claim: Claim, by: str, **values: object) -> bool:
        with self._db.change() as connection:
            done = connection.execute(
                update(mission_versions)
                .where(
                    mission_versions.c.mission_id == claim.mission_id,
                    mission_versions.c.version == claim.version,
                    mission_versions.c.status == "planning",
                    mission_versions.c.owner == by,
                )
                .values(changed_utc=stored_utc(self._clock()), **values)
            )
            return done.rowcount == 1
