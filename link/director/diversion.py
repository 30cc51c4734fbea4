"""The contingency in force, as it can be flown by the station in control alone.

A plan's contingencies cover their straight ways by any stations of the mission; a flight has links to the plan's own,
and on a straight way there is no handover. So a diversion is flown only where it lies wholly in the range of the
station in control; otherwise the flight goes back along the path, which is always covered by stations it has.
"""

from __future__ import annotations

import numpy as np

from gcs.flight import EventKind
from gcs.plan import Plan
from link.director.guidance import Guidance
from link.handover.handover_chain import HandoverChain
from link.session.context import FlightContext
from link.setpoints.setpoint import Vector


class Diversion:
    """Where the contingency being flown leaves the path, if it does: `choose`, then follow it tick by tick."""

    def __init__(self, flight: FlightContext, chain: HandoverChain, guidance: Guidance) -> None:
        self._flight = flight
        self._chain = chain
        self._guidance = guidance
        self._to_enu_m: Vector | None = None
        self._leave_for: tuple[float, str] | None = None

    def choose(self) -> None:
        """By what the plan says for where the flight is: a safe point at once, one further back, or the start."""
        plan, time_s = self._flight.plan, self._guidance.reference.time_s
        self._to_enu_m = self._leave_for = None
        for contingency in plan.contingencies:
            if contingency.from_s <= time_s <= contingency.to_s and contingency.safe_point is not None:
                if contingency.action == "divert":
                    self._to_enu_m = self._over(contingency.safe_point)
                    return
                if contingency.leave_path_s is not None:
                    self._leave_for = (contingency.leave_path_s, contingency.safe_point)
                    return

    @property
    def turning_off(self) -> bool:
        """Whether the flight is to stop here and leave the path, by `turn_off`."""
        return self._to_enu_m is not None

    def turn_off(self) -> None:
        """Leave the path for the safe point, from rest."""
        assert self._to_enu_m is not None
        self._guidance.divert(self._to_enu_m)
        self._to_enu_m = None
        reason = "to the safe point"
        self._flight.timeline.emit(EventKind.STATE, **{"from": "returning", "to": "returning", "reason": reason})

    @property
    def due(self) -> bool:
        """Whether the flight has come back to where the contingency leaves the path."""
        return self._leave_for is not None and self._guidance.reference.time_s <= self._leave_for[0]

    def leave_path(self) -> None:
        """Turn off here; on along the path where the way to the safe point is not covered from here."""
        assert self._leave_for is not None
        self._to_enu_m, self._leave_for = self._over(self._leave_for[1]), None

    def _over(self, safe_point: str) -> Vector | None:
        """The place over a safe point; None where the way there from the stop is not in the range of this station."""
        plan = self._flight.plan
        station_index = plan.trajectory.sequence[self._chain.leg]
        return over_safe_point(plan, station_index, self._guidance.stop_enu_m, safe_point)


def over_safe_point(plan: Plan, station_index: int, stop_enu_m: Vector, safe_point: str) -> Vector | None:
    """The place over a safe point at the height of ``stop_enu_m``; None where the way leaves the station's range."""
    point = next(p for p in plan.mission.safe_points if p.id == safe_point)
    ground = plan.geometry.enu_m([point.position])[0]
    over = (float(ground[0]), float(ground[1]), stop_enu_m[2])
    # A ball is convex: with its corners inside, the way there and down is.
    corners = np.array([stop_enu_m, over, ground])
    outside = plan.geometry.outside_m(np.array([station_index] * 3), corners)
    return over if bool((outside <= 0.0).all()) else None
