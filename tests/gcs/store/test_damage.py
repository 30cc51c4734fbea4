"""Damage, safety copies, and who may read: one torn row hides nothing else, a copy comes back whole."""

from __future__ import annotations

import os
import stat
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from sqlalchemy import text

from gcs.errors import ConflictError, MissionInfeasible, StoreUnavailable
from gcs.exports import umask, write_atomic
from gcs.mission import read_mission, write_mission
from gcs.settings import Settings
from gcs.store import back_up, restore
from gcs.store.store import Store
from tests.support.missions.malformed import GOOD
from tests.support.processes.store_backends import Backend

DOCUMENT = write_mission(read_mission(GOOD))
HASH = "a" * 64


@pytest.fixture
def store(backend: Backend) -> Iterator[Store]:
    with Store(backend.url) as opened:
        yield opened


def tear(store: Store, table: str, column: str, where: str = "1 = 1") -> None:
    with store.database.write() as connection:
        connection.execute(text(f"UPDATE {table} SET {column} = '{{torn' WHERE {where}"))


def planned(store: Store) -> str:
    record, _ = store.missions.add(DOCUMENT)
    claim = store.queue.claim("me", 30.0)
    assert claim is not None
    assert store.queue.finish(claim, "me", {"plan_sha256": HASH})
    return record.id


# --- one torn row ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("column", ["plan", "infeasibility", "document"])
def test_a_torn_mission_is_listed_with_the_others(store: Store, column: str) -> None:
    torn = planned(store)
    tear(store, "mission_versions", column)
    record, _ = store.missions.add(DOCUMENT)
    claim = store.queue.claim("me", 30.0)
    assert claim is not None
    store.queue.finish_infeasible(claim, "me", MissionInfeasible("broken_chain", "No chain."))
    assert [m.id for m in store.missions.page()] == [record.id, torn]
    if column == "plan":
        with pytest.raises(StoreUnavailable, match=f"plan of mission {torn} cannot be read"):
            store.missions.plan(torn)


def test_a_torn_mission_does_not_stand_in_the_way_of_those_behind_it(store: Store) -> None:
    torn, _ = store.missions.add(DOCUMENT)
    tear(store, "mission_versions", "document")
    sound, _ = store.missions.add(DOCUMENT)
    claim = store.queue.claim("me", 30.0)
    assert claim is not None
    assert claim.mission_id == sound.id
    assert store.missions.get(torn.id).status == "failed"
    assert "cannot be read" in (store.missions.get(torn.id).error or "")


def test_torn_entries_and_flights_are_listed_with_the_others(store: Store) -> None:
    mission_id = planned(store)
    for vehicle in ("a", "b"):
        store.registry.put("link", vehicle, {"url": "x"})
        store.flights.add(mission_id=mission_id, version=1, plan_sha256=HASH, vehicle_id=vehicle)
    tear(store, "registry", "document", "id = 'a'")
    tear(store, "flights", "document", "vehicle_id = 'a'")
    assert [e.document for e in store.registry.page("link")] == [{}, {"url": "x"}]
    assert len(store.flights.page(active=True)) == 2


# --- safety copies ---------------------------------------------------------------------------------------------


def test_a_safety_copy_comes_back_whole_while_the_store_is_open(store: Store, backend: Backend, tmp_path: Path) -> None:
    kept = planned(store)
    copy = tmp_path / "copy"
    back_up(backend.url, copy)
    assert stat.S_IMODE(copy.stat().st_mode) == 0o600
    lost, _ = store.missions.add(DOCUMENT)
    restore(backend.url, copy)
    with Store(backend.url) as again:
        assert [m.id for m in again.missions.page()] == [kept]
        assert again.missions.plan(kept) == {"plan_sha256": HASH}
        assert again.missions.add(DOCUMENT)[0].id != lost.id
    assert not list(tmp_path.glob("*.part"))


def test_nothing_is_restored_over_a_flight_that_has_not_ended(store: Store, backend: Backend, tmp_path: Path) -> None:
    mission_id = planned(store)
    back_up(backend.url, tmp_path / "copy")
    flight = store.flights.add(mission_id=mission_id, version=1, plan_sha256=HASH, vehicle_id="v")
    with pytest.raises(ConflictError, match=flight.id):
        restore(backend.url, tmp_path / "copy")
    assert store.flights.get(flight.id).id == flight.id


def test_what_is_no_safety_copy_changes_nothing(store: Store, backend: Backend, tmp_path: Path) -> None:
    kept = planned(store)
    noise = tmp_path / "noise"
    noise.write_bytes(b"no copy at all" * 1000)
    for path in (noise, tmp_path / "absent", tmp_path):
        with pytest.raises(StoreUnavailable):
            restore(backend.url, path)
    assert [m.id for m in store.missions.page()] == [kept]
    with pytest.raises(StoreUnavailable):
        back_up(backend.url, tmp_path / "no" / "folder")


@pytest.mark.parametrize("backend", ["sqlite"], indirect=True)
def test_a_copy_of_a_newer_release_is_refused(store: Store, backend: Backend, tmp_path: Path) -> None:
    with store.database.write() as connection:
        connection.execute(text("UPDATE alembic_version SET version_num = '9999'"))
    back_up(backend.url, tmp_path / "copy")
    with pytest.raises(StoreUnavailable, match="newer skyrelay"):
        restore(backend.url, tmp_path / "copy")


# --- who may read ----------------------------------------------------------------------------------------------


def test_a_data_directory_open_to_others_is_closed(tmp_path: Path) -> None:
    data = tmp_path / "data"
    data.mkdir(mode=0o755)
    data.chmod(0o755)
    Settings(data_dir=data).prepare()
    assert stat.S_IMODE(data.stat().st_mode) == 0o700


def test_writing_a_file_leaves_the_mask_of_the_process_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever another thread makes meanwhile must get the mask that was set, at every moment."""
    before = os.umask(0o027)
    try:
        changed: list[int] = []
        real = os.umask
        monkeypatch.setattr(os, "umask", lambda value: changed.append(value) or real(value))
        writing = threading.Thread(target=write_atomic, args=(tmp_path / "x", "text"))
        writing.start()
        writing.join()
        assert changed == []
        assert umask() == 0o027
        assert stat.S_IMODE((tmp_path / "x").stat().st_mode) == 0o640
    finally:
        monkeypatch.undo()
        os.umask(before)
