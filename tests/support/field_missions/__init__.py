"""Missions as planners in the field would send them: real coasts and valleys, and the slips people make."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parent


def text_of(name: str) -> str:
    """The mission's file, byte for byte."""
    return (FOLDER / f"{name}.json").read_text(encoding="utf-8")


def field_mission(name: str) -> dict[str, Any]:
    """A mission's document."""
    document: dict[str, Any] = json.loads(text_of(name))
    return document
