"""A vehicle's side of the mission protocol, as PX4 and ArduPilot were recorded to behave, and a bad link to it.

Small enough to run ten thousand transfers in virtual time; `sitl_fixtures` is the independent witness.
"""

from __future__ import annotations

import heapq
import itertools
import random
from typing import Any

from link.dialect import mavlink as m
from link.microservices.mission_download import MissionTransfer
from link.wire.codec import StationCodec

MAX_ITEMS = 650


class MissionVehicle:
    """Holds one list. ``kind`` is px4 or ardupilot."""

    def __init__(self, kind: str, held: list[Any], mission_type: int = 0) -> None:
        self.kind = kind
        self.codec = StationCodec(1, 1)
        self.mission_type = mission_type
        self.held = list(held)
        self.outgoing: list[tuple[int, bytes]] = []
        self.partner: int | None = None
        self.count = 0
        self.taken: list[Any] = []
        self.next_ask_s = float("inf")
        self.give_up_s = float("inf")
        self.reading = False

    @property
    def ask_every_s(self) -> float:
        return 0.25 if self.kind == "px4" else 1.0

    @property
    def patience_s(self) -> float:
        return 5.0 if self.kind == "px4" else 8.0

    @property
    def due_s(self) -> float:
        return min(self.next_ask_s, self.give_up_s)

    def send(self, station: int, kind: Any, *fields: Any) -> None:
        self.outgoing.append((station, self.codec.encode(kind(station, 190, *fields, mission_type=self.mission_type))))

    def ack(self, station: int, result: int) -> None:
        self.send(station, m.MAVLink_mission_ack_message, result)

    def ask(self, now_s: float) -> None:
        assert self.partner is not None
        kind = m.MAVLink_mission_request_int_message if self.kind == "px4" else m.MAVLink_mission_request_message
        self.send(self.partner, kind, len(self.taken))
        self.next_ask_s = now_s + self.ask_every_s

    def stop(self) -> None:
        self.partner = None
        self.next_ask_s = self.give_up_s = float("inf")

    def step(self, now_s: float) -> None:
        if self.partner is None:
            return
        if now_s >= self.give_up_s:
            if self.kind == "ardupilot":
                self.ack(self.partner, m.MAV_MISSION_OPERATION_CANCELLED)
            self.stop()
        elif now_s >= self.next_ask_s:
            self.ask(now_s)

    def receive(self, message: Any, now_s: float) -> None:
        kind = message.get_type()
        if not kind.startswith("MISSION_") or message.target_system != 1 or message.mission_type != self.mission_type:
            return
        station = message.get_srcSystem()
        handler = getattr(self, "on_" + kind.lower(), None)
        if handler is not None:
            handler(message, station, now_s)

    def on_mission_count(self, message: Any, station: int, now_s: float) -> None:
        if self.partner not in (None, station):
            self.ack(station, m.MAV_MISSION_ERROR if self.kind == "px4" else m.MAV_MISSION_DENIED)
        elif message.count > MAX_ITEMS:
            self.ack(station, m.MAV_MISSION_NO_SPACE)
        elif message.count == 0:
            self.held = self.held[:1] if self.kind == "ardupilot" else []
            self.ack(station, m.MAV_MISSION_ACCEPTED)
        elif self.kind == "px4" and self.partner == station and self.taken:
            return
        else:
            self.partner, self.count, self.taken = station, message.count, []
            if self.kind == "ardupilot":
                del self.held[message.count :]
            self.give_up_s = now_s + self.patience_s
            self.ask(now_s)

    def on_mission_item_int(self, message: Any, station: int, now_s: float) -> None:
        if self.partner != station:
            self.ack(station, m.MAV_MISSION_ERROR)
            return
        if message.seq != len(self.taken):
            if self.kind == "ardupilot":
                self.ack(station, m.MAV_MISSION_INVALID_SEQUENCE)
            return
        if message.command == 12345:
            self.ack(station, m.MAV_MISSION_UNSUPPORTED)
            self.stop()
            return
        self.taken.append(message)
        if self.kind == "ardupilot":
            # Straight into storage: a failure leaves a mixture.
            self.held[message.seq : message.seq + 1] = [message]
        self.give_up_s = now_s + self.patience_s
        if len(self.taken) == self.count:
            self.held = list(self.taken)
            self.ack(station, m.MAV_MISSION_ACCEPTED)
            self.stop()
        else:
            self.ask(now_s)

    def on_mission_ack(self, message: Any, station: int, now_s: float) -> None:
        if self.kind == "px4" and message.type == m.MAV_MISSION_OPERATION_CANCELLED and self.partner == station:
            self.stop()

    def on_mission_request_list(self, message: Any, station: int, now_s: float) -> None:
        if self.partner is not None:
            if self.kind == "ardupilot":
                self.ack(station, m.MAV_MISSION_DENIED)
            return
        self.send(station, m.MAVLink_mission_count_message, len(self.held))

    def on_mission_request_int(self, message: Any, station: int, now_s: float) -> None:
        if message.seq >= len(self.held):
            if self.kind == "ardupilot":
                self.ack(station, m.MAV_MISSION_INVALID_SEQUENCE)
            return
        i = self.held[message.seq]
        fields = (message.seq, i.frame, i.command, 0, 1, i.param1, i.param2, i.param3, i.param4, i.x, i.y, i.z)
        self.send(station, m.MAVLink_mission_item_int_message, *fields)

    def on_mission_clear_all(self, message: Any, station: int, now_s: float) -> None:
        if self.partner is not None and self.kind == "ardupilot":
            self.ack(station, m.MAV_MISSION_DENIED)
            return
        self.held = []
        self.ack(station, m.MAV_MISSION_ACCEPTED)


class BadLink:
    """Carries a transfer in virtual time: loses, doubles, delays and so reorders, from one seed."""

    def __init__(
        self,
        vehicle: MissionVehicle,
        *,
        seed: int = 0,
        loss: float = 0.0,
        doubled: float = 0.0,
        delay_s: tuple[float, float] = (0.005, 0.01),
        station: int = 241,
    ) -> None:
        self.vehicle = vehicle
        self.rng = random.Random(seed)
        self.loss, self.doubled, self.delay_s = loss, doubled, delay_s
        self.station = station
        self.codec = StationCodec(station)
        self.now_s = 100.0
        self.sent = 0
        self._order = itertools.count()
        self._air: list[tuple[float, int, bool, bytes]] = []
        self.drop_to_station: list[str] = []
        """Message kinds of which the next one towards the station is lost, in order."""

    def throw(self, frame: bytes, *, up: bool) -> None:
        self.sent += 1
        for _ in range(2 if self.rng.random() < self.doubled else 1):
            if self.rng.random() >= self.loss:
                arrival = self.now_s + self.rng.uniform(*self.delay_s)
                heapq.heappush(self._air, (arrival, next(self._order), up, frame))

    def run(self, transfer: MissionTransfer, *, limit_s: float = 3600.0) -> float:
        """Until the transfer ends; how long it took."""
        begin_s = self.now_s
        transfer.start(self.now_s)
        while True:
            for message in transfer.take_outgoing():
                self.throw(self.codec.encode(message), up=True)
            for station, frame in self.vehicle.outgoing:
                if station == self.station:
                    self.throw(frame, up=False)
            self.vehicle.outgoing.clear()
            if not transfer.running:
                return self.now_s - begin_s
            assert self.now_s - begin_s < limit_s, "the transfer never ends"
            self.now_s = max(
                self.now_s, min(self._air[0][0] if self._air else 1e18, transfer.deadline_s, self.vehicle.due_s)
            )
            while self._air and self._air[0][0] <= self.now_s:
                _, _, up, frame = heapq.heappop(self._air)
                for message in (self.vehicle.codec if up else self.codec).decode(frame):
                    if up:
                        self.vehicle.receive(message, self.now_s)
                    elif self.drop_to_station[:1] == [message.get_type()]:
                        self.drop_to_station.pop(0)
                    else:
                        transfer.receive(message, self.now_s)
            self.vehicle.step(self.now_s)
            transfer.step(self.now_s)
