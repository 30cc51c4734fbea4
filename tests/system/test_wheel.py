"""The wheel, installed in an empty environment away from the checkout, tells the whole story."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tarfile
import zipfile
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.support.paths import ROOT

DIALECT = Path("link/dialect/skyrelay.py")


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


def copy_source(target: Path) -> None:
    """The checkout as git would hand it over: nothing generated, so that a build must make what it needs."""
    listing = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=False)
    if listing.returncode:  # an unpacked archive: it holds only what git tracks, and what was made here since
        made_here = shutil.ignore_patterns(
            ".git",
            ".venv",
            "vendor",
            "node_modules",
            "*.egg-info",
            "build",
            "dist",
            "__pycache__",
            ".*_cache",
            ".hypothesis",
        )
        shutil.copytree(ROOT, target, ignore=made_here)
        (target / DIALECT).unlink(missing_ok=True)
        return
    for name in filter(None, listing.stdout.split("\0")):
        if (ROOT / name).is_file():
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, target / name)
    assert not (target / DIALECT).exists()


def build(source: Path, out: Path, *kinds: str) -> None:
    run(sys.executable, "-m", "build", *kinds, "--no-isolation", "--outdir", out, source, cwd=source)


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the checkout, so that building leaves nothing behind."""
    target = tmp_path_factory.mktemp("source") / "skyrelay"
    copy_source(target)
    return target


@pytest.fixture(scope="module")
def wheel(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, built straight from the checkout."""
    out = tmp_path_factory.mktemp("dist")
    build(source, out, "--wheel")
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
        str(DIALECT),
        "sitl_fixtures/missions/wadden_relay.json",
        "sitl_fixtures/missions/paper_like/M30_01.json",
        "gcs/store/migrations/env.py",
        "api/web/vendor/maplibre-gl/dist/maplibre-gl.mjs",
        "api/web/vendor/land-10m/cells.json",
    ):
        assert wanted in names
    assert not [name for name in names if name.startswith(("tests/", "docs/"))]


@pytest.mark.slow
def test_wheel_of_the_sdist_is_the_wheel_of_the_checkout(wheel: Path, source: Path, tmp_path: Path) -> None:
    """The sdist carries what the dialect is made from, not the dialect, and builds to the same files."""
    (source / DIALECT).write_text("raise SystemExit('stale')")  # left over in somebody's checkout
    try:
        build(source, tmp_path)  # an sdist, and the wheel out of that
    finally:
        (source / DIALECT).unlink()
    (sdist,) = tmp_path.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        carried = {name.split("/", 1)[1] for name in archive.getnames() if "/" in name}
    assert {"setup.py", "link/dialect/skyrelay.xml", "link/dialect/regenerate.py", "package-lock.json"} <= carried
    assert str(DIALECT) not in carried
    assert not [name for name in carried if name.startswith("api/web/vendor/")]
    (second,) = tmp_path.glob("*.whl")
    checksums = [{i.filename: i.CRC for i in zipfile.ZipFile(w).infolist()} for w in (wheel, second)]
    records = [{name: crc for name, crc in each.items() if ".dist-info/" not in name} for each in checksums]
    assert records[0] == records[1]


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
