"""The streamer as a process: its folder, its locks, its death; sockets and the wall clock are real."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from gcs.flight import FlightState
from link.errors import EndpointError, FlightRequestError
from link.session.request import FlightRequest
from link.streamer.control_socket import SOCKET_FILE, ControlServer, connect
from link.streamer.process import EXIT_REFUSED_REQUEST, main, make_codecs, open_links
from link.streamer.recorder import Recorder
from link.streamer.supervisor import start_flight
from link.transport.port_lock import LinkLocks
from tests.support.flights.processes import Events, free_ports, mode_seen, simulator
from tests.support.plans.planned import relay_plan

BOTH = pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
SPEEDUP = 4.0


def links(urls: list[str]) -> dict[str, str]:
    return dict(zip(relay_plan(2).station_ids, urls, strict=True))


def request(urls: list[str], **changes: object) -> FlightRequest:
    return FlightRequest(plan=relay_plan(2).to_document(), autopilot="px4", links=links(urls), **changes)  # type: ignore[arg-type]


def test_one_flight_a_link() -> None:
    (port,) = free_ports(1)
    url = f"udpout:127.0.0.1:{port}"
    first = LinkLocks([url, url])
    with pytest.raises(EndpointError, match=f"{url}: another flight on this machine uses this link"):
        LinkLocks([url])
    first.release()
    LinkLocks([url]).release()


def test_a_speed_up_and_unsigned_links_stay_on_this_machine() -> None:
    away = ["udpout:192.0.2.1:14550", "udpout:192.0.2.1:14551"]
    with pytest.raises(FlightRequestError) as refusal:
        open_links(request(away, speedup=2.0))
    words = str(refusal.value)
    assert "a speed-up is for simulations" in words
    assert "nothing on it is signed" in words
    for endpoint in open_links(request(away, allow_unsigned=True)).values():
        endpoint.close()
    here = [f"udpout:127.0.0.1:{port}" for port in free_ports(2)]
    for endpoint in open_links(request(here, speedup=2.0)).values():
        endpoint.close()


def test_a_key_signs_every_station_with_its_own_link_id_and_stamps(tmp_path: Path) -> None:
    key = tmp_path / "key"
    key.write_bytes(os.urandom(32))
    key.chmod(0o600)
    urls = [f"udpout:127.0.0.1:{port}" for port in free_ports(2)]
    codecs = make_codecs(request(urls, signing_key=f"file:{key}", signing_state=str(tmp_path)), tmp_path)
    assert [codec.signing.link_id for codec in codecs.values() if codec.signing is not None] == [241, 242]
    assert sorted(p.name for p in tmp_path.glob("*.stamps")) == ["station-241.stamps", "station-242.stamps"]
    for codec in codecs.values():
        assert codec.signing is not None
        codec.signing.store.close()


def test_a_request_it_cannot_fly_is_refused_in_words(tmp_path: Path) -> None:
    (tmp_path / "request.json").write_text(json.dumps({"autopilot": "px4"}))
    assert main([str(tmp_path)]) == EXIT_REFUSED_REQUEST
    said = json.loads((tmp_path / "refusal.json").read_text())
    assert said["kind"] == "FlightRequestError"
    assert "plan: missing" in said["error"]


def test_the_recorder_survives_a_full_disk(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, "/dev/full", 1_795_320_000.0)
    for k in range(100):
        recorder.frame(0.1 * k, b"\xfd" + bytes(11))
    recorder.close()
    assert recorder._log is not None
    assert recorder._log.dropped == 100


def test_a_socket_in_a_folder_of_any_depth(tmp_path: Path) -> None:
    folder = tmp_path.joinpath(*["a-run-folder-with-a-long-name"] * 8)
    folder.mkdir(parents=True)
    path = folder / SOCKET_FILE
    assert len(str(path)) > 200
    with pytest.raises(OSError):
        connect(path)
    server = ControlServer(path)
    with connect(path) as client:
        client.sendall(b'{"id": 1}\n')
        received: list[tuple[int, dict[str, object]]] = []
        while not received:
            received = server.receive()
    assert [line for _, line in received] == [{"id": 1}]
    server.close()
    assert list(folder.iterdir()) == []


def test_a_client_that_does_not_read_or_talks_nonsense_disturbs_nobody(tmp_path: Path) -> None:
    server = ControlServer(tmp_path / "c.sock")
    slow, good = (socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) for _ in range(2))
    slow.connect(str(tmp_path / "c.sock"))
    good.connect(str(tmp_path / "c.sock"))
    slow.sendall(b'{"attach": 0}\nnonsense\n[1]\n')
    good.sendall(b'{"attach": 0}\n')
    deadline = time.monotonic() + 5.0
    attached = set()
    while len(attached) < 2 and time.monotonic() < deadline:
        for client, line in server.receive():
            assert line == {"attach": 0}
            server.subscribe(client)
            attached.add(client)
    assert len(attached) == 2
    assert server.attended is None  # from the first client on: no change
    good.settimeout(5.0)
    received = bytearray()
    for k in range(3000):
        server.broadcast({"event": {"sequence": k, "filler": "x" * 4000}})
        while len(received) < (k - 20) * 4000:
            received += good.recv(1 << 20)
        server.receive()
    # The slow one was cut off when its backlog grew too long; the good one got everything.
    assert len(server.filenos()) == 2
    good.close()
    server.receive()
    assert server.attended is False
    slow.close()
    server.close()
    assert not (tmp_path / "c.sock").exists()


@BOTH
@pytest.mark.slow
def test_a_killed_streamer_means_silence_and_the_vehicles_own_failsafe(autopilot: str, tmp_path: Path) -> None:
    plan = relay_plan(2)
    with simulator(plan, autopilot, SPEEDUP) as vehicle:
        events = Events()
        flight = start_flight(vehicle.request(plan, autopilot, SPEEDUP), on_event=events, run_dir=tmp_path / "run")
        events.in_cruise(4.0)
        os.kill(flight.pid, signal.SIGKILL)
        result = flight.wait(20.0)
        assert (result.state, result.exit_code) == (FlightState.LOST, 4)
        assert "died" in result.reason
        assert events.all[-1].data["what"] == "streamer died"
        # A listener of its own sees the failsafe act: HOLD, or the return (ArduPilot: 5 s after the last heartbeat).
        expected = {"px4": "HOLD", "ardupilot": "RTL"}[autopilot]
        assert mode_seen(vehicle.links["s2"], autopilot, expected) == expected


@pytest.mark.slow
def test_told_to_stop_in_the_air_it_flies_the_contingency(tmp_path: Path) -> None:
    plan = relay_plan(2)
    with simulator(plan, "px4", SPEEDUP) as vehicle:
        events = Events()
        flight = start_flight(vehicle.request(plan, "px4", SPEEDUP), on_event=events, run_dir=tmp_path / "run")
        events.in_cruise(3.0)
        locked = re.search(r"VmLck:\s+(\d+) kB", Path(f"/proc/{flight.pid}/status").read_text())
        assert locked is not None
        assert (int(locked[1]) > 0) == ("memory: locked" in (tmp_path / "run" / "streamer.log").read_text())
        os.kill(flight.pid, signal.SIGTERM)
        result = flight.wait(60.0)
    assert (result.state, result.exit_code) == (FlightState.CONTINGENCY, 4)
    assert "returning" in [e.data.get("to") for e in events.all]


@pytest.mark.slow
def test_it_starts_from_any_folder_whatever_lies_there(tmp_path: Path) -> None:
    """A file called like one of our packages in the working folder must not be run."""
    (tmp_path / "link.py").write_text("raise SystemExit('the wrong link')\n")
    (tmp_path / "json.py").write_text("raise SystemExit('the wrong json')\n")
    (tmp_path / "request.json").write_text("{}")
    done = subprocess.run(
        [sys.executable, "-P", "-m", "link.streamer", str(tmp_path)],
        cwd=tmp_path,
        capture_output=True,
        check=False,
    )
    assert done.returncode == EXIT_REFUSED_REQUEST, done.stderr
