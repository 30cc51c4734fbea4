"""What the planner raises.

PlannerError
├── ProblemError        the problem itself makes no sense (a fault of the caller)
├── InfeasibleError     no trajectory exists; says why, where and by how much
└── SolverError         a numerical solver gave up; callers fall back to the next method
"""

from __future__ import annotations

from dataclasses import dataclass

from planner.remedy import Point, RaiseLimit, Remedy


class PlannerError(Exception):
    """Base of everything the planner raises on purpose."""


class ProblemError(PlannerError, ValueError):
    """The problem is malformed: a shape, a sign or a value that is not finite."""


class SolverError(PlannerError, RuntimeError):
    """A numerical solver did not return a usable answer."""


@dataclass(frozen=True)
class Infeasibility:
    """Why no trajectory exists, in the words and numbers an operator needs.

    ``reason`` is one of ``"start_uncovered"``, ``"destination_uncovered"``, ``"start_altitude"``,
    ``"destination_altitude"``, ``"broken_chain"``, ``"limits"``. ``stations`` are station indices of the
    problem (none, one or two). ``gap_m`` is how much range is missing between the two stations, or between
    the station and the point. ``position_m`` is where. ``remedies`` each cure everything: the smallest of its kind
    first, others of different kinds after it; there may be none.

    ``causes`` are all that is wrong on the best route, in flight order, each with the remedy that mends it alone; empty
    where there is but this one. ``masked``: stations whose elevation masks alone stand in the way.
    """

    reason: str
    message: str
    stations: tuple[int, ...] = ()
    gap_m: float | None = None
    position_m: Point | None = None
    remedies: tuple[Remedy, ...] = ()
    causes: tuple[Infeasibility, ...] = ()
    masked: tuple[int, ...] = ()

    @property
    def limit(self) -> str | None:
        """The limit that the first remedy raises; None where that is something else."""
        first = self.remedies[0][0] if self.remedies else None
        return first.limit if isinstance(first, RaiseLimit) else None


class InfeasibleError(PlannerError):
    """No trajectory of the problem exists; ``.infeasibility`` says why."""

    def __init__(self, infeasibility: Infeasibility) -> None:
        super().__init__(infeasibility.message)
        self.infeasibility = infeasibility
