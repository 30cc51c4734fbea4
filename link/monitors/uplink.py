"""What is known of our frames at the vehicle: when one last got there, and whether it takes anybody else's."""

from __future__ import annotations

import math
from collections import deque

from gcs.flight import FlightState
from link.session.control import Control
from link.session.timeline import Timeline
from link.session.vehicle import Vehicle

FOREIGN_TARGET_M = 5.0
FOREIGN_COUNT, FOREIGN_WITHIN_S, FOREIGN_AGAIN_S = 2, 2.0, 10.0
"""So many targets this far from every setpoint of ours within so long are told, and told again at most so often.

The setpoint of a foreign ground station holds until our next one. With the echoes of
`link.telemetry.streams.STREAMED_MESSAGES` one that holds for a quarter of the time is seen twice within a second, for
an eighth of it within two; less is seen as the echoes drift through the ticks, and moves the vehicle as little.
"""
GRACE_S = 1.0
"""Until our first setpoints are in, the vehicle rightly shows a target of its own, as after a take-off."""


class UplinkMonitor:
    """How long ago a frame of ours was last known to have reached the vehicle.

    Proof is an answered probe of the station in control, or a setpoint that the vehicle repeats, whoever sent it.
    When it grows older than the autopilot's time-out, the vehicle may have acted on our silence, whatever we hear.
    """

    def __init__(self, timeline: Timeline, vehicle: Vehicle, control: Control) -> None:
        self._timeline = timeline
        self._vehicle = vehicle
        self._control = control
        self._target_s = -math.inf
        self._proven_s = -math.inf
        self._foreign_since_s: float | None = None
        self._foreign: deque[float] = deque(maxlen=FOREIGN_COUNT)
        self._told_s = -math.inf
        self._ours_from_s = -math.inf

    def restart(self) -> None:
        """Count from now on: the stream begins."""
        timeline = self._timeline
        self._proven_s = timeline.now_s
        self._foreign_since_s = None
        self._foreign.clear()
        self._ours_from_s = timeline.now_s + GRACE_S

    def update(self) -> None:
        """Look at the newest answers; once a tick."""
        vehicle, control = self._vehicle, self._control
        self._proven_s = max(self._proven_s, vehicle.monitor.links[control.in_force.station_id].proven_s)
        if vehicle.monitor.target is None or vehicle.monitor.target_s <= self._target_s:
            return
        self._target_s = vehicle.monitor.target_s
        self._notice_foreign_targets()
        held = control.echoes.held(vehicle.monitor.target)
        if held:
            # The oldest it may be: proof must not be younger than what it proves.
            self._proven_s = max(self._proven_s, held[0].sent_s)

    def _notice_foreign_targets(self) -> None:
        """A target nowhere near our setpoints: somebody else streams, or the vehicle no longer takes ours."""
        timeline = self._timeline
        # Landing, and after the C2 link was lost, the vehicle flies a target of its own.
        other = timeline.state in (FlightState.LANDING, FlightState.LAPSED) or timeline.now_s < self._ours_from_s
        if other or self._control.echoes.distance_m(self._vehicle.monitor.target) <= FOREIGN_TARGET_M:
            self._foreign_since_s = None
            return
        if self._foreign_since_s is None:
            self._foreign_since_s = timeline.now_s
        self._foreign.append(timeline.now_s)
        often = len(self._foreign) == FOREIGN_COUNT and timeline.now_s - self._foreign[0] <= FOREIGN_WITHIN_S
        if often and timeline.now_s - self._told_s > FOREIGN_AGAIN_S:
            self._told_s = timeline.now_s
            timeline.alarm("the vehicle holds a target that is not ours")

    @property
    def foreign_for_s(self) -> float:
        """How long the vehicle has shown nothing but targets that are not ours."""
        return 0.0 if self._foreign_since_s is None else self._timeline.now_s - self._foreign_since_s

    @property
    def age_s(self) -> float:
        """Seconds since the newest frame known to have arrived was sent."""
        return self._timeline.now_s - self._proven_s
