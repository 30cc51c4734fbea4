"""The autopilots by name."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from link.autopilot.ardupilot import ArduPilotProfile
from link.autopilot.profile import AutopilotProfile
from link.autopilot.px4 import Px4Profile

PROFILES: Mapping[str, AutopilotProfile] = MappingProxyType({"px4": Px4Profile(), "ardupilot": ArduPilotProfile()})
"""The autopilots we speak to, by the name used on the command line and in documents."""


def profile_of_setpoints(counts: Mapping[int, int]) -> AutopilotProfile:
    """The autopilot setpoints were written for, from the number of messages by id in a log; PX4 where none tell."""
    return max(PROFILES.values(), key=lambda profile: counts.get(profile.setpoint_message_id, 0))
