"""The simulator as a process: real UDP, two links, speed-up, options that cannot be."""

from __future__ import annotations

import itertools
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl_fixtures.__main__ import main
from sitl_fixtures.errors import ConfigurationError
from sitl_fixtures.process.host import Address, Host
from sitl_fixtures.vehicle import SimulatedAutopilot, SimulatorConfig
from tests.support.flights.processes import free_ports


class Ground:
    """A ground station on a real socket."""

    def __init__(self, port: int, system_id: int = 255) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.settimeout(0.2)
        self.address = ("127.0.0.1", port)
        self.mav = mavlink.MAVLink(None, system_id, 190)
        self.parser = mavlink.MAVLink(None, 0, 0)
        self.parser.robust_parsing = True
        self.heard: list[Any] = []
        self.arrived: list[float] = []

    def send(self, message: Any) -> None:
        self.socket.sendto(message.pack(self.mav), self.address)
        self.mav.seq = (self.mav.seq + 1) % 256

    def hear(self, name: str, limit_s: float = 20.0, fits: Any = None) -> Any:
        """The next message of a name (that fits)."""
        end = time.monotonic() + limit_s
        while time.monotonic() < end:
            try:
                data = self.socket.recv(4096)
            except TimeoutError:
                self.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
                continue
            for message in self.parser.parse_buffer(data) or []:
                self.heard.append(message)
                self.arrived.append(time.monotonic())
                if message.get_type() == name and (fits is None or fits(message)):
                    return message
        raise AssertionError(f"no {name} within {limit_s} s")

    def command(self, number: int, *params: float) -> int:
        values = [*params, *[0.0] * (7 - len(params))]
        self.send(mavlink.MAVLink_command_long_message(1, 1, number, 0, *values))
        return int(self.hear("COMMAND_ACK", fits=lambda m: m.command == number).result)


@pytest.fixture
def simulator() -> Iterator[Any]:
    """Starts simulator processes and ends them."""
    running: list[subprocess.Popen[str]] = []

    def start(*options: str) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [sys.executable, "-m", "sitl_fixtures", *options], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        running.append(process)
        assert process.stdout is not None
        assert process.stdout.readline().startswith("ready ")
        return process

    yield start
    for process in running:
        process.terminate()
        process.communicate(timeout=10.0)
        assert process.returncode == 0


def test_two_links_one_vehicle(simulator: Any) -> None:
    """What A sets B sees; each is answered on its own link; the speed-up is told."""
    ports = free_ports(1)[0], free_ports(1)[0]
    simulator(
        *["--autopilot", "ardupilot", "--speedup", "20", "--home", "53.1,5.2,3.0", "--ready-after", "1"],
        *[f"--listen=udpin:127.0.0.1:{port}" for port in ports],
    )
    a, b = Ground(ports[0]), Ground(ports[1], 254)
    for station in (a, b):
        station.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
        assert station.hear("HEARTBEAT").autopilot == mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
    a.hear("GPS_RAW_INT", fits=lambda m: m.fix_type == 6)
    origin = a.hear("LOCAL_POSITION_NED") and a.command(512, 49) == 0 and a.hear("GPS_GLOBAL_ORIGIN")
    assert (origin.latitude, origin.longitude, origin.altitude) == (531000000, 52000000, 3000)
    a.send(mavlink.MAVLink_param_request_read_message(1, 1, b"SIM_SPEEDUP", -1))
    assert a.hear("PARAM_VALUE", fits=lambda m: m.param_id == "SIM_SPEEDUP").param_value == 20.0
    a.send(mavlink.MAVLink_param_set_message(1, 1, b"GUID_TIMEOUT", 1.5, 9))
    assert b.hear("PARAM_VALUE", fits=lambda m: m.param_id == "GUID_TIMEOUT").param_value == 1.5
    assert b.command(176, 1, 4) == 0
    assert a.hear("HEARTBEAT", fits=lambda m: m.custom_mode == 4)
    assert not [m for m in a.heard if m.get_type() == "COMMAND_ACK" and m.target_system == 254]


@pytest.mark.slow
def test_flies_over_real_sockets_on_the_vehicles_clock(simulator: Any) -> None:
    """Takes off and follows a stream at 25 times real time; SYSTEM_TIME is the vehicle's clock."""
    port = free_ports(1)[0]
    simulator("--autopilot", "ardupilot", "--speedup", "25", f"--listen=udpin:127.0.0.1:{port}", "--ready-after", "1")
    station = Ground(port)
    station.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
    first = station.hear("SYSTEM_TIME").time_boot_ms
    station.hear("LOCAL_POSITION_NED")
    assert station.command(176, 1, 4) == 0
    while station.command(400, 1) != 0:
        station.hear("SYSTEM_TIME")
    assert station.command(22, 0, 0, 0, 0, 0, 0, 30) == 0
    station.hear("LOCAL_POSITION_NED", fits=lambda m: m.z < -29.5)
    station.send(
        mavlink.MAVLink_set_position_target_local_ned_message(0, 1, 1, 1, 0xDF8, 100, 0, -30, 0, 0, 0, 0, 0, 0, 0, 0)
    )
    station.hear("LOCAL_POSITION_NED", fits=lambda m: m.x > 99.0)
    # 30 m of climb and 100 m of flight take the vehicle more than 15 s of its own time.
    assert station.hear("SYSTEM_TIME").time_boot_ms - first > 15_000


def taken_times(speedup: float, rounds: list[Callable[[socket.socket, int], None]], seconds: float) -> list[float]:
    """Vehicle times at which a host takes datagrams; each round is run inside one of its steps, as a stall would be."""
    port = free_ports(1)[0]
    vehicle = SimulatedAutopilot(SimulatorConfig(autopilot="px4", speedup=speedup))
    host = Host(vehicle, [Address.parse(f"udpin:127.0.0.1:{port}")], speedup)
    taken: list[float] = []
    vehicle.receive = lambda link, data, now_s: taken.append(now_s)  # type: ignore[method-assign]
    step, left = vehicle.step, [lambda *_: None, *rounds]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station:

        def stalling(now_s: float) -> None:
            if left:
                left.pop(0)(station, port)
            step(now_s)

        vehicle.step = stalling  # type: ignore[method-assign]
        try:
            host.run(seconds)
        finally:
            host.close()
    return taken


def test_datagrams_count_from_their_arrival_even_when_the_process_is_late() -> None:
    """Three datagrams came in 0.1 s apart while the process was held up: they are taken 0.1 s apart."""

    def held_up(station: socket.socket, port: int) -> None:
        for _ in range(3):
            station.sendto(b"x", ("127.0.0.1", port))
            time.sleep(0.1)

    taken = taken_times(1.0, [held_up], 0.6)
    assert len(taken) == 3
    assert all(0.09 < b - a < 0.5 for a, b in itertools.pairwise(taken))


def test_sped_up_setpoints_are_taken_as_far_apart_as_they_were_stamped() -> None:
    """Ten set-points 50 ms apart by their stamps come in two bursts: the vehicle flies them 50 ms apart."""
    mav = mavlink.MAVLink(None, 255, 190)

    def burst(first: int) -> Callable[[socket.socket, int], None]:
        def send(station: socket.socket, port: int) -> None:
            for number in range(first, first + 5):
                message = mavlink.MAVLink_set_position_target_local_ned_message(
                    10_000 + 50 * number, 1, 1, 1, 0xDF8, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0
                )
                station.sendto(message.pack(mav), ("127.0.0.1", port))
            time.sleep(0.05)

        return send

    taken = taken_times(50.0, [burst(0), burst(5)], 0.6)
    assert len(taken) == 10
    assert [b - a for a, b in itertools.pairwise(taken)] == pytest.approx([0.05] * 9, abs=1e-6)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--listen", "tcp:127.0.0.1:1"], "udpin:HOST:PORT"),
        (["--listen", "udpin:127.0.0.1:99999"], "port 1 to 65535"),
        (["--listen", "udpin:203.0.113.1:14540"], "a free address of this machine"),
        (["--home", "53,5"], "3 numbers"),
        (["--home", "95,5,0"], "latitude -89..89"),
        (["--param", "NO_SUCH=1"], "check the name"),
        (["--param", "COM_OF_LOSS_T=often"], "give a number"),
        (["--param", "COM_OF_LOSS_T=inf"], "finite"),
        (["--fault", "gremlins"], "list-faults"),
        (["--speedup", "0"], "0.01 to 1000"),
        (["--speedup", "nan"], "0.01 to 1000"),
        (["--system-id", "0"], "1 to 254"),
        (["--tilt", "89"], "5 to 70"),
        (["--wind", "strong"], "2 numbers"),
    ],
)
def test_options_that_cannot_be_end_with_two_and_say_why(
    options: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*options, "--duration", "0"]) == 2
    captured = capsys.readouterr()
    assert words in captured.err
    assert options[0] in captured.err
    assert captured.out == ""


@pytest.mark.parametrize("option", [["--home", "-35.3,149.1,584"], ["--home", "-.5,-70,3"], ["--wind", "-3,2"]])
def test_numbers_may_begin_with_a_minus(option: list[str]) -> None:
    """Every home south of the equator does."""
    (port,) = free_ports(1)
    assert main([*option, "--listen", f"udpin:127.0.0.1:{port}", "--duration", "0"]) == 0


def test_a_taken_port_is_said_to_be_taken(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as holder:
        holder.bind(("127.0.0.1", 0))
        assert main(["--listen", f"udpin:127.0.0.1:{holder.getsockname()[1]}"]) == 2
    assert "choose another" in capsys.readouterr().err


def test_faults_can_be_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--list-faults"]) == 0
    assert "ack-lost" in capsys.readouterr().out


def test_config_is_checked_without_the_command_line_too() -> None:
    with pytest.raises(ConfigurationError, match="px4 or ardupilot"):
        SimulatorConfig(autopilot="inav")
