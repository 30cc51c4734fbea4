"""How good what is heard of the vehicle is: silence, a place that is not known, an estimator or a receiver in trouble.

Told within two seconds in every state, and told again when it is over. While the vehicle's own estimate is in doubt
handovers wait (`link.session.vehicle.Vehicle.doubt`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeVar

from gcs.flight import FlightState
from link.dialect import mavlink
from link.session.context import FlightContext
from link.session.vehicle import POSITION_FRESH_S

T = TypeVar("T")

SILENT_S = 1.5
"""Nothing heard of the vehicle for so long is told."""
FIX_3D = 3
TROUBLE_S = 0.5
"""Trouble must be told for so long to be believed: by two messages at least."""
REPORT_FRESH_S = 4.0
REFUSED_AGAIN_S = 30.0
_SENSORS = (
    (mavlink.MAV_SYS_STATUS_SENSOR_GPS, "its satellite receiver is not well"),
    (mavlink.MAV_SYS_STATUS_AHRS, "its attitude and position estimate is not well"),
)
UNKNOWN = "the vehicle's position is not heard"
SILENT = "nothing is heard of the vehicle"
_WATCHED = frozenset(state for state in FlightState if not state.ended) - {
    FlightState.CONNECTING,
    FlightState.IDENTIFYING,
    FlightState.PREFLIGHT,
}


class EvidenceWatch:
    """Raises the alarms. `update` once a tick, in every state. ``estimate_back`` is called when a doubt is over."""

    def __init__(self, flight: FlightContext) -> None:
        self._timeline = flight.timeline
        self._vehicle = flight.vehicle
        self._told: set[str] = set()
        self._since_s: dict[str, float] = {}
        self._refused_s: dict[str, float] = {}
        self._jumps = 0

    def update(self) -> None:
        """Look at the ages and the reports; once a tick."""
        timeline, vehicle = self._timeline, self._vehicle
        self._tell_refused()
        if timeline.state not in _WATCHED:
            return
        silent_s = timeline.now_s - vehicle.monitor.last_heard_s()
        silent = silent_s > SILENT_S * vehicle.patience
        self._tell(SILENT, silent, "the vehicle is heard again", silent_s=round(silent_s, 1), mode=vehicle.mode)
        unknown = vehicle.position is None and not silent
        why = vehicle.monitor.places.refused or f"none for {POSITION_FRESH_S * vehicle.patience:g} s"
        self._tell(UNKNOWN, unknown, "the vehicle's position is known again", reason=why)
        self._judge_estimate()

    def _judge_estimate(self) -> None:
        """Its receiver, its estimator, its sensors."""
        timeline, vehicle = self._timeline, self._vehicle
        fix, estimator, sensors = vehicle.monitor.gps_fix, vehicle.monitor.estimator, vehicle.monitor.sensors
        doubts = []
        if self._lasts("fix", fix, lambda value: value < FIX_3D):
            doubts.append("it has no satellite fix")
        if self._lasts("estimator", estimator, lambda good: not good):
            doubts.append("its estimator has no position")
        for bit, what in _SENSORS:
            if self._lasts(what, sensors, lambda unwell, bit=bit: bool(unwell & bit)):  # type: ignore[misc]
                doubts.append(what)
        before, vehicle.doubt = vehicle.doubt, "; ".join(doubts)
        if vehicle.doubt and vehicle.doubt != before:
            timeline.alarm("the vehicle's position estimate is in doubt", reason=vehicle.doubt)
        elif before and not vehicle.doubt:
            lapsed = timeline.state is FlightState.LAPSED
            offer = "'resume' takes the flight up again" if lapsed else ""
            timeline.alarm("the vehicle's position estimate is good again", offer=offer)
        if vehicle.monitor.places.jumps != self._jumps:
            self._jumps = vehicle.monitor.places.jumps
            timeline.alarm("the vehicle's position jumped", by_m=round(vehicle.monitor.places.jumped_m, 1))

    def _lasts(self, what: str, report: tuple[float, T] | None, bad: Callable[[T], bool]) -> bool:
        """Whether a report is bad, and was before already; an old report says nothing."""
        now_s = self._timeline.now_s
        if report is None or now_s - report[0] > REPORT_FRESH_S * self._vehicle.patience or not bad(report[1]):
            self._since_s.pop(what, None)
            return False
        return report[0] - self._since_s.setdefault(what, report[0]) >= TROUBLE_S

    def _tell_refused(self) -> None:
        """What was told of places and cannot be."""
        now_s = self._timeline.now_s
        for what, why in self._vehicle.monitor.take_refused().items():
            if what != "position" and now_s - self._refused_s.get(what, -math.inf) >= REFUSED_AGAIN_S:
                self._refused_s[what] = now_s
                self._timeline.alarm(f"an absurd {what} is refused", reason=why)

    def _tell(self, what: str, bad: bool, over: str, **data: object) -> None:
        if bad and what not in self._told:
            self._told.add(what)
            self._timeline.alarm(what, **data)
        elif not bad and what in self._told:
            self._told.discard(what)
            self._timeline.alarm(over)
