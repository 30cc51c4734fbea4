"""``skyrelay demo --serve``: the story told through the service, which stays up to be looked at."""

from __future__ import annotations

import contextlib
import os
import socket
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from api.cli.commands.flight_view import FlightView
from api.cli.commands.plan import overview
from api.cli.console import Progress
from api.cli.demo import story
from api.cli.errors import BadInputError, FaultError, InfeasibleError
from api.cli.rest_client import RefusedError, ServiceClient
from api.processes import Children, python_module, start_simulator

if TYPE_CHECKING:
    from gcs.plan import Plan

PORT = 8000
VEHICLE = "demo"
_START_S = 60.0
_PLAN_S = 300.0
_LOOK_S = 0.25


def run(document: Any, wall_s: float) -> None:
    """Tell the story, then stay up until a signal."""
    with (
        tempfile.TemporaryDirectory(prefix="skyrelay-demo-") as folder,
        Children() as children,
        _flights_ended(Path(folder)),
    ):
        service = _start(children, Path(folder))
        story.say(f"The service is up: open {service.address} in a browser and watch.\n")
        mission = _plan(service, document)
        plan = _fetch(service, mission["id"])
        story.say(f"\n{overview(plan)}")
        story.say(f"On the map: {service.address}#mission/{mission['id']}\n")
        flight = story.fly_until_arrival(
            story.Pace.of(plan.mission_time_s, wall_s),
            lambda pace, _: _fly(service, children, plan, mission["id"], pace),
            lambda flown: flown["state"] == "completed",
        )
        story.say(_report(plan, flight))
        if flight["state"] == "completed":
            story.say(f"\nArrived. {story.closing(plan)}")
        story.say(f"The service stays up at {service.address} until Ctrl-C.")
        _stay(children)


def _stay(children: Children) -> None:
    while True:
        children.sleep(3600.0)


def _start(children: Children, folder: Path) -> ServiceClient:
    port = _free_port()
    # The environment as it is, without settings of ours that somebody has set for another service.
    others = {name: value for name, value in os.environ.items() if not name.startswith("SKYRELAY_")}
    environment = {**others, "SKYRELAY_DATA_DIR": str(folder)}
    child = children.start(
        "service",
        python_module("api.cli", "serve", f"--port={port}", "--log-level=warning"),
        env=environment,
    )
    service = ServiceClient(f"http://127.0.0.1:{port}/")
    deadline = time.monotonic() + _START_S
    while not service.ready():
        child.check()
        if time.monotonic() > deadline:
            raise FaultError("the service did not get ready", {"said": child.output()[-2000:]})
        time.sleep(0.1)
    return service


def _free_port() -> int:
    """The usual port, or another when that is taken."""
    for port in (PORT, 0):
        with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
            return int(probe.getsockname()[1])
    raise FaultError("no TCP port can be had on 127.0.0.1")


def _plan(service: ServiceClient, document: Any) -> dict[str, Any]:
    story.say(f"1. Planning: POST {service.address}v1/missions")
    try:
        mission = service.call("POST", "v1/missions", document)
    except RefusedError as refusal:
        if refusal.status == 422:
            raise BadInputError("the mission has a fault", *refusal.problem.get("errors", [])) from None
        raise
    deadline = time.monotonic() + _PLAN_S
    with Progress(to_stdout=True) as progress:
        while mission["status"] in ("queued", "planning"):
            progress.show(f"   {mission['status']}: {mission['progress']['phase']}")
            if time.monotonic() > deadline:
                raise FaultError("planning takes too long", {"what": f"{_PLAN_S:.0f} s are over"})
            time.sleep(_LOOK_S)
            mission = service.call("GET", f"v1/missions/{mission['id']}")
    if mission["status"] != "planned":
        problem = mission["problem"] or {}
        kind = InfeasibleError if mission["status"] == "infeasible" else FaultError
        raise kind(str(problem.get("detail")), {"reason": problem.get("reason"), "fix": problem.get("fix_text")})
    return dict(mission)


def _fetch(service: ServiceClient, mission_id: str) -> Plan:
    from gcs.plan import read_plan

    return read_plan(service.call("GET", f"v1/missions/{mission_id}/plan"))


def _fly(service: ServiceClient, children: Children, plan: Plan, mission_id: str, pace: story.Pace) -> dict[str, Any]:
    """One flight by REST, from the vehicle's entry in the registry to its end; the flight as the service shows it."""
    story.say(f"2. Flying it by REST: a simulated {story.AUTOPILOT} vehicle, {pace.speedup:.0f} times as fast as real")
    child, urls = start_simulator(children, plan, autopilot=story.AUTOPILOT, speedup=pace.speedup)
    for station, url in urls.items():
        service.call("PUT", f"v1/links/{quote(station)}", {"url": url, "description": "simulated radio"})
    vehicle = {"autopilot": story.AUTOPILOT, "links": {s: s for s in urls}, "name": "Simulated medical drone"}
    service.call("PUT", f"v1/vehicles/{VEHICLE}", vehicle)
    flight = service.call(
        "POST",
        "v1/flights",
        {
            "mission_id": mission_id,
            "plan_sha256": plan.plan_sha256,
            "vehicle_id": VEHICLE,
            "speedup": pace.speedup,
            "rate_hz": pace.rate_hz,
        },
    )
    address = f"v1/flights/{flight['id']}"
    with Progress(every_s=3.0, to_stdout=True) as progress:
        view = FlightView(plan, progress)
        seen, launched = 0, False
        last = False  # the figures follow the end by a moment: one more look
        while True:
            children.check()
            flight = service.call("GET", address)
            for event in service.call("GET", f"{address}/events?after={seen}")["items"]:
                seen = event["sequence"]
                if event["kind"] != "progress":
                    view.show(event["kind"], event["t_plus_s"], event["state"], event["data"])
            if flight["ended_utc"] is not None and (flight["result"] is not None or last):
                break
            last = flight["ended_utc"] is not None
            if not launched and flight["phase"] == "ready":
                launched = True
                command = {
                    "plan_sha256": plan.plan_sha256,
                    "preflight_id": flight["preflight"]["id"],
                    "by": "skyrelay demo",
                }
                service.call("POST", f"{address}/launch", command)
            live = flight["live"]
            if live["station"] is not None:
                ahead = [live["next_handover"]] if live["next_handover"] else []
                progress.show(view.where(live["t_plus_s"], live["phase"], {**live, "handovers": ahead}))
            time.sleep(_LOOK_S)
    child.stop()
    children.forget(child)
    return dict(flight)


def _report(plan: Plan, flight: dict[str, Any]) -> str:
    from api.cli.commands.flight_view import result_lines
    from gcs.flight import FlightState
    from link.streamer import FlightResult

    summary = flight["result"] or {}
    state = FlightState(flight["phase"])
    result = FlightResult(state, state.exit_code, str(flight["live"].get("reason") or ""), summary)
    return "\n" + "\n".join(result_lines(plan, result))


@contextlib.contextmanager
def _flights_ended(folder: Path) -> Iterator[None]:
    """Streamers outlive the service on purpose; those of a demonstration must not outlive it."""
    try:
        yield
    finally:
        from link.errors import SupervisorError
        from link.streamer import attach

        for run_dir in (folder / "flights").glob("*"):
            with contextlib.suppress(SupervisorError, OSError):
                flight = attach(run_dir)
                flight.kill()
                _reap(flight.pid)


def _reap(pid: int) -> None:
    """Wait until a process that is not our child is gone."""
    for _ in range(100):
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            return
        time.sleep(0.02)
