"""Flights through the service: a server process, a streamer process and a simulated vehicle on real UDP."""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Origin

from api.cli import rest_client as service_module
from api.processes import start_simulator
from api.processes.children import Children
from api.processes.quick_mission import QUICK_MISSION
from api.rest.schemas import NewFlight
from gcs.plan import read_plan
from link.errors import SupervisorError
from link.session.request import HANDOVER_WAYS
from link.streamer.supervisor import attach
from tests.support.processes.cli_process import Outcome, Server
from tests.support.processes.rest_client import assert_problem, launch, wait_for, wait_for_planning

SPEEDUP = 10.0


@pytest.fixture(scope="module")
def planned(client: httpx.Client) -> dict[str, Any]:
    mission = wait_for_planning(client, client.post("/v1/missions", json=QUICK_MISSION).json()["id"])
    assert mission["status"] == "planned"
    return mission


@pytest.fixture
def vehicle(client: httpx.Client, planned: dict[str, Any]) -> Iterator[str]:
    """A simulated vehicle, registered with a link for each station."""
    plan = read_plan(client.get(f"/v1/missions/{planned['id']}/plan").json())
    with Children() as children:
        _, urls = start_simulator(children, plan, autopilot="ardupilot", speedup=SPEEDUP)
        for station, url in urls.items():
            assert client.put(f"/v1/links/{station}", json={"url": url}).status_code in (200, 201)
        client.put("/v1/vehicles/drone", json={"autopilot": "ardupilot", "links": {s: s for s in urls}})
        yield "drone"


def request_for(planned: dict[str, Any], **more: Any) -> dict[str, Any]:
    plan = {"mission_id": planned["id"], "plan_sha256": planned["plan_sha256"]}
    return {**plan, "vehicle_id": "drone", "speedup": SPEEDUP, **more}


@contextlib.contextmanager
def flight_of(client: httpx.Client, planned: dict[str, Any], **more: Any) -> Iterator[dict[str, Any]]:
    """A flight, given up at the end whatever happened."""
    answer = client.post("/v1/flights", json=request_for(planned, **more))
    assert answer.status_code == 201, answer.text
    flight = answer.json()
    try:
        yield flight
    finally:
        client.post(f"/v1/flights/{flight['id']}/abort")
        # The links go with the simulator; a flight in the air would wait long for it to come back.
        with contextlib.suppress(AssertionError):
            wait_for(client, flight["id"], "refused", "completed", "contingency", "lost", timeout_s=5)


@pytest.mark.slow
def test_a_flight_from_preflight_to_landing(client: httpx.Client, planned: dict[str, Any], vehicle: str) -> None:
    """With operators' words asked for, the handover waits for the next station's; a refusal may be taken back."""
    with flight_of(client, planned, operator_words=True) as flight:
        assert flight["state"] == "preflight"
        address = f"/v1/flights/{flight['id']}"
        ready = wait_for(client, flight["id"], "ready")
        assert ready["state"] == "preflight"
        assert ready["preflight"]["passed"] is True
        assert ready["preflight"]["age_s"] < 60
        assert {check["level"] for check in ready["preflight"]["checks"]} <= {"pass", "warning"}
        assert_problem(client.delete(f"/v1/missions/{planned['id']}"), 409)  # it is being flown

        wrong = {"plan_sha256": "0" * 64, "preflight_id": ready["preflight"]["id"]}
        assert "plan" in assert_problem(client.post(f"{address}/launch", json=wrong), 409)["detail"]
        stale = {"plan_sha256": planned["plan_sha256"], "preflight_id": 99}
        assert "preflight" in assert_problem(client.post(f"{address}/launch", json=stale), 409)["detail"]
        assert client.get(address).json()["phase"] == "ready"

        with connect(f"ws{str(client.base_url)[4:]}/v1/flights/{flight['id']}/telemetry") as socket:
            assert launch(client, ready).status_code == 200
            wait_for(client, flight["id"], "cruise")
            assert_problem(client.post(f"{address}/handovers/7/ready"), 409)
            refusal = {"by": "east", "reason": "no radio"}
            assert client.post(f"{address}/handovers/1/refuse", json=refusal).status_code == 200
            assert client.get(address).json()["handover_states"]["1"] == "refused"
            assert client.post(f"{address}/handovers/1/accept", json={"by": "east"}).status_code == 200
            told = [json.loads(message) for message in socket]  # until the service closes it, at the end
        done = wait_for(client, flight["id"], "completed")

    stations = [state["station"] for state in told if state["phase"] == "cruise"]
    assert list(dict.fromkeys(stations)) == ["west", "east"]
    waits = [state["next_handover"]["in_s"] for state in told if state["next_handover"]]
    assert waits == sorted(waits, reverse=True)
    assert told[-1]["outcome"] == "completed"
    assert done["result"]["handovers"] == 1
    assert done["handover_states"] == {"1": "released"}
    assert done["ended_utc"] is not None
    events = client.get(f"{address}/events", params={"limit": 1000}).json()["items"]
    numbers = [event["sequence"] for event in events]
    assert numbers == sorted(set(numbers))
    words = [(e["data"]["word"], e["data"]["by"]) for e in events if e["kind"] == "word"]
    assert words == [("launch", "test"), ("refuse", "east"), ("accept", "east")]
    assert_problem(client.post(f"{address}/hold"), 409)
    assert done["id"] in [
        f["id"] for f in client.get("/v1/flights", params={"mission_id": planned["id"]}).json()["items"]
    ]


@pytest.mark.slow
def test_hold_shifts_the_schedule_and_abort_ends_in_a_contingency(
    client: httpx.Client, planned: dict[str, Any], vehicle: str
) -> None:
    with flight_of(client, planned) as flight:
        address = f"/v1/flights/{flight['id']}"
        assert_problem(client.post(f"{address}/resume"), 409)  # there is nothing to resume
        assert launch(client, wait_for(client, flight["id"], "ready")).status_code == 200
        wait_for(client, flight["id"], "cruise")
        assert client.post(f"{address}/hold", json={"by": "me", "reason": "birds"}).status_code == 200
        wait_for(client, flight["id"], "holding")
        time.sleep(1.0)  # ten seconds of the vehicle's
        assert client.post(f"{address}/resume").status_code == 200
        flown = wait_for(client, flight["id"], "cruise")
        until = time.monotonic() + 90
        while flown["live"]["shift_s"] < 5.0 and time.monotonic() < until:
            flown = client.get(address).json()
            time.sleep(0.05)
        assert flown["live"]["shift_s"] > 5.0
        assert client.post(f"{address}/abort").status_code == 200
        wait_for(client, flight["id"], "contingency", timeout_s=120)
        words = client.get(f"{address}/events", params={"limit": 1000}).json()["items"]
        assert [e["data"]["word"] for e in words if e["kind"] == "word"] == ["launch", "hold", "resume", "abort"]


@pytest.mark.slow
def test_a_new_plan_is_proposed_accepted_and_flown(client: httpx.Client, planned: dict[str, Any], vehicle: str) -> None:
    """From a hold: back to where it began; the service plans, a person accepts, the streamer flies it."""
    with flight_of(client, planned) as flight:
        address = f"/v1/flights/{flight['id']}"
        assert "cannot be replanned" in assert_problem(client.post(f"{address}/replan"), 409)["detail"]
        assert launch(client, wait_for(client, flight["id"], "ready")).status_code == 200
        wait_for(client, flight["id"], "cruise")
        assert client.post(f"{address}/hold").status_code == 200
        until = time.monotonic() + 90
        while time.monotonic() < until:
            # Refused while it is coming to a stop.
            answer = client.post(f"{address}/replan", json={"destination": {"east_m": 0, "north_m": 0, "up_m": 110}})
            if answer.status_code == 200:
                break
            assert_problem(answer, 409)
            time.sleep(0.1)
        assert answer.status_code == 200, answer.text
        proposal = answer.json()
        assert (proposal["at_rest"], proposal["decide_by_t_plus_s"]) == (True, None)
        assert proposal["stations"] == ["west"]
        assert proposal["checks"] == []  # no handover, so nothing that could come too late
        assert proposal["plan"]["mission"]["destination"] == {"east_m": 0.0, "north_m": 0.0, "up_m": 110.0}
        assert client.get(address).json()["phase"] == "holding"
        assert client.get(f"{address}/plan").json()["plan_sha256"] == planned["plan_sha256"]

        stations = {"excluded_stations": ["west", "east"]}
        assert_problem(client.post(f"{address}/replan", json=stations), 422)
        far = {"destination": {"east_m": 9000, "north_m": 0, "up_m": 110}}
        assert assert_problem(client.post(f"{address}/replan", json=far), 409)["reason"] == "destination_uncovered"
        unknown = client.post(f"{address}/replan/accept", json={"plan_sha256": "0" * 64})
        assert "ask for one and accept that" in assert_problem(unknown, 404)["detail"]

        word = {"plan_sha256": proposal["plan_sha256"], "by": "me", "reason": "the patient is elsewhere"}
        accepted = client.post(f"{address}/replan/accept", json=word)
        assert accepted.status_code == 200, accepted.text
        done = wait_for(client, flight["id"], "completed", timeout_s=120)
        assert done["result"]["plan_sha256"] == proposal["plan_sha256"]
        assert done["result"]["handovers"] == 0
        assert done["live"]["replanned_sha256"] == proposal["plan_sha256"]
        assert client.get(f"{address}/plan").json() == proposal["plan"]
        events = client.get(f"{address}/events", params={"limit": 1000}).json()["items"]
        assert [e["data"]["word"] for e in events if e["kind"] == "word"] == ["launch", "hold", "replan"]
        assert_problem(client.post(f"{address}/replan"), 409)


@pytest.mark.slow
def test_a_flight_outlives_the_service_which_finds_it_again(tmp_path: Path) -> None:
    server = Server(tmp_path / "d")
    with httpx.Client(base_url=server.address, timeout=60) as client, Children() as children:
        mission = wait_for_planning(client, client.post("/v1/missions", json=QUICK_MISSION).json()["id"])
        plan = read_plan(client.get(f"/v1/missions/{mission['id']}/plan").json())
        _, urls = start_simulator(children, plan, autopilot="ardupilot", speedup=SPEEDUP)
        for station, url in urls.items():
            client.put(f"/v1/links/{station}", json={"url": url})
        client.put("/v1/vehicles/drone", json={"autopilot": "ardupilot", "links": {s: s for s in urls}})
        flight = client.post("/v1/flights", json=request_for(mission)).json()
        launch(client, wait_for(client, flight["id"], "ready"))
        wait_for(client, flight["id"], "cruise")
        server.process.kill()
        server.stop()
        again = Server(tmp_path / "d")
        try:
            client.base_url = httpx.URL(again.address)
            done = wait_for(client, flight["id"], "completed")
            assert done["result"]["handovers"] == 1
            events = client.get(f"/v1/flights/{flight['id']}/events", params={"limit": 1000}).json()["items"]
            states = [e["data"]["to"] for e in events if e["kind"] == "state"]
            assert states[-4:] == ["cruise", "arrived", "landing", "completed"]  # nothing of it is missing
        finally:
            again.stop()
            for folder in (tmp_path / "d" / "flights").glob("*"):
                with contextlib.suppress(SupervisorError):
                    attach(folder).kill()


@pytest.mark.slow
def test_a_flight_nobody_answers_can_be_given_up(client: httpx.Client, planned: dict[str, Any]) -> None:
    for name, port in (("west", 9), ("east", 9)):
        client.put(f"/v1/links/{name}", json={"url": f"udpout:127.0.0.1:{port}"})
    client.put("/v1/vehicles/mute", json={"autopilot": "px4", "links": {"*": "west"}})
    with flight_of(client, planned, vehicle_id="mute") as flight:
        again = client.post("/v1/flights", json=request_for(planned, vehicle_id="mute"))
        assert "has not ended" in assert_problem(again, 409)["detail"]
        assert_problem(launch(client, {**flight, "preflight": {"id": 0}}), 409)
        assert client.post(f"/v1/flights/{flight['id']}/abort").status_code == 200
        ended = wait_for(client, flight["id"], "refused")
        assert ended["ended_utc"] is not None
        assert ended["preflight"]["passed"] is False
    # The list is the store's, which follows the live state.
    for _ in range(100):
        active = [f["id"] for f in client.get("/v1/flights", params={"active": True}).json()["items"]]
        if flight["id"] not in active:
            break
        time.sleep(0.1)
    assert flight["id"] not in active


@pytest.mark.parametrize(
    ("change", "status"),
    [
        ({"plan_sha256": "0" * 64}, 409),
        ({"plan_sha256": "short"}, 422),
        ({"vehicle_id": "nobody"}, 404),
        ({"mission_id": "nothing"}, 404),
        ({"version": 9}, 404),
        ({"rate_hz": 1000}, 422),
        ({"speedup": 0}, 422),
        ({"wings": 2}, 422),
        ({"rally": "some"}, 422),
        ({"fence": 3}, 422),
        ({"handover_way": "shout"}, 422),
        ({"handover_way": "parameter"}, 422),  # PX4 has no such parameter
    ],
)
def test_a_flight_that_must_not_be_is_refused_and_not_kept(
    client: httpx.Client, planned: dict[str, Any], change: dict[str, Any], status: int
) -> None:
    client.put("/v1/links/far", json={"url": "udpout:127.0.0.1:9"})
    client.put("/v1/vehicles/drone", json={"autopilot": "px4", "links": {"*": "far"}})

    def kept() -> list[str]:  # one of an earlier test may still be ending: its figures move, it does not go away
        return [flight["id"] for flight in client.get("/v1/flights", params={"limit": 200}).json()["items"]]

    before = kept()
    assert_problem(client.post("/v1/flights", json=request_for(planned, **change)), status)
    assert kept() == before


@pytest.mark.slow
def test_a_flight_is_asked_for_with_the_options_of_the_command_line(
    client: httpx.Client, planned: dict[str, Any], server: Server
) -> None:
    client.put("/v1/links/far", json={"url": "udpout:127.0.0.1:9"})
    client.put("/v1/vehicles/asked", json={"autopilot": "ardupilot", "links": {"*": "far"}})
    asked = {"rally": False, "fence": True, "handover_way": "parameter"}
    for wanted in (asked, {}):
        with flight_of(client, planned, vehicle_id="asked", **wanted) as flight:
            (path,) = server.data.glob(f"flights/{flight['id']}/request.json")
            request = json.loads(path.read_text())
        default = {"rally": True, "fence": False, "handover_way": "auto"}
        assert {name: request[name] for name in asked} == (wanted or default)


def test_every_way_of_a_handover_can_be_asked_for() -> None:
    schema = NewFlight.model_json_schema()["properties"]["handover_way"]["anyOf"][0]
    assert tuple(schema["enum"]) == HANDOVER_WAYS


def test_a_vehicle_without_a_link_to_a_station_is_told(client: httpx.Client, planned: dict[str, Any]) -> None:
    client.put("/v1/links/far", json={"url": "udpout:127.0.0.1:9"})
    client.put("/v1/vehicles/halfway", json={"autopilot": "px4", "links": {"west": "far"}})
    problem = assert_problem(client.post("/v1/flights", json=request_for(planned, vehicle_id="halfway")), 422)
    assert any("east" in error["where"] for error in problem["errors"])


@pytest.mark.slow
def test_a_link_the_streamer_refuses_ends_the_flight_and_frees_the_vehicle(
    client: httpx.Client, planned: dict[str, Any]
) -> None:
    client.put("/v1/links/broken", json={"url": "serial:/dev/no-such-device:57600"})
    client.put("/v1/vehicles/broken", json={"autopilot": "px4", "links": {"*": "broken"}})
    for _ in range(2):  # the second time as well: the vehicle is not left busy
        body = request_for(planned, vehicle_id="broken", speedup=1.0)
        problem = assert_problem(client.post("/v1/flights", json=body), 422)
        assert "no-such-device" in str(problem["errors"])


@pytest.mark.parametrize("word", ["hold", "resume", "abort", "land", "replan", "handovers/1/ready"])
def test_words_to_an_unknown_flight(client: httpx.Client, word: str) -> None:
    assert_problem(client.post(f"/v1/flights/none/{word}"), 404)
    assert_problem(client.get("/v1/flights/none"), 404)
    assert_problem(client.get("/v1/flights/none/events"), 404)


def test_telemetry_of_an_unknown_flight_is_closed_with_a_reason(client: httpx.Client) -> None:
    address = f"ws{str(client.base_url)[4:]}/v1/flights/none/telemetry"
    with connect(address) as socket, pytest.raises(ConnectionClosed, match="4404"):
        socket.recv(5)


def test_telemetry_to_a_foreign_page_is_refused(client: httpx.Client) -> None:
    address = f"ws{str(client.base_url)[4:]}/v1/flights/none/telemetry"
    with pytest.raises(InvalidStatus, match="403"), connect(address, origin=Origin("http://evil.example")):
        pass


# -- from the command line --------------------------------------------------------------------------------------------


Cli = Callable[..., Outcome]


@pytest.mark.slow
def test_a_flight_of_the_service_is_spoken_to_from_the_command_line(
    client: httpx.Client,
    planned: dict[str, Any],
    server: Server,
    cli: Cli,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # No flight of `fly` that another test happens to have on this machine.
    monkeypatch.setenv("SKYRELAY_STATE_DIR", str(tmp_path))
    client.put("/v1/links/far", json={"url": "udpout:127.0.0.1:9"})
    client.put("/v1/vehicles/told", json={"autopilot": "px4", "links": {"*": "far"}})
    at = ("--service", server.address)
    # So slow a clock that the vehicle is waited for as long as this takes.
    with flight_of(client, planned, vehicle_id="told", speedup=0.1) as flight:
        listed = cli("flight", *at)
        assert listed.code == 0
        assert f"{flight['id']}  " in listed.out
        assert "vehicle told" in listed.out
        looked = cli("flight", flight["id"], *at)
        assert looked.code == 0
        assert looked.out.startswith(f"flight {flight['id']}: connecting")
        # On the ground there is nothing to hold, and nothing to plan on from: the service's own words, exit code 2.
        held = cli("flight", flight["id"], "hold", *at)
        assert (held.code, held.out) == (2, "")
        assert "hold" in held.err
        new = cli("flight", flight["id"], "replan", "--destination", "0,0,110", "--exclude", "east", *at)
        assert "cannot be replanned" in new.err
        unreadable = cli("flight", flight["id"], "replan", "--destination", "0,0", *at)
        assert "three numbers: east_m,north_m,up_m" in unreadable.err
        accepted = cli("flight", flight["id"], "accept", "--plan", "0" * 64, *at)
        assert "ask for one and accept that" in accepted.err
        nameless = cli("flight", flight["id"], "accept", *at)
        assert "--plan" in nameless.err
        assert {o.code for o in (new, unreadable, accepted, nameless)} == {2}
        ended = cli("flight", flight["id"], "abort", "--by", "pilot", "--reason", "birds", *at, "--json")
        assert json.loads(ended.out)["id"] == flight["id"]
        wait_for(client, flight["id"], "refused")
        events = client.get(f"/v1/flights/{flight['id']}/events", params={"limit": 1000}).json()["items"]
        words = [(e["data"]["word"], e["data"]["by"], e["data"]["reason"]) for e in events if e["kind"] == "word"]
        assert words == [("abort", "pilot", "birds")]
    assert cli("flight", "none", "hold", *at).code == 2
    silent = cli("flight", "--service", "http://127.0.0.1:9")
    assert silent.code == 1
    assert "the service does not answer" in silent.err


def test_a_proposal_is_shown_with_what_speaks_against_it_and_how_to_accept_it(
    cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[str, str, Any]] = []
    sha = "ab" * 32
    check = {"level": "warning", "name": "handover 2", "message": "no room to stop", "fix": "plan slower"}
    proposal = {
        "plan_sha256": sha, "stations": ["west", "east"], "mission_time_s": 3725.0, "decide_by_t_plus_s": 65.0,
        "handovers": [{"index": 2, "from": "west", "to": "east", "t_plus_s": 90.0}],
        "checks": [check, {**check, "level": "pass", "name": "other"}], "plan": {},
    }  # fmt: skip

    def call(self: object, method: str, path: str, body: Any = None) -> Any:
        asked.append((method, path, body))
        if method == "GET":
            return {"mission": {"destination": {"lat_deg": 1.0, "lon_deg": 2.0, "alt_amsl_m": 3.0}}}
        return proposal

    monkeypatch.setattr(service_module.ServiceClient, "call", call)
    shown = cli(
        "flight", "f", "replan", "--destination", "53.1,4.8,100", "--exclude", "a", "--exclude", "b", "--ahead", "45"
    )
    assert asked[-1] == (
        "POST",
        "v1/flights/f/replan",
        {
            "by": None, "reason": None, "ahead_s": 45.0, "excluded_stations": ["a", "b"],
            "destination": {"lat_deg": 53.1, "lon_deg": 4.8, "alt_amsl_m": 100.0},
        },
    )  # fmt: skip
    assert shown.out.splitlines() == [
        f"plan {sha}",
        "  over west, east; it ends at T+ 1:02:05 of the plan",
        "  handover 2, west to east: T+ 0:01:30",
        "  warning: handover 2: no room to stop; plan slower",
        "  to be accepted before T+ 0:01:05",
        f"accept it with: skyrelay flight f accept --plan {sha}",
    ]


def test_a_flight_there_is_not_from_here_is_infeasible(cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    problem = {"detail": "no station covers the destination", "reason": "destination_uncovered", "gap_m": 12.0}

    def call(self: object, method: str, path: str, body: Any = None) -> Any:
        raise service_module.RefusedError(method, path, 409, problem)

    monkeypatch.setattr(service_module.ServiceClient, "call", call)
    outcome = cli("flight", "f", "replan")
    assert (outcome.code, outcome.out) == (3, "")
    assert "no station covers the destination" in outcome.err
    assert "destination_uncovered" in outcome.err
