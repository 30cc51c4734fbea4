"""The planner measured beside the paper's method: the missions, the comparison, what options cost, how it grows."""

from __future__ import annotations

from api.bench.planner.cases import DEFAULT_OPTIONS, PAPER_OPTIONS, Case, drawn, fixed
from api.bench.planner.compare import figures, mean_and_worst, measure, reference_available, warm_up
from api.bench.planner.costs import measure_costs
from api.bench.planner.scale import SEGMENTS, STATIONS, routing_row, segments_row

__all__ = [
    "DEFAULT_OPTIONS",
    "PAPER_OPTIONS",
    "SEGMENTS",
    "STATIONS",
    "Case",
    "drawn",
    "figures",
    "fixed",
    "mean_and_worst",
    "measure",
    "measure_costs",
    "reference_available",
    "routing_row",
    "segments_row",
    "warm_up",
]
