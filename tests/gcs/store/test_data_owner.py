"""One service a data directory; one running flight a vehicle, by the vehicle's own word."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from gcs.errors import ConflictError, StoreUnavailable
from gcs.store import DataOwner
from tests.support.paths import ROOT

HOLD = "import sys, pathlib; from gcs.store import DataOwner; o = DataOwner(pathlib.Path(sys.argv[1])); print(o.name, flush=True); sys.stdin.read()"  # noqa: E501


def test_a_second_service_on_a_data_directory_is_refused_with_the_first_ones_process(tmp_path: Path) -> None:
    first = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(tmp_path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT
    )
    assert first.stdout is not None
    name = first.stdout.readline().strip()
    try:
        with pytest.raises(StoreUnavailable, match=f"another service .process {first.pid}. uses the data directory"):
            DataOwner(tmp_path)
    finally:
        first.kill()
        first.communicate()
    # However it ended, the next one may; and it is the same service.
    owner = DataOwner(tmp_path)
    assert owner.name == name
    with pytest.raises(StoreUnavailable):
        DataOwner(tmp_path)
    owner.close()
    DataOwner(tmp_path).close()


def test_another_directory_is_another_service(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
    one, other = DataOwner(tmp_path / "a"), DataOwner(tmp_path / "b")
    assert one.name != other.name
    one.close()
    other.close()


def test_one_running_flight_a_vehicle_by_its_own_word(tmp_path: Path) -> None:
    from sqlalchemy import insert

    from gcs.store import Store
    from gcs.store.tables import flights, mission_versions, missions

    with Store(f"sqlite:///{tmp_path / 'x.db'}") as store:
        with store.database.write() as connection:
            connection.execute(
                insert(missions).values(
                    number=1, id="m", name="m", latest_version=1, created_utc="2026-01-01T00:00:00Z"
                )
            )
            connection.execute(
                insert(mission_versions).values(
                    mission_id="m",
                    version=1,
                    document="{}",
                    status="planned",
                    phase="",
                    progress=1.0,
                    plan_sha256="p",
                    created_utc="2026-01-01T00:00:00Z",
                    changed_utc="2026-01-01T00:00:00Z",
                )
            )
        ids = [
            store.flights.add(mission_id="m", version=1, plan_sha256="p", vehicle_id=f"entry-{k}", owner=f"s{k}").id
            for k in range(3)
        ]
        store.flights.claim(ids[0], "system 1, uid2:aa")
        store.flights.claim(ids[0], "system 1, uid2:aa")
        store.flights.claim(ids[1], "system 1, uid2:bb")
        with pytest.raises(ConflictError, match=f"is on flight {ids[0]}, which has not ended"):
            store.flights.claim(ids[2], "system 1, uid2:aa")
        with store.database.write() as connection:
            connection.execute(
                flights.update().where(flights.c.id == ids[0]).values(ended_utc="2026-01-01T00:00:00Z", state="lost")
            )
        store.flights.claim(ids[2], "system 1, uid2:aa")
        assert store.flights.get(ids[2]).vehicle_identity == "system 1, uid2:aa"
        assert store.flights.get(ids[2]).owner == "s2"
