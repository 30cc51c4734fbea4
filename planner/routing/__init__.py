"""Stations in order: the portal graph, candidate sequences, and the lower bound on time.

`navmesh` finds exact shortest paths through the union of ranges, `bound` makes of them a mission time that nothing can
beat. `portal_graph` prices every leg between two handovers, and `station_sequence` chooses, from the path where
handovers cost nothing and from the graph where they do, which stations to plan along.
"""

from planner.routing.bound import lower_bound
from planner.routing.station_sequence import candidate_routes

__all__ = ["candidate_routes", "lower_bound"]
