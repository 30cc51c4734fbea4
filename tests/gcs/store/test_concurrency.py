"""Many at once on one store: everybody is answered, and what may be there once is there once."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from sqlalchemy import text

from gcs.errors import ConflictError, GcsError, StoreUnavailable
from gcs.mission import read_mission, write_mission
from gcs.store.missions import Idempotency
from gcs.store.store import Store
from tests.support.missions.malformed import GOOD
from tests.support.processes import postgresql
from tests.support.processes.store_backends import Backend

DOCUMENT = write_mission(read_mission(GOOD))
HASH = "a" * 64


@pytest.fixture
def store(backend: Backend) -> Iterator[Store]:
    with Store(backend.url, lock_timeout_s=20.0) as opened:
        yield opened


def at_once(count: int, call: Callable[[int], object]) -> tuple[list[object], list[BaseException]]:
    """What ``count`` threads that start together got, and what was raised to them."""
    got: list[object] = []
    raised: list[BaseException] = []
    barrier = threading.Barrier(count)

    def run(k: int) -> None:
        barrier.wait()
        try:
            got.append(call(k))
        except BaseException as error:
            raised.append(error)

    threads = [threading.Thread(target=run, args=(k,)) for k in range(count)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return got, raised


def planned(store: Store) -> str:
    record, _ = store.missions.add(DOCUMENT)
    claim = store.queue.claim("me", 30.0)
    assert claim is not None
    assert store.queue.finish(claim, "me", {"plan_sha256": HASH})
    return record.id


def test_one_key_makes_one_mission_whoever_comes_first(store: Store) -> None:
    for k in range(3):
        key = Idempotency("a", f"k{k}", "h")
        got, raised = at_once(20, lambda _, key=key: store.missions.add(DOCUMENT, idempotency=key)[0].id)
        assert raised == []
        assert len(set(got)) == 1
    assert len(store.missions.page()) == 3


def test_versions_sent_at_once_are_numbered_without_a_gap(store: Store) -> None:
    first, _ = store.missions.add(DOCUMENT)
    got, raised = at_once(10, lambda _: store.missions.add_version(first.id, DOCUMENT)[0].version)
    assert raised == []
    assert sorted(got) == list(range(2, 12))  # type: ignore[type-var]
    assert [m.version for m in store.missions.page()] == [11]


def test_a_vehicle_is_on_one_flight(store: Store) -> None:
    mission_id = planned(store)

    def fly(_: int) -> str:
        return store.flights.add(mission_id=mission_id, version=1, plan_sha256=HASH, vehicle_id="v").id

    got, raised = at_once(6, fly)
    assert len(got) == 1
    assert all(isinstance(error, ConflictError) for error in raised), raised


def test_a_mission_put_away_at_once_with_its_flight_is_one_of_the_two(store: Store) -> None:
    for k in range(5):
        mission_id = planned(store)

        def one(which: int, mission_id: str = mission_id, k: int = k) -> object:
            if which:
                return store.missions.archive(mission_id)
            return store.flights.add(mission_id=mission_id, version=1, plan_sha256=HASH, vehicle_id=f"v{k}")

        _, raised = at_once(2, one)
        assert all(isinstance(error, GcsError) for error in raised), raised


def test_an_entry_written_at_once_is_counted_each_time(store: Store) -> None:
    got, raised = at_once(8, lambda k: store.registry.put("link", "l", {"url": f"{k}"})[0].revision)
    assert raised == []
    assert sorted(got) == list(range(1, 9))  # type: ignore[type-var]
    got, raised = at_once(8, lambda k: store.registry.put("link", "m", {"url": f"{k}"}, revision=0)[0].revision)
    assert got == [1]
    assert all(isinstance(error, ConflictError) for error in raised)


def test_a_broken_rule_of_the_tables_is_a_conflict_not_a_fault(store: Store) -> None:
    """Whatever the locks above miss: the tables refuse it, and the caller hears that it is not possible now."""
    planned(store)
    with pytest.raises(ConflictError, match="meanwhile"), store.database.change() as connection:
        connection.execute(
            text("INSERT INTO missions (id, name, latest_version, created_utc) SELECT id, 'x', 1, 't' FROM missions")
        )


def test_tables_of_a_newer_release_are_told_as_such(backend: Backend, store: Store) -> None:
    with store.database.write() as connection:
        connection.execute(text("UPDATE alembic_version SET version_num = '9999'"))
    with pytest.raises(StoreUnavailable, match=r"newer skyrelay \(revision 9999; this one knows up to"):
        Store(backend.url)


def test_readiness_is_a_write(backend: Backend) -> None:
    with Store(backend.url, lock_timeout_s=0.2) as store:
        store.check()
        with backend.held(), pytest.raises(StoreUnavailable, match="locked"):
            store.check()


@pytest.mark.parametrize(
    "url",
    ["postgresql://nobody@127.0.0.1:1/none", "postgres://nobody:secret@127.0.0.1:1/none", "postgresql://host:x/db"],
)
def test_a_server_that_is_not_there_is_told_without_the_password(url: str) -> None:
    with pytest.raises(StoreUnavailable) as told:
        Store(url, lock_timeout_s=0.5)
    assert "secret" not in str(told.value)
    assert len(str(told.value).splitlines()) == 1


@pytest.mark.parametrize("backend", ["postgresql"], indirect=True)
def test_a_database_in_another_encoding_is_refused(backend: Backend, postgresql_server: postgresql.PostgreSql) -> None:
    postgresql_server.execute("CREATE DATABASE latin WITH ENCODING 'LATIN1' LOCALE 'C' TEMPLATE template0")
    with pytest.raises(StoreUnavailable, match="LATIN1, not UTF8"):
        Store(postgresql_server.url("latin"))


def test_entries_come_in_the_order_of_their_characters(store: Store) -> None:
    names = ["a", "B", "ä", "_", "Z", "z", "a b", "a-b"]
    for name in names:
        store.registry.put("link", name, {"url": "x"})
    assert [e.id for e in store.registry.page("link")] == sorted(names)


def test_the_password_of_an_address_is_not_shown(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    from gcs.settings import Settings

    monkeypatch.setenv("SKYRELAY_DATABASE_URL", "postgresql://me:se/c:ret@db.example/x")
    assert "ret" not in Settings(data_dir=tmp_path).shown_url.split("@")[0]
