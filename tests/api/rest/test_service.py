"""The service around the missions: errors in one form, guards, health, metrics, registries, the page."""

from __future__ import annotations

import re
import socket
from typing import Any

import httpx
import pytest

from tests.support.missions.malformed import GOOD
from tests.support.paths import ROOT

PROBLEM = "application/problem+json"


def problem_of(answer: httpx.Response, status: int) -> dict[str, Any]:
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == PROBLEM
    body: dict[str, Any] = answer.json()
    return body


# -- errors -----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "path", "status"),
    [
        ("GET", "/nothing", 404),
        ("GET", "/v1", 404),
        ("PATCH", "/v1/missions", 405),
        ("POST", "/healthz", 405),
        ("GET", "/assets/app.py", 404),
        ("GET", "/assets/..%2Fapp.py", 404),
        ("GET", "/assets/%2e%2e%2f%2e%2e%2fetc%2fpasswd", 404),
        ("PUT", "/v1/stations/%20", 422),
        ("GET", "/v1/missions/" + "x" * 65, 422),
    ],
)
def test_every_error_is_a_problem_document(client: httpx.Client, method: str, path: str, status: int) -> None:
    body = problem_of(client.request(method, path), status)
    assert body["type"].startswith("urn:skyrelay:problem:")


def test_a_fault_of_ours_tells_nothing_of_its_inside_but_its_request_id(client: httpx.Client) -> None:
    """Half a character passes URL decoding nowhere, but a header may carry anything: whatever it is, no traceback."""
    answer = client.get("/v1/missions", headers={"X-Request-ID": "mine-1"})
    assert answer.headers["x-request-id"] == "mine-1"
    for bad in ("a b", "x" * 65, 'a"b'):
        given = client.get("/v1/missions", headers={"X-Request-ID": bad}).headers["x-request-id"]
        assert re.fullmatch(r"[0-9a-f]{32}", given)


def test_requests_that_are_no_http_do_not_hurt(server: Any, client: httpx.Client) -> None:
    host, port = server.address.removeprefix("http://").split(":")
    for noise in (b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03", b"GET\r\n\r\n", b"\xfd" * 100 + b"\r\n\r\n"):
        with socket.create_connection((host, int(port)), timeout=10) as connection:
            connection.sendall(noise)
            connection.shutdown(socket.SHUT_WR)
            connection.recv(1000)
    assert client.get("/healthz").status_code == 200


@pytest.mark.parametrize("content", [b"\xff\xfe", b"{", b"[]", b"", b"null", b'{"a": 1e999}', b"[" * 5000])
def test_a_small_body_that_is_no_json_is_malformed_too(client: httpx.Client, content: bytes) -> None:
    body = problem_of(client.post("/v1/flights", content=content, headers={"Content-Type": "application/json"}), 422)
    assert body["errors"][0]["where"].startswith("body")


# -- guards -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Origin": "http://127.0.0.1:1"},
        {"Sec-Fetch-Site": "cross-site"},
        {"Host": "rebound.example"},
        {"Host": "rebound.example:80", "Origin": "http://rebound.example:80"},
    ],
)
def test_writes_from_other_sites_are_refused(client: httpx.Client, headers: dict[str, str]) -> None:
    problem_of(client.post("/v1/missions", json=GOOD, headers=headers), 403)
    problem_of(client.delete("/v1/missions/x", headers=headers), 403)


def test_reads_under_a_foreign_name_are_refused_too(client: httpx.Client) -> None:
    """DNS rebinding: the browser thinks it talks to rebound.example and would hand the answer to its page."""
    problem_of(client.get("/v1/missions", headers={"Host": "rebound.example"}), 403)


def test_the_own_page_and_programs_may_write(client: httpx.Client, server: Any) -> None:
    port = server.address.rsplit(":", 1)[1]
    for headers in (
        {"Origin": server.address},
        {"Origin": f"http://localhost:{port}", "Host": f"localhost:{port}", "Sec-Fetch-Site": "same-origin"},
        {},
    ):
        assert client.post("/v1/missions", content=b"{}", headers=headers).status_code == 422


def test_nobody_is_invited_from_elsewhere(client: httpx.Client) -> None:
    answer = client.options(
        "/v1/missions", headers={"Origin": "http://evil.example", "Access-Control-Request-Method": "POST"}
    )
    assert "access-control-allow-origin" not in answer.headers


# -- health -----------------------------------------------------------------------------------------------------------


def test_health_readiness_and_metrics(client: httpx.Client) -> None:
    assert client.get("/healthz").json()["status"] == "ok"
    assert client.get("/readyz").json() == {
        "status": "ready",
        "version": client.get("/healthz").json()["version"],
        "checks": {"store": "ok", "planner": "ok"},
    }
    mission = client.post("/v1/missions", json=GOOD).json()
    with client.stream("GET", f"/v1/missions/{mission['id']}/events") as answer:
        answer.read()
    client.get(f"/v1/missions/{mission['id']}")
    text = client.get("/metrics").text
    samples = dict(line.rsplit(" ", 1) for line in text.splitlines() if line and not line.startswith("#"))
    assert float(samples['skyrelay_missions{status="planned"}']) >= 1
    assert float(samples['skyrelay_planning_seconds_count{outcome="planned"}']) >= 1
    route = 'skyrelay_http_requests_total{method="GET",route="/v1/missions/{mission_id}",status="200"}'
    assert float(samples[route]) >= 1
    assert mission["id"] not in text  # one series a route, not one an id


# -- registries -------------------------------------------------------------------------------------------------------

STATION = {"lat_deg": 52.9, "lon_deg": 4.8, "alt_amsl_m": 1.0, "range_m": 16000.0}


def test_an_entry_is_added_replaced_listed_and_forgotten(client: httpx.Client) -> None:
    url = "/v1/stations/Den Helder (A)"
    added = client.put(url, json=STATION)
    assert (added.status_code, added.headers["etag"]) == (201, '"1"')
    assert added.json()["id"] == "Den Helder (A)"
    replaced = client.put(url, json={**STATION, "range_m": 9000.0})
    assert (replaced.status_code, replaced.json()["revision"]) == (200, 2)
    assert client.get(url).json()["range_m"] == 9000.0
    assert "Den Helder (A)" in [e["id"] for e in client.get("/v1/stations").json()["items"]]
    assert client.delete(url).status_code == 204
    problem_of(client.get(url), 404)
    problem_of(client.delete(url), 404)


def test_a_lost_update_is_refused(client: httpx.Client) -> None:
    url = "/v1/stations/contested"
    assert client.put(url, json=STATION, headers={"If-Match": '"0"'}).status_code == 201
    assert client.put(url, json=STATION, headers={"If-Match": '"1"'}).status_code == 200
    assert "revision 2" in problem_of(client.put(url, json=STATION, headers={"If-Match": '"1"'}), 409)["detail"]


def test_registry_pages(client: httpx.Client) -> None:
    for k in range(5):
        client.put(f"/v1/links/page-{k}", json={"url": f"udpout:127.0.0.1:{20000 + k}"})
    seen: list[str] = []
    cursor: str | None = None
    while True:
        page = client.get("/v1/links", params={"limit": 2, **({"cursor": cursor} if cursor else {})}).json()
        seen += [entry["id"] for entry in page["items"]]
        cursor = page["next"]
        if cursor is None:
            break
    assert [name for name in seen if name.startswith("page-")] == [f"page-{k}" for k in range(5)]
    assert len(seen) == len(set(seen))


@pytest.mark.parametrize(
    ("path", "body", "where"),
    [
        ("stations/a", {**STATION, "range_m": 0}, "range_m"),
        ("stations/a", {**STATION, "lat_deg": 91}, "lat_deg"),
        ("stations/a", {**STATION, "rnage_m": 1}, "rnage_m"),
        ("stations/a", [], "body"),
        ("links/a", {"url": "udp://localhost:14540"}, "url"),
        ("links/a", {"url": "serial:/dev/ttyUSB0"}, "url"),
        ("links/a", {}, "url"),
        ("vehicles/a", {"autopilot": "paparazzi", "links": {"*": "x"}}, "autopilot"),
        ("vehicles/a", {"autopilot": "px4", "links": {}}, "links"),
        ("vehicles/a", {"autopilot": "px4", "links": {"*": "nobody-registered-me"}}, "links.*"),
    ],
)
def test_a_bad_entry_is_refused_with_its_place(client: httpx.Client, path: str, body: Any, where: str) -> None:
    problem = problem_of(client.put(f"/v1/{path}", json=body), 422)
    assert any(where in error["where"] for error in problem["errors"]), problem["errors"]


# -- the page ---------------------------------------------------------------------------------------------------------


def test_the_page_and_all_it_loads_come_from_here(client: httpx.Client) -> None:
    for path in ("/", "/docs"):
        page = client.get(path)
        assert page.headers["content-type"].startswith("text/html")
        assert "default-src 'self'" in page.headers["content-security-policy"]
        assert '<html lang="en">' in page.text
        assert "viewport" in page.text
        for asset in re.findall(r'(?:src|href)="(assets/[^"]+)"', page.text):
            assert client.get(f"/{asset}").status_code == 200
    foreign = re.compile(r"https?://(?!www\.w3\.org/)")
    web = ROOT / "api" / "web"
    for entry in [
        path for folder in (web, web / "parts", web / "views") for path in folder.iterdir() if path.is_file()
    ]:
        text = entry.read_text(encoding="utf-8")
        assert not foreign.search(text), entry.name
        for module in re.findall(r'(?:from |import\()"(\.[^"]+)"', text):
            address = (entry.parent / module).resolve().relative_to(web)
            answer = client.get(f"/assets/{address}")
            assert answer.status_code == 200, address
            assert answer.headers["content-type"].startswith("text/javascript"), address


def test_the_description_covers_every_route_with_examples(client: httpx.Client) -> None:
    described = client.get("/openapi.json").json()
    assert described["openapi"].startswith("3.1")
    mission = described["paths"]["/v1/missions"]["post"]
    examples = mission["requestBody"]["content"]["application/json"]["examples"]
    for example in examples.values():
        assert client.post("/v1/missions", json=example["value"]).status_code == 201
    for path, item in described["paths"].items():
        for method, operation in item.items():
            assert operation["summary"], (method, path)
            assert operation["tags"], (method, path)
            content = operation["responses"]["500"]["content"]
            assert list(content) == [PROBLEM]
    referred = set(re.findall(r"#/components/schemas/(\w+)", str(described)))
    assert referred <= set(described["components"]["schemas"])
