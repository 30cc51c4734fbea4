"""The figures of a flight's report. Needs matplotlib (the optional extra ``report``); drawn without a display."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from gcs.plan import Plan
from link.files.flight_report import FlightReport, FlightTraces
from planner.arrays import Array

_WIDE_IN, _MOST_POINTS = 7.2, 2500
_FLOWN, _PLANNED, _BAD, _QUIET = "#1f5fa8", "#9a9a9a", "#c0392b", "#666666"


def figures(plan: Plan, report: FlightReport, traces: FlightTraces) -> list[tuple[str, str, Any]]:
    """(name, what it shows, figure) each."""
    draws: list[tuple[str, str, float, Callable[[Any, Plan, FlightReport, FlightTraces], None]]] = [
        ("map", "The flight over the ground: planned path, trail, stations, handovers", 5.0, _map),
        ("height", "Height over time, planned and flown", 2.3, _height),
        ("tracking", "Distance from where the plan had the vehicle", 2.3, _tracking),
        ("range", "Range left to the station in control", 2.3, _range),
        ("lateness", "Lateness of each setpoint from its even grid", 2.3, _lateness),
        ("links", "Round trips of the stations' probes; those never answered at the top", 2.5, _links),
    ]
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    result = []
    for name, title, high_in, draw in draws:
        figure = Figure(figsize=(_WIDE_IN, high_in), layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots()
        axes.grid(color="#e4e4e4", linewidth=0.6)
        axes.spines[["top", "right"]].set_visible(False)
        draw(axes, plan, report, traces)
        if name != "map":
            _along(axes, report, traces)
        result.append((name, title, figure))
    return result


def _along(axes: Any, report: FlightReport, traces: FlightTraces) -> None:
    """What all figures over time share: handovers, holes of the log, one span."""
    for handover in report.handovers:
        axes.axvline(handover.flown_s, color=_QUIET, linewidth=0.8, linestyle=":")
    for low_s, high_s in report.damage.holes:
        low_s, high_s = low_s - traces.launched_s, high_s - traces.launched_s
        if high_s > 0.0 and low_s < report.flown_s:
            axes.axvspan(low_s, max(high_s, low_s + 0.002 * report.flown_s), color=_BAD, alpha=0.2, linewidth=0)
    axes.set_xlim(0.0, max(1.0, report.flown_s))
    axes.set_xlabel("T+, s")


def _thin(*arrays: Array) -> tuple[Array, ...]:
    step = max(1, len(arrays[0]) // _MOST_POINTS)
    return tuple(one[::step] for one in arrays)


def _peaks(time_s: Array, value: Array) -> tuple[Array, Array]:
    """Thinned so that the highest of each stretch stays."""
    step = max(1, len(value) // _MOST_POINTS)
    whole = len(value) // step * step
    if step == 1 or not whole:
        return time_s, value
    blocks = value[:whole].reshape(-1, step)
    at = np.arange(len(blocks)) * step + blocks.argmax(axis=1)
    return time_s[at], value[at]


def _map(axes: Any, plan: Plan, report: FlightReport, traces: FlightTraces) -> None:
    from matplotlib.patches import Circle

    planned = plan.trajectory.evaluate(np.linspace(0.0, plan.mission_time_s, 1000))
    flown = traces.errors.place
    for index in dict.fromkeys(plan.trajectory.sequence):
        station = plan.mission.stations[index]
        east, north, _ = plan.geometry.stations_enu_m[index]
        axes.add_patch(Circle((float(east), float(north)), station.range_m, fill=False, color="#cfd8e3", linewidth=0.8))
        axes.plot(float(east), float(north), marker="^", color=_QUIET, markersize=6)
        axes.annotate(station.id, (float(east), float(north)), xytext=(5, 4), textcoords="offset points", fontsize=8)
    axes.plot(planned[:, 0], planned[:, 1], color=_PLANNED, linewidth=3.0, label="planned", solid_capstyle="round")
    if len(flown):
        east, north = _thin(flown[:, 0], flown[:, 1])
        axes.plot(east, north, color=_FLOWN, linewidth=1.2, label="flown")
        for handover in report.handovers:
            at = int(np.abs(traces.errors.time_s - traces.launched_s - handover.flown_s).argmin())
            axes.plot(*flown[at, :2], marker="o", color=_BAD, markersize=5)
    axes.plot(*planned[0, :2], marker="s", color="black", markersize=5, linestyle="", label="start")
    axes.plot(*planned[-1, :2], marker="*", color="black", markersize=9, linestyle="", label="destination")
    both = np.vstack([planned[:, :2], flown[:, :2]]) if len(flown) else planned[:, :2]
    low, high = both.min(axis=0), both.max(axis=0)
    margin = 0.15 * float((high - low).max()) + 20.0
    axes.set_xlim(low[0] - margin, high[0] + margin)
    axes.set_ylim(low[1] - margin, high[1] + margin)
    axes.set_aspect("equal")
    # As high as the flight is wide: no empty paper above and below a long one.
    tall = float(np.ptp(axes.get_ylim()) / np.ptp(axes.get_xlim()))
    axes.figure.set_figheight(min(max(0.85 * _WIDE_IN * tall + 0.6, 2.2), 7.5))
    axes.set_xlabel("east, m")
    axes.set_ylabel("north, m")
    axes.legend(loc="best", fontsize=8, frameon=False)


def _height(axes: Any, plan: Plan, report: FlightReport, traces: FlightTraces) -> None:
    times = np.linspace(0.0, plan.mission_time_s, 1000)
    up = plan.plane.alt_amsl_m
    axes.plot(times, plan.trajectory.evaluate(times)[:, 2] + up, color=_PLANNED, linewidth=3.0, label="planned")
    if len(traces.errors.time_s):
        time_s, height = _thin(traces.errors.time_s - traces.launched_s, traces.errors.place[:, 2] + up)
        axes.plot(time_s, height, color=_FLOWN, linewidth=1.2, label="flown")
    axes.set_ylabel("m AMSL")
    axes.legend(loc="best", fontsize=8, frameon=False)


def _tracking(axes: Any, plan: Plan, report: FlightReport, traces: FlightTraces) -> None:
    time_s = traces.errors.time_s - traces.launched_s
    for value, name, colour in (
        (traces.errors.error_m, "distance", _FLOWN),
        (traces.errors.beside_m, "of it beside the path", "#e08e0b"),
    ):
        axes.plot(*_peaks(time_s, value), linewidth=1.0, label=name, color=colour)
    axes.set_ylim(bottom=0.0)
    axes.set_ylabel("m")
    axes.legend(loc="best", fontsize=8, frameon=False)


def _range(axes: Any, plan: Plan, report: FlightReport, traces: FlightTraces) -> None:
    time_s, left = _peaks(traces.margin_s, -traces.margin_m)
    axes.plot(time_s, -left, color=_FLOWN, linewidth=1.2)
    axes.axhline(0.0, color=_BAD, linewidth=1.0)
    axes.set_ylabel("m")


def _lateness(axes: Any, plan: Plan, report: FlightReport, traces: FlightTraces) -> None:
    axes.plot(*_peaks(traces.setpoint_s, traces.late_ms), color=_FLOWN, linewidth=0.8)
    axes.set_ylim(0.0, max(1.0, 1.1 * float(traces.late_ms.max())))
    axes.set_ylabel("ms")


def _links(axes: Any, plan: Plan, report: FlightReport, traces: FlightTraces) -> None:
    top = max((float(np.nanmax(ms)) for _, ms in traces.trips.values() if np.isfinite(ms).any()), default=1.0)
    top = max(top, 1.0)
    for station, (sent_s, trip_ms) in traces.trips.items():
        time_s = sent_s - traces.launched_s
        (line,) = axes.plot(*_thin(time_s, trip_ms), marker=".", markersize=2.5, linewidth=0.6, label=station)
        lost = np.isnan(trip_ms)
        axes.plot(time_s[lost], np.full(int(lost.sum()), 1.1 * top), linestyle="", marker="x", color=line.get_color())
    axes.set_ylim(0.0, 1.2 * top)
    axes.set_ylabel("ms")
    axes.legend(loc="best", fontsize=8, frameon=False, ncols=4)
