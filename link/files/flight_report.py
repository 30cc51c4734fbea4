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

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from gcs.plan import Plan
from link.autopilot.registry import PROFILES
from link.errors import ReportError
from link.files.comparison import (
    ON_PATH_M,
    PlannedPath,
    TrackingErrors,
    last_moving,
    launch_time_s,
    least_margin,
    to_plane,
    tracking_errors,
)
from link.files.flight_log import Sent, collect, station_names
from link.files.grid_lateness import grid_lateness_ms
from link.files.link_report import History, LinkReport, ProbeCount
from link.files.tlog import read_tlog
from planner.arrays import Array, Flags

AROUND_HANDOVER_S = 2.0


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
    names = station_names(plan)
    probes = ProbeCount(names)
    sent, heard, profile, log_end_s = collect(read_tlog(log), plan, probes)
    path = PlannedPath(plan)
    sent, place, plan_s, launched_s = _flight_of_the_plan(log, plan, path, sent)
    reached = float(np.linalg.norm(place[-1] - plan.trajectory.evaluate(plan.mission_time_s))) < 0.1
    end_s = float(sent.time_s[-1])
    heard = replace(heard, time_s=heard.time_s - probes.least_latency_s)
    links = probes.links(log_end_s, None if history is None else history.failovers)
    delay_s = {link.station: 1e-3 * (link.latency_ms or 0.0) for link in links}
    arrived_s = sent.time_s + np.array([delay_s[names[int(i)]] for i in sent.system_id])
    errors = tracking_errors(heard, sent, arrived_s, place, plan, (launched_s, end_s))
    gaps = np.diff(sent.time_s)
    counted = None if history is None else history.lateness
    lateness = _lateness(sent.time_s) if counted is None else counted
    margin, margin_station = least_margin(heard, sent, plan, launched_s, end_s)
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


def _flight_of_the_plan(log: str | Path, plan: Plan, path: PlannedPath, sent: Sent) -> tuple[Sent, Array, Array, float]:
    """The setpoints from T+0 to the last one on the plan's path, their places, their times of the plan, and T+0."""
    if len(sent.time_s) < 2:
        raise ReportError(f"{log} holds no setpoints of the plan's stations ({', '.join(plan.station_ids)})")
    place = to_plane(plan, sent.lat_deg, sent.lon_deg, sent.alt_amsl_m)
    plan_s, off_m = path.nearest(place)
    launched_s = launch_time_s(sent.time_s, plan_s, off_m, plan)
    flown = (sent.time_s >= launched_s - 1e-6) & (off_m <= ON_PATH_M)
    if flown.sum() < 2:
        raise ReportError(f"{log} holds setpoints, but none on the path of plan {plan.plan_sha256[:16]}")
    keep = flown & (np.arange(len(flown)) <= last_moving(flown, place, sent.velocity_m_s, plan))
    return sent.only(keep), place[keep], plan_s[keep], launched_s


def _handovers(sent: Sent, errors: TrackingErrors, plan: Plan, launched_s: float) -> tuple[HandoverReport, ...]:
    names = station_names(plan)
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


def _rms(values: Array) -> float | None:
    return float(np.sqrt(np.mean(values**2))) if len(values) else None


def _worst(values: Array) -> float | None:
    return float(values.max()) if len(values) else None
