"""Screenshots of every view, wide and narrow, light and dark: ``python -m tests.support.processes.pictures``.

A service of its own, the Wadden mission, a simulated vehicle; written into ``docs/pictures``.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from pathlib import Path

import httpx
from playwright.sync_api import Browser, sync_playwright

from api.processes import start_simulator
from api.processes.children import Children
from gcs.plan import read_plan
from tests.support.paths import ROOT
from tests.support.processes import browser
from tests.support.processes.cli_process import Server
from tests.support.processes.rest_client import wait_for_planning

TARGET = ROOT / "docs" / "pictures"
SIZES = {"wide": (1280, 900), "narrow": (390, 844)}
SPEEDUP = 20.0
IN_FLIGHT_S = 25.0
"""How long the vehicle flies before the pictures of the flight are taken; real time."""


def take(chromium: Browser, address: str, views: dict[str, str]) -> None:
    """A picture of every view in every size and colour scheme."""
    for size, (width, height) in SIZES.items():
        for scheme in ("light", "dark"):
            context = chromium.new_context(
                viewport={"width": width, "height": height},
                color_scheme=scheme,  # type: ignore[arg-type]
            )
            page = context.new_page()
            for name, fragment in views.items():
                page.goto("about:blank")
                page.goto(f"{address}/{fragment}")
                page.get_by_role("heading", level=1).wait_for()
                page.wait_for_timeout(3500)
                page.screenshot(path=TARGET / f"{name}-{size}-{scheme}.png")
            context.close()


def main() -> int:
    """Take them all."""
    program = browser.program()
    if program is None:
        print(browser.MISSING)
        return 1
    TARGET.mkdir(parents=True, exist_ok=True)
    document = json.loads((ROOT / "sitl_fixtures" / "missions" / "wadden_relay.json").read_text(encoding="utf-8"))
    with tempfile.TemporaryDirectory() as folder, Children() as children, sync_playwright() as playwright:
        server = Server(Path(folder) / "data")
        chromium = playwright.chromium.launch(executable_path=program, args=list(browser.ARGUMENTS))
        with httpx.Client(base_url=server.address, timeout=60) as client:
            while client.get("/readyz").status_code != 200:
                time.sleep(0.1)
            take(chromium, server.address, {"newcomer": "#missions"})
            mission = wait_for_planning(client, client.post("/v1/missions", json=document).json()["id"])
            plan = read_plan(client.get(f"/v1/missions/{mission['id']}/plan").json())
            _, urls = start_simulator(children, plan, autopilot="px4", speedup=SPEEDUP)
            for station, url in urls.items():
                client.put(f"/v1/links/{station}", json={"url": url})
            client.put("/v1/vehicles/drone", json={"autopilot": "px4", "links": {s: s for s in urls}})
            body = {"mission_id": mission["id"], "plan_sha256": mission["plan_sha256"], "vehicle_id": "drone"}
            flight = client.post("/v1/flights", json={**body, "speedup": SPEEDUP}).json()["id"]
            while client.get(f"/v1/flights/{flight}").json()["phase"] != "ready":
                time.sleep(0.2)
            take(chromium, server.address, {"preflight": f"#flight/{flight}"})
            preflight = client.post(f"/v1/flights/{flight}/preflight", json={})
            preflight.raise_for_status()
            while (ready := client.get(f"/v1/flights/{flight}").json())["phase"] != "ready":
                time.sleep(0.2)
            launch = {"plan_sha256": plan.plan_sha256, "preflight_id": ready["preflight"]["id"]}
            client.post(f"/v1/flights/{flight}/launch", json=launch).raise_for_status()
            time.sleep(IN_FLIGHT_S)
            views = {
                "flight": f"#flight/{flight}",
                "station": f"#station/{flight}/{plan.station_ids[-1]}",
                "operations": "#operations",
                "missions": "#missions",
                "mission": f"#mission/{mission['id']}",
                "plan": f"#plan/{mission['id']}",
            }
            take(chromium, server.address, views)
            client.post(f"/v1/flights/{flight}/land", json={})
        chromium.close()
        server.stop()
    print(f"wrote {len(list(TARGET.glob('*.png')))} pictures into docs/pictures")
    return 0


if __name__ == "__main__":
    sys.exit(main())
