"""What shows, as a mission is planned, that nobody can fly it. What shows before is in `gcs.layout.findings`.

A finding is data; what would help is sought by `gcs.remedies.explanation` alone.
"""

from __future__ import annotations

from gcs.errors import Finding
from gcs.layout.planning_problem import PlanningProblem
from gcs.mission.model import Mission
from planner import Infeasibility


class NoTrajectory(Finding):
    """The planner knows why there is no trajectory: ranges, altitude band, handovers, wind or start state."""

    def __init__(self, laid: PlanningProblem, infeasibility: Infeasibility) -> None:
        super().__init__(infeasibility.message)
        self.laid = laid
        self.infeasibility = infeasibility


class TooManyStations(Finding):
    """The plan found needs ``count`` stations, and system ids tell no more than ``most`` apart."""

    def __init__(self, mission: Mission, *, count: int, most: int) -> None:
        super().__init__(f"{count} stations are flown, and system ids tell no more than {most} apart")
        self.mission = mission
        self.count = count
        self.most = most


class EnduranceTooShort(Finding):
    """The fastest plan found, ``duration_s``, takes longer than endurance less reserve, ``allowed_s``.

    No flight takes less than ``lower_bound_s``.
    """

    def __init__(self, mission: Mission, *, allowed_s: float, duration_s: float, lower_bound_s: float) -> None:
        super().__init__(f"the fastest plan takes {duration_s:.1f} s, and the endurance allows {allowed_s:.1f} s")
        self.mission = mission
        self.allowed_s = allowed_s
        self.duration_s = duration_s
        self.lower_bound_s = lower_bound_s


class ArrivalTooEarly(Finding):
    """The fastest plan found, ``duration_s``, takes longer than the arrival asked for, ``arrival_s``."""

    def __init__(self, mission: Mission, *, arrival_s: float, duration_s: float) -> None:
        super().__init__(f"the fastest plan takes {duration_s:.1f} s, and arrival is asked for at {arrival_s:g} s")
        self.mission = mission
        self.arrival_s = arrival_s
        self.duration_s = duration_s


class ArrivalAfterEndurance(Finding):
    """Arrival is asked for at ``arrival_s``, when endurance less reserve, ``allowed_s``, is used up."""

    def __init__(self, mission: Mission, *, arrival_s: float, allowed_s: float) -> None:
        super().__init__(f"arrival at {arrival_s:g} s is later than the {allowed_s:g} s that the endurance allows")
        self.mission = mission
        self.arrival_s = arrival_s
        self.allowed_s = allowed_s
