"""The service on either database: many requests at once, and texts no database can hold."""

from __future__ import annotations

import concurrent.futures
import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from tests.support.missions.malformed import GOOD
from tests.support.processes.cli_process import Server
from tests.support.processes.rest_client import assert_problem, wait_for_planning
from tests.support.processes.store_backends import Backend

pytestmark = pytest.mark.slow


@pytest.fixture
def asked(backend: Backend, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[httpx.Client]:
    """A client of a service on the database."""
    monkeypatch.setenv("SKYRELAY_DATABASE_URL", backend.url)
    server = Server(tmp_path / "data")
    try:
        with httpx.Client(base_url=server.address, timeout=60) as client:
            while client.get("/readyz").status_code != 200:
                time.sleep(0.05)
            yield client
    finally:
        server.stop()


def many(count: int, call: Any) -> list[httpx.Response]:
    with concurrent.futures.ThreadPoolExecutor(count) as pool:
        return list(pool.map(call, range(count)))


def test_requests_at_once_are_all_answered_without_a_fault(asked: httpx.Client) -> None:
    key = {"Idempotency-Key": "same"}
    answers = many(20, lambda _: asked.post("/v1/missions", json=GOOD, headers=key))
    assert {a.status_code for a in answers} == {201}
    (mission_id,) = {a.json()["id"] for a in answers}
    answers = many(10, lambda _: asked.post(f"/v1/missions/{mission_id}/versions", json=GOOD))
    assert {a.status_code for a in answers} == {201}
    assert sorted(a.json()["version"] for a in answers) == list(range(2, 12))
    answers = many(8, lambda k: asked.put("/v1/links/one", json={"url": f"udpout:127.0.0.1:{15000 + k}"}))
    assert {a.status_code for a in answers} <= {200, 201}
    mission = wait_for_planning(asked, mission_id)
    assert mission["version"] == 11
    assert asked.get(f"/v1/missions/{mission_id}/plan").status_code == 200


@pytest.mark.parametrize(
    "path",
    ["missions?cursor=%00", "flights?cursor=%00", "flights?mission_id=%00", "links?cursor=%00", "links?cursor=a%00b",
     "stations?cursor=%0a", "vehicles?cursor=%ff", "missions?status=%00", "missions/a%00b", "links/a%00b"],
)  # fmt: skip
@pytest.mark.parametrize("backend", ["postgresql"], indirect=True)
def test_a_nul_in_an_address_is_bad_input(asked: httpx.Client, path: str) -> None:
    assert_problem(asked.get(f"/v1/{path}"), 422)


@pytest.mark.parametrize("bad", ["\\u0000", "\\ud800", "\\udc00x"])
@pytest.mark.parametrize("backend", ["postgresql"], indirect=True)
def test_a_text_no_database_can_hold_is_bad_input(asked: httpx.Client, bad: str) -> None:
    bodies: dict[str, Any] = {
        "links/a": {"url": "udpout:127.0.0.1:14540", "description": "@"},
        "stations/a": {"lat_deg": 1.0, "lon_deg": 1.0, "alt_amsl_m": 1.0, "range_m": 1.0, "name": "@"},
        "vehicles/a": {"autopilot": "px4", "links": {"@": "a"}},
        "vehicles/b": {"autopilot": "px4", "links": {"*": "@"}},
    }
    for path, body in bodies.items():
        text = json.dumps(body).replace("@", bad)
        assert_problem(asked.put(f"/v1/{path}", content=text, headers={"Content-Type": "application/json"}), 422)
    flight = {"mission_id": "@", "plan_sha256": "a" * 64, "vehicle_id": "v"}
    for text in (json.dumps(flight), json.dumps({**flight, "mission_id": "m", "vehicle_id": "@"})):
        content = text.replace("@", bad)
        assert_problem(asked.post("/v1/flights", content=content, headers={"Content-Type": "application/json"}), 422)
    assert_problem(asked.post("/v1/missions", content=json.dumps({**GOOD, "name": "@"}).replace("@", bad)), 422)
