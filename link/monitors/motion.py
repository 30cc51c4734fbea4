"""Whether the vehicle moves as it was told, by what it says of its place and speed: a fall, a descent, off its plan.

Told within a second. `Motion.spoiled` once it was so far off that the flight cannot be called flown as planned.
"""

from __future__ import annotations

from gcs.flight import FlightState
from link.monitors.tracking import LAG_GIVE_UP_M, LagMonitor
from link.session.context import FlightContext

SINKS_M_S, SINKS_S = 1.5, 0.45
"""Down so much faster than asked, for so long, is a descent nobody commanded."""
FALLS_MORE_M_S, FALLS_S = 4.0, 0.15
LANDS_M_S = 6.0
"""No landing of an autopilot is faster."""
OFF_PLAN_M, OFF_PLAN_S = 10.0, 0.35
SPOILED_M = 40.0
AGAIN_S = 10.0
DESCENT = "the vehicle descends and was not told to"
OFF_PLAN = "the vehicle is off its plan"
STREAMED = frozenset(
    {FlightState.TRANSIT, FlightState.CRUISE, FlightState.HOLDING, FlightState.RETURNING, FlightState.ARRIVED}
)


class MotionWatch:
    """Raises the alarms. `update` once a tick of a flight in the air."""

    def __init__(self, flight: FlightContext, lag: LagMonitor) -> None:
        self._timeline = flight.timeline
        self._vehicle = flight.vehicle
        self._lag = lag
        self._boot_s = 0.0
        self._since_s: dict[str, float] = {}
        self._told_s: dict[str, float] = {}
        self.spoiled = False
        """Whether the vehicle was ever so far beside, above or below its plan, or behind it, that it was not flown."""

    def update(self) -> None:
        """Judge the newest position, if there is a new one."""
        timeline, position = self._timeline, self._vehicle.position
        if position is None:
            self._since_s.clear()
            return
        if position.boot_s == self._boot_s:
            return
        self._boot_s = position.boot_s
        down_m_s = position.velocity_ned_m_s[2]
        height_m = round(position.alt_amsl_m, 1)
        led = timeline.state in STREAMED
        excess_m_s = down_m_s - max(0.0, self._lag.asked_down_m_s) if led else down_m_s
        sinks = led or timeline.state is FlightState.TAKEOFF
        falls_m_s = FALLS_MORE_M_S if sinks else LANDS_M_S
        data = {"down_m_s": round(down_m_s, 1), "alt_amsl_m": height_m}
        self._judge("falls", DESCENT, excess_m_s >= falls_m_s, FALLS_S, data)
        self._judge("sinks", DESCENT, sinks and excess_m_s >= SINKS_M_S, SINKS_S, data)
        tracking = self._lag.tracking
        if tracking is None or not led:
            self._since_s.pop("off", None)
            return
        # Behind along the path has its own alarm until the vehicle does not follow at all.
        off_m = max(tracking.beside_m, tracking.error_m if tracking.error_m > LAG_GIVE_UP_M else 0.0)
        where = {"error_m": round(tracking.error_m, 1), "beside_m": round(tracking.beside_m, 1)}
        self._judge("off", OFF_PLAN, off_m > OFF_PLAN_M, OFF_PLAN_S, where)
        flown = timeline.state in (FlightState.CRUISE, FlightState.ARRIVED)
        self.spoiled = self.spoiled or (flown and off_m > SPOILED_M and "off" in self._since_s)

    def _judge(self, what: str, alarm: str, bad: bool, after_s: float, data: dict[str, float]) -> None:
        timeline, position = self._timeline, self._vehicle.position
        assert position is not None
        if not bad:
            self._since_s.pop(what, None)
            return
        since_s = self._since_s.setdefault(what, position.boot_s)
        if position.boot_s - since_s >= after_s and timeline.now_s - self._told_s.get(alarm, -1e9) >= AGAIN_S:
            self._told_s[alarm] = timeline.now_s
            timeline.alarm(alarm, **data)
