"""Lists of missions: what they show comes from columns, and a page costs the same however long the history is."""

from __future__ import annotations

import sqlite3
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import text

from gcs.mission import read_mission, write_mission
from gcs.store.store import Store
from tests.support.missions.malformed import GOOD

DOCUMENT = write_mission(read_mission(GOOD))
PLAN = {"plan_sha256": "a" * 64, "mission_time_s": 760.25, "handovers": [{}, {}], "padding": "x" * 30_000}


def keep(store: Store, count: int, plan: dict[str, Any] | None = None) -> list[str]:
    made = []
    for _ in range(count):
        made.append(store.missions.add(DOCUMENT)[0].id)
        claim = store.queue.claim("me", 30.0)
        assert claim is not None
        assert store.queue.finish(claim, "me", plan or PLAN)
    return made


def steps_of(store: Store, **query: Any) -> int:
    """How many steps SQLite's machine takes for a page, in tens."""
    counted = [0]

    def one() -> None:
        counted[0] += 1

    with store.database.read() as connection:
        driver: Any = connection.connection.driver_connection
        driver.set_progress_handler(one, 10)
    # The pool has this one connection, so that the page goes over it.
    store.missions.page(limit=20, **query)
    driver.set_progress_handler(None, 0)
    return counted[0]


@pytest.mark.parametrize("query", [{}, {"archived": True}, {"status": "planned"}, {"status": "failed"}], ids=str)
def test_a_page_costs_the_same_however_long_the_history_is(tmp_path: Path, query: dict[str, Any]) -> None:
    with Store(f"sqlite:///{tmp_path / 'skyrelay.db'}") as store:
        for mission_id in keep(store, 30)[:3]:
            store.missions.archive(mission_id)
        few = steps_of(store, **query)
        # Put away in the middle of the list: these must not be walked through either.
        for mission_id in keep(store, 200)[20:120]:
            store.missions.archive(mission_id)
        assert steps_of(store, **query) <= few * 1.2 + 5


def test_a_list_shows_a_plans_facts_without_reading_it(tmp_path: Path) -> None:
    with Store(f"sqlite:///{tmp_path / 'skyrelay.db'}") as store:
        keep(store, 1)
        with store.database.write() as connection:
            connection.execute(text("UPDATE mission_versions SET plan = '{torn'"))
        (shown,) = store.missions.page()
    assert (shown.mission_time_s, shown.handover_count) == (760.25, 2)


def test_the_latest_version_alone_is_listed(tmp_path: Path) -> None:
    with Store(f"sqlite:///{tmp_path / 'skyrelay.db'}") as store:
        first, second = keep(store, 2)
        store.missions.add_version(first, DOCUMENT)
        assert [(m.id, m.version, m.status) for m in store.missions.page()] == [
            (second, 1, "planned"),
            (first, 2, "queued"),
        ]
        store.missions.archive(first)
        assert [m.id for m in store.missions.page()] == [second]
        assert [(m.id, m.version) for m in store.missions.page(archived=True)] == [(second, 1), (first, 2)]


def test_a_database_of_before_is_brought_up_to_date_with_what_it_keeps(tmp_path: Path) -> None:
    """Made by the first migration alone, as earlier releases left it: two versions, one archived, one plan torn."""
    from alembic import command
    from alembic.config import Config

    from gcs.store.database import Database

    path = tmp_path / "skyrelay.db"
    before = Database(f"sqlite:///{path}")
    with before.write() as connection:
        config = Config()
        config.attributes["connection"] = connection
        config.set_main_option("script_location", "gcs:store/migrations")
        command.upgrade(config, "0001")
    before.close()
    plan = '{"plan_sha256": "a", "mission_time_s": 12.5, "handovers": [{}]}'
    with sqlite3.connect(path) as old:
        for number, (name, latest, archived) in enumerate([("a", 2, None), ("b", 1, "x"), ("c", 1, None)], start=1):
            old.execute("INSERT INTO missions VALUES (?, ?, ?, ?, 't', ?)", (number, name, name, latest, archived))
        rows = [("a", 1, plan), ("a", 2, plan), ("b", 1, "{torn"), ("c", 1, "{torn")]
        for mission, version, kept in rows:
            old.execute(
                "INSERT INTO mission_versions (mission_id, version, document, status, phase, progress, plan, "
                "plan_sha256, created_utc, changed_utc) "
                "VALUES (?, ?, '{}', 'planned', 'planned', 1.0, ?, 's', 't', 't')",
                (mission, version, kept),
            )
    old.close()
    with Store(f"sqlite:///{path}") as store:
        listed = [(m.id, m.version, m.mission_time_s, m.handover_count) for m in store.missions.page()]
        assert listed == [("c", 1, None, None), ("a", 2, 12.5, 1)]
        assert [m.id for m in store.missions.page(archived=True)] == ["c", "b", "a"]
        assert store.missions.get("a", 1).handover_count == 1
