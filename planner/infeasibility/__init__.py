"""What makes a problem impossible, and the changes that would help."""

from planner.infeasibility.diagnosis import diagnose
from planner.infeasibility.explanation import diagnose_ranges, explain

__all__ = ["diagnose", "diagnose_ranges", "explain"]
