"""Which jobs go with which database."""

from __future__ import annotations

from gcs.jobs.local_jobs import LocalJobs
from gcs.jobs.planning_jobs import OnChange, PlanningJobs
from gcs.store.store import Store


def open_jobs(
    store: Store,
    *,
    processes: int = 1,
    replan_processes: int = 1,
    limit_s: float = 60.0,
    silence_s: float = 15.0,
    on_change: OnChange | None = None,
) -> PlanningJobs:
    """The jobs of a store: one service's own on SQLite, those of many services and workers on PostgreSQL.

    Processes and ``on_change`` are `PlanningJobs`'; ``silence_s`` is how long a service or worker on PostgreSQL may be
    silent before others take over what it was planning.
    """
    if store.database.is_sqlite:
        return LocalJobs(
            store, processes=processes, replan_processes=replan_processes, limit_s=limit_s, on_change=on_change
        )
    # Imported here: whoever keeps missions in a file does not pay for it.
    from gcs.jobs.shared_jobs import SharedJobs

    return SharedJobs(
        store,
        processes=processes,
        replan_processes=replan_processes,
        limit_s=limit_s,
        silence_s=silence_s,
        on_change=on_change,
    )
