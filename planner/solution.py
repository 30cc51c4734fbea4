"""What a planner returns."""

from __future__ import annotations

from dataclasses import dataclass, field

from planner.certificate import Certificate
from planner.trajectory import Trajectory


@dataclass(frozen=True)
class Solution:
    """A certified trajectory and how it came about.

    ``method`` names the method that made it (after any fallback); ``lower_bound_s`` is a time no trajectory of the
    problem can beat; ``iterations`` counts the method's outer steps; ``notes`` say what a reader of the plan should
    know, e.g. that a fallback was used. ``fastest_s`` and ``fastest_handovers`` are those of the fastest plan found,
    where this one has fewer handovers for ``fewer_cost_s`` more, else None. ``overlap_cost_s``: what it takes
    longer for overlaps as wide as aimed at.
    """

    trajectory: Trajectory
    certificate: Certificate
    method: str
    lower_bound_s: float
    iterations: int = 0
    notes: tuple[str, ...] = field(default=())
    fastest_s: float | None = None
    fastest_handovers: int | None = None
    fewer_cost_s: float = 0.0
    overlap_cost_s: float = 0.0
