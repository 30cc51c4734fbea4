"""The whole vehicle: bytes and a clock in, bytes out."""

from __future__ import annotations

from sitl_fixtures.vehicle.config import SimulatorConfig
from sitl_fixtures.vehicle.vehicle import SimulatedAutopilot

__all__ = ["SimulatedAutopilot", "SimulatorConfig"]
