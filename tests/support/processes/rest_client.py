"""What the tests of the service do over REST: wait, launch, check a problem document."""

from __future__ import annotations

import time
from typing import Any

import httpx

PROBLEM = "application/problem+json"


def wait_for_planning(client: httpx.Client, mission_id: str, timeout_s: float = 60.0) -> dict[str, Any]:
    until = time.monotonic() + timeout_s
    while time.monotonic() < until:
        mission: dict[str, Any] = client.get(f"/v1/missions/{mission_id}").json()
        if mission["status"] not in ("queued", "planning"):
            return mission
        time.sleep(0.05)
    raise AssertionError(f"still {mission['status']} after {timeout_s} s")


def assert_problem(answer: httpx.Response, status: int) -> dict[str, Any]:
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == PROBLEM
    body: dict[str, Any] = answer.json()
    assert body["status"] == status
    assert body["title"]
    assert body["detail"]
    assert body["request_id"] == answer.headers["x-request-id"]
    assert isinstance(body["errors"], list)
    return body


def wait_for(client: httpx.Client, flight_id: str, *phases: str, timeout_s: float = 90.0) -> dict[str, Any]:
    until = time.monotonic() + timeout_s
    while time.monotonic() < until:
        flight: dict[str, Any] = client.get(f"/v1/flights/{flight_id}").json()
        # The figures follow the end by a moment.
        ended = flight["ended_utc"] is not None
        if flight["phase"] in phases and (not ended or flight["result"] or flight["preflight"]["id"] is None):
            return flight
        assert not ended or flight["phase"] in phases, flight
        time.sleep(0.05)
    raise AssertionError(f"{flight['phase']} after {timeout_s} s, not {phases}")


def launch(client: httpx.Client, flight: dict[str, Any]) -> httpx.Response:
    body = {"plan_sha256": flight["plan_sha256"], "preflight_id": flight["preflight"]["id"], "by": "test"}
    return client.post(f"/v1/flights/{flight['id']}/launch", json=body)
