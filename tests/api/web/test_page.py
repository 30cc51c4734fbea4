"""The page in a real browser: from nothing to a flown mission, by hand, by keyboard, on a phone."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Page, WebSocketRoute, expect

from api.processes import start_simulator
from api.processes.children import Children
from api.processes.quick_mission import QUICK_MISSION
from gcs.plan import read_plan
from tests.support.processes.rest_client import wait_for_planning

pytestmark = pytest.mark.slow
SPEEDUP = 8.0
View = Callable[..., Any]


@pytest.fixture(scope="module")
def planned(client: httpx.Client) -> dict[str, Any]:
    return wait_for_planning(client, client.post("/v1/missions", json=QUICK_MISSION).json()["id"])


@pytest.fixture
def vehicle(client: httpx.Client, planned: dict[str, Any]) -> Iterator[str]:
    """A simulated vehicle at the mission's start, registered with a link for each station."""
    plan = read_plan(client.get(f"/v1/missions/{planned['id']}/plan").json())
    with Children() as children:
        _, urls = start_simulator(children, plan, autopilot="px4", speedup=SPEEDUP)
        for station, url in urls.items():
            client.put(f"/v1/links/{station}", json={"url": url})
        client.put("/v1/vehicles/drone", json={"autopilot": "px4", "name": "Drone", "links": {s: s for s in urls}})
        yield "drone"


@pytest.fixture
def flight(client: httpx.Client, planned: dict[str, Any], vehicle: str) -> Iterator[str]:
    """A flight that is ready; given up at the end, whatever happened."""
    body = {"mission_id": planned["id"], "plan_sha256": planned["plan_sha256"], "vehicle_id": vehicle}
    answer = client.post("/v1/flights", json={**body, "speedup": SPEEDUP, "operator_words": False})
    assert answer.status_code == 201, answer.text
    made = answer.json()["id"]
    yield made
    for _ in range(600):
        state = client.get(f"/v1/flights/{made}").json()
        if state["ended_utc"]:
            return
        client.post(f"/v1/flights/{made}/{'abort' if state['state'] == 'preflight' else 'land'}", json={})
        time.sleep(0.2)


def launch(page: Page) -> None:
    page.get_by_role("button", name="Prepare to launch").click(timeout=60_000)
    page.get_by_role("button", name="Launch now").click()


def test_nothing_inline_is_allowed(client: httpx.Client) -> None:
    for path in ("/", "/docs", "/assets/app.js", "/assets/vendor/maplibre-gl/dist/maplibre-gl.mjs"):
        policy = client.get(path).headers["content-security-policy"]
        assert "default-src 'self'" in policy
        assert "unsafe" not in policy


def test_a_newcomer_is_told_what_it_is_and_plans_an_example(view: View) -> None:
    page = view().open("#missions")
    expect(page.get_by_role("heading", level=1)).to_have_text("Missions")
    page.get_by_role("button", name="Fill in an example").click()
    page.get_by_role("button", name="Plan it").click()
    expect(page.get_by_role("heading", name="Den Helder to Texel")).to_be_visible()
    expect(page.locator("p.status.planned")).to_be_visible()
    expect(page.locator("canvas.maplibregl-canvas")).to_be_visible()
    expect(page.locator("#handovers tbody tr")).to_have_count(1)
    expect(page.locator(".profile canvas")).to_have_count(4)


def test_what_is_no_mission_is_said_beside_the_form(view: View) -> None:
    one = view()
    one.expected = ["422"]
    page = one.open("#missions")
    page.get_by_label("Mission, as JSON").fill('{"name": 3}')
    page.get_by_role("button", name="Plan it").click()
    expect(page.get_by_role("alert").first).to_contain_text("start")


def test_one_cursor_ties_map_profiles_and_bars_and_stands_in_the_address(
    view: View, client: httpx.Client, planned: dict[str, Any]
) -> None:
    page = view().open(f"#mission/{planned['id']}")
    plot = page.locator(".profile .u-over").first
    plot.wait_for()
    plot.scroll_into_view_if_needed()
    box = plot.bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 0.4 * box["width"], box["y"] + 0.5 * box["height"])
    expect(page.locator(".profile output").first).to_contain_text("at T+")
    expect(page.locator(".profile output").last).to_contain_text("at T+")
    expect(page.locator("#now")).to_have_attribute("visibility", "visible")
    assert re.search(r"\?t=\d", page.url)


def test_flown_from_the_page(view: View, flight: str) -> None:
    page = view().open(f"#flight/{flight}")
    expect(page.get_by_text("passed", exact=False).first).to_be_visible(timeout=60_000)
    launch(page)
    expect(page.locator(".headline")).to_contain_text("takes control in", timeout=60_000)
    expect(page.locator("#links tbody tr").first).to_contain_text("s ago")
    expect(page.locator("#time-distance .flown")).to_have_attribute("points", re.compile(r"\d+"), timeout=30_000)
    expect(page.locator(".headline")).to_contain_text("completed", timeout=120_000)
    expect(page.locator("#handovers")).to_contain_text("released")


def test_abort_asks_twice(view: View, client: httpx.Client, flight: str) -> None:
    page = view().open(f"#flight/{flight}")
    page.get_by_role("button", name="Abort", exact=True).click()
    assert client.get(f"/v1/flights/{flight}").json()["ended_utc"] is None
    page.get_by_role("button", name="Abort: sure?").click()
    expect(page.locator(".headline")).to_contain_text("ended", timeout=60_000)


def test_held_and_landed_from_the_page_and_no_countdown_meanwhile(view: View, flight: str) -> None:
    page = view().open(f"#flight/{flight}")
    launch(page)
    expect(page.locator(".headline")).to_contain_text("cruise", timeout=60_000)
    page.get_by_role("button", name="Hold").click()
    expect(page.locator(".headline")).to_contain_text("holding")
    expect(page.locator(".headline")).to_contain_text("no handover timed now")
    page.get_by_role("button", name="Land here").click()
    page.get_by_role("button", name="Land here: sure?").click()
    expect(page.locator(".headline")).to_contain_text("landed by command", timeout=60_000)


def test_alerts_are_sorted_told_once_and_acknowledged_together(view: View, flight: str) -> None:
    """A record with three alarms, as a service would give it: the worst comes first, past ones are apart."""
    one = view()
    utc = "2026-12-01T10:00:0{}Z"
    alarms = [
        {"utc": utc.format(1), "t_plus_s": 1.0, "what": "an interval was asked for again"},
        {"utc": utc.format(2), "t_plus_s": 2.0, "what": "the vehicle falls behind", "behind_m": 12.0},
        {"utc": utc.format(3), "t_plus_s": 3.0, "what": "lapse", "reason": "nothing heard for 3 s"},
    ]

    def with_alarms(route: Any) -> None:
        answer = route.fetch()
        route.fulfill(response=answer, json={**answer.json(), "alarms": alarms})

    one.page.route(f"**/v1/flights/{flight}", with_alarms)
    page = one.open(f"#flight/{flight}")
    shown = page.locator(".alert")
    expect(shown).to_have_count(3)
    assert [t.split(":")[0].strip() for t in shown.all_inner_texts()] == ["Warning", "Caution", "Advisory"]
    expect(page.locator("[role=alert]").first).to_have_text("Warning: lapse")
    page.get_by_role("button", name="Acknowledge all 3").click()
    expect(shown).to_have_count(0)
    page.reload()
    expect(page.get_by_text("3 acknowledged")).to_be_visible()


def test_the_connection_lost_and_found_again(view: View, flight: str) -> None:
    one, down, sockets = view(), [False], []
    one.expected = ["Failed to load resource", "ERR_", "WebSocket"]

    def routed(socket: WebSocketRoute) -> None:
        sockets.append(socket)
        if down[0]:
            socket.close(code=1011)
        else:
            socket.connect_to_server()

    one.page.route_web_socket("**/telemetry", routed)
    page = one.open(f"#flight/{flight}")
    expect(page.get_by_role("button", name="Prepare to launch")).to_be_visible(timeout=60_000)
    expect(page.get_by_text("No live data.")).to_have_count(0)
    down[0] = True
    page.route("**/v1/**", lambda route: route.abort())
    sockets[-1].close(code=1011)
    expect(page.get_by_text("No live data.")).to_be_visible()
    expect(page.locator(".figures.live .stale").first).to_be_visible(timeout=10_000)
    down[0] = False
    page.unroute("**/v1/**")
    expect(page.get_by_text("No live data.")).to_have_count(0, timeout=10_000)


def test_an_operator_accepts_a_handover_on_a_phone(
    view: View, client: httpx.Client, planned: dict[str, Any], flight: str
) -> None:
    plan = client.get(f"/v1/missions/{planned['id']}/plan").json()
    receiving = plan["handovers"][0]["to"]
    page = view(390, 844, has_touch=True, is_mobile=True).open(f"#station/{flight}/{receiving}")
    expect(page.get_by_role("heading", name="You take control")).to_be_visible(timeout=60_000)
    page.get_by_role("button", name="Accept").tap()
    expect(page.get_by_text("Answered: accept.")).to_be_visible()
    told = client.get(f"/v1/flights/{flight}/events?limit=1000").json()["items"]
    assert [e for e in told if e["data"].get("by") == receiving and "accept" in str(e["data"].values())], told[-3:]
    assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")


def test_a_range_too_short_shows_its_gap_and_the_fix_is_applied_with_a_click(view: View) -> None:
    page = view().open("#plan")
    expect(page.locator("p.status.good", has_text="planned")).to_be_visible()
    page.get_by_label("Range of texel, metres").fill("3000")
    page.get_by_label("Range of texel, metres").press("Tab")
    expect(page.get_by_text("The gap:")).to_contain_text("2702 m")
    page.get_by_role("button", name="Apply").first.click()
    expect(page.locator("p.status.good", has_text="planned")).to_be_visible()
    page.get_by_role("button", name="Undo").click()
    expect(page.get_by_text("The gap:")).to_be_visible()
    page.get_by_role("button", name="Redo").click()
    expect(page.locator("p.status.good", has_text="planned")).to_be_visible()


def test_a_station_dragged_out_of_reach_and_nothing_lost_on_reload(view: View) -> None:
    page = view().open("#plan")
    expect(page.locator("p.status.good", has_text="planned")).to_be_visible()
    handle = page.get_by_role("button", name=re.compile("Station texel"))
    box = handle.bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 8, box["y"] + 8)
    page.mouse.down()
    page.mouse.move(box["x"] + 200, box["y"] - 160, steps=8)
    page.mouse.up()
    expect(page.locator("p.status.bad")).to_contain_text("infeasible")
    moved = json.loads(page.evaluate("localStorage.getItem('skyrelay.draft')"))
    page.reload()
    expect(page.locator("p.status.bad")).to_contain_text("infeasible")
    assert json.loads(page.evaluate("localStorage.getItem('skyrelay.draft')")) == moved


def test_by_the_keyboard_alone(view: View) -> None:
    page = view().open("#missions")
    expect(page.locator("#document")).to_be_visible()
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.textContent").startswith("Skip")
    for _ in range(4):
        page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.textContent") == "Plan"
    page.keyboard.press("Enter")
    handle = page.get_by_role("button", name=re.compile("^Destination"))
    expect(handle).to_be_visible()
    before = page.evaluate("JSON.parse(localStorage.getItem('skyrelay.draft') ?? 'null')")
    handle.focus()
    page.keyboard.press("ArrowUp")
    page.wait_for_function("before => localStorage.getItem('skyrelay.draft') !== JSON.stringify(before)", arg=before)


def test_all_flights_and_stations_on_one_board(view: View, flight: str, planned: dict[str, Any]) -> None:
    page = view().open("#operations")
    expect(page.locator("#flights tbody tr")).to_have_count(1)
    expect(page.locator("svg.board rect").first).to_be_visible()
    expect(page.locator("#workload tbody tr").first).to_be_visible()


VIEWS = ("missions", "mission", "plan", "operations", "flight", "station")


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("name", VIEWS)
def test_axe_finds_nothing_serious(
    view: View, client: httpx.Client, planned: dict[str, Any], flight: str, name: str, scheme: str
) -> None:
    plan = client.get(f"/v1/missions/{planned['id']}/plan").json()
    more = {"mission": planned["id"], "flight": flight, "station": f"{flight}/{plan['stations'][-1]}"}.get(name)
    page = view(1280, 900, color_scheme=scheme).open(f"#{name}" + (f"/{more}" if more else ""))
    page.get_by_role("heading", level=1).wait_for()
    page.wait_for_timeout(1000)
    found = Axe().run(page).response["violations"]
    serious = [v for v in found if v["impact"] in ("serious", "critical")]
    assert [(v["id"], [n["html"][:120] for n in v["nodes"]][:3]) for v in serious] == []


@pytest.mark.parametrize("name", VIEWS)
def test_no_view_is_wider_than_a_phone(
    view: View, client: httpx.Client, planned: dict[str, Any], flight: str, name: str, folder: Path
) -> None:
    plan = client.get(f"/v1/missions/{planned['id']}/plan").json()
    more = {"mission": planned["id"], "flight": flight, "station": f"{flight}/{plan['stations'][-1]}"}.get(name)
    page = view(390, 844).open(f"#{name}" + (f"/{more}" if more else ""))
    page.get_by_role("heading", level=1).wait_for()
    page.wait_for_timeout(500)
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
