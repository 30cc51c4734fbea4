"""The autopilots by name."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from link.autopilot.ardupilot import ArduPilotProfile
from link.autopilot.profile import AutopilotProfile
from link.autopilot.px4 import Px4Profile

PROFILES: Mapping[str, AutopilotProfile] = MappingProxyType({"px4": Px4Profile(), "ardupilot": ArduPilotProfile()})
"""The autopilots we speak to, by the name used on the command line and in documents."""
