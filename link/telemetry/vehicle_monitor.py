"""What the vehicle says, over all links at once: its state, its links' health, its own words.

Messages of the vehicle's autopilot (its system id, component 1) alone count; its gimbals and companions send
heartbeats too. The same message comes once over every link and, over radio, late or out of order: what carries a
time stamp is taken once and never backwards (`link.telemetry.boot_clock`). What cannot be is not believed
(`link.telemetry.plausibility`): it changes nothing, is kept as a reason to tell, and never raises. Every figure has the
time it was heard at.
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
from link.telemetry.boot_clock import BootClock
from link.telemetry.plausibility import HomePlace, Position, PositionGate, Reach, no_place
from link.telemetry.station_link import StationLink

TEXT_CHUNK = 50
TEXT_WAIT_S = 1.0
SAME_TEXT_S = 3.0
MISSING = " ... "

GROUND_STATION_TYPES = (mavlink.MAV_TYPE_GCS,)


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

    @property
    def shows(self) -> tuple[bool, int]:
        """Armed or not, and the mode."""
        return self.armed, self.custom_mode


@dataclass(frozen=True, slots=True)
class Battery:
    """BATTERY_STATUS (147) of one battery: when it came, per cent left (None: not told), MAV_BATTERY_CHARGE_STATE."""

    heard_s: float
    percent: int | None
    charge_state: int


@dataclass(frozen=True, slots=True)
class _Chunks:
    """A STATUSTEXT (253) of several, so far: when it began, and its parts by number.

    The last part is shorter than `TEXT_CHUNK`; a text of just two or three chunks has no such part, and is shown late.
    """

    since_s: float
    severity: int
    parts: dict[int, str]

    @property
    def whole(self) -> bool:
        """Whether every part has come, and the last is known to be the last."""
        last = max(self.parts)
        return len(self.parts[last]) < TEXT_CHUNK and len(self.parts) == last + 1

    @property
    def text(self) -> str:
        """The parts joined, `MISSING` where one is."""
        return "".join(self.parts.get(k, MISSING) for k in range(max(self.parts) + 1))


class VehicleMonitor:
    """Everything heard, merged.

    ``stations`` are the station ids of a flight, ``own_system_ids`` their system ids, ``urls`` the link paths of each
    where there are several, ``reach`` where anything of the vehicle may be (None: anywhere on earth).
    """

    def __init__(
        self,
        stations: tuple[str, ...],
        vehicle_system_id: int,
        own_system_ids: frozenset[int],
        urls: Mapping[str, Sequence[str]] | None = None,
        reach: Reach | None = None,
        *,
        speedup: float = 1.0,
    ) -> None:
        self.vehicle_system_id = vehicle_system_id
        self.links = {station: StationLink(station, (urls or {}).get(station, ("",))) for station in stations}
        self.heartbeat: Heartbeat | None = None
        self.clock = BootClock()
        self.places = PositionGate(reach)
        self.home: HomePlace | None = None
        self.refused: dict[str, str] = {}
        """Why what was told of a place was not believed, by what it was; taken by `take_refused`."""
        self.kinds_s: dict[int, float] = {}
        """When each kind of message was last heard, by its id."""
        self.version: Any = None
        self.unix_s: tuple[float, float] | None = None
        """The vehicle's UTC (SYSTEM_TIME) and our clock when it came; None while it has none."""
        self.landed_state: int = 0
        self.landed_s, self.landed_since_s = -math.inf, math.inf
        """When the landed state was last told, and since when it has been the same."""
        self.gps_fix: tuple[float, int] | None = None
        """GPS_RAW_INT: when it came, and the fix type."""
        self.estimator: tuple[float, bool] | None = None
        """EKF_STATUS_REPORT or ESTIMATOR_STATUS: when it came, and whether it has a position to fly by."""
        self.sensors: tuple[float, int] | None = None
        """SYS_STATUS: when it came, and the sensors in use that are not well."""
        self.battery_percent: int | None = None
        self.batteries: dict[int, Battery] = {}
        """BATTERY_STATUS (147) by the battery's id."""
        self.control_main: int | None = None
        self.control_s = -math.inf
        self.target: Any = None
        self.target_s = -math.inf
        self.board = BoardWatch(speedup)
        self.foreign_stations: dict[int, float] = {}
        self.other_vehicles: dict[int, float] = {}
        """When an autopilot of another system id was last heard."""
        self.signed = False
        """Whether the newest HEARTBEAT was signed."""
        self._own = own_system_ids
        self._reach = reach
        self._beats: dict[str, tuple[tuple[bool, int], int]] = {}
        self._texts: list[tuple[int, str]] = []
        self._recent_texts: deque[tuple[float, int, str]] = deque(maxlen=32)
        self._chunks: dict[tuple[str, int], _Chunks] = {}
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
            elif kind == "HEARTBEAT" and component == AUTOPILOT_COMPONENT and system not in self._own:
                self.other_vehicles[system] = now_s
            return False
        if component != AUTOPILOT_COMPONENT:
            return False
        link = self.links[station_id]
        path = link.path(url)
        path.heard(now_s, message.get_seq())
        self.board.on_frame(now_s, path.url, message)
        if kind == "AUTOPILOT_VERSION":
            self.board.on_version(now_s, path.url, message)
        self.kinds_s[message.get_msgId()] = now_s
        self.clock.heard(now_s, booting=kind == "HEARTBEAT" and message.system_status in _BOOTING)
        if kind == "TIMESYNC":
            if message.tc1 != 0:
                sent_s = path.probe_sent_s(message.ts1)
                if sent_s is not None:
                    self.board.on_timesync(now_s, sent_s, message.tc1)
                path.answered(message.ts1, now_s)
                self._in_order(now_s, kind, message.tc1 * 1e-9)
            return True
        boot_ms = getattr(message, "time_boot_ms", None)
        fresh = boot_ms is None or self._in_order(now_s, kind, boot_ms * 1e-3)
        handler = _HANDLERS.get(kind)
        if handler is not None:
            handler(self, now_s, link, message, fresh)
        return True

    @property
    def position(self) -> Position | None:
        """Where it last said it was, however long ago (``heard_s``), where that can be."""
        return self.places.position

    @property
    def reboots(self) -> int:
        """How often the autopilot has restarted."""
        return self.clock.reboots

    def _in_order(self, now_s: float, kind: str, boot_s: float) -> bool:
        """Whether a stamp is on the vehicle's clock and as new as its kind's newest; notices a restart."""
        before = self.clock.reboots
        fresh = self.clock.stamp(now_s, kind, boot_s)
        if self.clock.reboots != before:
            self.places.forget()
            self.home = self.target = self.gps_fix = self.estimator = self.sensors = None
            self.landed_state, self.landed_since_s = 0, math.inf
            for link in self.links.values():
                link.forget_origin()
        return fresh

    def our_time_s(self, boot_s: float) -> float | None:
        """Our clock when the vehicle's showed ``boot_s``.

        By the fastest message lately, less half of the shortest round trip lately: right where there and back take
        equally long. A message that was faster than that path's own (over another link) keeps it from being early.
        """
        time_s = self.clock.our_time_s(boot_s)
        if time_s is None:
            return None
        latencies = [c.least_latency_s for link in self.links.values() for c in link.paths if c.round_trip_s]
        return time_s - min(latencies, default=0.0)

    def probe(self, now_s: float, station_id: str) -> Any:
        """A TIMESYNC of a station, for all its paths; its answer can only be the answer to it (matched by ``ts1``)."""
        self._probe_count += 1
        # Nanoseconds of our clock would repeat between stations; the count cannot.
        nonce = (int(max(now_s, 0.0) * 1e6) << 20) | (self._probe_count & 0xFFFFF)
        for path in self.links[station_id].paths:
            path.probed(now_s, nonce)
        return mavlink.MAVLink_timesync_message(0, nonce)

    # -- out ----------------------------------------------------------------------------------------------------------

    def take_texts(self, now_s: float = -math.inf) -> list[tuple[int, str]]:
        """(severity, text) of what the vehicle said since the last call, each once however many links brought it.

        A long one that has not come whole within `TEXT_WAIT_S` is shown as far as it came.
        """
        for key, one in list(self._chunks.items()):
            if now_s - one.since_s >= TEXT_WAIT_S:
                del self._chunks[key]
                self._say(now_s, one.severity, one.text)
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

    def take_refused(self) -> dict[str, str]:
        """What was told of places and not believed since the last call, and why."""
        refused, self.refused = self.refused, {}
        return refused

    @property
    def beats_alike(self) -> int:
        """How many HEARTBEATs in a row of one link have shown what the newest shows."""
        beat = self.heartbeat
        return 0 if beat is None else max(n for shown, n in self._beats.values() if shown == beat.shows)

    # -- messages -----------------------------------------------------------------------------------------------------

    def _on_heartbeat(self, now_s: float, link: StationLink, m: Any, fresh: bool) -> None:
        beat = Heartbeat.from_message(now_s, m)
        self.signed = bool(m.get_header().incompat_flags & mavlink.MAVLINK_IFLAG_SIGNED)
        self.heartbeat = beat
        shown, count = self._beats.get(link.station_id, (beat.shows, 0))
        self._beats[link.station_id] = (beat.shows, count + 1 if shown == beat.shows else 1)

    def _on_global_position(self, now_s: float, link: StationLink, m: Any, fresh: bool) -> None:
        if not fresh or (self.position is not None and m.time_boot_ms * 1e-3 <= self.position.boot_s):
            return
        if not self.places.take(Position.from_message(now_s, m)):
            self.refused["position"] = self.places.refused

    def _on_target(self, now_s: float, link: StationLink, m: Any, fresh: bool) -> None:
        if fresh:
            self.target, self.target_s = m, now_s

    def _on_origin(self, now_s: float, link: StationLink, m: Any, fresh: bool) -> None:
        why = no_place(m.latitude * 1e-7, m.longitude * 1e-7, m.altitude * 1e-3, self._reach)
        if why:
            self.refused["EKF origin"] = why
        else:
            link.tell_origin(now_s, EkfOrigin.from_message(m))

    def _on_home(self, now_s: float, link: StationLink, m: Any, fresh: bool) -> None:
        place = (m.latitude * 1e-7, m.longitude * 1e-7, m.altitude * 1e-3)
        why = no_place(*place, self._reach)
        if why:
            self.refused["home"] = why
        else:
            self.home = HomePlace(now_s, *place)

    def _on_extended_state(self, now_s: float, link: StationLink, m: Any, fresh: bool) -> None:
        if m.landed_state != self.landed_state or math.isinf(self.landed_since_s):
            self.landed_since_s = now_s
        self.landed_state, self.landed_s = m.landed_state, now_s

    def _on_gps(self, now_s: float, link: StationLink, m: Any, fresh: bool) -> None:
        self.gps_fix = (now_s, m.fix_type)

    def _on_estimator(self, now_s: float, link: StationLink, m: Any, fresh: bool) -> None:
        self.estimator = (now_s, m.flags & _ESTIMATE_NEEDED == _ESTIMATE_NEEDED and not m.flags & _ESTIMATE_BAD)

    def _on_sys_status(self, now_s: float, link: StationLink, m: Any, fresh: bool) -> None:
        self.battery_percent = m.battery_remaining if 0 <= m.battery_remaining <= 100 else None
        used = m.onboard_control_sensors_present & m.onboard_control_sensors_enabled
        self.sensors = (now_s, used & ~m.onboard_control_sensors_health)

    def _on_battery(self, now_s: float, link: StationLink, m: Any, fresh: bool) -> None:
        percent = m.battery_remaining if 0 <= m.battery_remaining <= 100 else None
        self.batteries[m.id] = Battery(now_s, percent, m.charge_state)

    def _on_version(self, now_s: float, link: StationLink, m: Any, fresh: bool) -> None:
        self.version = m

    def _on_system_time(self, now_s: float, link: StationLink, m: Any, fresh: bool) -> None:
        if m.time_unix_usec > 0 and fresh:
            self.unix_s = (m.time_unix_usec * 1e-6, now_s)

    def _on_control_status(self, now_s: float, link: StationLink, m: Any, fresh: bool) -> None:
        self.control_main, self.control_s = m.gcs_main, now_s

    def _on_text(self, now_s: float, link: StationLink, m: Any, fresh: bool) -> None:
        if not m.id:
            self._say(now_s, m.severity, m.text)
            return
        key = (link.station_id, m.id)
        one = self._chunks.setdefault(key, _Chunks(now_s, m.severity, {}))
        one.parts[m.chunk_seq] = m.text
        if one.whole:
            del self._chunks[key]
            self._say(now_s, one.severity, one.text)

    def _say(self, now_s: float, severity: int, text: str) -> None:
        # PX4 ends its texts with a tab.
        text = text.strip()
        for heard_s, before_severity, before in self._recent_texts:
            if now_s - heard_s <= SAME_TEXT_S and before_severity == severity and before == text:
                return
        self._recent_texts.append((now_s, severity, text))
        self._texts.append((severity, text))


_BOOTING = (mavlink.MAV_STATE_UNINIT, mavlink.MAV_STATE_BOOT, mavlink.MAV_STATE_CALIBRATING)
_ESTIMATE_NEEDED = mavlink.ESTIMATOR_POS_HORIZ_ABS | mavlink.ESTIMATOR_POS_VERT_ABS
"""Without these an estimator has no place; the bits are the same in EKF_STATUS_REPORT and ESTIMATOR_STATUS."""
_ESTIMATE_BAD = mavlink.ESTIMATOR_CONST_POS_MODE | mavlink.ESTIMATOR_GPS_GLITCH | 0x8000
"""It stands still, its GNSS glitches or (ArduPilot, 1024) it has not begun; 0x8000 is ArduPilot's GNSS glitch."""

_HANDLERS = {
    "HEARTBEAT": VehicleMonitor._on_heartbeat,
    "GLOBAL_POSITION_INT": VehicleMonitor._on_global_position,
    "POSITION_TARGET_LOCAL_NED": VehicleMonitor._on_target,
    "GPS_GLOBAL_ORIGIN": VehicleMonitor._on_origin,
    "HOME_POSITION": VehicleMonitor._on_home,
    "GPS_RAW_INT": VehicleMonitor._on_gps,
    "EKF_STATUS_REPORT": VehicleMonitor._on_estimator,
    "ESTIMATOR_STATUS": VehicleMonitor._on_estimator,
    "EXTENDED_SYS_STATE": VehicleMonitor._on_extended_state,
    "SYS_STATUS": VehicleMonitor._on_sys_status,
    "BATTERY_STATUS": VehicleMonitor._on_battery,
    "AUTOPILOT_VERSION": VehicleMonitor._on_version,
    "SYSTEM_TIME": VehicleMonitor._on_system_time,
    "CONTROL_STATUS": VehicleMonitor._on_control_status,
    "STATUSTEXT": VehicleMonitor._on_text,
}
