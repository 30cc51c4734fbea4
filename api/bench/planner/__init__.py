"""Figures of the planner."""
