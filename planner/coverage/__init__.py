"""What stations cover: balls and elevation masks, discs at a height, overlaps, windows along a curve.

The geometry of ranges, and nothing of flights but where a given curve is covered. A station's ball narrowed by its
mask (`elevation_mask`) is a disc at every altitude (`disc`); two discs share an overlap (`overlap`) and a chord, which
prices a handover (`chord`); `window` finds when a curve enters and leaves a range, by roots. `grid_zoom` searches for
the least value of convex functions.
"""

from planner.coverage.disc import disc_radius_m
from planner.coverage.elevation_mask import ElevationMask
from planner.coverage.overlap import adjacent_pairs
from planner.coverage.window import Stations, coverage_windows

__all__ = ["ElevationMask", "Stations", "adjacent_pairs", "coverage_windows", "disc_radius_m"]
