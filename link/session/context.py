"""What the parts of one flight share."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gcs.plan import Plan
from link.autopilot.registry import PROFILES
from link.clock import UtcScale
from link.microservices.command import Commander
from link.session.control import Control
from link.session.request import FlightRequest
from link.session.timeline import Timeline
from link.session.vehicle import PATIENT_SPEEDUP, Vehicle
from link.telemetry.plausibility import Reach
from link.telemetry.setpoint_echo import EchoTracker
from link.telemetry.vehicle_monitor import VehicleMonitor
from link.transport.gate import TransmitterGate
from link.wire.codec import StationCodec

ECHO_MEMORY_S = 5.0
"""For so long a setpoint is remembered that the vehicle may repeat."""

FAR_M = 100_000.0
"""Farther than this from the plan no vehicle of the flight is."""


def _reach(plan: Plan) -> Reach:
    """Where anything the vehicle says of places may be."""
    path = plan.trajectory.evaluate(np.linspace(0.0, plan.mission_time_s, 200))
    farthest_m = float(np.hypot(path[:, 0], path[:, 1]).max())
    return Reach(plan.plane.lat_deg, plan.plane.lon_deg, 1.02 * farthest_m + FAR_M)


@dataclass
class FlightContext:
    """One flight's request, the plan it flies (another one after a replan), and its three shared parts."""

    request: FlightRequest
    plan: Plan
    timeline: Timeline
    vehicle: Vehicle
    control: Control

    @classmethod
    def begin(
        cls, request: FlightRequest, codecs: Mapping[str, StationCodec], *, now_s: float, epoch_unix_s: float
    ) -> FlightContext:
        """A flight at its beginning: nobody is in control and nothing has been heard.

        ``codecs`` are the stations'; ``epoch_unix_s`` is UTC at 0 of the flight's clock, ``now_s`` that clock now.
        """
        plan, system_ids = request.flown_plan, request.system_ids
        vehicle_id = plan.mission.options.vehicle_system_id
        profile = PROFILES[request.autopilot]
        timeline = Timeline(UtcScale(epoch_unix_s), now_s)
        own_ids = frozenset(system_ids.values()) | {vehicle_id}
        monitor = VehicleMonitor(
            request.stations, vehicle_id, own_ids, request.urls, _reach(plan), speedup=request.speedup
        )
        patience = max(1.0, request.speedup / PATIENT_SPEEDUP)
        vehicle = Vehicle(profile, monitor, plan.plane, now_s=now_s, patience=patience)
        gate = TransmitterGate(
            {station: codec.encode for station, codec in codecs.items()},
            {s: StationCodec(vehicle_id, 190, signing=codec.signing).encode for s, codec in codecs.items()},
        )
        echoes = EchoTracker(runs_on=profile.target_runs_on, memory=math.ceil(ECHO_MEMORY_S * request.rate_hz))
        control = Control(timeline, vehicle, gate, Commander(gate.send, system_ids), echoes, system_ids)
        return cls(request, plan, timeline, vehicle, control)
