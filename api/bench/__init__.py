"""Measurements behind ``skyrelay bench``: of the planner, of the seed paper's experiments, of the wire layer."""
