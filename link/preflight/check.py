"""Findings of a preflight: what was found, what is required, what to do; the worst level decides."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum


class Level(IntEnum):
    """How bad a finding is. From `FAILURE` on the flight does not start."""

    PASS = 0
    WARNING = 1
    FAILURE = 2
    ERROR = 3
    """It could not be judged: what must be known is not known."""


@dataclass(frozen=True)
class Check:
    """One finding. ``fix`` says what to do; ``set`` is the remedy where it is one parameter: its name, the value."""

    name: str
    level: Level
    message: str
    value: object = None
    required: str = ""
    set: tuple[str, int | float] | None = None
    fix: str = ""

    @property
    def blocks(self) -> bool:
        """Whether the flight must not start."""
        return self.level >= Level.FAILURE

    @property
    def remedy(self) -> str:
        """What to do, in words; empty where nothing is wrong."""
        if self.level is Level.PASS:
            return ""
        if self.fix:
            return self.fix
        return "" if self.set is None else f"set {self.set[0]} to {self.set[1]:g}"

    @property
    def said(self) -> str:
        """All of it in a line."""
        required = f" (required: {self.required})" if self.required else ""
        remedy = f"; {self.remedy}" if self.remedy else ""
        return f"{self.name}: {self.message}{required}{remedy}"

    def to_document(self) -> dict[str, object]:
        """As a JSON object."""
        return {
            "name": self.name,
            "level": self.level.name.lower(),
            "message": self.message,
            "value": self.value,
            "required": self.required,
            "set": None if self.set is None else {"name": self.set[0], "value": self.set[1]},
            "fix": self.remedy,
        }


def worst_first(checks: Iterable[Check]) -> list[Check]:
    """Errors, failures, warnings, passes; those of a level as they came."""
    return sorted(checks, key=lambda check: -check.level)


def worst(checks: Iterable[Check]) -> Level:
    """The level of the whole; `Level.PASS` of nothing."""
    return max((check.level for check in checks), default=Level.PASS)
