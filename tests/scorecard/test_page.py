"""``docs/link-scorecard.md`` names a test or a command behind every figure, and they exist."""

from __future__ import annotations

import re

from tests.support.paths import ROOT

PAGE = (ROOT / "docs" / "link-scorecard.md").read_text(encoding="utf-8")
ROWS = (*range(1, 15), 16, 17, 18, 19, 20, 24, *range(30, 38), 40)


def rows() -> dict[int, list[str]]:
    """The cells of each numbered row."""
    found = {}
    for line in PAGE.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if line.startswith("|") and cells[0].isdigit():
            found[int(cells[0])] = cells
    return found


def test_every_row_is_there_with_a_target_a_figure_and_what_shows_it() -> None:
    assert tuple(rows()) == ROWS
    for number, (_, figure, target, reached, shown) in rows().items():
        assert all((figure, target, reached, shown)), number
        assert re.search(r"`[^`]+`", shown), f"row {number} names neither a test nor a command"


def test_the_tests_it_names_exist() -> None:
    named = re.findall(r"`(tests/[\w/]+\.py)(?:::(\w+))?`", PAGE)
    assert len(named) > 30
    for path, name in named:
        text = (ROOT / path).read_text(encoding="utf-8")
        assert not name or f"def {name}(" in text, f"{path}::{name}"
