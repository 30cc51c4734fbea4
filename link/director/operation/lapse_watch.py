"""After the C2 link was lost: what is happening, until when, and what may be commanded, for people."""

from __future__ import annotations

import math
from typing import Any

from gcs.flight import FlightState
from link.director.link_loss import LostC2Link
from link.session.context import FlightContext
from link.session.coverage import margin_m, nearest

AGAIN_S = 60.0
LOOK_S = 1.0
MOVING_M_S = 0.3
WINDOW_S = 5.0


class LapseWatch:
    """`update` every tick: tells the vehicle's mode when it changes, the whole picture at once and now and then."""

    def __init__(self, flight: FlightContext, lost_link: LostC2Link) -> None:
        self._flight = flight
        self._timeline = flight.timeline
        self._vehicle = flight.vehicle
        self._lost_link = lost_link
        self._told_s = -math.inf
        self._mode: str | None = None
        self._down = False
        self._entering = self._offered = False
        self._looked_s = -math.inf
        self._was: tuple[float, str, float] | None = None
        self._closes_m_s: float | None = None

    def update(self) -> None:
        """Tell what has changed."""
        timeline, vehicle = self._timeline, self._vehicle
        if timeline.state is not FlightState.LAPSED:
            self._told_s, self._mode, self._down, self._was = -math.inf, vehicle.mode, False, None
            self._closes_m_s, self._offered = None, False
            return
        self._measure()
        down = vehicle.on_ground
        again = timeline.now_s - self._told_s >= AGAIN_S
        ended = self._entering and not self._lost_link.entering
        self._entering = self._lost_link.entering
        offered = self._offers() and not self._offered
        self._offered = self._offered or offered
        if again or offered or vehicle.mode != self._mode or (down and not self._down) or ended:
            self._told_s, self._mode, self._down = timeline.now_s, vehicle.mode, down
            picture = self.picture()
            timeline.alarm("lost C2 link", **{k: v for k, v in picture.items() if v is not None})

    def _offers(self) -> bool:
        """Whether a resume may succeed, looked at once a second."""
        now_s = self._timeline.now_s
        if self._offered or now_s - self._looked_s < LOOK_S:
            return False
        self._looked_s = now_s
        return not self._lost_link.no_way_back()

    def _measure(self) -> None:
        """How fast the vehicle comes back into range: of the station nearest to it, over some seconds."""
        timeline, near = self._timeline, nearest(self._flight)
        if near is None:
            self._was = self._closes_m_s = None
            return
        if self._was is None or self._was[1] != near[0]:
            self._was = (timeline.now_s, *near)
        elif timeline.now_s - self._was[0] >= WINDOW_S:
            self._closes_m_s = (near[1] - self._was[2]) / (timeline.now_s - self._was[0])
            self._was = (timeline.now_s, *near)

    def picture(self) -> dict[str, Any]:
        """What is happening, until when, what may be commanded."""
        timeline, vehicle, link = self._timeline, self._vehicle, self._lost_link
        request, near, until_s = self._flight.request, nearest(self._flight), link.resort_s
        resort = {"return": vehicle.profile.return_mode, "land": vehicle.profile.land_mode}.get(request.last_resort)
        then = None
        if until_s is not None:
            then = f"then told to {resort}" if resort else "then left to the autopilot"
        blocked = "" if link.entering else link.no_way_back()
        position = vehicle.monitor.position
        age_s = timeline.now_s - vehicle.monitor.last_heard_s()
        return {
            "mode": vehicle.mode,
            "on_ground": vehicle.on_ground,
            "armed": vehicle.armed,
            "heard_s_ago": round(age_s, 1),
            "speed_m_s": None if position is None else round(position.speed_m_s, 1),
            "nearest_station": None if near is None else near[0],
            "nearest_margin_m": None if near is None else round(near[1], 1),
            "covered": None if near is None else near[1] >= 0.0,
            "closes_m_s": None if self._closes_m_s is None else round(self._closes_m_s, 1),
            "station_margin_m": self._own_margin_m(),
            "until_in_s": None if until_s is None else round(max(0.0, until_s - timeline.now_s), 1),
            "then": then,
            "resuming": link.entering,
            "resume_blocked": blocked or None,
            "commands": "land, abort" if blocked else "resume, land, abort",
        }

    def _own_margin_m(self) -> float | None:
        grant = self._flight.control.gate.in_force
        margin = None if grant is None else margin_m(self._flight, grant.station_id)
        return None if margin is None else round(margin, 1)
