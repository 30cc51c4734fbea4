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
    gaps_s,
    last_moving,
    launch_time_s,
    least_margin,
    margins_m,
    seen_only,
    to_plane,
    tracking_errors,
)
from link.files.flight_log import FlightLog, Heard, LogPart, Sent, station_names
from link.files.grid_lateness import grid_lateness_ms
from link.files.link_report import History, LinkReport
from link.files.log_damage import LogDamage
from planner.arrays import Array, Flags

AROUND_HANDOVER_S = 2.0
FAR_OFF_M = 10.0
"""A vehicle that was so far off its path, or from its destination at the end, did not fly as planned."""
LATE_S = 2.0


@dataclass(frozen=True)
class HandoverReport:
    """One change of the sending station. Times are T+ in seconds; ``planned_s`` is None where none was planned,
    ``gap_s`` where the log has a hole there."""

    index: int | None
    from_station: str
    to_station: str
    planned_s: float | None
    flown_s: float
    gap_s: float | None
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
    end_off_m: float | None
    flight: int
    flights: int
    damage: LogDamage
    not_planned: tuple[str, ...]
    """Why it was not flown as planned; empty where it was, as far as the log tells."""

    @property
    def verdict(self) -> str:
        """Whether it was flown as planned, and why not."""
        told = "not as planned: " + "; ".join(self.not_planned) if self.not_planned else "flown as planned"
        return told + (", as far as the damaged log tells" if self.damage.lines else "")

    def to_document(self) -> dict[str, Any]:
        """As a JSON object."""
        document = asdict(self)
        document["handovers"] = [asdict(h) for h in self.handovers]
        document["links"] = [asdict(link) for link in self.links]
        document["damage"] = self.damage.to_document()
        return document

    def to_text(self) -> str:
        """For people."""

        def metres(value: float | None) -> str:
            return "unknown" if value is None else f"{value:.2f} m"

        lines = [
            *(
                [f"Flights       {self.flights} in this log; this is number {self.flight} (--flight tells which)"]
                if self.flights > 1
                else []
            ),
            f"Flown         {self.verdict}",
            *(f"Log           {line}" for line in self.damage.lines),
            *(f"Clock         {line}" for line in self.damage.clock_lines),
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
                f"T+{h.flown_s:.2f} s ({planned}), gap "
                + ("unknown, " if h.gap_s is None else f"{h.gap_s * 1e3:.0f} ms, ")
                + f"error {metres(h.error_before_m)} before, {metres(h.error_around_m)} around"
            )
        return "\n".join(lines) + "\n"


@dataclass(frozen=True)
class FlightTraces:
    """What a report is drawn from. Times are T+; places (N, 3) in the plan's plane, east, north, up."""

    errors: TrackingErrors
    setpoint_s: Array
    late_ms: Array
    margin_s: Array
    margin_m: Array
    trips: dict[str, tuple[Array, Array]]
    """Of each station's probes: when sent, and the round trip in ms (NaN: never answered)."""
    launched_s: float


def report_flight(
    log: str | Path, plan: Plan, events: str | Path | None = None, *, flight: int | None = None
) -> FlightReport:
    """Compare a flight in a telemetry log with its plan; ``events`` is a file of the flight's events, ``flight`` says
    which of several (from 1; None: the first).

    Raises `ReportError` when log or events hold no (such) flight of this plan, `link.errors.TlogError` when the log
    cannot be read.
    """
    return report_and_traces(log, plan, events, flight=flight)[0]


def report_and_traces(
    log: str | Path, plan: Plan, events: str | Path | None = None, *, flight: int | None = None
) -> tuple[FlightReport, FlightTraces]:
    """`report_flight`, and what it is drawn from."""
    history = None if events is None else History.read(events, plan)
    whole = FlightLog(log, plan)
    flights = _flights(log, whole, plan)
    number = 1 if flight is None else flight
    if not 1 <= number <= len(flights):
        raise ReportError(f"{log} holds {len(flights)} flight(s) of this plan, none of number {number}")
    part, flown = flights[number - 1]
    return _compare(plan, history, whole.damage, part, flown, (number, len(flights)))


_Flown = tuple[Sent, Array, Array, float]
"""The setpoints from T+0 to the last one on the plan's path, their places, their times of the plan, and T+0."""


def _flights(log: str | Path, whole: FlightLog, plan: Plan) -> list[tuple[LogPart, _Flown]]:
    """The flights of the plan in a log, in its order. Raises `ReportError` where there is none."""
    path = PlannedPath(plan)
    found: list[tuple[LogPart, _Flown]] = []
    some = False
    for part in whole.parts():
        sent = part.sent
        some = some or len(sent.time_s) >= 2
        while (flown := _flight_of_the_plan(plan, path, sent)) is not None:
            found.append((part, flown))
            sent = sent.only(sent.time_s > flown[0].time_s[-1] + 1e-6)
            if not _begins_again(plan, path, sent):
                break
    if found:
        return found
    if some:
        raise ReportError(f"{log} holds setpoints, but none on the path of plan {plan.plan_sha256[:16]}")
    raise ReportError(f"{log} holds no setpoints of the plan's stations ({', '.join(plan.station_ids)})")


def _begins_again(plan: Plan, path: PlannedPath, sent: Sent) -> bool:
    """Whether setpoints after a flight's last are another flight's: on the path, under way, early in the plan."""
    if len(sent.time_s) < 2:
        return False
    plan_s, off_m = path.nearest(to_plane(plan, sent.lat_deg, sent.lon_deg, sent.alt_amsl_m))
    moving = np.linalg.norm(sent.velocity_m_s, axis=-1) > 0.5
    early = plan_s < 0.5 * plan.mission_time_s
    way = np.einsum("ni,ni->n", sent.velocity_m_s, plan.trajectory.evaluate(plan_s, 1))
    return bool((moving & early & (off_m <= ON_PATH_M) & (way > 0.0)).sum() > 20)


def _flight_of_the_plan(plan: Plan, path: PlannedPath, sent: Sent) -> _Flown | None:
    """The first flight in some setpoints; None where none lie on the path."""
    if len(sent.time_s) < 2:
        return None
    place = to_plane(plan, sent.lat_deg, sent.lon_deg, sent.alt_amsl_m)
    plan_s, off_m = path.nearest(place)
    launched_s = launch_time_s(sent.time_s, plan_s, off_m, plan)
    flown = (sent.time_s >= launched_s - 1e-6) & (off_m <= ON_PATH_M)
    if flown.sum() < 2:
        return None
    keep = flown & (np.arange(len(flown)) <= last_moving(flown, place, sent.velocity_m_s, plan))
    if keep.sum() < 2:
        return None
    return sent.only(keep), place[keep], plan_s[keep], launched_s


def _compare(
    plan: Plan,
    history: History | None,
    damage: LogDamage,
    part: LogPart,
    flown: _Flown,
    numbers: tuple[int, int],
) -> tuple[FlightReport, FlightTraces]:
    sent, place, plan_s, launched_s = flown
    names = station_names(plan)
    reached = float(np.linalg.norm(place[-1] - plan.trajectory.evaluate(plan.mission_time_s))) < 0.1
    end_s = float(sent.time_s[-1])
    heard = replace(part.heard, time_s=part.heard.time_s - part.probes.least_latency_s)
    heard = seen_only(heard, damage)
    links = part.probes.links(part.end_s, None if history is None else history.failovers)
    delay_s = {link.station: 1e-3 * (link.latency_ms or 0.0) for link in links}
    arrived_s = sent.time_s + np.array([delay_s[names[int(i)]] for i in sent.system_id])
    errors = tracking_errors(heard, sent, arrived_s, place, plan, (launched_s, end_s))
    gaps = gaps_s(sent, damage)
    late_ms = grid_lateness_ms(sent.time_s)
    counted = None if history is None else history.lateness
    lateness = _lateness(late_ms) if counted is None else counted
    margins = margins_m(heard, sent, plan, launched_s, end_s)
    margin, margin_station = least_margin(margins, plan)
    off_path = PlannedPath(plan).nearest(errors.place)[1] if len(errors.time_s) else np.array([])
    flown_s = end_s - launched_s
    report = FlightReport(
        plan_sha256=plan.plan_sha256,
        autopilot=part.profile.name,
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
        longest_gap_s=max(gaps, default=0.0),
        lateness_p50_ms=lateness["p50_ms"],
        lateness_p99_ms=lateness["p99_ms"],
        lateness_worst_ms=lateness["worst_ms"],
        lateness_from="log" if counted is None else "streamer",
        skipped_ticks=None if counted is None else int(counted["skipped_ticks"]),
        links=links,
        handovers=_handovers(sent, errors, plan, launched_s, damage),
        reached=reached,
        end_off_m=_end_off_m(heard, plan, end_s),
        flight=numbers[0],
        flights=numbers[1],
        damage=damage,
        not_planned=(),
    )
    report = replace(report, not_planned=_not_planned(report, plan, history))
    times = (sent.time_s - launched_s, late_ms, margins.time_s - launched_s, margins.left_m)
    return report, FlightTraces(errors, *times, part.probes.trips(), launched_s)


def _end_off_m(heard: Heard, plan: Plan, end_s: float) -> float | None:
    """How near the vehicle came to its destination when its stream ended; None where nothing was heard then."""
    late = _between(heard.time_s, end_s - 2.0, end_s + 20.0)
    if not late.any():
        return None
    places = to_plane(plan, heard.lat_deg[late], heard.lon_deg[late], heard.alt_amsl_m[late])
    return float(np.linalg.norm(places - plan.trajectory.evaluate(plan.mission_time_s), axis=-1).min())


def _not_planned(report: FlightReport, plan: Plan, history: History | None) -> tuple[str, ...]:
    """What a flight as planned does not have."""
    told = [] if history is None else list(history.not_planned)
    if not report.reached:
        told.append("not flown to its end")
    elif report.end_off_m is not None and report.end_off_m > FAR_OFF_M:
        told.append(f"the vehicle came no nearer to the destination than {report.end_off_m:.1f} m")
    if report.off_path_worst_m is None:
        told.append("where the vehicle was is not in the log")
    elif report.off_path_worst_m > FAR_OFF_M:
        told.append(f"up to {report.off_path_worst_m:.1f} m off its path")
    if report.reached and report.shift_s > LATE_S:
        told.append(f"{report.shift_s:.1f} s late")
    if report.margin_least_m is not None and report.margin_least_m < 0.0:
        told.append(f"up to {-report.margin_least_m:.0f} m out of range of the station in control")
    done = [h.index for h in report.handovers]
    if report.reached and done != [h.index for h in plan.handovers]:
        told.append(f"{len(done)} handovers flown, {len(plan.handovers)} planned, not one for one")
    return tuple(told)


def _handovers(
    sent: Sent, errors: TrackingErrors, plan: Plan, launched_s: float, damage: LogDamage
) -> tuple[HandoverReport, ...]:
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
                gap_s=None if damage.hides(float(sent.time_s[k]), time_s) else time_s - float(sent.time_s[k]),
                error_before_m=_worst(errors.error_m[_between(errors.time_s, time_s - AROUND_HANDOVER_S, time_s)]),
                error_around_m=_worst(errors.error_m[_between(errors.time_s, time_s, time_s + AROUND_HANDOVER_S)]),
            )
        )
    return tuple(result)


def _between(times: Array, low: float, high: float) -> Flags:
    return (times >= low) & (times <= high)


def _lateness(late_ms: Array) -> dict[str, float]:
    return {
        "p50_ms": float(np.quantile(late_ms, 0.5)),
        "p99_ms": float(np.quantile(late_ms, 0.99)),
        "worst_ms": float(late_ms.max()),
    }


def _rms(values: Array) -> float | None:
    return float(np.sqrt(np.mean(values**2))) if len(values) else None


def _worst(values: Array) -> float | None:
    return float(values.max()) if len(values) else None
