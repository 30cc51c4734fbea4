"""A mission of a minute, for demonstrations and benchmarks."""

from __future__ import annotations

from typing import Any

QUICK_MISSION: dict[str, Any] = {
    "name": "A short hop between two stations",
    "origin": {"lat_deg": 39.96, "lon_deg": 116.32, "alt_amsl_m": 0.0},
    "start": {"east_m": 0.0, "north_m": 0.0, "up_m": 110.0},
    "destination": {"east_m": 1500.0, "north_m": 300.0, "up_m": 110.0},
    "stations": [
        {"id": "west", "name": "West mast", "east_m": 0.0, "north_m": 0.0, "up_m": 0.0, "range_m": 1000.0},
        {"id": "east", "name": "East mast", "east_m": 1500.0, "north_m": 300.0, "up_m": 0.0, "range_m": 1000.0},
    ],
    "limits": {"min_alt_amsl_m": 100.0, "max_alt_amsl_m": 120.0, "max_speed_m_s": 25.0, "max_accel_m_s2": 3.0},
}
