"""What every link carries of itself: heartbeats, probes, and which of a station's links sends."""

from __future__ import annotations

import math
from typing import Any

from gcs.flight import EventKind
from link.dialect import mavlink
from link.director.airborne import Airborne
from link.session.context import FlightContext
from link.telemetry.link_path import FAILOVER_S, IDLE_FAILOVER_S

HEARTBEAT_S = 0.5
"""Twice as often as is usual: ArduPilot returns after 5 s without one, which at 10 % loss would come once in 30 hours
with one a second (of 5 in a row each lost), and at 30 % once in 10 minutes."""
PROBE_S = 1.0
GROUND_PROBE_S = 0.25
FAST_PROBE_S = 0.1
"""Every link is probed once a second; that of the station in control, and of the next one when near, this often."""


class LinkUpkeep:
    """Looks after all links of a flight: `choose` before a tick's work, `heartbeats` and `probes` after it."""

    def __init__(self, flight: FlightContext, airborne: Airborne) -> None:
        self._timeline = flight.timeline
        self._vehicle = flight.vehicle
        self._control = flight.control
        self._stations = flight.request.stations
        self._airborne = airborne
        self._beat_s: dict[str, float] = {}
        self._probed_s: dict[str, float] = {}
        self._near: set[str | None] = set()

    def choose(self) -> None:
        """Let another of a station's links send where it is proved and the present one is not."""
        timeline = self._timeline
        for link in self._vehicle.monitor.links.values():
            if len(link.paths) == 1:
                continue
            near = link.station_id in self._near or not timeline.state.airborne
            before = link.choose(FAILOVER_S if near else IDLE_FAILOVER_S)
            if before and near:
                timeline.emit(EventKind.LINK, station=link.station_id, url=link.active.url, before=before)

    def heartbeats(self) -> None:
        """Those that are due of the station in control and of the one control is moving to or from."""
        now_s, gate = self._timeline.now_s, self._control.gate
        for station in (self._own_voice, gate.incoming):
            if station is not None and now_s - self._beat_s.get(station, -math.inf) >= HEARTBEAT_S - 1e-6:
                self._beat_s[station] = now_s
                gate.heartbeat(station, _heartbeat())

    def probes(self) -> None:
        """Those that are due of all stations."""
        now_s, control = self._timeline.now_s, self._control
        # On the ground every link is to be judged within seconds, losses or not.
        every_s = PROBE_S if self._timeline.state.airborne else GROUND_PROBE_S
        self._near = {self._own_voice, *self._coming()}
        for station in self._stations:
            due_s = FAST_PROBE_S if station in self._near else every_s
            if now_s - self._probed_s.get(station, -math.inf) >= due_s - 1e-6:
                self._probed_s[station] = now_s
                # A station the vehicle does not hear proves its link with the id that is always heard.
                manager = control.id_manager
                deaf = manager is not None and station != self._own_voice and not manager.hears(station)
                control.gate.probe(station, self._vehicle.monitor.probe(now_s, station), as_vehicle=deaf)

    @property
    def _own_voice(self) -> str | None:
        """The station in control where it speaks under its own id; None while nobody does."""
        grant = self._control.gate.in_force
        return None if grant is None or grant.sender.as_vehicle else grant.station_id

    def _coming(self) -> list[str]:
        """Stations that may be handed to soon, whichever way the flight goes."""
        chain, guidance = self._airborne.chain, self._airborne.guidance
        if not self._timeline.state.airborne or not guidance.on_plan:
            return []
        windows = (chain.ahead(backwards=False), chain.ahead(backwards=True))
        return [w.to_station for w in windows if w is not None and w.near(guidance.reference.time_s)]


def _heartbeat() -> Any:
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE, 3
    )
