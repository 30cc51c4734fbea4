"""The handover schedule for people and programs: a plain table, JSON and CSV; whole, or one station's part.

Times are T+ (seconds, or h:mm:ss for people) and, when a launch time is given, UTC. Numbers in JSON and CSV are
unrounded.
"""

from __future__ import annotations

import csv
import io
import json
import os
import re
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from gcs.errors import ExportError
from gcs.mission.staffing import staffed
from gcs.plan.handover_schedule import Handover
from gcs.plan.model import Plan
from gcs.timestamps import utc_text

CSV_HEADER = (
    "index",
    "time_s",
    "time_utc",
    "from",
    "to",
    "lat_deg",
    "lon_deg",
    "alt_amsl_m",
    "speed_m_s",
    "course_deg",
    "overlap_start_s",
    "overlap_end_s",
    "margin_from_m",
    "margin_to_m",
)
FORMATS = ("table", "json", "csv")


@dataclass(frozen=True)
class Watch:
    """One station's time in control: from ``start_s`` to ``end_s`` (T+)."""

    station: str
    start_s: float
    end_s: float


def watches(plan: Plan, station: str | None = None) -> list[Watch]:
    """Who is in control when, in flight order; of one station when ``station`` is given."""
    times = [0.0, *(h.time_s for h in plan.handovers), plan.mission_time_s]
    legs = [Watch(s, times[k], times[k + 1]) for k, s in enumerate(plan.station_ids)]
    return [leg for leg in legs if station in (None, leg.station)]


def handovers_of(plan: Plan, station: str | None = None) -> list[Handover]:
    """The handovers, or those a station gives or takes. Raises `ExportError` for a station the mission lacks."""
    if station is None:
        return list(plan.handovers)
    if station not in {s.id for s in plan.mission.stations}:
        flown = ", ".join(dict.fromkeys(plan.station_ids))
        raise ExportError(f"the mission has no station {station!r}; this plan uses {flown}")
    return [h for h in plan.handovers if station in (h.from_station, h.to_station)]


def export_handovers(plan: Plan, kind: str, *, station: str | None = None, launch: datetime | None = None) -> str:
    """The schedule as text in one of `FORMATS`. Raises `ExportError`."""
    makers = {"table": handover_table, "json": handover_json, "csv": handover_csv}
    if kind not in makers:
        raise ExportError(f"there is no format {kind!r}; choose one of {', '.join(FORMATS)}")
    return makers[kind](plan, station=station, launch=launch)


_LEAP_SECOND = re.compile(r"(\d{4}-\d\d-\d\d[Tt ]\d\d:\d9):60(\.\d+)?(Z|z|[+-]\d\d:?\d\d)")


def parse_launch(text: str) -> datetime:
    """A launch time, RFC 3339 with ``Z`` or an offset, as UTC. Raises `ExportError`.

    A leap second is the second after it: clocks of computers have none.
    """
    leap = _LEAP_SECOND.fullmatch(text)
    try:
        moment = datetime.fromisoformat(f"{leap[1]}:59{leap[2] or ''}{leap[3]}" if leap else text)
        if leap:
            moment += timedelta(seconds=1)
    except (ValueError, OverflowError):
        moment = None
    if moment is None or moment.tzinfo is None:
        raise ExportError(f"launch time {text!r} is not RFC 3339 with a time zone, such as 2026-11-22T09:00:00Z")
    return moment.astimezone(UTC)


def utc_at(launch: datetime | None, time_s: float) -> str | None:
    """UTC of a T+ time, RFC 3339 to the millisecond; None without a launch. Raises `ExportError` past year 9999."""
    if launch is None:
        return None
    try:
        # Half a millisecond more, cut off: rounded.
        moment = launch.astimezone(UTC) + timedelta(seconds=time_s, microseconds=500)
    except OverflowError:
        raise ExportError(f"launch time {launch} is out of range") from None
    return utc_text(moment, "milliseconds")


def clock(time_s: float) -> str:
    """Seconds as h:mm:ss."""
    whole = round(time_s)
    return f"{whole // 3600}:{whole // 60 % 60:02d}:{whole % 60:02d}"


def handover_csv(plan: Plan, *, station: str | None = None, launch: datetime | None = None) -> str:
    """RFC 4180: a header, one line a handover, CRLF. ``time_utc`` is empty without a launch time."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\r\n")
    writer.writerow(CSV_HEADER)
    for h in handovers_of(plan, station):
        writer.writerow(
            [
                h.index,
                repr(h.time_s),
                utc_at(launch, h.time_s) or "",
                h.from_station,
                h.to_station,
                *(repr(value) for value in (h.lat_deg, h.lon_deg, h.alt_amsl_m, h.speed_m_s, h.course_deg)),
                *(repr(value) for value in (h.overlap_start_s, h.overlap_end_s, h.margin_from_m, h.margin_to_m)),
            ]
        )
    return text.getvalue()


def handover_json(plan: Plan, *, station: str | None = None, launch: datetime | None = None) -> str:
    """One object: whose plan, who is in control when, and the handovers as in the plan document with ``time_utc``."""
    people = {s.id: s for s in plan.mission.stations}
    document = {
        "mission": plan.mission.name,
        "plan_sha256": plan.plan_sha256,
        "mission_time_s": plan.mission_time_s,
        "launch_utc": utc_at(launch, 0.0),
        "station": station,
        "handovers": [{**h.to_document(), "time_utc": utc_at(launch, h.time_s)} for h in handovers_of(plan, station)],
        "in_control": [
            {
                "station": w.station,
                "system_id": people[w.station].system_id,
                "start_s": w.start_s,
                "end_s": w.end_s,
                "start_utc": utc_at(launch, w.start_s),
                "end_utc": utc_at(launch, w.end_s),
                "hours": people[w.station].hours,
                "staffed": _staffed(plan, w, launch),
            }
            for w in watches(plan, station)
        ],
    }
    return json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def _staffed(plan: Plan, watch: Watch, launch: datetime | None) -> bool | None:
    """Whether the station is staffed at both ends of its watch, as far as its hours tell."""
    if launch is None:
        return None
    hours = plan.mission.stations[plan.mission.station_index(watch.station)].hours
    ends = [staffed(hours, launch + timedelta(seconds=t)) for t in (watch.start_s, watch.end_s)]
    return None if None in ends else all(ends)


def handover_table(plan: Plan, *, station: str | None = None, launch: datetime | None = None) -> str:
    """A wide plain-text table, with who is in control when, contacts and channels below it."""
    head = [
        plan.mission.name + (f"  -  the part of {station}" if station else ""),
        f"plan {plan.plan_sha256[:16]}, mission time {clock(plan.mission_time_s)} ({plan.mission_time_s:.1f} s)",
    ]
    if launch is not None:
        head.append(f"launch (T+0) {utc_at(launch, 0.0)}")
    part = handovers_of(plan, station)
    rows = [_row(h, launch) for h in part]
    titles = ["#", "T+", "UTC", "from", "to", "latitude", "longitude", "alt AMSL", "speed", "course"]
    titles += ["both cover", "before/after", "range left from/to"]
    if launch is None:
        titles.pop(2)
        for row in rows:
            row.pop(2)
    lines = [*head, ""]
    watched = watches(plan, station)
    if rows:
        lines += _columns([titles, *rows])
    elif watched:
        lines.append("No handovers: one station is in control all the way.")
    else:
        lines.append(f"This plan does not use {station}.")
    lines.append("")
    watch_rows = [["in control", "from T+", "to T+", "MAVLink id", "contact", "channel", "hours"]]
    for watch in watched:
        s = plan.mission.stations[plan.mission.station_index(watch.station)]
        hours = s.hours or "-"
        if _staffed(plan, watch, launch) is False:
            hours += "  NOT STAFFED THEN"
        watch_rows.append(
            [
                s.id,
                clock(watch.start_s),
                clock(watch.end_s),
                str(s.system_id),
                s.contact or "-",
                s.radio_channel or "-",
                hours,
            ]
        )
    lines += _columns(watch_rows) if watched else []
    return "\n".join(lines) + "\n"


def _row(h: Handover, launch: datetime | None) -> list[str]:
    utc = utc_at(launch, round(h.time_s))
    return [
        str(h.index),
        clock(h.time_s),
        utc[11:19] if utc else "",
        h.from_station,
        h.to_station,
        f"{h.lat_deg:.6f}",
        f"{h.lon_deg:.6f}",
        f"{h.alt_amsl_m:.0f} m",
        f"{h.speed_m_s:.1f} m/s",
        f"{h.course_deg:05.1f}",
        f"{clock(h.overlap_start_s)} to {clock(h.overlap_end_s)}",
        f"{h.time_s - h.overlap_start_s:.0f}/{h.overlap_end_s - h.time_s:.0f} s",
        f"{h.margin_from_m:.0f}/{h.margin_to_m:.0f} m",
    ]


def _columns(rows: Sequence[Sequence[str]]) -> list[str]:
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]


def umask() -> int:
    """This process's mask of file modes, asked for without changing it: other threads are making files meanwhile."""
    try:
        status = Path("/proc/self/status").read_text(encoding="ascii", errors="replace")
        return int(status.split("\nUmask:")[1].split()[0], 8)
    except (OSError, IndexError, ValueError):
        return 0o077  # cannot be asked for any other way: files for this user alone


def write_atomic(path: str | Path, data: str | bytes) -> None:
    """Write a file whole or not at all: a temporary file beside it, synced, then renamed over it.

    Raises ``OSError`` as the file system gives it; what stood there before then still stands.
    """
    target = Path(path)
    raw = data.encode("utf-8") if isinstance(data, str) else data
    handle, name = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.", suffix=".tmp")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(raw)
            file.flush()
            os.fsync(file.fileno())
        # mkstemp makes files nobody else may read; a plan is no secret.
        os.chmod(name, 0o666 & ~umask())
        os.replace(name, target)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
    folder = os.open(target.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)
