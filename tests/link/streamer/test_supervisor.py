"""Starting, attending, leaving and ending flights: the streamer outlives everybody but its flight."""

from __future__ import annotations

import json
import time
from pathlib import Path

import pytest

from gcs.flight import FlightEvent, FlightState, TransitionError
from gcs.mission.model import LocalPosition
from gcs.planning.replanning import replan
from link.errors import FlightRequestError, SupervisorError
from link.session.request import FlightRequest
from link.streamer.supervisor import attach, start_flight
from tests.support.flights.processes import Events, bad_links, free_ports, kill, simulator, start_attended
from tests.support.plans.planned import relay_plan, wide_plan
from tests.support.processes.tree import alive

SPEEDUP = 4.0


def idle_request(**changes: object) -> FlightRequest:
    """A flight with nobody at the other end."""
    plan = relay_plan(2)
    urls = [f"udpout:127.0.0.1:{port}" for port in free_ports(2)]
    return FlightRequest(
        plan=plan.to_document(),
        autopilot="px4",
        links=dict(zip(plan.station_ids, urls, strict=True)),
        **changes,  # type: ignore[arg-type]
    )


@pytest.mark.slow
def test_no_vehicle_is_a_refused_flight_with_a_reason_and_no_process_left(tmp_path: Path) -> None:
    journal = Events()
    flight = start_flight(idle_request(connect_timeout_s=1.0), journal, run_dir=tmp_path / "run")
    result = flight.wait(30.0)
    assert (result.state, result.exit_code) == (FlightState.REFUSED, 4)
    assert not alive(flight.pid)
    written = [
        FlightEvent.from_document(json.loads(line))
        for line in (tmp_path / "run" / "events.jsonl").read_text().splitlines()
    ]
    assert written == journal.all
    assert "no heartbeat of system 1" in next(e.data["reason"] for e in written if e.data.get("to") == "refused")
    with pytest.raises(SupervisorError, match="no streamer runs in"):
        attach(tmp_path / "run")
    with pytest.raises(SupervisorError, match=r"cannot be reached|has ended"):
        flight.command("hold")


@pytest.mark.slow
def test_words_are_answered_and_a_second_flight_on_the_same_links_is_refused(tmp_path: Path) -> None:
    request = idle_request(connect_timeout_s=60.0)
    flight = start_flight(request, run_dir=tmp_path / "a")
    try:
        assert flight.status()["state"] == "connecting"
        with pytest.raises(TransitionError, match="'hold' needs a flight that is"):
            flight.command("hold")
        with pytest.raises(TransitionError, match=r"unknown word|is not a valid"):
            flight.command("sing")
        with pytest.raises(FlightRequestError, match="another flight on this machine uses this link"):
            start_flight(request, run_dir=tmp_path / "b")
        with pytest.raises(SupervisorError, match="has been flown from"):
            start_flight(idle_request(), run_dir=tmp_path / "a")
        flight.command("abort", by="test")
        assert flight.wait(20.0).state is FlightState.REFUSED
    finally:
        flight.kill()
    assert not alive(flight.pid)


@pytest.mark.slow
def test_a_streamer_that_cannot_start_says_why_and_leaves_no_process(tmp_path: Path) -> None:
    (port,) = free_ports(1)
    import socket

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", port))
        plan = relay_plan(2)
        links = dict.fromkeys(plan.station_ids, f"udpin:127.0.0.1:{port}")
        request = FlightRequest(plan=plan.to_document(), autopilot="px4", links=links)
        with pytest.raises(FlightRequestError, match="the port is taken"):
            start_flight(request, run_dir=tmp_path / "run")


@pytest.mark.slow
def test_a_killed_flight_on_the_ground_is_a_fault_of_ours(tmp_path: Path) -> None:
    flight = start_flight(idle_request(connect_timeout_s=60.0), run_dir=tmp_path / "run")
    flight.status()
    flight.kill()
    result = flight.wait(10.0)
    assert (result.state, result.exit_code) == (FlightState.LOST, 1)
    with pytest.raises(SupervisorError):
        flight.status()


@pytest.mark.slow
def test_one_leaves_and_another_takes_over_the_attending(tmp_path: Path) -> None:
    """A service that restarts: nothing is missed, and the flight does not notice."""
    plan = relay_plan(2)
    with simulator(plan, "px4", SPEEDUP) as vehicle:
        first, second = Events(), Events()
        flight = start_flight(vehicle.request(plan, "px4", SPEEDUP), on_event=first, run_dir=tmp_path / "run")
        first.in_cruise(3.0)
        flight.detach()
        seen = first.all[-1].sequence
        time.sleep(1.0)
        again = attach(tmp_path / "run", on_event=second, after=seen)
        again.command("hold", by="the new one")
        second.wait_for(lambda e: e.data.get("to") == "holding")
        again.command("resume")
        result = again.wait(60.0)
    assert (result.state, result.exit_code) == (FlightState.COMPLETED, 0)
    sequences = [e.sequence for e in first.all + second.all]
    assert sequences == list(range(1, len(sequences) + 1))
    assert "nobody attends the flight" in [e.data.get("what") for e in second.all]
    assert not alive(flight.pid)


@pytest.mark.soak
def test_over_bad_links_a_station_that_dies_ends_the_flight_in_its_contingency(tmp_path: Path) -> None:
    """Real UDP: 10 % loss, 100 ms latency and reordering on every link (in the flight's time); then s3's link is gone.

    The flight waits inside s2's coverage, goes back along its path, hands over backwards and lands where it began.
    """
    plan = relay_plan(3)
    late = ("--loss", "0.1", "--latency", str(0.1 / SPEEDUP), "--jitter", str(0.05 / SPEEDUP))
    with simulator(plan, "ardupilot", SPEEDUP) as vehicle, bad_links(vehicle, *late) as proxies:
        events = Events()
        log = tmp_path / "flight.tlog"
        request = vehicle.request(plan, "ardupilot", SPEEDUP, wait_for_station_s=5.0, log_path=str(log))
        flight = start_flight(request, on_event=events, run_dir=tmp_path / "run")
        events.in_cruise(plan.handovers[0].time_s + 3.0)
        proxies["s3"].kill()
        result = flight.wait(120.0)
    assert (result.state, result.exit_code) == (FlightState.CONTINGENCY, 4), result.reason
    states = [e.data["to"] for e in events.all if e.kind.value == "state"]
    assert states[-4:] == ["holding", "returning", "landing", "contingency"]
    released = [(e.data["from"], e.data["to"]) for e in events.all if e.data.get("state") == "released"]
    assert released == [("s1", "s2"), ("s2", "s1")]
    links = result.summary["links"]
    assert 0.03 < links["s1"]["loss"] < 0.2
    assert 60.0 < links["s1"]["latency_ms"] < 300.0


@pytest.mark.slow
def test_a_plan_given_in_the_air_is_flown_by_the_streamer(tmp_path: Path) -> None:
    """In motion, on real UDP: a new plan that begins some way ahead is taken over, and ends where it says."""
    plan = wide_plan()
    with simulator(plan, "px4", SPEEDUP) as vehicle:
        events = Events()
        flight = start_flight(vehicle.request(plan, "px4", SPEEDUP), on_event=events, run_dir=tmp_path / "run")
        try:
            at_s = float(events.in_cruise(1.0).data["plan_s"])
            with pytest.raises(TransitionError, match="No such file"):
                flight.command("replan", new_plan_sha256="0" * 64)
            home = LocalPosition(30.0, 20.0, 42.0)
            # Past the tenure of s2, which is not to be cut short; well ahead.
            join_s = plan.handovers[0].time_s + 14.0
            assert join_s > at_s + 12.0
            new = replan(plan, join_s, destination=home, method="fast").plan
            flight.replan(new.to_document(), by="test", reason="home again")
            assert flight.status()["plan_sha256"] == new.plan_sha256
            events.in_cruise(join_s + 2.0)
            with pytest.raises(TransitionError, match="too late"):
                flight.replan(plan.to_document())
            result = flight.wait(120.0)
        finally:
            flight.kill()
    assert (result.state, result.exit_code) == (FlightState.COMPLETED, 0)
    assert result.summary["plan_sha256"] == new.plan_sha256
    assert result.summary["handovers"] == len(new.handovers)
    told = [e for e in events.all if e.kind.value == "replanned"]
    assert [e.data["before"] for e in told] == [plan.plan_sha256]


@pytest.mark.slow
@pytest.mark.parametrize(("autopilot", "stations"), [("px4", 3), ("ardupilot", 2)])
def test_a_killed_parent_does_not_disturb_the_flight(autopilot: str, stations: int, tmp_path: Path) -> None:
    plan = relay_plan(stations)
    run = tmp_path / "run"
    with simulator(plan, autopilot, SPEEDUP) as vehicle:
        request = vehicle.request(plan, autopilot, SPEEDUP, log_path=str(tmp_path / "flight.tlog"))
        parent, pid = start_attended(request, tmp_path)
        deadline = time.monotonic() + 60.0
        while time.monotonic() < deadline and '"cruise"' not in (run / "events.jsonl").read_text():
            time.sleep(0.05)
        kill(parent)
        while time.monotonic() < deadline + 60.0 and alive(pid):
            time.sleep(0.05)
    assert not alive(pid)
    result = json.loads((run / "result.json").read_text())
    assert (result["state"], result["exit_code"]) == ("completed", 0)
    events = [json.loads(line) for line in (run / "events.jsonl").read_text().splitlines()]
    killed = next(e for e in events if e["data"].get("what") == "nobody attends the flight")
    assert killed["state"] in ("takeoff", "transit", "cruise")
    from link.files.flight_report import report_flight

    report = report_flight(tmp_path / "flight.tlog", plan, run / "events.jsonl")
    assert report.reached
    assert [h.index for h in report.handovers] == list(range(1, stations))
    assert report.lateness_from == "streamer"
    assert {link.station for link in report.links} == set(plan.station_ids)
    for link in report.links:
        assert link.loss == 0.0
        assert link.probes > 10
        assert link.failovers == 0
