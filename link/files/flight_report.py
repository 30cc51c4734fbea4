"""Planned against flown, from a telemetry log and the plan.

Everything is measured from the frames: setpoints from those of the plan's stations (their system ids tell who was in
control), positions from the vehicle's GLOBAL_POSITION_INT. The flight's events, where they are given too, add what a
log cannot tell (`link.files.link_report`). What is meant by the figures:

- *tracking error*: distance (3-D) between where the vehicle said it was and what was asked of it at that moment,
  *along* the path or *beside* it. The vehicle's clock is laid on the log's by the fastest message heard, less what that
  took, and a setpoint asks from when it arrived. Frames take half of a probe's round trip: the shortest of all for the
  fastest message, the station's median for its setpoints.
- *off the path*: distance to the nearest point of the planned path, whatever the time.
- *T+0*: found from the setpoints themselves, which lie on the path: the median of (time sent - time of the plan).
- *margin*: range left to the station in control, by its full range, at the positions flown.
- *gap*: time between setpoints; *lateness*: of each from the even grid the stream keeps, in the flight's seconds; with
  events, the streamer's own count of it.
- *links*: by the stations' probes, see `link.files.link_report`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from gcs.plan import Plan
from link.autopilot.local_frame import EkfOrigin
from link.autopilot.profile import AutopilotProfile
from link.autopilot.registry import PROFILES, profile_of_setpoints
from link.errors import ReportError
from link.files.grid_lateness import grid_lateness_ms
from link.files.link_report import History, LinkReport, ProbeCount
from link.files.tlog import TlogRecord, read_tlog
from planner.arrays import Array, Flags, Indices

PATH_STEP_S = 0.02
ON_PATH_M = 0.5
AROUND_HANDOVER_S = 2.0
SETPOINT_IDS = frozenset({84, 86})


@dataclass(frozen=True)
class HandoverReport:
    """One change of the sending station. Times are T+ in seconds; ``planned_s`` is None where none was planned."""

    index: int | None
    from_station: str
    to_station: str
    planned_s: float | None
    flown_s: float
    gap_s: float
    error_before_m: float | None
    error_around_m: float | None


@dataclass(frozen=True)
class FlightReport:
    """The figures of a flight; None where the log does not tell. See the module for what each means.

    ``lateness_from``: ``"log"``, or ``"streamer"`` for its own count, which ``skipped_ticks`` is of too.
    """

    plan_sha256: str
    autopilot: str
    launched_unix_s: float
    planned_s: float
    flown_s: float
    shift_s: float
    setpoints: int
    setpoints_by_station: dict[str, int]
    tracking_rms_m: float | None
    tracking_worst_m: float | None
    along_worst_m: float | None
    beside_worst_m: float | None
    off_path_worst_m: float | None
    margin_least_m: float | None
    margin_least_station: str | None
    longest_gap_s: float
    lateness_p50_ms: float
    lateness_p99_ms: float
    lateness_worst_ms: float
    lateness_from: str
    skipped_ticks: int | None
    links: tuple[LinkReport, ...]
    handovers: tuple[HandoverReport, ...]
    reached: bool

    def to_document(self) -> dict[str, Any]:
        """As a JSON object."""
        document = asdict(self)
        document["handovers"] = [asdict(h) for h in self.handovers]
        document["links"] = [asdict(link) for link in self.links]
        return document

    def to_text(self) -> str:
        """For people."""

        def metres(value: float | None) -> str:
            return "unknown" if value is None else f"{value:.2f} m"

        lines = [
            f"Plan          {self.plan_sha256[:16]}, flown by {PROFILES[self.autopilot].title}",
            f"Time          {self.flown_s:.2f} s flown, {self.planned_s:.2f} s planned"
            + (
                f", {self.shift_s:+.2f} s against the schedule at the end" if self.reached else ", not flown to its end"
            ),
            f"Tracking      {metres(self.tracking_rms_m)} rms, {metres(self.tracking_worst_m)} at worst "
            f"({metres(self.along_worst_m)} along, {metres(self.beside_worst_m)} beside)",
            f"Off the path  {metres(self.off_path_worst_m)} at worst",
            f"Range left    {metres(self.margin_least_m)} at least"
            + (f" ({self.margin_least_station})" if self.margin_least_station else ""),
            f"Setpoints     {self.setpoints}, longest gap {self.longest_gap_s * 1e3:.0f} ms",
            "Lateness      "
            f"p50 {self.lateness_p50_ms:.1f}, p99 {self.lateness_p99_ms:.1f}, worst {self.lateness_worst_ms:.1f} ms"
            + ("" if self.skipped_ticks is None else f", {self.skipped_ticks} skipped (the streamer's own count)"),
            "C2 links",
            *(f"  {link.to_text()}" for link in self.links),
            f"Handovers     {len(self.handovers)}",
        ]
        for h in self.handovers:
            planned = "not planned" if h.planned_s is None else f"planned T+{h.planned_s:.2f}"
            lines.append(
                f"  {h.index if h.index is not None else '-':>3}  {h.from_station} -> {h.to_station}: "
                f"T+{h.flown_s:.2f} s ({planned}), gap {h.gap_s * 1e3:.0f} ms, "
                f"error {metres(h.error_before_m)} before, {metres(h.error_around_m)} around"
            )
        return "\n".join(lines) + "\n"


def report_flight(log: str | Path, plan: Plan, events: str | Path | None = None) -> FlightReport:
    """Compare the flight in a telemetry log with its plan; ``events`` is a file of the flight's events.

    Raises `ReportError` when log or events hold no flight of this plan, `link.errors.TlogError` when the log cannot be
    read.
    """
    history = None if events is None else History.read(events, plan)
    names = _station_names(plan)
    probes = ProbeCount(names)
    sent, heard, profile, log_end_s = _collect(read_tlog(log), plan, probes)
    if len(sent.time_s) < 2:
        raise ReportError(f"{log} holds no setpoints of the plan's stations ({', '.join(plan.station_ids)})")
    place = _to_plane(plan, sent.lat_deg, sent.lon_deg, sent.alt_amsl_m)
    path = _Path(plan)
    plan_s, off_m = path.nearest(place)
    launched_s = _launch(sent.time_s, plan_s, off_m, plan)
    # The flight of the plan: from T+0 to the last setpoint on its path.
    flown = (sent.time_s >= launched_s - 1e-6) & (off_m <= ON_PATH_M)
    if flown.sum() < 2:
        raise ReportError(f"{log} holds setpoints, but none on the path of plan {plan.plan_sha256[:16]}")
    keep = flown & (np.arange(len(flown)) <= _last_moving(flown, place, sent.velocity_m_s, plan))
    sent, place, plan_s = sent.only(keep), place[keep], plan_s[keep]
    reached = float(np.linalg.norm(place[-1] - plan.trajectory.evaluate(plan.mission_time_s))) < 0.1
    end_s = float(sent.time_s[-1])
    heard = replace(heard, time_s=heard.time_s - probes.least_latency_s)
    links = probes.links(log_end_s, None if history is None else history.failovers)
    way_s = {link.station: 1e-3 * (link.latency_ms or 0.0) for link in links}
    arrived_s = sent.time_s + np.array([way_s[names[int(i)]] for i in sent.system_id])
    errors = _errors(heard, sent, arrived_s, place, plan, (launched_s, end_s))
    gaps = np.diff(sent.time_s)
    counted = None if history is None else history.lateness
    lateness = _lateness(sent.time_s) if counted is None else counted
    margin, margin_station = _margin(heard, sent, plan, launched_s, end_s)
    off_path = path.nearest(errors.place)[1] if len(errors.time_s) else np.array([])
    flown_s = end_s - launched_s
    return FlightReport(
        plan_sha256=plan.plan_sha256,
        autopilot=profile.name,
        launched_unix_s=launched_s,
        planned_s=plan.mission_time_s,
        flown_s=flown_s,
        shift_s=flown_s - (plan.mission_time_s if reached else float(plan_s[-1])),
        setpoints=len(sent.time_s),
        setpoints_by_station={names[int(i)]: int((sent.system_id == i).sum()) for i in np.unique(sent.system_id)},
        tracking_rms_m=_rms(errors.error_m),
        tracking_worst_m=_worst(errors.error_m),
        along_worst_m=_worst(np.abs(errors.behind_m)),
        beside_worst_m=_worst(errors.beside_m),
        off_path_worst_m=_worst(off_path),
        margin_least_m=margin,
        margin_least_station=margin_station,
        longest_gap_s=float(gaps.max()),
        lateness_p50_ms=lateness["p50_ms"],
        lateness_p99_ms=lateness["p99_ms"],
        lateness_worst_ms=lateness["worst_ms"],
        lateness_from="log" if counted is None else "streamer",
        skipped_ticks=None if counted is None else int(counted["skipped_ticks"]),
        links=links,
        handovers=_handovers(sent, errors, plan, launched_s),
        reached=reached,
    )


@dataclass(frozen=True)
class _Sent:
    """Setpoints: arrays of one length; velocity (N, 3) east, north, up along true axes."""

    time_s: Array
    system_id: Indices
    lat_deg: Array
    lon_deg: Array
    alt_amsl_m: Array
    velocity_m_s: Array

    def only(self, keep: Flags) -> _Sent:
        return _Sent(*(getattr(self, name)[keep] for name in self.__dataclass_fields__))


@dataclass(frozen=True)
class _Heard:
    """Positions: when (log's clock, by the vehicle's), where."""

    time_s: Array
    lat_deg: Array
    lon_deg: Array
    alt_amsl_m: Array


@dataclass(frozen=True)
class _Errors:
    time_s: Array
    place: Array
    error_m: Array
    behind_m: Array
    beside_m: Array


def _collect(
    records: Iterable[TlogRecord], plan: Plan, probes: ProbeCount
) -> tuple[_Sent, _Heard, AutopilotProfile, float]:
    """Setpoints, positions, the autopilot, and when the log ends (Unix time)."""
    end_s = 0.0
    stations = set(_station_names(plan))
    vehicle = plan.mission.options.vehicle_system_id
    origin: EkfOrigin | None = None
    kinds: dict[int, int] = {}
    local: list[tuple[float, ...]] = []
    sent: list[tuple[float, ...]] = []
    positions: dict[int, tuple[float, ...]] = {}
    for record in records:
        m = record.message
        if m is None:
            continue
        system, number = m.get_srcSystem(), m.get_msgId()
        end_s = max(end_s, record.time_utc_s)
        if number == 111:
            probes.note(record.time_utc_s, system, m, vehicle=system == vehicle and m.get_srcComponent() == 1)
        elif number in SETPOINT_IDS and system in stations:
            kinds[number] = kinds.get(number, 0) + 1
            # NED to east, north, up.
            velocity = (m.vy, m.vx, -m.vz)
            if number == 86:
                sent.append((record.time_utc_s, system, m.lat_int * 1e-7, m.lon_int * 1e-7, m.alt, *velocity))
            elif origin is not None:
                local.append((record.time_utc_s, system, m.x, m.y, origin.alt_amsl_m - m.z, *velocity))
        elif system == vehicle and m.get_srcComponent() == 1:
            if number == 33:
                row = (record.time_utc_s, m.time_boot_ms * 1e-3, m.lat * 1e-7, m.lon * 1e-7, m.alt * 1e-3)
                # The same message comes over every link; the first is the fastest.
                positions.setdefault(m.time_boot_ms, row)
            elif number == 49:
                origin = EkfOrigin.from_message(m)
    profile = profile_of_setpoints(kinds)
    if origin is not None:
        sent += [(*p[:2], *profile.lat_lon_deg(origin, p[2], p[3]), *p[4:]) for p in local]
    table = np.array(sorted(sent), dtype=float).reshape(-1, 8)
    heard = np.array(list(positions.values()), dtype=float).reshape(-1, 5)
    return (
        _Sent(table[:, 0], table[:, 1].astype(np.int64), table[:, 2], table[:, 3], table[:, 4], table[:, 5:8]),
        _Heard(_on_log_clock(heard[:, 0], heard[:, 1]), heard[:, 2], heard[:, 3], heard[:, 4]),
        profile,
        end_s,
    )


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


def _to_plane(plan: Plan, lat_deg: Array, lon_deg: Array, alt_amsl_m: Array) -> Array:
    east, north = plan.plane.to_plane(lat_deg, lon_deg)
    return np.stack([east, north, alt_amsl_m - plan.plane.alt_amsl_m], axis=-1)


class _Path:
    """The planned path, for nearest points."""

    def __init__(self, plan: Plan) -> None:
        count = max(2, math.ceil(plan.mission_time_s / PATH_STEP_S) + 1)
        self._times = np.linspace(0.0, plan.mission_time_s, count)
        self._curve = plan.trajectory
        self._tree = cKDTree(plan.trajectory.evaluate(self._times))

    def nearest(self, places: Array) -> tuple[Array, Array]:
        """Times of the plan and distances (m) of the nearest points, refined between the samples."""
        if not len(places):
            return np.array([]), np.array([])
        _, index = self._tree.query(places)
        time = self._times[index]
        for _ in range(2):
            # One Newton step each along the tangent.
            off = places - self._curve.evaluate(time)
            velocity = self._curve.evaluate(time, 1)
            speed2 = np.maximum(np.einsum("ni,ni->n", velocity, velocity), 1e-6)
            step = np.einsum("ni,ni->n", off, velocity) / speed2
            time = np.clip(time + np.clip(step, -PATH_STEP_S, PATH_STEP_S), 0.0, self._times[-1])
        return time, np.linalg.norm(places - self._curve.evaluate(time), axis=-1)


def _launch(time_s: Array, plan_s: Array, off_m: Array, plan: Plan) -> float:
    """When T+0 was: setpoints well under way tell, those at rest at the start do not."""
    total = plan.mission_time_s
    early = (off_m <= ON_PATH_M) & (plan_s >= min(2.0, 0.05 * total)) & (plan_s <= min(30.0, 0.5 * total))
    first = np.flatnonzero(early)
    if not len(first):
        return float(time_s[0])
    # The first pass alone: a flight may come back over the same ground.
    first = first[time_s[first] <= time_s[first[0]] + 60.0]
    return float(np.median(time_s[first] - plan_s[first]))


def _last_moving(flown: Flags, place: Array, velocity_m_s: Array, plan: Plan) -> int:
    """The index where the stream of the plan ends: its first sample at rest at the end, or the last one on the path."""
    from_end = np.linalg.norm(place - plan.trajectory.evaluate(plan.mission_time_s), axis=-1)
    arrived = np.flatnonzero(flown & (from_end < 0.1) & (np.linalg.norm(velocity_m_s, axis=-1) < 1e-5))
    return int(arrived[0]) if len(arrived) else int(np.flatnonzero(flown)[-1])


def _errors(
    heard: _Heard, sent: _Sent, arrived_s: Array, place: Array, plan: Plan, span_s: tuple[float, float]
) -> _Errors:
    inside = (heard.time_s >= max(span_s[0], float(arrived_s[0]))) & (heard.time_s <= span_s[1])
    time_s = heard.time_s[inside]
    here = _to_plane(plan, heard.lat_deg[inside], heard.lon_deg[inside], heard.alt_amsl_m[inside])
    # At a handover from a slow link to a quick one the new station's first setpoints overtake the old one's last.
    arrived_s = np.maximum.accumulate(arrived_s)
    at = np.clip(np.searchsorted(arrived_s, time_s, side="right") - 1, 0, len(arrived_s) - 1)
    carry = np.clip(time_s - arrived_s[at], 0.0, 1.0)
    # Between setpoints the reference moves on: to the next one where there is one soon.
    after = np.minimum(at + 1, len(arrived_s) - 1)
    step = arrived_s[after] - arrived_s[at]
    share = np.where((step > 0) & (step < 0.5), carry / np.maximum(step, 1e-9), 0.0)[:, None]
    asked = place[at] + share * (place[after] - place[at])
    off = here - asked
    velocity = sent.velocity_m_s[at]
    speed = np.linalg.norm(velocity, axis=-1)
    along = np.where(speed[:, None] > 0.5, velocity / np.maximum(speed, 1e-9)[:, None], 0.0)
    ahead = np.einsum("ni,ni->n", off, along)
    return _Errors(
        time_s, here, np.linalg.norm(off, axis=-1), -ahead, np.linalg.norm(off - ahead[:, None] * along, axis=-1)
    )


def _margin(heard: _Heard, sent: _Sent, plan: Plan, from_s: float, to_s: float) -> tuple[float | None, str | None]:
    inside = (heard.time_s >= from_s) & (heard.time_s <= to_s)
    if not inside.any():
        return None, None
    places = _to_plane(plan, heard.lat_deg[inside], heard.lon_deg[inside], heard.alt_amsl_m[inside])
    at = np.clip(np.searchsorted(sent.time_s, heard.time_s[inside], side="right") - 1, 0, len(sent.time_s) - 1)
    names = _station_names(plan)
    index = np.array([plan.mission.station_index(names[int(i)]) for i in sent.system_id[at]])
    left = -plan.geometry.outside_m(index, places)
    worst = int(left.argmin())
    return float(left[worst]), plan.mission.stations[index[worst]].id


def _handovers(sent: _Sent, errors: _Errors, plan: Plan, launched_s: float) -> tuple[HandoverReport, ...]:
    names = _station_names(plan)
    planned = list(plan.handovers)
    result = []
    for k in np.flatnonzero(np.diff(sent.system_id)):
        before, after = names[int(sent.system_id[k])], names[int(sent.system_id[k + 1])]
        time_s = float(sent.time_s[k + 1])
        match = next((h for h in planned if (h.from_station, h.to_station) == (before, after)), None)
        if match is not None:
            planned.remove(match)
        result.append(
            HandoverReport(
                index=None if match is None else match.index,
                from_station=before,
                to_station=after,
                planned_s=None if match is None else match.time_s,
                flown_s=time_s - launched_s,
                gap_s=time_s - float(sent.time_s[k]),
                error_before_m=_worst(errors.error_m[_between(errors.time_s, time_s - AROUND_HANDOVER_S, time_s)]),
                error_around_m=_worst(errors.error_m[_between(errors.time_s, time_s, time_s + AROUND_HANDOVER_S)]),
            )
        )
    return tuple(result)


def _between(times: Array, low: float, high: float) -> Flags:
    return (times >= low) & (times <= high)


def _lateness(time_s: Array) -> dict[str, float]:
    late_ms = grid_lateness_ms(time_s)
    return {
        "p50_ms": float(np.quantile(late_ms, 0.5)),
        "p99_ms": float(np.quantile(late_ms, 0.99)),
        "worst_ms": float(late_ms.max()),
    }


def _station_names(plan: Plan) -> dict[int, str]:
    return {
        int(plan.mission.stations[i].system_id or 0): plan.mission.stations[i].id
        for i in dict.fromkeys(plan.trajectory.sequence)
    }


def _rms(values: Array) -> float | None:
    return float(np.sqrt(np.mean(values**2))) if len(values) else None


def _worst(values: Array) -> float | None:
    return float(values.max()) if len(values) else None
