"""Stations in order: the portal graph, candidate sequences, and the lower bound on time."""

from planner.routing.bound import lower_bound
from planner.routing.station_sequence import candidate_routes

__all__ = ["candidate_routes", "lower_bound"]
