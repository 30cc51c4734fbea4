"""The balls a trajectory goes through piece by piece, and first polylines in them."""

from planner.corridor.corridor import build_corridor
from planner.corridor.polyline_program import polyline_length_m, shortest_polyline

__all__ = ["build_corridor", "polyline_length_m", "shortest_polyline"]
