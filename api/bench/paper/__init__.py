"""The seed paper's experiments made again: the runs, what they measured, its tables, figures and page."""

from __future__ import annotations

from api.bench.paper.experiments import ALLOCATIONS, Settings, nlopt_available, run, summary, table_3, table_4
from api.bench.paper.figures import draw_all, matplotlib_available
from api.bench.paper.page import TABLE_3, cells_3, mean, tables_page
from api.bench.paper.results import Results, ResultsError

__all__ = [
    "ALLOCATIONS",
    "TABLE_3",
    "Results",
    "ResultsError",
    "Settings",
    "cells_3",
    "draw_all",
    "matplotlib_available",
    "mean",
    "nlopt_available",
    "run",
    "summary",
    "table_3",
    "table_4",
    "tables_page",
]
