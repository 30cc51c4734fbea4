"""What planners do to a version of a mission: the row is the record of its planning.

A version goes queued -> planning -> planned | infeasible | failed. Each attempt at it has a name; once another attempt
has it, or it was cancelled, what the first still has to say changes nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from sqlalchemy import select, update

from gcs.errors import MissionInfeasible, StoreUnavailable
from gcs.store.database import Database
from gcs.store.documents import dump, load
from gcs.store.missions import Clock, stored_utc
from gcs.store.tables import mission_versions

_AGAIN = {"status": "queued", "phase": "queued", "progress": 0.0, "owner": None}


@dataclass(frozen=True)
class Claim:
    """A version taken for planning, by the attempt of that name."""

    mission_id: str
    version: int
    attempt: str
    document: dict[str, Any]


class PlanningStore:
    """How planning stands. Every method raises `StoreUnavailable` when the database cannot be used."""

    def __init__(self, database: Database, clock: Clock) -> None:
        self._db = database
        self._clock = clock

    def take(self, attempt: str) -> Claim | None:
        """Begin the version that has waited longest; None when none waits. Nothing is written while none does.

        One whose document cannot be read has failed: it must not stand in the way of those behind it.
        """
        while True:
            with self._db.read() as connection:
                found = connection.execute(
                    select(mission_versions.c.mission_id, mission_versions.c.version)
                    .where(mission_versions.c.status == "queued")
                    .order_by(mission_versions.c.number)
                    .limit(1)
                ).first()
            if found is None:
                return None
            claim = self.begin(str(found.mission_id), int(found.version), attempt)
            if claim is not None:
                return claim

    def begin(self, mission_id: str, version: int, attempt: str, *, take_over: bool = False) -> Claim | None:
        """Begin a version that is queued; with ``take_over`` one that somebody dead was planning, too.

        None where there is nothing to plan: done, cancelled, another attempt has it, or it cannot be read.
        """
        due = ("queued", "planning") if take_over else ("queued",)
        with self._db.change() as connection:
            text = connection.execute(
                update(mission_versions)
                .where(
                    mission_versions.c.mission_id == mission_id,
                    mission_versions.c.version == version,
                    mission_versions.c.status.in_(due),
                )
                .values(
                    status="planning",
                    phase="preparing",
                    progress=0.0,
                    owner=attempt,
                    changed_utc=stored_utc(self._clock()),
                )
                .returning(mission_versions.c.document)
            ).scalar_one_or_none()
        if text is None:
            return None
        try:
            return Claim(mission_id, version, attempt, load(str(text), f"the document of mission {mission_id}"))
        except StoreUnavailable as error:
            self.finish_failed(Claim(mission_id, version, attempt, {}), str(error))
            return None

    def queue_again(self) -> int:
        """Queue everything that was being planned, by whomever: for the start of the only service. How many."""
        with self._db.change() as connection:
            return connection.execute(
                update(mission_versions)
                .where(mission_versions.c.status == "planning")
                .values(changed_utc=stored_utc(self._clock()), **_AGAIN)
            ).rowcount

    def release(self, claim: Claim) -> bool:
        """Queue it again; False when it is no longer this attempt's."""
        return self._settle(claim, **_AGAIN)

    def set_progress(self, claim: Claim, phase: str, progress: float) -> bool:
        """Note how far the planning is; False when it is no longer this attempt's (cancelled, or taken over)."""
        return self._settle(claim, phase=phase, progress=progress)

    def finish(self, claim: Claim, plan: Mapping[str, Any]) -> bool:
        """Store the plan; False when the planning is no longer this attempt's."""
        handovers = plan.get("handovers")
        return self._settle(
            claim,
            status="planned",
            phase="planned",
            progress=1.0,
            plan=dump(plan),
            plan_sha256=str(plan["plan_sha256"]),
            mission_time_s=plan.get("mission_time_s"),
            handover_count=None if handovers is None else len(handovers),
            owner=None,
        )

    def finish_infeasible(self, claim: Claim, found: MissionInfeasible) -> bool:
        """Store why there is no plan; as `finish`."""
        return self._settle(
            claim,
            status="infeasible",
            phase="infeasible",
            progress=1.0,
            infeasibility=dump(found.to_document()),
            owner=None,
        )

    def finish_failed(self, claim: Claim, error: str) -> bool:
        """Store what failed; as `finish`."""
        return self._settle(claim, status="failed", phase="failed", error=error[:10_000], owner=None)

    def _settle(self, claim: Claim, **values: object) -> bool:
        with self._db.change() as connection:
            done = connection.execute(
                update(mission_versions)
                .where(
                    mission_versions.c.mission_id == claim.mission_id,
                    mission_versions.c.version == claim.version,
                    mission_versions.c.status == "planning",
                    mission_versions.c.owner == claim.attempt,
                )
                .values(changed_utc=stored_utc(self._clock()), **values)
            )
            return done.rowcount == 1
