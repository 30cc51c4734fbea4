"""What a telemetry log holds of a flight: the setpoints sent, the positions heard, as arrays; what is wrong with it.

The whole log is read once, in the order of its records; its clock is set right by the vehicle's
(`link.files.log_clock`), and what it holds is told apart by the flights' own probes, whose numbers go on through a
flight and begin anew with the next.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from gcs.plan import Plan
from link.autopilot.local_frame import EkfOrigin
from link.autopilot.profile import AUTOPILOT_COMPONENT, AutopilotProfile
from link.autopilot.registry import profile_of_setpoints
from link.files.link_report import ProbeCount
from link.files.log_clock import LogClock, set_right
from link.files.log_damage import LogDamage
from link.files.tlog import TlogBytes, TlogRecord, read_tlog
from link.telemetry.board import STAMPED
from link.wire.sequence import frames_ahead
from planner.arrays import Array, Flags, Indices

SETPOINT_IDS = frozenset({84, 86})
PAUSE_S = 60.0
"""No flight's log is silent for so long: its heartbeats alone are a record a second."""
_ARMED = 128


def station_names(plan: Plan) -> dict[int, str]:
    """The plan's stations in flight order, by their system ids."""
    return {
        int(plan.mission.stations[i].system_id or 0): plan.mission.stations[i].id
        for i in dict.fromkeys(plan.trajectory.sequence)
    }


@dataclass(frozen=True)
class Sent:
    """Setpoints: arrays of one length; velocity (N, 3) east, north, up along true axes."""

    time_s: Array
    system_id: Indices
    lat_deg: Array
    lon_deg: Array
    alt_amsl_m: Array
    velocity_m_s: Array

    def only(self, keep: Flags) -> Sent:
        """Those of them to ``keep``."""
        return Sent(*(getattr(self, name)[keep] for name in self.__dataclass_fields__))


@dataclass(frozen=True)
class Heard:
    """Positions: when (log's clock, by the vehicle's), where."""

    time_s: Array
    lat_deg: Array
    lon_deg: Array
    alt_amsl_m: Array


@dataclass(frozen=True)
class LogPart:
    """One program's run in a log: setpoints, positions, the autopilot, probes, and when it ends (Unix time)."""

    sent: Sent
    heard: Heard
    profile: AutopilotProfile
    probes: ProbeCount
    end_s: float


@dataclass
class _Rows:
    """What is kept while reading, each row with the number of its record."""

    stamp_s: list[float] = field(default_factory=list)
    setpoints: list[tuple[float, ...]] = field(default_factory=list)
    """Record, message id, system, then latitude, longitude, altitude or x, y, altitude; then velocity."""
    positions: list[tuple[float, ...]] = field(default_factory=list)
    origins: list[tuple[int, EkfOrigin]] = field(default_factory=list)
    probes: list[tuple[int, int, Any, bool]] = field(default_factory=list)
    boot: list[tuple[int, float]] = field(default_factory=list)
    utc_off_s: list[float] = field(default_factory=list)
    missing: list[tuple[int, int, int]] = field(default_factory=list)
    """Between which two records of a station frames are missing, and how many."""
    starts: list[tuple[int, int]] = field(default_factory=list)
    """(last probe of a run, first of the next)."""
    damaged: list[int] = field(default_factory=list)
    repeated: int = 0
    unknown: int = 0
    armed: bool = False


class FlightLog:
    """A whole log, read against the plan. Raises `link.errors.TlogError` when it cannot be read."""

    def __init__(self, log: str | Path, plan: Plan) -> None:
        self._names = station_names(plan)
        self._vehicle = plan.mission.options.vehicle_system_id
        self._rows = _Rows()
        self._last: dict[int, tuple[int, int]] = {}
        self._probe = (-1, -1)
        self._origin: EkfOrigin | None = None
        count, seen = TlogBytes(), set()
        for record in read_tlog(log, count):
            known = hash((record.time_utc_us, record.frame))
            if known in seen:
                self._rows.repeated += 1
                continue
            seen.add(known)
            self._take(record)
        rows = self._rows
        boot = np.array(rows.boot, dtype=float).reshape(-1, 2)
        self.clock: LogClock = set_right(np.array(rows.stamp_s), boot[:, 0].astype(np.int64), boot[:, 1])
        self.damage = self._judge(count)

    # -- reading ------------------------------------------------------------------------------------------------------

    def _take(self, record: TlogRecord) -> None:
        rows, m = self._rows, record.message
        number = len(rows.stamp_s)
        rows.stamp_s.append(record.time_utc_s)
        if record.skipped_bytes:
            rows.damaged.append(number)
        if m is None:
            rows.unknown += 1
            return
        system, kind = m.get_srcSystem(), m.get_msgId()
        autopilot = system == self._vehicle and m.get_srcComponent() == AUTOPILOT_COMPONENT
        if system in self._names:
            self._count(number, system, m)
        if kind == 111:
            rows.probes.append((number, system, m, autopilot))
        elif kind in SETPOINT_IDS and system in self._names:
            self._take_setpoint(number, system, m)
        elif autopilot:
            self._take_telemetry(number, record, m)

    def _count(self, number: int, system: int, m: Any) -> None:
        """A frame of a station: every one was kept as it was sent, so what is left out is missing."""
        before = self._last.get(system)
        ahead = 1 if before is None else frames_ahead(before[1], m.get_seq())
        if before is not None and ahead > 1:
            self._rows.missing.append((before[0], number, ahead - 1))
        self._last[system] = (number, m.get_seq())
        if m.get_msgId() == 111 and m.tc1 == 0:
            if m.ts1 < self._probe[1]:
                self._rows.starts.append((self._probe[0], number))
            self._probe = (number, m.ts1)

    def _take_setpoint(self, number: int, system: int, m: Any) -> None:
        # NED to east, north, up.
        velocity = (m.vy, m.vx, -m.vz)
        if m.get_msgId() == 86:
            row = (m.lat_int * 1e-7, m.lon_int * 1e-7, m.alt)
        elif self._origin is not None:
            row = (m.x, m.y, self._origin.alt_amsl_m - m.z)
        else:
            return
        if np.isfinite((*row, *velocity)).all():
            self._rows.setpoints.append((number, m.get_msgId(), system, *row, *velocity))

    def _take_telemetry(self, number: int, record: TlogRecord, m: Any) -> None:
        rows, kind = self._rows, m.get_msgId()
        if kind == 0:
            rows.armed = bool(m.base_mode & _ARMED)
        elif kind == 2 and m.time_unix_usec:
            rows.utc_off_s.append(record.time_utc_s - m.time_unix_usec * 1e-6)
        elif kind == 49:
            self._origin = EkfOrigin.from_message(m)
            rows.origins.append((number, self._origin))
        if m.get_type() in STAMPED and m.time_boot_ms:
            rows.boot.append((number, m.time_boot_ms * 1e-3))
        if kind == 33 and abs(m.lat) <= 900_000_000 and abs(m.lon) <= 1_800_000_000 and (m.lat or m.lon):
            rows.positions.append((number, m.time_boot_ms * 1e-3, m.lat * 1e-7, m.lon * 1e-7, m.alt * 1e-3))

    # -- judging ------------------------------------------------------------------------------------------------------

    def _judge(self, count: TlogBytes) -> LogDamage:
        rows, time_s = self._rows, self.clock.time_s
        bounds = {last for last, _ in self._starts()}
        missing = [one for one in rows.missing if not any(one[0] <= last < one[1] for last in bounds)]
        holes = [(float(time_s[low]), float(time_s[high])) for low, high, _ in missing]
        holes += [(float(time_s[max(0, r - 1)]), float(time_s[r])) for r in {*rows.damaged, *self.clock.leaps}]
        return LogDamage(
            total_bytes=count.read,
            damaged_places=len(rows.damaged) + bool(count.tail),
            skipped_bytes=count.skipped,
            cut_tail_bytes=count.tail,
            missing_frames=sum(frames for _, _, frames in missing),
            holes=_joined(holes),
            repeated_records=rows.repeated,
            unknown_frames=rows.unknown,
            clock_steps=tuple((float(time_s[r]), by_s) for r, by_s in self.clock.steps),
            stray_stamps=self.clock.strays,
            utc_off_s=float(np.median(rows.utc_off_s)) if rows.utc_off_s else None,
            ends_armed=rows.armed,
        )

    def _starts(self) -> list[tuple[int, int]]:
        """Where runs begin: between the last probe of one and the first of the next, at the longest silence."""
        result = []
        for last, first in self._rows.starts:
            went_s = np.abs(np.diff(np.array(self._rows.stamp_s[last : first + 1])))
            at = last + int(went_s.argmax())
            result.append((at, at + 1))
        return result

    # -- parts --------------------------------------------------------------------------------------------------------

    def parts(self) -> list[LogPart]:
        """The runs in the log, in its order."""
        edges = [0, *(first for _, first in self._starts()), len(self._rows.stamp_s)]
        return [self._part(low, high) for low, high in itertools.pairwise(edges)]

    def _part(self, low: int, high: int) -> LogPart:
        rows, time_s = self._rows, self.clock.time_s
        probes = ProbeCount(self._names)
        for number, system, m, vehicle in rows.probes:
            if low <= number < high:
                probes.note(float(time_s[number]), system, m, vehicle=vehicle)
        table = np.array([row for row in rows.setpoints if low <= row[0] < high], dtype=float).reshape(-1, 9)
        kinds = {int(kind): int((table[:, 1] == kind).sum()) for kind in np.unique(table[:, 1])}
        profile = profile_of_setpoints(kinds)
        origin = next((o for number, o in reversed(rows.origins) if number < high), None)
        local = table[:, 1] == 84
        if origin is not None and local.any():
            table[local, 3], table[local, 4] = np.transpose(
                [profile.lat_lon_deg(origin, x, y) for x, y in table[local, 3:5]]
            )
        heard = np.array([row for row in rows.positions if low <= row[0] < high], dtype=float).reshape(-1, 5)
        return LogPart(
            Sent(
                time_s[table[:, 0].astype(np.int64)],
                table[:, 2].astype(np.int64),
                table[:, 3],
                table[:, 4],
                table[:, 5],
                table[:, 6:9],
            ),
            self._heard(heard),
            profile,
            probes,
            float(time_s[high - 1]) if high > low else 0.0,
        )

    def _heard(self, rows: Array) -> Heard:
        """Positions, each once (the same message may come over every link; the first is the fastest)."""
        came_s, boot_s = self.clock.time_s[rows[:, 0].astype(np.int64)], rows[:, 1]
        # The vehicle's clock begins anew where it restarts.
        boots = np.cumsum(np.diff(boot_s, prepend=boot_s[:1]) < -PAUSE_S / 6.0)
        times = np.empty(len(rows))
        keep = np.zeros(len(rows), dtype=bool)
        for boot in np.unique(boots):
            one = np.flatnonzero(boots == boot)
            times[one] = _on_log_clock(came_s[one], boot_s[one])
            keep[one[np.unique(boot_s[one], return_index=True)[1]]] = True
        order = np.flatnonzero(keep)
        return Heard(times[order], rows[order, 2], rows[order, 3], rows[order, 4])


def _joined(holes: list[tuple[float, float]]) -> tuple[tuple[float, float], ...]:
    """Holes in order, those that overlap as one."""
    result: list[tuple[float, float]] = []
    for low, high in sorted(holes):
        if result and low <= result[-1][1]:
            result[-1] = (result[-1][0], max(result[-1][1], high))
        else:
            result.append((low, high))
    return tuple(result)


def _on_log_clock(came_s: Array, boot_s: Array, window_s: float = 20.0) -> Array:
    """The log's clock at each of the vehicle's stamps: late only by the smallest delay within a window."""
    if not len(came_s):
        return came_s
    offset = came_s - boot_s
    block = np.floor((came_s - came_s[0]) / window_s).astype(np.int64)
    least = np.full(int(block.max()) + 1, np.inf)
    np.minimum.at(least, block, offset)
    before = np.concatenate([[np.inf], least[:-1]])
    return np.asarray(boot_s + np.minimum(least, before)[block])
