"""What people are told while a flight goes on: once a second where it is, and whenever the schedule moves."""

from __future__ import annotations

import math
from typing import Any

from gcs.flight import EventKind, FlightState
from link.director.airborne import Airborne
from link.director.operation.lapse_watch import LapseWatch
from link.session.context import FlightContext

PROGRESS_S = 1.0
RETIMED_S = 1.0
FOREIGN_S = 30.0
BEHIND_RATE = 0.98
LATE_S = 2.0
"""An arrival so much later than planned is told as an alarm."""


class Announcer:
    """Emits progress, re-timed schedules and the alarms that are not somebody else's. `update` every tick."""

    def __init__(self, flight: FlightContext, airborne: Airborne) -> None:
        self._flight = flight
        self._timeline = flight.timeline
        self._vehicle = flight.vehicle
        self._control = flight.control
        self._air = airborne
        self._progress_s = -math.inf
        self._shift_s = 0.0
        self._told_t0 = False
        self._plan_sha256 = flight.plan.plan_sha256
        self._behind = False
        self.late_s: float | None = None
        """How much later than planned the flight arrived; None before."""
        self.lapse = LapseWatch(flight, airborne.lost_link)
        self._foreign: dict[int, float] = {}

    def update(self) -> None:
        """Tell what has changed."""
        timeline = self._timeline
        for system_id, heard_s in self._vehicle.monitor.foreign_stations.items():
            if heard_s - self._foreign.get(system_id, -math.inf) > FOREIGN_S:
                timeline.alarm("another ground station is on the link", system_id=system_id)
                self._foreign[system_id] = heard_s
        if not timeline.state.airborne:
            return
        self.lapse.update()
        self._retime()
        self._tell_behind()
        self._tell_late()
        if timeline.now_s - self._progress_s >= PROGRESS_S:
            self._progress_s = timeline.now_s
            timeline.emit(EventKind.PROGRESS, **self.where())

    @property
    def shift_s(self) -> float | None:
        """How much later than planned the flight is; None before T+0 and off the plan."""
        t_plus_s, guidance = self._timeline.t_plus_s, self._air.guidance
        if t_plus_s is None or not guidance.on_plan:
            return None
        return t_plus_s - guidance.reference.time_s

    def handovers_to_come(self) -> list[dict[str, Any]]:
        """Those ahead, with the T+ they are now expected at if the flight goes on at full rate."""
        shift_s = self.shift_s
        if shift_s is None:
            return []
        return [
            {"index": h.index, "from": h.from_station, "to": h.to_station, "t_plus_s": round(h.time_s + shift_s, 3)}
            for h in self._flight.plan.handovers[self._air.chain.leg :]
        ]

    def _retime(self) -> None:
        timeline, shift_s = self._timeline, self.shift_s
        if shift_s is None or timeline.state not in (FlightState.CRUISE, FlightState.HOLDING):
            return
        moved = abs(shift_s - self._shift_s)
        # While the flight stands the schedule slips all the time; it is told again when it goes on.
        settled = self._air.guidance.reference.rate == 1.0
        replanned = self._plan_sha256 != self._flight.plan.plan_sha256
        if not self._told_t0 or replanned or (moved >= RETIMED_S and settled):
            self._told_t0, self._shift_s, self._plan_sha256 = True, shift_s, self._flight.plan.plan_sha256
            timeline.emit(EventKind.RETIMED, shift_s=round(shift_s, 3), handovers=self.handovers_to_come())

    def _tell_behind(self) -> None:
        timeline, reference, tracking = self._timeline, self._air.guidance.reference, self._air.lag.tracking
        if tracking is None or timeline.state is not FlightState.CRUISE:
            return
        behind = reference.rate < BEHIND_RATE and tracking.behind_m > 10.0
        if behind and not self._behind:
            timeline.alarm("the vehicle falls behind", behind_m=round(tracking.behind_m, 1))
        if behind or reference.rate == 1.0:
            self._behind = behind

    def _tell_late(self) -> None:
        timeline = self._timeline
        if self.late_s is not None or timeline.state is not FlightState.ARRIVED or timeline.t_plus_s is None:
            return
        self.late_s = timeline.t_plus_s - self._flight.plan.mission_time_s
        if self.late_s > LATE_S:
            timeline.alarm("arrived late", late_s=round(self.late_s, 1))

    def where(self) -> dict[str, Any]:
        """The flight now, as JSON."""
        timeline, vehicle, control = self._timeline, self._vehicle, self._control
        air, reference = self._air, self._air.guidance.reference
        position, now = vehicle.monitor.position, vehicle.position
        # What is shown of old positions is where it was, and how long ago; nothing else is known then.
        tracking = None if now is None else air.lag.tracking
        # On the ground nobody measures it by the tick.
        air.range.update()
        station, margin_m = control.speaker, air.range.margin_m
        return {
            "station": station,
            "plan_s": round(reference.time_s, 3) if air.guidance.on_plan else None,
            "rate": round(reference.rate, 4),
            "stands": reference.stands,
            "lead_ms": round(air.latency.ahead_s * 1e3, 1),
            "lat_deg": None if position is None else position.lat_deg,
            "lon_deg": None if position is None else position.lon_deg,
            "alt_amsl_m": None if position is None else position.alt_amsl_m,
            "position_age_s": None if position is None else round(timeline.now_s - position.heard_s, 2),
            "heard_age_s": round(timeline.now_s - vehicle.monitor.last_heard_s(), 2),
            "doubt": vehicle.doubt or None,
            "speed_m_s": None if now is None else round(now.speed_m_s, 2),
            "velocity_ned_m_s": None if now is None else list(now.velocity_ned_m_s),
            "error_m": None if tracking is None else round(tracking.error_m, 2),
            "behind_m": None if tracking is None else round(tracking.behind_m, 2),
            "beside_m": None if tracking is None else round(tracking.beside_m, 2),
            "margin_m": None if margin_m is None else round(margin_m, 1),
            "uplink_age_s": round(air.uplink.age_s, 3) if control.gate.in_force is not None else None,
            "mode": vehicle.mode,
            "armed": vehicle.armed,
            "battery_percent": vehicle.monitor.battery_percent,
            "handovers_done": air.chain.leg,
            "held_for": air.held.text if timeline.state is FlightState.HOLDING else None,
            # Standing, or off the plan, no time can be given for a handover.
            "handovers": self.handovers_to_come()[:1] if timeline.state is FlightState.CRUISE else [],
            "lapse": self.lapse.picture() if timeline.state is FlightState.LAPSED else None,
            "links": {link.station_id: link.to_document(timeline.now_s) for link in vehicle.monitor.links.values()},
        }
