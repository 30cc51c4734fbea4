"""One aircraft, one flight, with real processes and real UDP: however a second flight leads to the same vehicle."""

from __future__ import annotations

from pathlib import Path

import pytest

from gcs.flight import FlightState
from link.errors import FlightRequestError
from link.session.request import FlightRequest
from link.streamer.supervisor import start_flight
from tests.support.flights.processes import Events, free_ports, simulator
from tests.support.plans.planned import relay_plan

SPEEDUP = 10.0
AUTOPILOTS = ("ardupilot", "px4")


@pytest.mark.slow
@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_another_spelling_of_a_link_and_another_temporary_folder_are_the_same_link(
    autopilot: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = relay_plan(2)
    with simulator(plan, autopilot, SPEEDUP) as vehicle:
        first = start_flight(vehicle.request(plan, autopilot, SPEEDUP, auto_launch=False), run_dir=tmp_path / "a")
        try:
            (tmp_path / "other").mkdir()
            monkeypatch.setenv("TMPDIR", str(tmp_path / "other"))
            for host in ("127.0.0.1", "localhost"):
                links = {s: url.replace("127.0.0.1", host) for s, url in vehicle.links.items()}
                again = FlightRequest(plan=plan.to_document(), autopilot=autopilot, links=links, speedup=SPEEDUP)
                with pytest.raises(FlightRequestError, match=f"process {first.pid}, of the flight in"):
                    start_flight(again, run_dir=tmp_path / host)
        finally:
            first.kill()


@pytest.mark.slow
@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_two_flights_over_different_ports_of_one_vehicle(
    autopilot: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its own identity tells; the flight that has it goes on and is named."""
    plan = relay_plan(2)
    stations = list(dict.fromkeys(plan.station_ids))
    ports = free_ports(len(stations))
    more = [text for port in ports for text in ("--listen", f"udpin:127.0.0.1:{port}")]
    with simulator(plan, autopilot, SPEEDUP, *more) as vehicle:
        seen = Events()
        first = start_flight(vehicle.request(plan, autopilot, SPEEDUP), on_event=seen, run_dir=tmp_path / "a")
        try:
            seen.wait_for(lambda e: e.kind.value == "identity")
            monkeypatch.setenv("TMPDIR", str(tmp_path))
            # The simulator's own links come last: see `simulator`.
            links = {s: f"udpout:127.0.0.1:{p}" for s, p in zip(stations, ports, strict=True)}
            request = FlightRequest(plan=plan.to_document(), autopilot=autopilot, links=links, speedup=SPEEDUP)
            theirs = Events()
            second = start_flight(request, on_event=theirs, run_dir=tmp_path / "b")
            assert second.wait(60.0).state is FlightState.REFUSED
            said = [str(e.data["reason"]) for e in theirs.all if e.kind.value == "state"]
            assert f"is on another flight of this machine: process {first.pid}" in said[-1]
            assert not [e for e in theirs.all if e.kind.value == "parameter"]
            assert first.wait(90.0).state is FlightState.COMPLETED
            assert not [e for e in seen.all if e.kind.value == "alarm"]
        finally:
            if first.result is None:
                first.kill()
