"""The planner as a mission's planning uses it: one method and one time limit for every problem made of the mission."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from planner import Method, Problem, Solution


class PlannerLike(Protocol):
    """What planning needs of a planner: `planner.Planner`."""

    def plan(
        self,
        problem: Problem,
        *,
        method: Method = "joint",
        time_limit_s: float | None = None,
        energy_weight: float = 0.0,
    ) -> Solution:
        """A certified solution; raises `planner.InfeasibleError` or `planner.SolverError`."""
        ...


@dataclass(frozen=True)
class ProblemPlanner:
    """A planner, and how it is asked."""

    planner: PlannerLike
    method: Method = "joint"
    time_limit_s: float | None = None

    def plan(self, problem: Problem, energy_weight: float = 0.0) -> Solution:
        """A certified solution; raises `planner.InfeasibleError` or `planner.SolverError`."""
        return self.planner.plan(
            problem, method=self.method, time_limit_s=self.time_limit_s, energy_weight=energy_weight
        )
