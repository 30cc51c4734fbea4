"""Where a vehicle truly flies, 100 km from its EKF origin: the simulated autopilot with its own projection, on WGS84.

The simulator shares no code with the product. Plane, resampling, profile, codec and the autopilot's estimator all have
to agree; sending the plane's own metres would put the vehicle 300 m off.
"""

from __future__ import annotations

import math
from typing import Any

import pytest
from geographiclib.geodesic import Geodesic

from gcs.geodesy.plane import Plane
from link.autopilot.local_frame import EkfOrigin
from link.autopilot.registry import PROFILES
from link.dialect import mavlink
from link.setpoints.sampler import SetpointSampler
from link.setpoints.setpoint import Setpoint
from link.wire.codec import StationCodec
from sitl_fixtures.vehicle import SimulatedAutopilot, SimulatorConfig
from tests.support.heartbeats import is_autopilot
from tests.support.plans.drawn import make_plan, rest_to_rest

GROUND_AMSL_M = 20.0
CLIMB_M = 40.0


class Flight:
    """A simulated vehicle and one station, in virtual time."""

    def __init__(self, autopilot: str, home: tuple[float, float]) -> None:
        self.profile = PROFILES[autopilot]
        self.simulator = SimulatedAutopilot(SimulatorConfig(autopilot=autopilot, home=(*home, GROUND_AMSL_M), seed=1))
        self.codec = StationCodec(241)
        self.now_s = 0.0
        self.origin: EkfOrigin | None = None
        self.offboard = False

    def send(self, message: Any) -> None:
        self.simulator.receive(0, self.codec.encode(message), self.now_s)

    def command(self, command: int, *parameters: float) -> None:
        values = [*parameters, *[0.0] * (7 - len(parameters))]
        self.send(mavlink.MAVLink_command_long_message(1, 1, command, 0, *values))

    def step(self, setpoint: Setpoint | None = None) -> None:
        """One twentieth of a second."""
        if setpoint is not None:
            self.send(self.profile.encode(setpoint, target_system=1, origin=self.origin))
        if round(self.now_s * 20) % 20 == 0:
            self.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
        self.now_s += 0.05
        self.simulator.step(self.now_s)
        for _, frame in self.simulator.take_outgoing():
            for message in self.codec.decode(frame):
                if message.get_type() == "GPS_GLOBAL_ORIGIN":
                    self.origin = EkfOrigin.from_message(message)
                if is_autopilot(self.profile, message):
                    self.offboard = self.profile.is_offboard(message)

    def take_off(self, start: Setpoint) -> None:
        """To the start of the plan, by each autopilot's own way."""
        self.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 49)
        self.step()
        assert self.origin is not None
        if self.profile.name == "ardupilot":
            self.command(mavlink.MAV_CMD_DO_SET_MODE, *self.profile.set_mode_parameters("GUIDED"))
            self.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
            self.step()
            self.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, CLIMB_M)
            for _ in range(600):
                self.step()
        for _ in range(40):
            self.step(start.hold())
        if self.profile.name == "px4":
            self.command(mavlink.MAV_CMD_DO_SET_MODE, *self.profile.set_mode_parameters("OFFBOARD"))
            self.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
        for _ in range(800):
            self.step(start.hold())
        assert self.offboard

    def error_m(self, sample: Setpoint) -> tuple[float, float]:
        """True distance over ground and in height from a sample."""
        body = self.simulator.body
        path = Geodesic.WGS84.Inverse(body.lat_deg, body.lon_deg, sample.lat_deg, sample.lon_deg)
        return path["s12"], abs(body.height_m - sample.alt_amsl_m)


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_true_place_100_km_from_the_vehicles_origin(autopilot: str) -> None:
    # The plan's plane is about 53 N, 4.8 E; the flight is 98 km east of it, where its north is 1.2 degrees off.
    curve = rest_to_rest((98_000, 0, 50), (98_400, 0, 50), (98_400, 500, 70), (98_900, 700, 60), duration_s=130.0)
    stream = SetpointSampler(make_plan(curve), 20.0)
    first, last = stream.at(0.0), stream.at(130.0)
    flight = Flight(autopilot, (first.lat_deg, first.lon_deg))
    for _ in range(200):
        flight.step()
    # It was switched on 100 km away, south-west of here: that is where its local frame begins.
    lat, lon = Plane(53.0, 4.8).to_geodetic(27_000.0, -70_000.0)
    flight.simulator.estimator.set_origin(math.radians(float(lat)), math.radians(float(lon)), 3.0)
    flight.take_off(first)
    assert flight.error_m(first)[0] < 0.3
    worst = (0.0, 0.0)
    for sample in stream:
        flight.step(sample)
        worst = max(worst, flight.error_m(sample))
    # On the way the vehicle's own tracking error, as real ones show it; at rest nothing but the conversions.
    assert worst[0] < 2.0
    for _ in range(200):
        flight.step(last)
    across, height = flight.error_m(last)
    assert across < 0.3
    assert height < 0.3
    assert flight.offboard
