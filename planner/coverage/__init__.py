"""What stations cover: balls and elevation masks, discs at a height, overlaps, windows along a curve."""

from planner.coverage.disc import disc_radius_m
from planner.coverage.overlap import adjacent_pairs
from planner.coverage.window import Stations, coverage_windows

__all__ = ["Stations", "adjacent_pairs", "coverage_windows", "disc_radius_m"]
