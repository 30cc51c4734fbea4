"""The vehicle's side of MAVLink: frames, telemetry, parameters, mission transfer, signing, operator control."""

from __future__ import annotations

from sitl_fixtures.mavlink.mission_protocol import FENCE, MISSION, RALLY, Item

__all__ = ["FENCE", "MISSION", "RALLY", "Item"]
