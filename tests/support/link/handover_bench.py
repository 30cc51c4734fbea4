"""A bench on which one handover is driven by hand."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

from gcs.flight import EventKind, FlightState
from link.dialect import mavlink
from link.director.core import FlightCore
from link.handover.handover import handover_windows
from link.session.request import FlightRequest
from link.telemetry.plausibility import Position
from link.wire.codec import StationCodec
from tests.support.plans.planned import relay_plan

TICK_S = 0.05

STATIONS = ("s1", "s2", "s3")


@cache
def request(**changes: Any) -> FlightRequest:
    plan = relay_plan()
    links = {s: f"udpout:127.0.0.1:{20000 + k}" for k, s in enumerate(plan.station_ids)}
    return FlightRequest(plan=plan.to_document(), autopilot="px4", links=links, **changes)


class Bench:
    """The handover chain of a flight core in cruise, and a vehicle reduced to what a handover needs of it.

    ``up`` says which links work, ``obeys`` whom the vehicle answers; time moves by `tick`.
    """

    def __init__(self, **changes: Any) -> None:
        self.core = FlightCore(request(**changes))
        self.c = self.core.context
        self.chain = self.core.airborne.chain
        for state in ("identifying", "preflight", "ready", "arming", "takeoff", "transit", "cruise"):
            self.c.timeline.become(FlightState(state))
        self.c.control.grant("s1", "first")
        self.up = dict.fromkeys(STATIONS, True)
        self.obeys = set(STATIONS)
        self.decoder = StationCodec(99)
        self.senders: list[str] = []
        """Station of every setpoint of the last tick."""
        self.plan_s = 0.0
        self.be_at(0.0)
        self.hear()

    def hear(self) -> None:
        """The working links bring telemetry and answered probes."""
        for station, works in self.up.items():
            if works:
                link = self.c.vehicle.monitor.links[station]
                link.active.heard_s = link.active.proven_s = self.c.timeline.now_s

    def be_at(self, plan_s: float) -> None:
        """The vehicle is where the plan has it, and that is known throughout."""
        plane = self.c.plan.plane
        east_m, north_m, up_m = (float(x) for x in self.c.plan.trajectory.evaluate(plan_s))
        lat, lon = plane.to_geodetic(east_m, north_m)
        place = Position(0.0, math.inf, float(lat), float(lon), plane.alt_amsl_m + up_m, (0.0, 0.0, 0.0))
        self.c.vehicle.monitor.places.position = place

    def tick(self, to_s: float | None = None, *, backwards: bool = False) -> None:
        self.c.timeline.now_s += TICK_S
        self.hear()
        if to_s is not None:
            self.plan_s = to_s
            self.be_at(to_s)
        self.chain.step(self.plan_s, backwards=backwards)
        self.c.control.send_setpoint(self.core.airborne.guidance.stream.at(self.plan_s))
        self.c.control.commander.step(self.c.timeline.now_s)
        self.deliver()

    def deliver(self) -> None:
        self.senders = []
        for sender, frame in self.c.control.gate.take_outgoing():
            station = sender.station_id
            for message in self.decoder.decode(frame):
                if message.get_type() == "SET_POSITION_TARGET_GLOBAL_INT":
                    self.senders.append(station)
                elif message.get_type() == "COMMAND_LONG" and self.up[station] and station in self.obeys:
                    ack = mavlink.MAVLink_command_ack_message(
                        message.command, 0, 0, 0, message.get_srcSystem(), message.get_srcComponent()
                    )
                    self.c.control.commander.on_ack(self.c.timeline.now_s, ack)

    def said(self, **data: Any) -> list[Any]:
        return [
            e
            for e in self.c.timeline.events
            if e.kind is EventKind.HANDOVER and all(e.data.get(k) == v for k, v in data.items())
        ]


FIRST, SECOND = handover_windows(relay_plan())
