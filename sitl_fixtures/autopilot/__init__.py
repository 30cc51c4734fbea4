"""What the two autopilot models have in common: state, commands, flown missions."""

from __future__ import annotations

from sitl_fixtures.autopilot.model import AutopilotModel

__all__ = ["AutopilotModel"]
