"""Stations in order: the portal graph, candidate sequences, and the lower bound on time."""
