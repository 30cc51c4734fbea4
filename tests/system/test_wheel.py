"""The wheel, installed in an empty environment away from the checkout, tells the whole story."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import zipfile
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.support.paths import ROOT


def run(*command: str | Path, cwd: Path, timeout_s: float = 600) -> subprocess.CompletedProcess[str]:
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "SKYRELAY", "VIRTUAL_ENV"))}
    result = subprocess.run(
        [str(part) for part in command],
        cwd=cwd,
        env=environment,
        capture_output=True,
        text=True,
        timeout=timeout_s,
        check=False,
    )
    assert result.returncode == 0, (
        f"{command}: exit {result.returncode}\n{result.stdout[-4000:]}\n{result.stderr[-4000:]}"
    )
    return result


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel of the checkout as git would hand it over: built from a copy, so that nothing is left behind."""
    source = tmp_path_factory.mktemp("source") / "skyrelay"
    ignore = shutil.ignore_patterns(
        ".git", ".venv", "*.egg-info", "build", "dist", "__pycache__", ".*_cache", ".hypothesis"
    )
    shutil.copytree(ROOT, source, ignore=ignore)
    out = tmp_path_factory.mktemp("dist")
    run(sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", out, source, cwd=source)
    (built,) = out.glob("*.whl")
    return built


def link_dependencies(target: Path) -> None:
    """Link every distribution that skyrelay's own metadata asks for, and what those ask for, into ``target``."""
    wanted, seen = ["skyrelay"], set()
    while wanted:
        name = canonicalize_name(wanted.pop())
        if name in seen:
            continue
        seen.add(name)
        distribution = metadata.distribution(name)
        for line in distribution.requires or []:
            requirement = Requirement(line)
            if requirement.marker is None or requirement.marker.evaluate({"extra": ""}):
                wanted.append(requirement.name)
        if name == "skyrelay":
            continue
        tops = {file.parts[0] for file in distribution.files or [] if file.parts[0] not in ("..", "__pycache__")}
        for top in tops:
            link = target / top
            if not link.exists():
                link.symlink_to(Path(str(distribution.locate_file(top))))


@pytest.mark.slow
def test_wheel_holds_code_and_data_but_no_tests(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    for wanted in (
        "planner/py.typed",
        "link/dialect/skyrelay.xml",
        "link/dialect/skyrelay.py",
        "sitl_fixtures/missions/wadden_relay.json",
        "sitl_fixtures/missions/paper_like/M30_01.json",
        "gcs/store/migrations/env.py",
    ):
        assert wanted in names
    assert not [name for name in names if name.startswith(("tests/", "docs/"))]


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_demo_from_an_installed_wheel(wheel: Path, tmp_path: Path) -> None:
    """An empty environment with the wheel and what it declares, nothing else: `skyrelay demo` plans and flies.

    The declared dependencies are linked in from the running environment, so that the test needs no network; a
    dependency used but not declared is missing there, and so is the checkout.
    """
    run(sys.executable, "-m", "venv", tmp_path / "env", cwd=tmp_path)
    python = tmp_path / "env" / "bin" / "python"
    purelib = Path(
        run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", cwd=tmp_path).stdout.strip()
    )
    link_dependencies(purelib)
    run(python, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", wheel, cwd=tmp_path)
    where = run(python, "-c", "import planner, api; print(planner.__file__, api.__file__)", cwd=tmp_path).stdout
    assert str(ROOT) not in where
    result = run(tmp_path / "env" / "bin" / "skyrelay", "demo", "--quick", cwd=tmp_path, timeout_s=600)
    assert "arrived" in result.stdout.lower()
