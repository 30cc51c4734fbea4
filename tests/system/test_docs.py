"""The pages name what is there: every file, link, module and function of ours that README and docs mention."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import pytest

from tests.support.paths import ROOT

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
PACKAGES = ("planner", "gcs", "link", "api", "sitl_fixtures")
# A path in a code span, such as `link/files/` or `tests/system/test_docs.py::test_a`; `gcs/*.py` is a pattern.
FILE = re.compile(rf"`((?:{'|'.join(PACKAGES)}|tests|docs)/[\w./*-]*)(?:::[^`]*)?`")
LINK = re.compile(r"\]\((?!https?:)([^)#]+)[^)]*\)")
NAME = re.compile(rf"`((?:{'|'.join(PACKAGES)})(?:\.\w+)+)`")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_file_a_page_names_is_there(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    missing = [name for name in FILE.findall(text) if not any(ROOT.glob(name.rstrip("/")))]
    missing += [target for target in LINK.findall(text) if not (page.parent / target).exists()]
    assert not missing, f"{page.relative_to(ROOT)} names {missing}"


def there(name: str) -> bool:
    """Whether a dotted name is a module of ours, or something in one."""
    parts = name.split(".")
    for count in range(len(parts), 0, -1):
        try:
            found: object = importlib.import_module(".".join(parts[:count]))
        except ModuleNotFoundError:
            continue
        for attribute in parts[count:]:
            if not hasattr(found, attribute):
                return False
            found = getattr(found, attribute)
        return True
    return False


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_name_a_page_gives_is_there(page: Path) -> None:
    missing = [name for name in NAME.findall(page.read_text(encoding="utf-8")) if not there(name)]
    assert not missing, f"{page.relative_to(ROOT)} names {missing}"
