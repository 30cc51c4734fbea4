"""What a flight is watched by is asked for again: streams that stop, origin and home missing or contradicted.

An autopilot forgets its message intervals when it restarts, another ground station may change them, and the one
announcement of an origin laid anew may be lost. Nothing here waits: one question at a time, beside the flight.
"""

from __future__ import annotations

import math

from link.autopilot.profile import AutopilotProfile
from link.dialect import mavlink
from link.microservices.command import Ticket
from link.monitors.tracking import LagMonitor
from link.session.context import FlightContext
from link.telemetry.plausibility import HomePlace, apart_m, same_origin
from link.telemetry.streams import ESTIMATOR_HZ, STREAMED_MESSAGES

MISSING_INTERVALS, MISSING_LEAST_S = 3.5, 1.0
"""A stream that has not come for so many of its intervals, and at least so long, is asked for again."""
STREAM_AGAIN_S = 2.0
DENIALS = 3
"""A message refused so often the vehicle does not have."""
PLACE_AGAIN_S = 30.0
PLACE_SOON_S = 0.5
STEADY_M, STEADY_S = 4.0, 2.0
"""Beside its reference by so much for so long, the vehicle may count from another origin than was told."""
HOME_MOVED_M = 5.0
"""So far home has been moved, and is told."""
_UNABLE = (mavlink.MAV_RESULT_DENIED, mavlink.MAV_RESULT_UNSUPPORTED)
_ORIGIN, _HOME = mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN, mavlink.MAVLINK_MSG_ID_HOME_POSITION


def streams_of(profile: AutopilotProfile) -> tuple[tuple[int, float], ...]:
    """The messages a vehicle is asked to send, and how often, in Hz."""
    return (*STREAMED_MESSAGES, (profile.estimator_message_id, ESTIMATOR_HZ))


class TelemetryUpkeep:
    """Asks again. `step` once a tick while the flight is ready or in the air and no control is being moved."""

    def __init__(self, flight: FlightContext, lag: LagMonitor) -> None:
        self._timeline = flight.timeline
        self._vehicle = flight.vehicle
        self._control = flight.control
        self._lag = lag
        self._asked_s: dict[int, float] = {}
        self._denied: dict[int, int] = {}
        self._ticket: Ticket | None = None
        self._asking = 0
        self._beside_since_s: float | None = None
        self._home: HomePlace | None = None

    def step(self) -> None:
        """Ask for what is due."""
        self._watch_home()
        if self._ticket is not None:
            if not self._ticket.finished:
                return
            refused = self._ticket.result in _UNABLE
            self._denied[self._asking] = self._denied.get(self._asking, 0) + 1 if refused else 0
            self._ticket = None
        now_s = self._timeline.now_s
        for message_id, again_s in (*self._places(), *self._streams()):
            denied = self._denied.get(message_id, 0) >= DENIALS
            if not denied and now_s - self._asked_s.get(message_id, -math.inf) >= again_s * self._vehicle.patience:
                self._ask(message_id)
                return

    def _ask(self, message_id: int) -> None:
        self._asked_s[message_id], self._asking = self._timeline.now_s, message_id
        rates = dict(streams_of(self._vehicle.profile))
        if message_id in rates:
            parameters = (float(message_id), 1e6 / rates[message_id])
            number = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
            self._ticket = self._control.start_command("message interval", number, parameters, attempts=2)
        else:
            number = mavlink.MAV_CMD_REQUEST_MESSAGE
            self._ticket = self._control.start_command("request message", number, (float(message_id),), attempts=2)

    def _streams(self) -> list[tuple[int, float]]:
        """Those that do not come, though the vehicle is heard."""
        monitor, now_s, patience = self._vehicle.monitor, self._timeline.now_s, self._vehicle.patience
        if now_s - monitor.last_heard_s() > MISSING_LEAST_S * patience:
            return []
        return [
            (message_id, STREAM_AGAIN_S)
            for message_id, rate_hz in streams_of(self._vehicle.profile)
            if now_s - monitor.kinds_s.get(message_id, -math.inf)
            > max(MISSING_LEAST_S, MISSING_INTERVALS / rate_hz) * patience
        ]

    def _places(self) -> list[tuple[int, float]]:
        """Origin and home: soon where they are missing or contradicted, else now and then."""
        vehicle, station = self._vehicle, self._control.in_force.station_id
        link = vehicle.monitor.links[station]
        contradicted = (
            link.origin is None
            or vehicle.origin is None
            or (not same_origin(link.origin, vehicle.origin) and link.origin_told < 2)
            or self._beside
        )
        home_soon = vehicle.monitor.home is None
        return [
            (_ORIGIN, PLACE_SOON_S if contradicted else PLACE_AGAIN_S),
            (_HOME, STREAM_AGAIN_S if home_soon else PLACE_AGAIN_S),
        ]

    @property
    def _beside(self) -> bool:
        """Whether the vehicle is steadily beside where it was told to be."""
        tracking, now_s = self._lag.tracking, self._timeline.now_s
        if tracking is None or tracking.error_m < STEADY_M:
            self._beside_since_s = None
            return False
        if self._beside_since_s is None:
            self._beside_since_s = now_s
        return now_s - self._beside_since_s >= STEADY_S

    def _watch_home(self) -> None:
        """Tell that home has moved in flight: its own return leads there."""
        home, before = self._vehicle.monitor.home, self._home
        if home is None or before is None or home is before:
            # Arming lays home anew (`PreflightEvidence.armed` forgets it): the next one told is the one that counts.
            self._home = home
            return
        moved_m = apart_m(home.lat_deg, home.lon_deg, before.lat_deg, before.lon_deg)
        if moved_m > HOME_MOVED_M:
            self._home = home
            if self._timeline.state.airborne:
                self._timeline.alarm(
                    "home has moved", by_m=round(moved_m, 1), lat_deg=home.lat_deg, lon_deg=home.lon_deg
                )
