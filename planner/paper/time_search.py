"""Algorithm 3: with the boundary conditions fixed, every piece on its own as short as the constraints allow."""

from __future__ import annotations

import numpy as np

from planner.arrays import Array, Flags
from planner.corridor.corridor import Corridor
from planner.corridor.limit_check import CorridorCheck
from planner.paper.boundary import control_points
from planner.paper.initial import leg_durations


def shortest_durations(
    check: CorridorCheck,
    corridor: Corridor,
    boundary: Array,
    durations_s: Array,
    minima_s: Array,
    *,
    tolerance_s: float = 1e-6,
) -> Array:
    """Durations ``(S,)`` no longer than ``durations_s`` for fixed ``boundary`` ``(S + 1, 3, 3)``.

    A bisection of [minimum, present duration] for all pieces at once; the upper end always stays feasible. A leg
    that would fall short of its tenure keeps as much of its present durations as that takes.
    """
    low, high = minima_s.copy(), durations_s.copy()
    at_low = check.holds(control_points(boundary, low), low) & (low < high)
    high[at_low] = low[at_low]
    while (high - low).max() > tolerance_s:
        middle = 0.5 * (low + high)
        feasible = check.holds(control_points(boundary, middle), middle)
        high = np.where(feasible, middle, high)
        low = np.where(feasible, low, middle)
    return _keep_tenure(check, corridor, boundary, durations_s, high)


def _keep_tenure(check: CorridorCheck, corridor: Corridor, boundary: Array, before_s: Array, after_s: Array) -> Array:
    legs = np.array([piece.leg for piece in corridor.pieces])
    asked = corridor.min_leg_s * (1.0 + 1e-12)
    durations = after_s.copy()
    for leg in np.flatnonzero(leg_durations(corridor, after_s) < asked):
        mine = legs == leg

        def at(share: float) -> Array:
            return after_s + share * (before_s - after_s)

        def holds(share: float, mine: Flags = mine) -> bool:
            return bool(check.holds(control_points(boundary, at(share)), at(share))[mine].all())

        # Between the two, feasibility is not monotone; the present durations are the end known to be feasible.
        low = (asked - after_s[mine].sum()) / max(float((before_s - after_s)[mine].sum()), 1e-300)
        low, high = min(low, 1.0), 1.0
        if holds(low):
            high = low
        while high - low > 1e-6:
            middle = 0.5 * (low + high)
            low, high = (low, middle) if holds(middle) else (middle, high)
        durations[mine] = at(high)[mine]
    return durations
