"""Figures like the paper's 9 to 14, from what `api.bench.paper.experiments` measured and kept.

Needs matplotlib (the optional extra ``bench``); drawn without a display. Parts of a figure are in
`api.bench.paper.drawing`.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Collection, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from api.bench.paper import drawing
from api.bench.paper.experiments import ALLOCATIONS, DELTA_T_S, curve_of, mission_times
from api.bench.planner import PAPER_OPTIONS, Case
from gcs.layout import lay_out
from gcs.mission import read_mission, with_options
from planner import Problem
from planner.paper import Iteration, plan_paper

# Radii in the radar graphs: per cent over the bound.
_RADAR_RINGS = (1, 10, 100, 1000)


def matplotlib_available() -> bool:
    """Whether matplotlib, which draws, is installed."""
    return importlib.util.find_spec("matplotlib") is not None


def draw_all(cases: Sequence[Case], rows: Sequence[dict[str, Any]], folder: Path) -> list[tuple[Path, str]]:
    """Draw every figure into ``folder``; (file, title) each. ``rows`` are `api.bench.paper.experiments.run`'s of
    ``cases``.

    Raises ``OSError`` when a file cannot be written.
    """
    problems = [lay_out(with_options(read_mission(case.document), PAPER_OPTIONS)).problem for case in cases]
    maps = list(zip(rows, problems, strict=True))
    figures: list[tuple[str, str, Callable[[], Any]]] = [
        ("09-scenarios", "the first mission of each size, with its ranges", partial(scenarios, maps)),
        ("10-enumeration", "every sequence that enumeration planned", partial(enumerated, rows)),
        ("11-iterations", "alternating minimisation step by step", partial(iterations, *maps[0])),
        ("12-radar", "eight methods for the lower level, and this planner", partial(radar, rows)),
        ("13-trajectories", "what the methods fly on the last mission", partial(trajectories, *maps[-1])),
        ("14-convergence", "alternating minimisation and gradient descent over time", partial(convergence, rows)),
    ]
    written = []
    for name, title, draw in figures:
        path = folder / f"{name}.png"
        drawing.save(draw(), path)
        written.append((path, title))
    return written


def scenarios(maps: Sequence[tuple[dict[str, Any], Problem]]) -> Any:
    """Figure 9: a map of each size: ranges, ends, Dijkstra's sequence and this planner's curve."""
    firsts = {row["stations"]: (row, problem) for row, problem in reversed(maps)}
    figure = drawing.figure(5.0 * len(firsts), 5.4 + 0.3 * (5 - _columns(firsts)))
    for place, count in enumerate(sorted(firsts), start=1):
        row, problem = firsts[count]
        axes = figure.add_subplot(1, len(firsts), place)
        drawing.ranges(axes, problem, row["plans"]["decoupling"]["sequence"])
        drawing.sequence(axes, problem, row["plans"]["decoupling"]["sequence"])
        drawing.path(axes, curve_of(row["plans"]["ours"]["curve"]), drawing.COLOURS["ours"], "this planner")
        drawing.ends(axes, problem)
        axes.set_title(f"{row['name']}: {count} stations")
        drawing.kilometres(axes, first=place == 1)
        if place == 1:
            handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=_columns(firsts), frameon=False)
    return figure


def enumerated(rows: Sequence[dict[str, Any]]) -> Any:
    """Figure 10: mission times of all sequences planned by EM, and processor times."""
    groups = list(_by_size(rows))
    figure = drawing.figure(5.2 * len(groups), 7.0)
    for place, (count, mine) in enumerate(groups):
        upper = figure.add_subplot(2, len(groups), place + 1)
        lower = figure.add_subplot(2, len(groups), len(groups) + place + 1)
        at = np.arange(1, len(mine) + 1)
        for x, row in zip(at, mine, strict=True):
            found = row["enumeration"]["found_s"] if row["enumeration"] else []
            upper.scatter([x] * len(found), found, s=14, facecolors="none", edgecolors="0.65", linewidths=0.7)
        kinds = (("EM", "o", "black", "enumeration, best"), ("DC", "^", "tab:orange", "decoupling"))
        for name, mark, colour, label in (*kinds, ("ours", "D", drawing.COLOURS["ours"], "this planner")):
            times = [mission_times(row).get(name, np.nan) for row in mine]
            upper.scatter(at, times, s=34, marker=mark, color=colour, label=label, zorder=3)
            cpu = [_cpu_s(row, name) for row in mine]
            lower.semilogy(at, cpu, marker=mark, color=colour, linewidth=0.8)
        upper.scatter(
            at, [row["plans"]["lower_bound_s"] for row in mine], s=150, marker="_", color="tab:red", label="lower bound"
        )
        upper.set_title(f"M = {count}")
        drawing.plain_logarithmic(lower.yaxis)
        for axes in (upper, lower):
            axes.set_xticks(at, [row["name"].rpartition("_")[2] for row in mine])
            axes.grid(axis="y", color="0.9")
            axes.set_axisbelow(True)
        lower.set_xlabel("mission")
        if place == 0:
            upper.set_ylabel("mission time, s")
            lower.set_ylabel("processor time, s")
            upper.scatter([], [], s=14, facecolors="none", edgecolors="0.65", label="enumeration, each sequence")
            handles, labels = upper.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=_columns(groups), frameon=False)
    return figure


def iterations(row: dict[str, Any], problem: Problem) -> Any:
    """Figure 11: the trajectories of some iterations of AM seen from above, and their profiles."""
    from matplotlib import colormaps

    record: list[Iteration] = []
    plan_paper(problem, delta_t_s=DELTA_T_S, record=record)
    shown = [entry for entry in record if entry.number in {0, 1, 2, 3, 5} or entry is record[-1]]
    colours = colormaps["viridis"](np.linspace(0.0, 0.9, len(shown)))
    figure = drawing.figure(12.0, 6.4)
    left, right = figure.subfigures(1, 2, width_ratios=(1.0, 1.15))
    axes = left.subplots()
    used = row["plans"]["decoupling"]["sequence"]
    drawing.ranges(axes, problem, used, only_used=True)
    for entry, colour in zip(shown, colours, strict=True):
        drawing.path(axes, entry.trajectory, colour, None, width=1.4)
    drawing.ends(axes, problem)
    axes.set_title(f"(a) {row['name']}, seen from above")
    drawing.kilometres(axes, first=True)
    curves = [
        (entry.trajectory, colour, f"iteration {entry.number}: {entry.mission_time_s:.1f} s")
        for entry, colour in zip(shown, colours, strict=True)
    ]
    drawing.profiles(right, problem, curves, "(b) profiles", columns=3)
    return figure


def radar(rows: Sequence[dict[str, Any]]) -> Any:
    """Figure 12: per cent over the bound of every method on every mission, on a logarithmic radius."""
    groups = list(_by_size(rows))
    figure = drawing.figure(5.0 * len(groups), 5.9)
    for place, (count, mine) in enumerate(groups, start=1):
        axes = figure.add_subplot(1, len(groups), place, projection="polar")
        angle = np.linspace(0.0, 2.0 * np.pi, len(mine), endpoint=False)
        for name in (*ALLOCATIONS, "ours"):
            over = [100.0 * (mission_times(row)[name] / row["plans"]["lower_bound_s"] - 1.0) for row in mine]
            # Logarithm of the gap, at least a tenth of a per cent, from the centre out.
            radius = np.log10(np.maximum(over, 0.1)) + 1.0
            drawing.closed(axes, angle, radius, drawing.COLOURS[name], drawing.LABELS[name])
        axes.set_theta_zero_location("N")
        axes.set_theta_direction(-1)
        axes.set_xticks(angle, [row["name"].rpartition("_")[2] for row in mine])
        axes.set_ylim(0.0, 4.0)
        axes.set_yticks([np.log10(ring) + 1.0 for ring in _RADAR_RINGS], [f"{ring} %" for ring in _RADAR_RINGS])
        axes.set_rlabel_position(180.0 / max(len(mine), 1))
        axes.tick_params(axis="y", labelsize=8, labelcolor="0.3")
        axes.grid(color="0.85")
        axes.set_title(f"M = {count}: over the lower bound", pad=18)
        if place == 1:
            handles, labels = axes.get_legend_handles_labels()
    columns = 9 if len(groups) > 1 else 3
    figure.legend(handles, labels, loc="outside lower center", ncols=columns, frameon=False, fontsize=10)
    return figure


def trajectories(row: dict[str, Any], problem: Problem) -> Any:
    """Figure 13: the sequence, the trajectories of all methods in space, and their profiles."""
    curves = [
        (curve_of(row["allocations"][name]["curve"]), drawing.COLOURS[name], drawing.LABELS[name])
        for name in ALLOCATIONS
    ]
    curves.append((curve_of(row["plans"]["ours"]["curve"]), drawing.COLOURS["ours"], drawing.LABELS["ours"]))
    figure = drawing.figure(13.0, 9.6)
    upper, lower = figure.subfigures(2, 1, height_ratios=(1.0, 1.0))
    left, right = upper.subfigures(1, 2, width_ratios=(1.0, 1.2))
    axes = left.subplots()
    used = row["plans"]["decoupling"]["sequence"]
    drawing.ranges(axes, problem, used)
    drawing.sequence(axes, problem, used)
    drawing.ends(axes, problem)
    axes.set_title(f"(a) {row['name']}: Dijkstra's sequence")
    drawing.kilometres(axes, first=True)
    space = right.add_subplot(projection="3d")
    for trajectory, colour, label in curves:
        drawing.path_in_space(space, trajectory, colour, label)
    drawing.space(space, problem)
    space.set_title("(b) trajectories; altitude stretched")
    drawing.profiles(lower, problem, curves, "(c) profiles; dashed: the end", columns=9)
    return figure


def convergence(rows: Sequence[dict[str, Any]], each: int = 3) -> Any:
    """Figure 14: best mission time over processor time for AM and BGD, on up to ``each`` missions of a size."""
    groups = list(_by_size(rows))
    figure = drawing.figure(4.3 * each, 3.0 * len(groups))
    handles: list[Any] = []
    labels: list[str] = []
    for line, (_, mine) in enumerate(groups):
        spread = np.linspace(0, len(mine) - 1, min(each, len(mine))).round().astype(int)
        for column, row in enumerate(mine[k] for k in spread):
            axes = figure.add_subplot(len(groups), each, line * each + column + 1)
            for name, mark in (("BGD", "s"), ("AM", "o")):
                elapsed, times = np.array(row["allocations"][name]["convergence"]).T
                axes.step(elapsed, times, where="post", color=drawing.CONVERGENCE[name], linewidth=0.8)
                axes.plot(
                    elapsed, times, mark, color=drawing.CONVERGENCE[name], markersize=4, label=drawing.LABELS[name]
                )
            ours, label = row["plans"]["ours"], drawing.LABELS["ours"]
            axes.plot([ours["cpu_s"]], [ours["mission_time_s"]], "D", color=drawing.COLOURS["ours"], label=label)
            axes.axhline(
                row["plans"]["lower_bound_s"], color="black", linestyle="--", linewidth=0.8, label="lower bound"
            )
            axes.set_yscale("log")
            drawing.plain_logarithmic(axes.yaxis)
            axes.set_title(row["name"], fontsize=11)
            axes.grid(color="0.92")
            if column == 0:
                axes.set_ylabel("mission time, s")
            if line == len(groups) - 1:
                axes.set_xlabel("processor time, s")
            if not handles:
                handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False)
    return figure


def _by_size(rows: Sequence[dict[str, Any]]) -> Iterator[tuple[int, list[dict[str, Any]]]]:
    for count in sorted({row["stations"] for row in rows}):
        yield count, [row for row in rows if row["stations"] == count]


def _columns(panels: Collection[Any]) -> int:
    """Columns of a legend of five, under so many panels."""
    return min(5, 2 * len(panels))


def _cpu_s(row: dict[str, Any], name: str) -> float:
    if name == "EM":
        return float(row["enumeration"]["cpu_s"]) if row["enumeration"] else np.nan
    return float(row["plans"]["ours" if name == "ours" else "decoupling"]["cpu_s"])
