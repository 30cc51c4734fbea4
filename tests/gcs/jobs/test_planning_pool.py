"""Planning in real processes that are stopped, killed and cancelled at work; nothing is lost, nothing stays behind."""

from __future__ import annotations

import os
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from gcs.errors import MissionError, MissionInfeasible, PlanningCancelled, PlanningFailed
from gcs.jobs.planning_pool import PlanningPool, release_dead, this_owner
from gcs.jobs.worker_pool import WorkerPool
from gcs.mission import read_mission, write_mission
from gcs.mission.document import parse_mission_json
from gcs.plan import read_plan
from gcs.planning.mission_planning import plan_mission
from gcs.store.missions import MissionRecord
from gcs.store.store import Store
from tests.support.missions.infeasible import local
from tests.support.missions.malformed import GOOD
from tests.support.paths import ROOT
from tests.support.processes.tree import alive

DOCUMENT = write_mission(read_mission(GOOD))
LONGER = write_mission(
    parse_mission_json((ROOT / "sitl_fixtures" / "missions" / "paper_like" / "M30_02.json").read_bytes())
)


def wait_for(what: Callable[[], Any], limit_s: float = 60.0) -> Any:
    """The first true value of ``what()``."""
    end = time.monotonic() + limit_s
    while time.monotonic() < end:
        value = what()
        if value:
            return value
        time.sleep(0.01)
    raise AssertionError("waited in vain")


@pytest.fixture(scope="module")
def shared_pool() -> Iterator[WorkerPool]:
    made = WorkerPool(1, limit_s=60.0)
    made.start()
    yield made
    pids = made.pids
    made.stop()
    assert not any(alive(pid) for pid in pids)


@pytest.fixture
def pool(shared_pool: WorkerPool) -> WorkerPool:
    """One warm process; the pool lives on from test to test, as it does through a day's work."""
    wait_for(lambda: shared_pool.ready and not shared_pool.busy)
    shared_pool.restarts = shared_pool.timeouts = 0
    return shared_pool


def test_a_worker_plans_what_this_process_plans(pool: WorkerPool) -> None:
    told: list[tuple[str, float]] = []
    job = pool.submit(DOCUMENT, on_progress=lambda *step: told.append(step))
    plan = read_plan(job.future.result(60))
    assert plan.plan_sha256 == plan_mission(read_mission(DOCUMENT)).plan_sha256
    assert [phase for phase, _ in told] == ["preparing", "planning", "scheduling", "done"]


def test_errors_cross_over_whole(pool: WorkerPool) -> None:
    broken = write_mission(read_mission(local(stations__1__east_m=2500.0, destination__east_m=2500.0)))
    with pytest.raises(MissionInfeasible) as caught:
        pool.submit(broken).future.result(60)
    assert caught.value.stations == ("A", "B")
    assert caught.value.gap_m == pytest.approx(510.03, abs=0.01)
    with pytest.raises(MissionError) as bad:
        pool.submit({**DOCUMENT, "start": {}}).future.result(60)
    assert bad.value.problems[0].where == "start.lat_deg"
    assert pool.restarts == 0


@pytest.mark.slow
def test_a_hung_worker_is_killed_and_the_mission_planned_otherwise(pool: WorkerPool) -> None:
    """A stopped process is as hung as one can be: it answers nothing and dies of nothing but SIGKILL."""
    (hung,) = pool.pids
    os.kill(hung, signal.SIGSTOP)
    plan = read_plan(pool.submit(DOCUMENT, limit_s=2.0).future.result(60))
    assert plan.method == "paper"
    assert "took longer than 2 s" in plan.notes[0]
    assert plan.certificate.feasible
    assert not alive(hung)
    assert pool.pids != [hung]
    assert (pool.timeouts, pool.restarts) == (1, 1)


def test_a_crashed_worker_is_replaced_and_the_mission_planned_again(pool: WorkerPool) -> None:
    (first,) = pool.pids

    def kill_at_work(phase: str, _: float) -> None:
        if phase == "planning" and alive(first):
            os.kill(first, signal.SIGKILL)

    job = pool.submit(LONGER, on_progress=kill_at_work)
    usual = pool.submit(DOCUMENT)
    plan = read_plan(job.future.result(120))
    assert plan.method == "paper"
    assert "ended (signal 9)" in plan.notes[0]
    assert pool.restarts == 1
    # the next mission is planned the usual way
    assert read_plan(usual.future.result(60)).method == "joint"


def test_a_mission_that_kills_twice_fails(pool: WorkerPool) -> None:
    """Whoever takes it dies: after the second time it is given up, and the pool lives on."""
    job = pool.submit(LONGER, limit_s=0.01)
    with pytest.raises(PlanningFailed, match=r"longer than 0\.01 s, the second attempt"):
        job.future.result(60)
    assert pool.timeouts == 2


def test_cancelled_at_work_and_in_the_queue(pool: WorkerPool) -> None:
    (pid,) = pool.pids
    os.kill(pid, signal.SIGSTOP)  # it will be at work for as long as we like
    at_work, queued = pool.submit(LONGER), pool.submit(LONGER)
    wait_for(lambda: pool.busy)
    pool.cancel(queued)
    pool.cancel(at_work)
    for job in (queued, at_work):
        with pytest.raises(PlanningCancelled):
            job.future.result(30)
    wait_for(lambda: not alive(pid))


@pytest.mark.slow
def test_stop_ends_every_process_and_answers_everybody() -> None:
    pool = WorkerPool(2)
    pool.start()
    wait_for(lambda: pool.ready == 2)
    pids = pool.pids
    jobs = [pool.submit(LONGER) for _ in range(4)]
    wait_for(lambda: pool.busy == 2)
    pool.stop()
    assert not any(alive(pid) for pid in pids)
    for job in [*jobs, pool.submit(DOCUMENT)]:
        with pytest.raises(PlanningCancelled, match="shutting down"):
            job.future.result(1)


def test_grace_lets_work_finish() -> None:
    pool = WorkerPool(1)
    pool.start()
    wait_for(lambda: pool.ready)
    job = pool.submit(DOCUMENT)
    wait_for(lambda: pool.busy)
    pool.stop(grace_s=60.0)
    assert read_plan(job.future.result(0)).certificate.feasible


def test_a_pool_needs_sense() -> None:
    with pytest.raises(ValueError, match="positive"):
        WorkerPool(0)
    with pytest.raises(ValueError, match="positive"):
        WorkerPool(1, limit_s=0.0)


# --- with the store --------------------------------------------------------------------------------------------


@pytest.fixture
def url(tmp_path: Path) -> str:
    return f"sqlite:///{tmp_path / 'skyrelay.db'}"


def settled(store: Store, mission_id: str) -> MissionRecord | None:
    record = store.missions.get(mission_id)
    return record if record.status in ("planned", "infeasible", "failed") else None


def stop_workers(pool: PlanningPool) -> None:
    """The pool's processes, once warm, stand still: whatever they take stays at work."""
    wait_for(lambda: pool.workers is not None and pool.workers.ready)
    assert pool.workers is not None
    for pid in pool.workers.pids:
        os.kill(pid, signal.SIGSTOP)


@pytest.mark.slow
def test_missions_in_the_store_get_planned(url: str) -> None:
    changes: list[MissionRecord] = []
    with Store(url) as store:
        waiting, _ = store.missions.add(DOCUMENT)  # queued before the pool starts
        pool = PlanningPool(store, processes=1, on_change=changes.append)
        pool.start()
        hopeless, _ = store.missions.add(write_mission(read_mission(local(start__east_m=-1200.0))))
        pool.wake()
        good = wait_for(lambda: settled(store, waiting.id))
        bad = wait_for(lambda: settled(store, hopeless.id))
        assert pool.ready
        assert pool.stats()["processes"] == 1
        answer = pool.plan(DOCUMENT).result(60)
        pool.stop()
        assert (good.status, bad.status) == ("planned", "infeasible")
        plan = read_plan(store.missions.plan(waiting.id))
        assert plan.plan_sha256 == good.plan_sha256 == answer["plan_sha256"]
        assert bad.infeasibility is not None
        assert bad.infeasibility["reason"] == "start_uncovered"
        seen = [(c.status, c.phase) for c in changes if c.id == waiting.id]
        assert seen[0] == ("planning", "preparing")
        assert seen[-1] == ("planned", "planned")
        assert ("planning", "scheduling") in seen
        progress = [c.progress for c in changes if c.id == waiting.id]
        assert progress == sorted(progress)


@pytest.mark.slow
def test_cancel_through_the_store(url: str) -> None:
    with Store(url) as store:
        pool = PlanningPool(store, processes=1)
        pool.start()
        stop_workers(pool)
        record, _ = store.missions.add(LONGER)
        pool.wake()
        wait_for(lambda: store.missions.get(record.id).status == "planning")
        assert pool.cancel(record.id)
        assert not pool.cancel(record.id)
        other, _ = store.missions.add(DOCUMENT)
        pool.wake()
        assert wait_for(lambda: settled(store, other.id)).status == "planned"
        assert store.missions.get(record.id).phase == "cancelled"
        pool.stop()


def test_stopping_queues_again_what_was_being_planned(url: str) -> None:
    with Store(url) as store:
        pool = PlanningPool(store, processes=1)
        pool.start()
        stop_workers(pool)
        record, _ = store.missions.add(LONGER)
        pool.wake()
        wait_for(lambda: store.missions.get(record.id).status == "planning")
        pool.stop()
        assert store.missions.get(record.id).status == "queued"
        assert store.queue.owners() == []


def test_results_wait_for_a_locked_database(url: str, tmp_path: Path) -> None:
    """The database is locked while a plan comes in: it is stored as soon as the lock is gone."""
    with Store(url, lock_timeout_s=0.1) as store:
        record, _ = store.missions.add(DOCUMENT)
        pool = PlanningPool(store, processes=1, poll_s=0.05)
        pool.start()
        wait_for(lambda: store.missions.get(record.id).status == "planning")
        holder = sqlite3.connect(tmp_path / "skyrelay.db", isolation_level=None, timeout=10)
        holder.execute("BEGIN IMMEDIATE")
        assert pool.workers is not None
        wait_for(lambda: pool.workers is not None and not pool.workers.busy)
        time.sleep(0.3)
        held = store.missions.get(record.id).status
        holder.execute("ROLLBACK")
        holder.close()
        assert wait_for(lambda: settled(store, record.id)).status == "planned"
        pool.stop()
        assert held in ("planning", "planned")  # planned only if the plan came in before the lock


@pytest.mark.slow
def test_killed_service_leaves_no_process_and_its_mission_is_planned_by_the_next(url: str) -> None:
    """SIGKILL to the service while it plans: its workers die with it, and a new one takes the mission up at once."""
    with Store(url) as store:
        service = subprocess.Popen(
            [sys.executable, "-m", "tests.support.processes.jobs_owner", url],
            cwd=ROOT,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert service.stdout is not None
        pids = [int(pid) for pid in service.stdout.readline().split()]
        assert len(pids) == 2
        # One worker hangs, so that the mission is certainly still at work when the service dies.
        for pid in pids:
            os.kill(pid, signal.SIGSTOP)
        record, _ = store.missions.add(DOCUMENT)
        wait_for(lambda: store.missions.get(record.id).status == "planning")
        service.kill()
        service.wait()
        service.stdout.close()
        wait_for(lambda: not any(alive(pid) for pid in pids), 20.0)
        pool = PlanningPool(store, processes=1)
        pool.start()
        assert wait_for(lambda: settled(store, record.id)).status == "planned"
        pool.stop()


def test_a_living_planner_is_not_robbed(url: str) -> None:
    with Store(url) as store:
        store.missions.add(DOCUMENT)
        owner = this_owner()
        assert store.queue.claim(owner, 600.0)
        assert release_dead(store) == 0
        dead = subprocess.run([sys.executable, "-c", "import os; print(os.getpid())"], capture_output=True, text=True)
        parts = owner.split("/")
        store.queue.release(owner=owner)
        assert store.queue.claim("/".join([parts[0], dead.stdout.strip(), "1", parts[3]]), 600.0)
        assert release_dead(store) == 1
        # another machine's planner can only be judged by its lease
        assert store.queue.claim("elsewhere/1/1/x", 600.0)
        assert release_dead(store) == 0


def test_a_service_without_planners_still_answers(url: str) -> None:
    with Store(url) as store:
        pool = PlanningPool(store, processes=0)
        pool.start()
        assert pool.ready
        with pytest.raises(PlanningCancelled, match="no planning processes"):
            pool.plan(DOCUMENT)
        record, _ = store.missions.add(DOCUMENT)
        assert pool.cancel(record.id)
        pool.stop()
