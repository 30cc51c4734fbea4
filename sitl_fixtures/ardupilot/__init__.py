"""The model of ArduCopter."""

from __future__ import annotations

from sitl_fixtures.ardupilot.autopilot import ArduCopter

__all__ = ["ArduCopter"]
