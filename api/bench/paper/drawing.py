"""Parts of figures: maps, curves and profiles, in one style. Needs matplotlib."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from planner import Problem, Trajectory
from planner.coverage import disc_radius_m

# Distinct for readers who see colours differently too: dark and light alternate, this planner is the strongest.
COLOURS = {
    "COBYLA": "#88ccee",
    "BOBYQA": "#cc6677",
    "NEWUOA-BOUND": "#ddcc77",
    "PRAXIS": "#117733",
    "NELDERMEAD": "#332288",
    "SBPLX": "#aa4499",
    "BGD": "#999999",
    "AM": "#ff7f0e",
    "ours": "#0055d4",
}
LABELS = {name: name for name in COLOURS} | {"ours": "this planner"}
# As in the paper's Figure 14.
CONVERGENCE = {"BGD": "#3b6fb6", "AM": "#d62728"}
Curve = tuple[Trajectory, Any, str | None]


def figure(width_in: float, height_in: float) -> Any:
    """An empty figure that lays itself out."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width_in, height_in), layout="constrained", facecolor="white")


def save(drawn: Any, path: Path) -> None:
    """Write a figure as a PNG of 256 colours, a third of the size of one in full colour. Raises ``OSError``."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image

    canvas = FigureCanvasAgg(drawn)
    # The layout of the first drawing knows no legend outside the axes yet.
    canvas.draw()
    canvas.draw()
    image = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy())
    # By the range of colours, not by area: thin lines and small marks keep theirs.
    image.quantize(256, method=Image.Quantize.MAXCOVERAGE, kmeans=2, dither=Image.Dither.NONE).save(path, optimize=True)


def ranges(axes: Any, problem: Problem, used: Sequence[int], *, only_used: bool = False) -> None:
    """Every station and its disc at the bottom of the band, those of ``used`` stronger."""
    from matplotlib.collections import EllipseCollection

    radii = disc_radius_m(problem, np.arange(problem.station_count), problem.limits.min_alt_m) / 1000.0
    at = problem.station_positions_m[:, :2] / 1000.0
    mine = np.zeros(len(at), dtype=bool)
    mine[list(used)] = True
    for chosen, colour, alpha in ((~mine, "0.5", 0.09), (mine, "tab:orange", 0.16)):
        if only_used and chosen is not mine and not mine[chosen].any():
            continue
        wide = 2.0 * radii[chosen]
        for face, edge, strength in ((colour, "none", alpha), ("none", colour, 0.45)):
            discs = EllipseCollection(
                wide,
                wide,
                np.zeros_like(wide),
                units="xy",
                offsets=at[chosen],
                transOffset=axes.transData,
                facecolors=face,
                edgecolors=edge,
                linewidths=0.6,
                alpha=strength,
            )
            axes.add_collection(discs)
        axes.plot(*at[chosen].T, ".", color=colour, markersize=3)
    shown = mine if only_used else np.ones_like(mine)
    low, high = (at[shown] - radii[shown, None]).min(axis=0), (at[shown] + radii[shown, None]).max(axis=0)
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_aspect("equal")


def sequence(axes: Any, problem: Problem, stations: Sequence[int]) -> None:
    """The stations of a sequence, joined."""
    at = problem.station_positions_m[list(stations), :2] / 1000.0
    axes.plot(*at.T, "^--", color="tab:orange", markersize=6, linewidth=1.0, label="Dijkstra's sequence")


def ends(axes: Any, problem: Problem) -> None:
    """Start and destination."""
    for point, mark, colour, label in (
        (problem.start_m, "s", "tab:green", "start"),
        (problem.destination_m, "*", "tab:red", "destination"),
    ):
        axes.plot(
            point[0] / 1000.0,
            point[1] / 1000.0,
            mark,
            color=colour,
            markersize=10 if mark == "s" else 14,
            markeredgecolor="white",
            linestyle="none",
            label=label,
            zorder=5,
        )


def path(axes: Any, trajectory: Trajectory, colour: Any, label: str | None, width: float = 2.0) -> None:
    """A trajectory seen from above."""
    points = trajectory.evaluate(_times(trajectory)) / 1000.0
    axes.plot(points[:, 0], points[:, 1], color=colour, linewidth=width, label=label, zorder=4)


def path_in_space(axes: Any, trajectory: Trajectory, colour: Any, label: str | None) -> None:
    """A trajectory in space: kilometres, and metres of altitude."""
    points = trajectory.evaluate(_times(trajectory)) / np.array([1000.0, 1000.0, 1.0])
    axes.plot(*points.T, color=colour, linewidth=1.4, label=label)


def space(axes: Any, problem: Problem) -> None:
    """Labels and the altitude band of a view in space."""
    from matplotlib.ticker import MaxNLocator

    axes.set_xlabel("east, km")
    axes.set_ylabel("north, km")
    axes.set_zlabel("altitude, m")
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_major_locator(MaxNLocator(5))
    axes.set_zlim(problem.limits.min_alt_m, problem.limits.max_alt_m)
    axes.set_box_aspect((1.0, 1.0, 0.55), zoom=0.95)
    axes.view_init(elev=32.0, azim=-60.0)


def kilometres(axes: Any, *, first: bool) -> None:
    """Axis labels of a map."""
    axes.set_xlabel("east, km")
    if first:
        axes.set_ylabel("north, km")


def profiles(figure: Any, problem: Problem, curves: Sequence[Curve], title: str, *, columns: int) -> None:
    """Altitude, speed and acceleration over time, one above the other; a dashed line where each flight ends."""
    limits = problem.limits
    axes = figure.subplots(3, 1, sharex=True)
    for trajectory, colour, label in curves:
        times = _times(trajectory)
        shown = (
            trajectory.evaluate(times)[:, 2],
            np.linalg.norm(trajectory.evaluate(times, 1), axis=-1),
            np.linalg.norm(trajectory.evaluate(times, 2), axis=-1),
        )
        for row, values in zip(axes, shown, strict=True):
            row.plot(times, values, color=colour, linewidth=1.2, label=label)
            row.axvline(trajectory.duration_s, color=colour, linestyle="--", linewidth=0.8)
    for row, name, bounds in zip(
        axes,
        ("altitude, m", "speed, m/s", "acceleration, m/s²"),
        ((limits.min_alt_m, limits.max_alt_m), (limits.max_speed_m_s,), (limits.max_accel_m_s2,)),
        strict=True,
    ):
        row.set_ylabel(name, fontsize=9)
        for bound in bounds:
            row.axhline(bound, color="0.3", linestyle=":", linewidth=0.9)
        row.grid(color="0.93")
    axes[0].set_xlim(left=0.0)
    axes[-1].set_xlabel("time, s")
    axes[0].set_title(title)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=columns, frameon=False, fontsize=9)


def plain_logarithmic(axis: Any) -> None:
    """Ticks of a logarithmic axis as plain numbers."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(base=10.0, subs=(1.0, 2.0, 5.0)))
    # As short as each number is: one form for all would round the small ones.
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def closed(axes: Any, angle: Any, radius: Any, colour: Any, label: str) -> None:
    """A closed line of a radar graph."""
    strong = label == LABELS["ours"]
    axes.plot(
        np.append(angle, angle[:1]),
        np.append(radius, radius[:1]),
        color=colour,
        linewidth=2.4 if strong else 1.4,
        marker="o",
        markersize=3,
        label=label,
    )


def _times(trajectory: Trajectory, count: int = 800) -> Any:
    """Times to draw at: evenly, and every joint."""
    return np.union1d(np.linspace(0.0, trajectory.duration_s, count), trajectory.knots_s)
