"""A small ground station in virtual time, for tests of the simulator's core."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl_fixtures.vehicle import SimulatedAutopilot, SimulatorConfig

ACCEPTED, TEMPORARILY_REJECTED, DENIED, UNSUPPORTED, FAILED = 0, 1, 2, 3, 4
POSITION, POSITION_VELOCITY, ALL, VELOCITY = 0x0DF8, 0x0DC0, 0x0C00, 0x0DC7
OFFBOARD, HOLD, RTL, LAND = (6, 0), (4, 3), (4, 5), (4, 6)
GUIDED, AP_LOITER, AP_RTL, AP_LAND, BRAKE = 4, 5, 6, 9, 17


class Rig:
    """A vehicle and the stations that speak to it, on one clock.

    Args:
        autopilot: ``px4`` or ``ardupilot``.
        links: how many; station ``i`` of ``station(i)`` speaks on link ``i``.
        options: further fields of ``SimulatorConfig``.
    """

    def __init__(self, autopilot: str, *, links: int = 1, **options: Any) -> None:
        self.autopilot = autopilot
        self.sim = SimulatedAutopilot(SimulatorConfig(autopilot=autopilot, links=links, **options))
        self.now = 0.0
        self.stations: list[Station] = []
        self.streams: list[Callable[[float], None]] = []
        self.frames: list[tuple[float, int, bytes]] = []
        self._next_beat = 0.0
        self.beating = True
        self.sim.step(0.0)

    def station(self, link: int = 0, system_id: int = 255) -> Station:
        """A new ground station."""
        made = Station(self, link, system_id)
        self.stations.append(made)
        return made

    def collect(self) -> None:
        """Hands what the vehicle sent to the stations."""
        for link, data in self.sim.take_outgoing():
            self.frames.append((self.now, link, data))
            for station in self.stations:
                if station.link == link:
                    station.take(data)

    def run(self, seconds: float, step_s: float = 0.05) -> None:
        """Lets time pass: streams send at every step, heartbeats once a second."""
        end = self.now + seconds
        while self.now < end - 1e-9:
            self.now += min(step_s, end - self.now)
            if self.beating and self.now >= self._next_beat:
                self._next_beat = self.now + 1.0
                for station in self.stations:
                    if station.beating:
                        station.heartbeat()
            for stream in self.streams:
                stream(self.now)
            self.sim.step(self.now)
            self.collect()

    def until(self, condition: Callable[[], bool], limit_s: float) -> float:
        """Runs until a condition holds; the time it took."""
        start = self.now
        while not condition():
            assert self.now - start < limit_s, f"not within {limit_s} s"
            self.run(0.05)
        return self.now - start

    @property
    def place(self) -> tuple[float, float, float]:
        """North, east, down by the estimate, m."""
        e = self.sim.estimator
        return e.n, e.e, e.d

    @property
    def mode(self) -> str:
        return self.sim.autopilot.mode_name

    def off(self, north: float, east: float) -> float:
        """Horizontal distance from a local place, m."""
        return math.hypot(self.place[0] - north, self.place[1] - east)


class Station:
    """One ground station: sends, and keeps what it heard."""

    def __init__(self, rig: Rig, link: int, system_id: int) -> None:
        self.rig = rig
        self.link = link
        self.beating = True
        self.mav = mavlink.MAVLink(None, system_id, 190)
        self._parser = mavlink.MAVLink(None, 0, 0)
        self._parser.robust_parsing = True
        self.heard: list[tuple[float, Any]] = []
        self.last: dict[str, Any] = {}

    def take(self, data: bytes) -> None:
        for message in self._parser.parse_buffer(data) or []:
            self.heard.append((self.rig.now, message))
            self.last[message.get_type()] = message

    def send(self, message: Any) -> None:
        data = message.pack(self.mav)
        self.mav.seq = (self.mav.seq + 1) % 256
        self.rig.sim.receive(self.link, data, self.rig.now)
        self.rig.collect()

    def heartbeat(self) -> None:
        self.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))

    def of(self, name: str, since: float = -1.0) -> list[Any]:
        """Messages of a name heard since a time."""
        return [m for t, m in self.heard if t >= since and m.get_type() == name]

    def texts(self, since: float = -1.0) -> list[str]:
        """Texts heard since a time, pieces joined."""
        found: list[str] = []
        for message in self.of("STATUSTEXT", since):
            if message.chunk_seq and found:
                found[-1] += message.text
            else:
                found.append(message.text)
        return [text.rstrip("\t") for text in found]

    def command(self, number: int, *params: float, component: int = 1, system: int = 1) -> list[int]:
        """Sends a COMMAND_LONG; the results of the acknowledgements that came at once."""
        before = len(self.heard)
        values = [*params, *[0.0] * (7 - len(params))]
        self.send(mavlink.MAVLink_command_long_message(system, component, number, 0, *values))
        return [m.result for _, m in self.heard[before:] if m.get_type() == "COMMAND_ACK" and m.command == number]

    def set_mode(self, mode: int | tuple[int, int]) -> list[int]:
        main, sub = mode if isinstance(mode, tuple) else (mode, 0)
        return self.command(176, 1, main, sub)

    def arm(self, on: bool = True, force: float = 0.0) -> list[int]:
        return self.command(400, float(on), force)

    def local(
        self,
        position: tuple[float, float, float] = (0, 0, 0),
        velocity: tuple[float, float, float] = (0, 0, 0),
        accel: tuple[float, float, float] = (0, 0, 0),
        mask: int = POSITION,
        frame: int = 1,
        system: int = 1,
        component: int = 1,
    ) -> None:
        """SET_POSITION_TARGET_LOCAL_NED."""
        self.send(
            mavlink.MAVLink_set_position_target_local_ned_message(
                0, system, component, frame, mask, *position, *velocity, *accel, 0, 0
            )
        )

    def stream(self, target: Callable[[float], dict[str, Any]]) -> Callable[[], None]:
        """Streams set-points from now on; call what is returned to stop."""
        step = lambda now: self.local(**target(now))  # noqa: E731
        self.rig.streams.append(step)
        return lambda: self.rig.streams.remove(step)

    def set_parameter(self, name: str, value: float, kind: int = 9) -> Any:
        """PARAM_SET; the PARAM_VALUE that came back, or None."""
        before = len(self.heard)
        self.send(mavlink.MAVLink_param_set_message(1, 1, name.encode(), value, kind))
        found = [m for _, m in self.heard[before:] if m.get_type() == "PARAM_VALUE" and m.param_id == name]
        return found[-1] if found else None

    def read_parameter(self, name: str) -> Any:
        """PARAM_REQUEST_READ; the PARAM_VALUE that came back, or None."""
        before = len(self.heard)
        self.send(mavlink.MAVLink_param_request_read_message(1, 1, name.encode(), -1))
        found = [m for _, m in self.heard[before:] if m.get_type() == "PARAM_VALUE" and m.param_id == name]
        return found[-1] if found else None


def airborne(autopilot: str, height_m: float = 50.0, **options: Any) -> tuple[Rig, Station]:
    """A vehicle hovering at a height in OFFBOARD or GUIDED; PX4's stream to hold it goes on as ``rig.streams[0]``."""
    rig = Rig(autopilot, **options)
    station = rig.station()
    rig.run(4.0)
    if autopilot == "px4":
        station.stream(lambda now: {"position": (0, 0, -height_m)})
        rig.run(1.5)
        assert station.set_mode(OFFBOARD) == [ACCEPTED, ACCEPTED]
        assert station.arm() == [ACCEPTED]
    else:
        assert station.set_mode(GUIDED) == [ACCEPTED]
        assert station.arm() == [ACCEPTED]
        assert station.command(22, 0, 0, 0, 0, 0, 0, height_m) == [ACCEPTED]
    rig.until(lambda: rig.place[2] < 0.3 - height_m, 60.0)
    rig.run(6.0)
    return rig, station
