"""Missions over REST, against a server process on a port of its own."""

from __future__ import annotations

import concurrent.futures
import copy
import csv
import io
import json
from typing import Any

import httpx
import pytest

from tests.support.checker import check_plan
from tests.support.missions.infeasible import INFEASIBLE
from tests.support.missions.malformed import GOOD, GOOD_LOCAL, MALFORMED
from tests.support.processes.rest_client import assert_problem, wait_for_planning


def body_of(document: Any) -> bytes:
    return document if isinstance(document, bytes) else json.dumps(document).encode()


@pytest.fixture(scope="module")
def planned(client: httpx.Client) -> dict[str, Any]:
    """A planned mission of two stations."""
    mission = client.post("/v1/missions", json={**GOOD, "name": "planned once"}).json()
    return wait_for_planning(client, mission["id"])


def count(client: httpx.Client) -> int:
    """How many mission versions there are, from the metrics."""
    text = client.get("/metrics").text
    lines = [line for line in text.splitlines() if line.startswith("skyrelay_missions{")]
    return round(sum(float(line.rsplit(" ", 1)[1]) for line in lines))


# -- sending ----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_mission_is_stored_planned_and_its_plan_is_sound(client: httpx.Client) -> None:
    answer = client.post("/v1/missions", json=GOOD)
    assert answer.status_code == 201
    created = answer.json()
    assert answer.headers["location"] == f"/v1/missions/{created['id']}"
    assert created["status"] in ("queued", "planning", "planned")
    mission = wait_for_planning(client, created["id"])
    assert mission["status"] == "planned"
    assert mission["progress"] == {"phase": "planned", "fraction": 1.0}
    assert mission["mission"]["stations"][0]["id"] == "den-helder"
    assert mission["mission"]["options"]["min_tenure_s"] == 10.0  # a default, filled in
    answer = client.get(f"/v1/missions/{created['id']}/plan")
    plan = answer.json()
    assert answer.headers["etag"] == f'"{plan["plan_sha256"]}"'
    assert mission["plan_sha256"] == plan["plan_sha256"]
    assert mission["mission_time_s"] == plan["mission_time_s"]
    assert check_plan(plan, GOOD) == []


@pytest.mark.parametrize(("name", "document", "where"), MALFORMED, ids=[name for name, *_ in MALFORMED])
def test_a_malformed_mission_is_answered_with_the_place_and_not_stored(
    client: httpx.Client, name: str, document: Any, where: str
) -> None:
    before = count(client)
    problem = assert_problem(client.post("/v1/missions", content=body_of(document)), 422)
    # NaN and infinities have no JSON: the text itself is refused, before any field is looked at.
    where = "mission" if b"NaN" in body_of(document) or b"Infinity" in body_of(document) else where
    assert any(where in error["where"] for error in problem["errors"]), problem["errors"]
    assert all(error["what"] for error in problem["errors"])
    assert count(client) == before


@pytest.mark.parametrize(("name", "document", "reason", "words"), INFEASIBLE, ids=[name for name, *_ in INFEASIBLE])
def test_an_infeasible_mission_is_stored_and_explained(
    client: httpx.Client, name: str, document: Any, reason: str, words: tuple[str, ...]
) -> None:
    mission = wait_for_planning(client, client.post("/v1/missions", json=document).json()["id"])
    assert mission["status"] == "infeasible"
    assert mission["problem"]["reason"] == reason
    problem = assert_problem(client.get(f"/v1/missions/{mission['id']}/plan"), 409)
    assert problem["type"] == "urn:skyrelay:problem:infeasible"
    assert problem["reason"] == reason
    assert {"place", "gap_m", "fix"} <= problem.keys()
    said = f"{problem['detail']} {problem['fix_text']}"
    assert all(word in said for word in words), said
    for form in ("handovers", "setpoints"):
        assert_problem(client.get(f"/v1/missions/{mission['id']}/{form}"), 409)


def test_a_body_of_50_mb_is_refused_and_not_held(client: httpx.Client, server_pid: int) -> None:
    def rss_kb() -> int:
        with open(f"/proc/{server_pid}/status", encoding="ascii") as status:
            return next(int(line.split()[1]) for line in status if line.startswith("VmHWM"))

    def chunks() -> Any:
        for _ in range(500):
            yield b" " * 100_000

    before = rss_kb()
    for content in (b" " * 50_000_000, chunks()):  # with Content-Length, and without
        problem = assert_problem(client.post("/v1/missions", content=content), 413)
        assert "10000000" in problem["errors"][0]["allowed"]
    assert rss_kb() - before < 20_000
    assert client.get("/healthz").status_code == 200


def test_just_under_the_limit_is_read_and_judged(client: httpx.Client) -> None:
    padded = json.dumps(GOOD).encode().ljust(9_999_990)
    assert client.post("/v1/missions", content=padded).status_code == 201


# -- idempotency ------------------------------------------------------------------------------------------------------


def test_the_same_key_and_body_make_one_mission(client: httpx.Client) -> None:
    headers = {"Idempotency-Key": "order-66"}
    first = client.post("/v1/missions", json=GOOD, headers=headers)
    again = client.post("/v1/missions", json=GOOD, headers=headers)
    assert (first.status_code, again.status_code) == (201, 201)
    assert again.json()["id"] == first.json()["id"]
    assert again.headers["location"] == first.headers["location"]
    assert again.headers["idempotent-replayed"] == "true"
    other = client.post("/v1/missions", json={**GOOD, "name": "another"}, headers=headers)
    assert "order-66" in assert_problem(other, 409)["detail"]


def test_one_of_many_at_once_wins(client: httpx.Client) -> None:
    def send(_: int) -> str:
        answer = client.post("/v1/missions", json=GOOD, headers={"Idempotency-Key": "at-once"})
        assert answer.status_code == 201
        return str(answer.json()["id"])

    with concurrent.futures.ThreadPoolExecutor(8) as pool:
        assert len(set(pool.map(send, range(16)))) == 1


@pytest.mark.parametrize("key", ["", "x" * 256, "with blank"])
def test_a_bad_key_is_refused(client: httpx.Client, key: str) -> None:
    answer = client.post("/v1/missions", json=GOOD, headers={"Idempotency-Key": key})
    assert "Idempotency-Key" in str(assert_problem(answer, 422)["errors"])


# -- listing, versions, archive ---------------------------------------------------------------------------------------


@pytest.mark.slow
def test_pages_hold_every_mission_once_while_new_ones_come(client: httpx.Client) -> None:
    made = [client.post("/v1/missions", json={**GOOD, "name": f"page {k}"}).json()["id"] for k in range(7)]
    seen: list[str] = []
    cursor: str | None = None
    while True:
        page = client.get("/v1/missions", params={"limit": 3, **({"cursor": cursor} if cursor else {})}).json()
        assert len(page["items"]) <= 3
        seen += [mission["id"] for mission in page["items"]]
        if cursor is None:
            client.post("/v1/missions", json=GOOD)  # comes in while we read on
        cursor = page["next"]
        if cursor is None:
            break
    assert len(seen) == len(set(seen))
    assert [mission_id for mission_id in seen if mission_id in made] == made[::-1]


@pytest.mark.parametrize(
    "query", ["limit=0", "limit=201", "limit=many", "cursor=-1", "cursor=abc", "cursor=1e3", "status=lost", "version=0"]
)
def test_a_bad_query_is_refused(client: httpx.Client, planned: dict[str, Any], query: str) -> None:
    path = f"/v1/missions/{planned['id']}" if query.startswith("version") else "/v1/missions"
    problem = assert_problem(client.get(f"{path}?{query}"), 422)
    assert problem["errors"][0]["where"].endswith(query.split("=")[0])


def test_versions_keep_the_earlier_plans(client: httpx.Client) -> None:
    mission = wait_for_planning(client, client.post("/v1/missions", json=GOOD).json()["id"])
    slower = copy.deepcopy(GOOD)
    slower["limits"]["max_speed_m_s"] = 20.0
    answer = client.post(f"/v1/missions/{mission['id']}/versions", json=slower)
    assert answer.status_code == 201
    assert answer.json()["version"] == 2
    assert answer.headers["location"].endswith("?version=2")
    second = wait_for_planning(client, mission["id"])
    assert second["version"] == 2
    assert second["mission_time_s"] > mission["mission_time_s"]
    first_plan = client.get(f"/v1/missions/{mission['id']}/plan", params={"version": 1}).json()
    assert first_plan["plan_sha256"] == mission["plan_sha256"]
    versions = client.get(f"/v1/missions/{mission['id']}/versions").json()["items"]
    assert [v["version"] for v in versions] == [1, 2]
    malformed = client.post(f"/v1/missions/{mission['id']}/versions", content=b"{")
    assert_problem(malformed, 422)
    assert_problem(client.get(f"/v1/missions/{mission['id']}", params={"version": 3}), 404)


def test_an_archived_mission_leaves_the_list_and_stays_readable(client: httpx.Client) -> None:
    mission = wait_for_planning(client, client.post("/v1/missions", json=GOOD).json()["id"])
    for _ in range(2):
        assert client.delete(f"/v1/missions/{mission['id']}").status_code == 204
    listed = [m["id"] for m in client.get("/v1/missions", params={"limit": 200}).json()["items"]]
    assert mission["id"] not in listed
    everything = client.get("/v1/missions", params={"limit": 200, "archived": True}).json()["items"]
    assert mission["id"] in [m["id"] for m in everything]
    assert client.get(f"/v1/missions/{mission['id']}").json()["archived_utc"] is not None
    assert client.get(f"/v1/missions/{mission['id']}/plan").status_code == 200
    assert_problem(client.post(f"/v1/missions/{mission['id']}/versions", json=GOOD), 409)


@pytest.mark.parametrize("path", ["", "/plan", "/handovers", "/setpoints", "/versions", "/events"])
def test_an_unknown_mission_is_not_found(client: httpx.Client, path: str) -> None:
    assert_problem(client.get(f"/v1/missions/0123456789abcdef{path}"), 404)


# -- what a plan can be fetched as ------------------------------------------------------------------------------------


def test_the_schedule_in_every_form(client: httpx.Client, planned: dict[str, Any]) -> None:
    base = f"/v1/missions/{planned['id']}"
    plan = client.get(f"{base}/plan").json()
    whole = client.get(f"{base}/handovers").json()
    assert [h["time_s"] for h in whole["handovers"]] == [h["time_s"] for h in plan["handovers"]]
    launched = client.get(f"{base}/handovers", params={"format": "csv", "launch": "2026-11-22T09:00:00+01:00"})
    assert launched.headers["content-type"].startswith("text/csv")
    rows = list(csv.DictReader(io.StringIO(launched.text)))
    assert [row["from"] for row in rows] == [h["from"] for h in plan["handovers"]]
    assert rows[0]["time_utc"].startswith("2026-11-22T08:")
    assert "texel" in client.get(f"{base}/handovers", params={"format": "table", "station": "texel"}).text


def test_a_plus_sign_lost_on_the_way_is_found_again(client: httpx.Client, planned: dict[str, Any]) -> None:
    base = f"/v1/missions/{planned['id']}/handovers?format=json&launch=2026-11-22T09:00:00"
    assert client.get(f"{base}+01:00").json()["launch_utc"].startswith("2026-11-22T08:00:00")


@pytest.mark.parametrize(
    "query",
    ["handovers?format=xls", "handovers?station=atlantis", "handovers?launch=tomorrow", "setpoints?format=xls",
     "setpoints?rate=0", "setpoints?rate=201", "setpoints?rate=nan", "setpoints?autopilot=paparazzi",
     "setpoints?format=tlog&launch=2026-11-22"],
)  # fmt: skip
def test_a_form_that_does_not_exist_is_refused(client: httpx.Client, planned: dict[str, Any], query: str) -> None:
    assert_problem(client.get(f"/v1/missions/{planned['id']}/{query}"), 422)


def test_setpoints_are_sent_as_they_are_made(client: httpx.Client, planned: dict[str, Any]) -> None:
    url = f"/v1/missions/{planned['id']}/setpoints"
    with client.stream("GET", url, params={"rate": 200, "format": "csv"}) as answer:
        assert answer.status_code == 200
        assert "content-length" not in answer.headers
        lines = answer.iter_lines()
        assert next(lines).startswith("time_s,station,north_m")
        assert next(lines).startswith("0.000000,den-helder,")
        # hanging up here must not disturb the server
    text = client.get(url, params={"rate": 5, "format": "jsonl"}).text.splitlines()
    times = [json.loads(line)["time_s"] for line in text]
    assert times[0] == 0.0
    assert times[1] == pytest.approx(0.2)
    assert times[-1] == pytest.approx(planned["mission_time_s"], abs=1e-6)
    log = client.get(url, params={"rate": 5, "format": "tlog", "autopilot": "ardupilot"}).content
    assert log.count(b"\xfd") >= len(times)  # MAVLink 2 frames


def test_progress_is_told_as_it_happens(client: httpx.Client) -> None:
    mission = client.post("/v1/missions", json=GOOD_LOCAL).json()
    names, states = [], []
    with client.stream("GET", f"/v1/missions/{mission['id']}/events") as answer:
        assert answer.headers["content-type"].startswith("text/event-stream")
        for line in answer.iter_lines():
            if line.startswith("event:"):
                names.append(line.split(":", 1)[1].strip())
            if line.startswith("data:"):
                states.append(json.loads(line[5:]))
    assert names[-1] == "done"
    assert states[-1]["status"] == "planned"
    assert set(names[:-1]) <= {"progress"}
    fractions = [state["progress"]["fraction"] for state in states]
    assert fractions == sorted(fractions)
