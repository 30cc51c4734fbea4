"""A service with planning processes that plans for ever; it is there to be killed.

``python -m tests.support.processes.jobs_owner URL``: prints the ids of its planning processes once they
are warm, then waits.
"""

from __future__ import annotations

import sys
import time

from gcs.jobs.planning_pool import PlanningPool
from gcs.store.store import Store


def main() -> None:
    pool = PlanningPool(Store(sys.argv[1]), processes=2, lease_s=600.0)
    pool.start()
    assert pool.workers is not None
    while pool.workers.ready < 2:
        time.sleep(0.01)
    print(*pool.workers.pids, flush=True)
    time.sleep(600.0)


if __name__ == "__main__":
    main()
