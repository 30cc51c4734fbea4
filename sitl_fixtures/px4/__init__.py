"""The model of PX4."""

from __future__ import annotations

from sitl_fixtures.px4.autopilot import Px4

__all__ = ["Px4"]
