"""Bodies at the door: their media type, fields given twice, half characters; and what an address takes."""

from __future__ import annotations

import json
from typing import Any

import httpx
import pytest

from tests.support.missions.malformed import GOOD
from tests.support.processes.rest_client import assert_problem

STATION = {"lat_deg": 52.9, "lon_deg": 4.8, "alt_amsl_m": 1.0, "range_m": 16000.0}
WRITES: list[tuple[str, str, Any]] = [
    ("POST", "/v1/missions", GOOD),
    ("POST", "/v1/missions/abc/versions", GOOD),
    ("PUT", "/v1/stations/a", STATION),
    ("POST", "/v1/flights", {"mission_id": "a", "plan_sha256": "a" * 64, "vehicle_id": "v"}),
    ("POST", "/v1/flights/a/hold", {"by": "me"}),
    ("POST", "/v1/flights/a/replan", {"ahead_s": 30.0}),
    ("POST", "/v1/flights/a/launch", {"plan_sha256": "a" * 64, "preflight_id": 1}),
]


@pytest.mark.parametrize(
    "media",
    ["text/plain", "application/x-www-form-urlencoded", "application/json; charset=utf-16", "multipart/form-data"],
)
@pytest.mark.parametrize(("method", "path", "body"), WRITES, ids=lambda part: part if isinstance(part, str) else "")
def test_what_does_not_say_it_is_json_is_refused(
    client: httpx.Client, method: str, path: str, body: Any, media: str
) -> None:
    answer = client.request(method, path, content=json.dumps(body), headers={"Content-Type": media})
    assert "application/json" in assert_problem(answer, 415)["errors"][0]["allowed"]


@pytest.mark.parametrize("media", ["application/json", "application/json; charset=UTF-8", "Application/JSON"])
def test_json_by_any_of_its_spellings_is_taken(client: httpx.Client, media: str) -> None:
    answer = client.put("/v1/stations/spelt", content=json.dumps(STATION), headers={"Content-Type": media})
    assert answer.status_code in (200, 201)


@pytest.mark.parametrize(("method", "path", "body"), WRITES, ids=lambda part: part if isinstance(part, str) else "")
def test_a_field_given_twice_is_refused(client: httpx.Client, method: str, path: str, body: Any) -> None:
    field, value = next(iter(body.items()))
    text = json.dumps(body)[:-1] + f", {json.dumps(field)}: {json.dumps(value)}}}"
    if "versions" in path:
        path = path.replace("abc", client.post("/v1/missions", json=GOOD).json()["id"])
    problem = assert_problem(
        client.request(method, path, content=text, headers={"Content-Type": "application/json"}), 422
    )
    assert "twice" in problem["errors"][0]["what"]
    assert field in problem["errors"][0]["where"]


@pytest.mark.parametrize(
    ("path", "methods"),
    [
        ("/v1/missions", {"GET", "HEAD", "POST"}),
        ("/v1/missions/a", {"GET", "HEAD", "DELETE"}),
        ("/v1/missions/a/versions", {"GET", "HEAD", "POST"}),
        ("/v1/stations/a", {"GET", "HEAD", "PUT", "DELETE"}),
        ("/v1/links/a", {"GET", "HEAD", "PUT", "DELETE"}),
        ("/v1/flights", {"GET", "HEAD", "POST"}),
        ("/v1/flights/a/hold", {"POST"}),
        ("/healthz", {"GET", "HEAD"}),
    ],
)
def test_a_refused_method_is_told_those_allowed(client: httpx.Client, path: str, methods: set[str]) -> None:
    for method in ("PATCH", "TRACE"):
        answer = client.request(method, path)
        assert_problem(answer, 405)
        assert set(answer.headers["allow"].split(", ")) == methods
