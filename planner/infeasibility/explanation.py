"""Why a problem has no plan, and what would give it one: the first of what speaks against it, with its remedies.

`planner.infeasibility.diagnosis` says what is wrong with the ranges and the one station to change,
`planner.infeasibility.limit_faults` what is wrong with wind, start state and endurance, and
`planner.infeasibility.alternatives` what else would help.
"""

from __future__ import annotations

from planner.errors import Infeasibility
from planner.infeasibility.alternatives import with_alternatives
from planner.infeasibility.diagnosis import diagnose
from planner.infeasibility.limit_faults import endurance_fault, start_state_fault, wind_fault
from planner.problem import Problem


def infeasibility_of(problem: Problem, lower_bound_s: float, *, chained: bool = False) -> Infeasibility | None:
    """Why no trajectory of ``problem`` exists; None when neither ranges nor limits speak against one.

    ``lower_bound_s``: a time no trajectory can beat. ``chained``: a chain of stations is known, so the ranges need no
    second look.
    """
    return (
        (None if chained else diagnose_ranges(problem))
        or wind_fault(problem.limits)
        or start_state_fault(problem)
        or endurance_fault(problem, lower_bound_s, proven=True)
    )


def diagnose_ranges(problem: Problem) -> Infeasibility | None:
    """As `infeasibility_of`, of ranges, altitude band and handovers alone."""
    found = diagnose(problem)
    return None if found is None else with_alternatives(problem, found)
