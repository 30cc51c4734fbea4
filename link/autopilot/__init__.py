"""All that differs between PX4 and ArduPilot."""

from link.autopilot.local_frame import EkfOrigin
from link.autopilot.profile import AutopilotProfile
from link.autopilot.registry import PROFILES

__all__ = ["PROFILES", "AutopilotProfile", "EkfOrigin"]
