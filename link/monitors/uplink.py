"""The share of frames that reach the vehicle, link by link."""

from __future__ import annotations

import math
from collections import deque

from gcs.flight import FlightState
from link.monitors.tracking import GRACE_S, STRANGE_AGAIN_S, STRANGE_COUNT, STRANGE_M, STRANGE_WITHIN_S
from link.session.context import FlightContext


class UplinkMonitor:
    """How long ago a frame of ours was last known to have reached the vehicle.

    Proof is an answered probe of the station in control, or a setpoint that the vehicle repeats, whoever sent it.
    When it grows older than the autopilot's time-out, the vehicle may have acted on our silence, whatever we hear.
    """

    def __init__(self, context: FlightContext) -> None:
        self._c = context
        self._target_s = -math.inf
        self._proven_s = -math.inf
        self._strange_since_s: float | None = None
        self._strange: deque[float] = deque(maxlen=STRANGE_COUNT)
        self._told_s = -math.inf
        self._ours_from_s = -math.inf

    def restart(self) -> None:
        """Count from now on: the stream begins."""
        self._proven_s = self._c.now_s
        self._strange_since_s = None
        self._strange.clear()
        self._ours_from_s = self._c.now_s + GRACE_S

    def update(self) -> None:
        """Look at the newest answers; once a tick."""
        c = self._c
        self._proven_s = max(self._proven_s, c.monitor.links[c.in_force.station_id].proven_s)
        if c.monitor.target is None or c.monitor.target_s <= self._target_s:
            return
        self._target_s = c.monitor.target_s
        self._notice_strangers()
        held = c.echoes.held(c.monitor.target)
        if held:
            # The oldest it may be: proof must not be younger than what it proves.
            self._proven_s = max(self._proven_s, held[0].sent_s)

    def _notice_strangers(self) -> None:
        """A target nowhere near our setpoints: somebody else streams, or the vehicle no longer takes ours."""
        c = self._c
        # Landing, and after a lapse, the vehicle flies a target of its own.
        other = c.state in (FlightState.LANDING, FlightState.LAPSED) or c.now_s < self._ours_from_s
        if other or c.echoes.distance_m(c.monitor.target) <= STRANGE_M:
            self._strange_since_s = None
            return
        if self._strange_since_s is None:
            self._strange_since_s = c.now_s
        self._strange.append(c.now_s)
        often = len(self._strange) == STRANGE_COUNT and c.now_s - self._strange[0] <= STRANGE_WITHIN_S
        if often and c.now_s - self._told_s > STRANGE_AGAIN_S:
            self._told_s = c.now_s
            c.alarm("the vehicle holds a target that is not ours")

    @property
    def strange_for_s(self) -> float:
        """How long the vehicle has shown nothing but targets that are not ours."""
        return 0.0 if self._strange_since_s is None else self._c.now_s - self._strange_since_s

    @property
    def age_s(self) -> float:
        """Seconds since the newest frame known to have arrived was sent."""
        return self._c.now_s - self._proven_s
