"""What the vehicle says, over all links at once: its state, its links' health, its own words.

Messages of the vehicle's autopilot (its system id, component 1) alone count; its gimbals and companions send
heartbeats too. The same message comes once over every link and, over radio, late or out of order: what carries a
time stamp is taken once and never backwards; a stamp that goes far back means that the autopilot has restarted.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from link.autopilot.local_frame import EkfOrigin
from link.autopilot.profile import AUTOPILOT_COMPONENT
from link.dialect import mavlink
from link.telemetry.board import BoardWatch
from link.telemetry.station_link import StationLink

REBOOT_BACK_S = 3.0
"""A time stamp this far behind is no reordering."""
TEXT_CHUNK = 50
SAME_TEXT_S = 2.0
OFFSET_WINDOW_S = 20.0

GROUND_STATION_TYPES = (mavlink.MAV_TYPE_GCS,)


@dataclass(frozen=True, slots=True)
class Position:
    """GLOBAL_POSITION_INT (33): degrees, metres AMSL, m/s true north/east/down.

    ``boot_s`` is the vehicle's clock, ``heard_s`` ours when it came.
    """

    boot_s: float
    heard_s: float
    lat_deg: float
    lon_deg: float
    alt_amsl_m: float
    velocity_ned_m_s: tuple[float, float, float]

    @property
    def speed_m_s(self) -> float:
        """Speed over ground and up, together."""
        return math.hypot(*self.velocity_ned_m_s)


@dataclass(frozen=True, slots=True)
class Heartbeat:
    """HEARTBEAT (0) of the autopilot, and when it came."""

    heard_s: float
    autopilot: int
    vehicle_type: int
    base_mode: int
    custom_mode: int
    system_status: int

    @classmethod
    def from_message(cls, heard_s: float, message: Any) -> Heartbeat:
        """From a HEARTBEAT that came at ``heard_s``."""
        m = message
        return cls(heard_s, m.autopilot, m.type, m.base_mode, m.custom_mode, m.system_status)

    @property
    def armed(self) -> bool:
        """MAV_MODE_FLAG_SAFETY_ARMED."""
        return bool(self.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)


class VehicleMonitor:
    """Everything heard, merged.

    ``stations`` are the station ids of a flight, ``own_system_ids`` their system ids, ``urls`` the link paths of each
    where there are several.
    """

    def __init__(
        self,
        stations: tuple[str, ...],
        vehicle_system_id: int,
        own_system_ids: frozenset[int],
        urls: Mapping[str, Sequence[str]] | None = None,
        *,
        speedup: float = 1.0,
    ) -> None:
        self.vehicle_system_id = vehicle_system_id
        self.links = {station: StationLink(station, (urls or {}).get(station, ("",))) for station in stations}
        self.heartbeat: Heartbeat | None = None
        self.position: Position | None = None
        self.version: Any = None
        self.unix_s: tuple[float, float] | None = None
        """The vehicle's UTC (SYSTEM_TIME) and our clock when it came; None while it has none."""
        self.landed_state: int = 0
        self.battery_percent: int | None = None
        self.control_main: int | None = None
        self.control_s = -math.inf
        self.target: Any = None
        self.target_s = -math.inf
        self.reboots = 0
        self.board = BoardWatch(speedup)
        self.foreign_stations: dict[int, float] = {}
        self._own = own_system_ids
        self._boot_ms = -1
        self._behind: deque[float] = deque(maxlen=3)
        self._offset: list[tuple[float, float]] = []
        self._texts: list[tuple[int, str]] = []
        self._recent_texts: deque[tuple[float, int, str]] = deque(maxlen=32)
        self._chunks: dict[tuple[str, int], dict[int, str]] = {}
        self._probe_count = 0

    # -- in -----------------------------------------------------------------------------------------------------------

    def receive(self, now_s: float, station_id: str, message: Any, url: str | None = None) -> bool:
        """Take a message heard over a station's link; whether it was the vehicle's autopilot speaking.

        ``url`` tells which of the station's link paths it came over.
        """
        system, component = message.get_srcSystem(), message.get_srcComponent()
        kind = message.get_type()
        if system != self.vehicle_system_id:
            if kind == "HEARTBEAT" and message.type in GROUND_STATION_TYPES and system not in self._own:
                self.foreign_stations[system] = now_s
            return False
        if component != AUTOPILOT_COMPONENT:
            return False
        link = self.links[station_id]
        path = link.path(url)
        path.heard(now_s, message.get_seq())
        self.board.on_frame(now_s, path.url, message)
        if kind == "AUTOPILOT_VERSION":
            self.board.on_version(path.url, message)
        if kind == "TIMESYNC":
            if message.tc1 != 0:
                sent_s = path.probe_sent_s(message.ts1)
                if sent_s is not None:
                    self.board.on_timesync(now_s, sent_s, message.tc1)
                path.answered(message.ts1, now_s)
            return True
        fresh = self._in_order(now_s, getattr(message, "time_boot_ms", None))
        handler = _HANDLERS.get(kind)
        if handler is not None:
            handler(self, now_s, link, message, fresh)
        return True

    def _in_order(self, now_s: float, boot_ms: int | None) -> bool:
        """Whether a stamp is newer than, or as new as, the newest; notices a restart."""
        if boot_ms is None:
            return True
        if boot_ms >= self._boot_ms:
            self._boot_ms = boot_ms
            self._behind.clear()
            self._note_offset(now_s, boot_ms * 1e-3)
            return True
        if self._boot_ms - boot_ms < REBOOT_BACK_S * 1e3:
            return False
        # A single frame that was on its way for seconds is no restart; a few in a row are.
        self._behind.append(now_s)
        if len(self._behind) == self._behind.maxlen:
            self.reboots += 1
            self._boot_ms = boot_ms
            self._behind.clear()
            self._offset.clear()
            self.position = None
            for link in self.links.values():
                link.origin = None
        return False

    def _note_offset(self, now_s: float, boot_s: float) -> None:
        offset = now_s - boot_s
        if not self._offset or now_s - self._offset[-1][0] > OFFSET_WINDOW_S:
            self._offset = [*self._offset[-1:], (now_s, offset)]
        elif offset < self._offset[-1][1]:
            self._offset[-1] = (self._offset[-1][0], offset)

    def our_time_s(self, boot_s: float) -> float | None:
        """Our clock when the vehicle's showed ``boot_s``.

        By the fastest message lately, less half of the shortest round trip lately: right where there and back take
        equally long. A message that was faster than that path's own (over another link) keeps it from being early.
        """
        if not self._offset:
            return None
        latencies = [c.least_latency_s for link in self.links.values() for c in link.paths if c.round_trip_s]
        return boot_s + min(offset for _, offset in self._offset) - min(latencies, default=0.0)

    def probe(self, now_s: float, station_id: str) -> Any:
        """A TIMESYNC of a station, for all its paths; its answer can only be the answer to it (matched by ``ts1``)."""
        self._probe_count += 1
        # Nanoseconds of our clock would repeat between stations; the count cannot.
        nonce = (int(max(now_s, 0.0) * 1e6) << 20) | (self._probe_count & 0xFFFFF)
        for path in self.links[station_id].paths:
            path.probed(now_s, nonce)
        return mavlink.MAVLink_timesync_message(0, nonce)

    # -- out ----------------------------------------------------------------------------------------------------------

    def take_texts(self) -> list[tuple[int, str]]:
        """(severity, text) of what the vehicle said since the last call, each once however many links brought it."""
        texts, self._texts = self._texts, []
        return texts

    def heard_within(self, now_s: float, station_id: str, age_s: float) -> bool:
        """Whether the vehicle was heard over a station's link lately."""
        return now_s - self.links[station_id].heard_s <= age_s

    def proven_within(self, now_s: float, station_id: str, age_s: float) -> bool:
        """Whether a frame no older than ``age_s`` was answered over a station's link."""
        return now_s - self.links[station_id].proven_s <= age_s

    def last_heard_s(self) -> float:
        """When the vehicle was last heard over any link."""
        return max(link.heard_s for link in self.links.values())

    # -- messages -----------------------------------------------------------------------------------------------------

    def _on_heartbeat(self, now_s: float, link: StationLink, m: Any, fresh: bool) -> None:
        self.heartbeat = Heartbeat.from_message(now_s, m)

    def _on_global_position(self, now_s: float, link: StationLink, m: Any, fresh: bool) -> None:
        # Later than other messages is not too late: a place is judged by its own stamp.
        if self.position is not None and m.time_boot_ms * 1e-3 <= self.position.boot_s:
            return
        self.position = Position(
            m.time_boot_ms * 1e-3,
            now_s,
            m.lat * 1e-7,
            m.lon * 1e-7,
            m.alt * 1e-3,
            (m.vx * 0.01, m.vy * 0.01, m.vz * 0.01),
        )

    def _on_target(self, now_s: float, link: StationLink, m: Any, fresh: bool) -> None:
        if fresh:
            self.target, self.target_s = m, now_s

    def _on_origin(self, now_s: float, link: StationLink, m: Any, fresh: bool) -> None:
        link.origin = EkfOrigin.from_message(m)
        link.origin_s = now_s

    def _on_extended_state(self, now_s: float, link: StationLink, m: Any, fresh: bool) -> None:
        self.landed_state = m.landed_state

    def _on_sys_status(self, now_s: float, link: StationLink, m: Any, fresh: bool) -> None:
        self.battery_percent = m.battery_remaining if m.battery_remaining >= 0 else None

    def _on_version(self, now_s: float, link: StationLink, m: Any, fresh: bool) -> None:
        self.version = m

    def _on_system_time(self, now_s: float, link: StationLink, m: Any, fresh: bool) -> None:
        if m.time_unix_usec > 0 and fresh:
            self.unix_s = (m.time_unix_usec * 1e-6, now_s)

    def _on_control_status(self, now_s: float, link: StationLink, m: Any, fresh: bool) -> None:
        self.control_main, self.control_s = m.gcs_main, now_s

    def _on_text(self, now_s: float, link: StationLink, m: Any, fresh: bool) -> None:
        text = m.text
        if m.id:
            chunks = self._chunks.setdefault((link.station_id, m.id), {})
            chunks[m.chunk_seq] = text
            last = max(chunks)
            if len(chunks[last]) >= TEXT_CHUNK or len(chunks) != last + 1:
                return
            text = "".join(chunks[k] for k in sorted(chunks))
            del self._chunks[link.station_id, m.id]
        # PX4 ends its texts with a tab.
        text = text.strip()
        for heard_s, severity, before in self._recent_texts:
            if now_s - heard_s <= SAME_TEXT_S and severity == m.severity and before == text:
                return
        self._recent_texts.append((now_s, m.severity, text))
        self._texts.append((m.severity, text))


_HANDLERS = {
    "HEARTBEAT": VehicleMonitor._on_heartbeat,
    "GLOBAL_POSITION_INT": VehicleMonitor._on_global_position,
    "POSITION_TARGET_LOCAL_NED": VehicleMonitor._on_target,
    "GPS_GLOBAL_ORIGIN": VehicleMonitor._on_origin,
    "EXTENDED_SYS_STATE": VehicleMonitor._on_extended_state,
    "SYS_STATUS": VehicleMonitor._on_sys_status,
    "AUTOPILOT_VERSION": VehicleMonitor._on_version,
    "SYSTEM_TIME": VehicleMonitor._on_system_time,
    "CONTROL_STATUS": VehicleMonitor._on_control_status,
    "STATUSTEXT": VehicleMonitor._on_text,
}
