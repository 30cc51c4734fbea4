"""The store on SQLite and on PostgreSQL: what was said to be kept is kept, and nothing else happens."""

from __future__ import annotations

import sqlite3
import subprocess
import sys
import threading
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import text
from sqlalchemy.exc import IntegrityError

from gcs.errors import ConflictError, MissionInfeasible, NotFoundError, QueueFullError, StoreUnavailable
from gcs.flight import EventKind, FlightEvent, FlightState
from gcs.mission import read_mission, write_mission
from gcs.settings import Settings
from gcs.store.database import HEAD
from gcs.store.missions import Idempotency
from gcs.store.store import Store
from gcs.store.tables import metadata
from tests.support.missions.malformed import GOOD, GOOD_LOCAL
from tests.support.paths import ROOT
from tests.support.processes.store_backends import Backend

DOCUMENT = write_mission(read_mission(GOOD))
HASH = "a" * 64


class Clock:
    def __init__(self) -> None:
        self.now = datetime(2026, 11, 22, 9, 0, tzinfo=UTC)

    def __call__(self) -> datetime:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


on_sqlite = pytest.mark.parametrize("backend", ["sqlite"], indirect=True)


@pytest.fixture
def url(backend: Backend) -> str:
    return backend.url


@pytest.fixture
def store(url: str, clock: Clock) -> Iterator[Store]:
    with Store(url, clock=clock, lock_timeout_s=0.3) as opened:
        yield opened


def planned(store: Store) -> str:
    """A mission with a plan of hash `HASH`."""
    record, _ = store.missions.add(DOCUMENT)
    claim = store.queue.claim("me", 30.0)
    assert claim is not None
    assert store.queue.finish(claim, "me", {"plan_sha256": HASH, "x": 1.0000000000000002})
    return record.id


# --- the database ----------------------------------------------------------------------------------------------


@on_sqlite
def test_settings_of_the_file(store: Store) -> None:
    """Write-ahead log, synced on every commit, foreign keys on."""
    with store.database.read() as connection:
        assert connection.execute(text("PRAGMA journal_mode")).scalar_one() == "wal"
        assert connection.execute(text("PRAGMA synchronous")).scalar_one() == 2
        assert connection.execute(text("PRAGMA foreign_keys")).scalar_one() == 1


def test_migrations_make_the_tables_the_code_speaks_of(store: Store) -> None:
    """No difference between gcs/store/tables.py and what the migrations built, as Alembic sees it."""
    from alembic.autogenerate import compare_metadata
    from alembic.migration import MigrationContext

    with store.database.read() as connection:
        differences = compare_metadata(MigrationContext.configure(connection), metadata)
    assert differences == []


def test_opening_again_changes_nothing(url: str, store: Store) -> None:
    mission_id = planned(store)
    with Store(url) as again:
        assert again.database.revision() == HEAD
        assert again.missions.plan(mission_id) == {"plan_sha256": HASH, "x": 1.0000000000000002}


def test_two_programs_may_open_a_new_database_at_once(url: str) -> None:
    errors: list[BaseException] = []

    def open_it() -> None:
        try:
            Store(url).close()
        except BaseException as error:
            errors.append(error)

    threads = [threading.Thread(target=open_it) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert errors == []


@pytest.mark.parametrize(
    "bad", ["sqlite://", "nonsense", "sqlite:////no/such/folder/x.db", "martian://localhost/db", "sqlite:///:memory:"]
)
def test_addresses_that_cannot_work_are_refused(bad: str) -> None:
    with pytest.raises(StoreUnavailable):
        Store(bad)


def test_a_file_that_is_no_database_is_told(tmp_path: Path) -> None:
    path = tmp_path / "skyrelay.db"
    path.write_bytes(b"this is no database, and never was one" * 100)
    with pytest.raises(StoreUnavailable, match="not a database"):
        Store(f"sqlite:///{path}")


def test_a_locked_database_is_told_and_nothing_is_half_done(backend: Backend, store: Store) -> None:
    with backend.held():
        with pytest.raises(StoreUnavailable, match="locked"):
            store.missions.add(DOCUMENT)
        assert store.missions.page() == []  # reading goes on
    store.missions.add(DOCUMENT)
    assert len(store.missions.page()) == 1


@on_sqlite
def test_a_full_disk_is_told_and_what_was_kept_stays(store: Store) -> None:
    """SQLite may use no more pages: the next mission is refused as a whole, the ones before are all there."""
    store.missions.add(DOCUMENT)
    with store.database.engine.connect() as connection:
        pages = connection.exec_driver_sql("PRAGMA page_count").scalar_one()
        connection.exec_driver_sql(f"PRAGMA max_page_count={pages + 3}")
    kept = 1
    with pytest.raises(StoreUnavailable, match="full"):  # noqa: PT012 - which one is refused is the disk's affair
        for _ in range(100):
            store.missions.add(DOCUMENT)
            kept += 1
    assert kept < 50
    assert len(store.missions.page(limit=1000)) == kept
    assert store.missions.counts()["queued"] == kept


@on_sqlite
def test_a_damaged_file_is_told(tmp_path: Path, url: str) -> None:
    with Store(url) as store:
        for _ in range(20):
            store.missions.add(DOCUMENT)
        with store.database.engine.connect() as connection:
            connection.exec_driver_sql("PRAGMA wal_checkpoint(TRUNCATE)")
    raw = bytearray((tmp_path / "skyrelay.db").read_bytes())
    for page in range(4096, len(raw), 4096):
        raw[page : page + 64] = b"\xff" * 64
    (tmp_path / "skyrelay.db").write_bytes(raw)
    with pytest.raises(StoreUnavailable, match=r"malformed|not a database"), Store(url) as store:
        store.missions.page(limit=1000)


@on_sqlite
def test_safety_copy_while_in_use(tmp_path: Path, store: Store) -> None:
    mission_id = planned(store)
    store.backup_to(tmp_path / "copy.db")
    store.missions.add(DOCUMENT)
    with Store(f"sqlite:///{tmp_path / 'copy.db'}") as copy:
        assert [m.id for m in copy.missions.page()] == [mission_id]
        assert copy.missions.plan(mission_id) == store.missions.plan(mission_id)
    with pytest.raises(StoreUnavailable, match="cannot copy"):
        store.backup_to(tmp_path / "no" / "folder.db")
    assert not list(tmp_path.glob("*.part"))


# --- missions --------------------------------------------------------------------------------------------------


def test_a_mission_is_kept_to_the_last_digit(store: Store) -> None:
    document = write_mission(read_mission({**GOOD_LOCAL, "name": "Ünï → 日本"}))
    document["start"]["east_m"] = 0.1 + 0.2  # type: ignore[index]
    record, new = store.missions.add(document)
    assert new
    assert (record.version, record.status, record.progress) == (1, "queued", 0.0)
    assert store.missions.document(record.id) == document
    assert store.missions.plan(record.id) is None
    assert record.created_utc == "2026-11-22T09:00:00.000000Z"


def test_versions(store: Store) -> None:
    first, _ = store.missions.add(DOCUMENT)
    second, _ = store.missions.add_version(first.id, {**DOCUMENT, "name": "Again"})
    assert (second.version, second.latest_version, second.name) == (2, 2, "Again")
    assert store.missions.get(first.id).version == 2
    assert store.missions.get(first.id, 1).version == 1
    assert [v.version for v in store.missions.versions(first.id)] == [1, 2]
    assert store.missions.document(first.id, 1)["name"] == "Den Helder to Texel"
    for wrong in (3, 0):
        with pytest.raises(NotFoundError, match="version"):
            store.missions.get(first.id, wrong)
    for call in (store.missions.get, store.missions.document, store.missions.versions, store.missions.archive):
        with pytest.raises(NotFoundError):
            call("nowhere")


def test_an_idempotency_key_makes_one_mission(store: Store) -> None:
    key = Idempotency("alice", "k1", "h1")
    first, new = store.missions.add(DOCUMENT, idempotency=key)
    again, new_again = store.missions.add(DOCUMENT, idempotency=key)
    assert (new, new_again, again.id) == (True, False, first.id)
    with pytest.raises(ConflictError, match="another request"):
        store.missions.add(DOCUMENT, idempotency=Idempotency("alice", "k1", "h2"))
    other, _ = store.missions.add(DOCUMENT, idempotency=Idempotency("bob", "k1", "h2"))
    assert other.id != first.id
    third, new = store.missions.add_version(first.id, DOCUMENT, idempotency=Idempotency("alice", "v2", "h"))
    assert (third.version, new) == (2, True)
    assert store.missions.add_version(first.id, DOCUMENT, idempotency=Idempotency("alice", "v2", "h"))[0].version == 2
    assert len(store.missions.page()) == 2


def test_many_at_once_with_one_key_make_one(url: str) -> None:
    """Eight threads send the same request: one mission, and everybody gets it."""
    with Store(url, lock_timeout_s=20.0) as store:
        results: list[str] = []

        def send() -> None:
            results.append(store.missions.add(DOCUMENT, idempotency=Idempotency("a", "k", "h"))[0].id)

        threads = [threading.Thread(target=send) for _ in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert len(results) == 8
        assert len(set(results)) == 1
        assert len(store.missions.page()) == 1


def test_pages_are_complete_whatever_is_added_meanwhile(store: Store) -> None:
    ids = [store.missions.add(DOCUMENT)[0].id for _ in range(7)]
    seen: list[str] = []
    before = None
    while page := store.missions.page(limit=3, before=before):
        seen += [m.id for m in page]
        before = page[-1].number
        store.missions.add(DOCUMENT)  # newer ones do not shift what is still to come
    assert seen == ids[::-1]


def test_a_full_queue_takes_no_more(store: Store) -> None:
    for _ in range(3):
        store.missions.add(DOCUMENT, max_queued=3)
    with pytest.raises(QueueFullError, match="3 missions wait"):
        store.missions.add(DOCUMENT, max_queued=3)
    with pytest.raises(QueueFullError):
        store.missions.add_version(store.missions.page()[0].id, DOCUMENT, max_queued=3)
    assert store.queue.claim("me", 30.0) is not None
    store.missions.add(DOCUMENT, max_queued=3)


def test_archive(store: Store) -> None:
    kept, _ = store.missions.add(DOCUMENT)
    gone, _ = store.missions.add(DOCUMENT)
    record = store.missions.archive(gone.id)
    assert record.archived_utc is not None
    assert (record.status, record.phase) == ("failed", "archived")
    assert store.missions.archive(gone.id).archived_utc == record.archived_utc
    assert [m.id for m in store.missions.page()] == [kept.id]
    assert len(store.missions.page(archived=True)) == 2
    with pytest.raises(ConflictError, match="archived"):
        store.missions.add_version(gone.id, DOCUMENT)
    claim = store.queue.claim("me", 30.0)
    assert claim is not None
    assert claim.mission_id == kept.id
    assert store.queue.claim("me", 30.0) is None


def test_a_mission_in_flight_is_not_archived(store: Store) -> None:
    mission_id = planned(store)
    flight = store.flights.add(mission_id=mission_id, version=1, plan_sha256=HASH, vehicle_id="v")
    with pytest.raises(ConflictError, match=flight.id):
        store.missions.archive(mission_id)
    store.flights.append(flight.id, event(1, FlightState.REFUSED))
    assert store.missions.archive(mission_id).archived_utc is not None


# --- the queue -------------------------------------------------------------------------------------------------


def test_first_come_first_planned(store: Store) -> None:
    ids = [store.missions.add({**DOCUMENT, "name": f"m{k}"})[0].id for k in range(3)]
    claims = [store.queue.claim("me", 30.0) for _ in range(4)]
    assert [c and c.mission_id for c in claims] == [*ids, None]
    assert claims[0] is not None
    assert claims[0].document == {**DOCUMENT, "name": "m0"}
    assert store.missions.counts() == {"queued": 0, "planning": 3, "planned": 0, "infeasible": 0, "failed": 0}


def test_what_becomes_of_a_claim(store: Store) -> None:
    for _ in range(3):
        store.missions.add(DOCUMENT)
    done, impossible, broken = (store.queue.claim("me", 30.0) for _ in range(3))
    assert done
    assert impossible
    assert broken
    assert store.queue.set_progress(done, "me", "planning", 0.4)
    record = store.missions.get(done.mission_id)
    assert (record.status, record.phase, record.progress) == ("planning", "planning", 0.4)
    assert store.queue.finish(done, "me", {"plan_sha256": HASH})
    error = MissionInfeasible("broken_chain", "No chain.", gap_m=12.5, fix={"action": "raise_range", "by_m": 12.5})
    assert store.queue.finish_infeasible(impossible, "me", error)
    assert store.queue.finish_failed(broken, "me", "x" * 20_000)
    assert store.missions.get(done.mission_id).plan_sha256 == HASH
    found = store.missions.get(impossible.mission_id)
    assert found.status == "infeasible"
    assert found.infeasibility == error.to_document()
    assert len(store.missions.get(broken.mission_id).error or "") == 10_000
    assert [m.id for m in store.missions.page(status="planned")] == [done.mission_id]


def test_only_the_owner_settles(store: Store) -> None:
    record, _ = store.missions.add(DOCUMENT)
    claim = store.queue.claim("me", 30.0)
    assert claim
    assert not store.queue.finish(claim, "you", {"plan_sha256": HASH})
    assert store.missions.cancel(record.id)
    assert not store.missions.cancel(record.id)
    assert not store.queue.set_progress(claim, "me", "planning", 0.5)
    assert not store.queue.finish(claim, "me", {"plan_sha256": HASH})
    assert (store.missions.get(record.id).status, store.missions.get(record.id).error) == (
        "failed",
        "planning was cancelled",
    )


def test_leases_run_out(store: Store, clock: Clock) -> None:
    store.missions.add(DOCUMENT)
    claim = store.queue.claim("dead", 30.0)
    assert claim
    clock.now += timedelta(seconds=29)
    assert store.queue.release() == 0
    assert store.queue.renew("dead", 30.0) == 1
    clock.now += timedelta(seconds=29)
    assert store.queue.release() == 0
    clock.now += timedelta(seconds=2)
    assert store.queue.release() == 1
    assert store.queue.owners() == []
    again = store.queue.claim("alive", 30.0)
    assert again
    assert again.mission_id == claim.mission_id
    # the first one wakes up late: too late
    assert not store.queue.finish(claim, "dead", {"plan_sha256": HASH})
    assert store.queue.finish(again, "alive", {"plan_sha256": HASH})


def test_planners_never_get_the_same_mission(url: str) -> None:
    with Store(url, lock_timeout_s=20.0) as store:
        for _ in range(30):
            store.missions.add(DOCUMENT)
        taken: list[str] = []

        def take(owner: str) -> None:
            with Store(url, lock_timeout_s=20.0) as own:
                while claim := own.queue.claim(owner, 30.0):
                    taken.append(claim.mission_id)

        threads = [threading.Thread(target=take, args=(f"p{k}",)) for k in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert len(taken) == len(set(taken)) == 30


# --- registries ------------------------------------------------------------------------------------------------


def test_registry(store: Store) -> None:
    entry, new = store.registry.put("vehicle", "v1", {"name": "Kestrel"})
    assert (entry.revision, new) == (1, True)
    entry, new = store.registry.put("vehicle", "v1", {"name": "Kestrel 2"}, revision=1)
    assert (entry.revision, new, entry.document) == (2, False, {"name": "Kestrel 2"})
    with pytest.raises(ConflictError, match="revision 2, not 1"):
        store.registry.put("vehicle", "v1", {}, revision=1)
    with pytest.raises(ConflictError):
        store.registry.put("vehicle", "v1", {}, revision=0)
    for k in range(5):
        store.registry.put("link", f"l{k}", {"url": "udpout:127.0.0.1:14550"}, revision=0)
    assert [e.id for e in store.registry.page("link", limit=2, after="l1")] == ["l2", "l3"]
    assert [e.id for e in store.registry.page("vehicle")] == ["v1"]
    store.registry.remove("vehicle", "v1")
    for call in (lambda: store.registry.get("vehicle", "v1"), lambda: store.registry.remove("vehicle", "v1")):
        with pytest.raises(NotFoundError):
            call()
    with pytest.raises(ValueError, match="no registry"):
        store.registry.page("rocket")


# --- flights ---------------------------------------------------------------------------------------------------


def event(sequence: int, state: FlightState = FlightState.CRUISE, **data: Any) -> FlightEvent:
    return FlightEvent(sequence, EventKind.STATE, 0.1, None, "2026-11-22T09:00:00.000Z", state, data)


def test_a_flight_needs_the_very_plan(store: Store) -> None:
    mission_id = planned(store)
    with pytest.raises(ConflictError, match="not b"):
        store.flights.add(mission_id=mission_id, version=1, plan_sha256="b" * 64, vehicle_id="v")
    with pytest.raises(NotFoundError):
        store.flights.add(mission_id=mission_id, version=9, plan_sha256=HASH, vehicle_id="v")
    queued, _ = store.missions.add(DOCUMENT)
    with pytest.raises(ConflictError, match="queued, not planned"):
        store.flights.add(mission_id=queued.id, version=1, plan_sha256=HASH, vehicle_id="v")
    flight = store.flights.add(
        mission_id=mission_id, version=1, plan_sha256=HASH, vehicle_id="v", document={"autopilot": "px4"}
    )
    assert (flight.state, flight.document) == (FlightState.CONNECTING, {"autopilot": "px4"})
    with pytest.raises(ConflictError, match="on flight"):
        store.flights.add(mission_id=mission_id, version=1, plan_sha256=HASH, vehicle_id="v")
    assert store.flights.update(flight.id, {"autopilot": "px4", "preflight": 1}).document["preflight"] == 1
    assert [f.id for f in store.flights.page(active=True, mission_id=mission_id)] == [flight.id]
    with pytest.raises(NotFoundError):
        store.flights.get("nowhere")


def test_history_is_only_added_to(store: Store) -> None:
    mission_id = planned(store)
    flight = store.flights.add(mission_id=mission_id, version=1, plan_sha256=HASH, vehicle_id="v")
    events = [event(k, state, note=k) for k, state in enumerate([FlightState.CRUISE, FlightState.COMPLETED], start=1)]
    for one in events:
        store.flights.append(flight.id, one)
    store.flights.append(flight.id, events[0])  # told twice: kept once
    assert store.flights.events(flight.id) == events
    assert store.flights.events(flight.id, after=1) == events[1:]
    with pytest.raises(ConflictError, match="another event number 2"):
        store.flights.append(flight.id, event(2, note="rewritten"))
    with pytest.raises(NotFoundError):
        store.flights.append("nowhere", events[0])
    ended = store.flights.get(flight.id)
    assert ended.state is FlightState.COMPLETED
    assert ended.ended_utc is not None
    for order in ("UPDATE flight_events SET kind = 'x'", "DELETE FROM flight_events"):
        with pytest.raises(IntegrityError, match="append-only"), store.database.write() as connection:
            connection.execute(text(order))
    assert store.flights.events(flight.id) == events


def test_a_journal_waits_out_a_locked_database(backend: Backend, store: Store) -> None:
    mission_id = planned(store)
    flight = store.flights.add(mission_id=mission_id, version=1, plan_sha256=HASH, vehicle_id="v")
    journal = store.flights.journal(flight.id)
    journal.append(event(1))
    with backend.held():
        journal.append(event(2))
        assert journal.backlog == 1
    journal.append(event(3))
    assert journal.backlog == 0
    assert [e.sequence for e in store.flights.events(flight.id)] == [1, 2, 3]


@pytest.mark.slow
@pytest.mark.parametrize("kill_after", [1, 7, 23, 40])
def test_what_was_acknowledged_survives_kill_9(backend: Backend, url: str, kill_after: int) -> None:
    """A writer is killed in the middle of its work: every commit it told of is there, and nothing is torn."""
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.support.processes.store_writer", url], cwd=ROOT, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    told = [process.stdout.readline().split() for _ in range(kill_after)]
    process.kill()
    told += [line.split() for line in process.stdout.read().splitlines() if len(line.split()) == 2]
    process.stdout.close()
    process.wait()
    if backend.kind == "sqlite":
        with sqlite3.connect(backend.path) as raw:
            assert raw.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        raw.close()
    with Store(url) as store:
        missions = {m.id for m in store.missions.page(limit=100_000)}
        flight_id = told[0][1]
        kept = {e.sequence for e in store.flights.events(flight_id, limit=100_000)}
        assert {name for kind, name in told if kind == "mission"} <= missions
        assert {int(name) for kind, name in told if kind == "event"} <= kept
        # at most the one commit in flight is there without having been told
        assert len(missions) - 1 <= sum(kind == "mission" for kind, _ in told) + 1
        assert kept == set(range(1, len(kept) + 1))


# --- settings --------------------------------------------------------------------------------------------------


def test_settings_come_from_the_environment(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("SKYRELAY_DATA_DIR", str(tmp_path / "data"))
    monkeypatch.setenv("SKYRELAY_PLANNER_PROCESSES", "3")
    monkeypatch.setenv("SKYRELAY_LOG_LEVEL", "")
    settings = Settings()
    assert settings.url == f"sqlite:///{tmp_path / 'data' / 'skyrelay.db'}"
    assert (settings.planner_processes, settings.log_level) == (3, "info")
    settings.prepare()
    assert (tmp_path / "data").is_dir()
    with Store(settings.url) as store:
        store.check()
    monkeypatch.setenv("SKYRELAY_DATABASE_URL", "postgresql://db/skyrelay")
    assert Settings().url == "postgresql://db/skyrelay"


@pytest.mark.parametrize(
    ("name", "value"),
    [("PLANNER_PROCESSES", "-1"), ("PLANNING_LIMIT_S", "0"), ("LOG_LEVEL", "loud"), ("MAX_STATIONS", "x")],
)
def test_settings_out_of_range_are_refused(monkeypatch: pytest.MonkeyPatch, name: str, value: str) -> None:
    from pydantic import ValidationError

    monkeypatch.setenv(f"SKYRELAY_{name}", value)
    with pytest.raises(ValidationError, match=name.lower()):
        Settings()
