"""The house keeps its shape: import direction, packaging, and no address or path that ties it to a machine."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.paths import ROOT

# Each package and those of ours it may import: api -> link -> gcs -> planner, the simulator on its own.
ALLOWED = {
    "planner": {"planner"},
    "gcs": {"gcs", "planner"},
    "link": {"link", "gcs", "planner"},
    "api": {"api", "link", "gcs", "planner"},
    "sitl_fixtures": {"sitl_fixtures"},
}


def imported_packages(path: Path) -> set[str]:
    """Top-level names imported anywhere in a file, function bodies included."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            found.add((node.module or "").split(".")[0])
    return found


@pytest.mark.slow
@pytest.mark.parametrize("package", sorted(ALLOWED))
def test_import_direction(package: str) -> None:
    files = sorted((ROOT / package).rglob("*.py"))
    assert files
    for path in files:
        ours = imported_packages(path) & (set(ALLOWED) | {"tests"})
        assert ours <= ALLOWED[package], f"{path.relative_to(ROOT)} imports {sorted(ours - ALLOWED[package])}"


@pytest.mark.slow
def test_planner_and_simulator_have_no_ui_or_store() -> None:
    """The planner does no I/O and knows no clock; the simulator brings no web server."""
    banned = {
        "planner": {"pymavlink", "fastapi", "sqlalchemy", "socket", "datetime", "pydantic", "json", "pathlib"},
        "gcs": {"pymavlink", "fastapi", "uvicorn", "starlette"},
        "link": {"fastapi", "sqlalchemy", "uvicorn", "starlette"},
        "sitl_fixtures": {"fastapi", "sqlalchemy", "uvicorn", "starlette"},
    }
    for package, names in banned.items():
        for path in (ROOT / package).rglob("*.py"):
            assert not imported_packages(path) & names, path


@pytest.mark.parametrize("package", sorted(ALLOWED))
def test_public_names_exist(package: str) -> None:
    """``__all__`` is the public surface: everything it lists is there, sorted."""
    code = (
        f"import {package} as p; names = getattr(p, '__all__', []); "
        "assert list(names) == sorted(names), names; [getattr(p, n) for n in names]"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)


def tracked_files() -> list[Path]:
    listing = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=False)
    if listing.returncode:
        pytest.skip("not a git checkout")
    return [ROOT / name for name in listing.stdout.split("\0") if name]


def test_no_registry_address_and_no_machine_path() -> None:
    """Packages come by name; nothing in the repository names a registry's host or a path of one machine."""
    hosts = re.compile(r"pypi\.org|pythonhosted|registry\.npmjs|deb\.debian\.org|/work/")
    for path in tracked_files():
        if path.suffix in {".gz", ".png", ".pbf"} or path == Path(__file__) or not path.is_file():
            continue
        match = hosts.search(path.read_text(encoding="utf-8", errors="replace"))
        assert match is None, f"{path.relative_to(ROOT)}: {match}"


def test_packages_are_listed_explicitly() -> None:
    """Every folder with an ``__init__`` that should ship is in pyproject.toml."""
    import tomllib

    listed = set(tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"])
    found = {
        ".".join(init.parent.relative_to(ROOT).parts)
        for package in ALLOWED
        for init in (ROOT / package).rglob("__init__.py")
    }
    assert found == listed


def test_third_party_notices_cover_the_lock() -> None:
    from tests.support.third_party import PAGE, locked

    page = PAGE.read_text(encoding="utf-8")
    missing = [name for name, version in locked().items() if f"| {name} | {version} |" not in page]
    assert not missing, f"run `python tests/support/third_party.py`: {missing}"
