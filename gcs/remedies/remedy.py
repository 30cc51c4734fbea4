"""Remedies: changes made together, their order, and the contract's ``fix``.

What is offered to people is a list of remedies, the smallest first, each of which cures everything.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

from gcs.remedies.changes import (
    AddStation,
    Change,
    IncludeStation,
    LowerMargin,
    Move,
    RaiseAllRanges,
    RaiseRange,
    SetAltitude,
    WidenBand,
    to_document,
)

Remedy: TypeAlias = tuple[Change, ...]
"""The change that matters most first; never empty."""

_IN_METRES = (RaiseRange, RaiseAllRanges, LowerMargin, WidenBand, SetAltitude, Move)


def document_of(remedies: Sequence[Remedy]) -> dict[str, object] | None:
    """Remedies as the contract's ``fix``: the first one, what it needs beside it under ``also``, and the others under
    ``alternatives``. None without any.
    """
    if not remedies:
        return None
    first, *others = (_document(remedy) for remedy in remedies)
    return {**first, "alternatives": others} if others else first


def _document(remedy: Remedy) -> dict[str, object]:
    first, *also = (to_document(change) for change in remedy)
    return {**first, "also": also} if also else first


def cost_order(remedy: Remedy) -> tuple[int, float]:
    """What remedies are sorted by: what is asked of the mission, then metres in all, then what asks for many or a new
    one.

    An option or an angle first; one place's metres next; a station that was left out on purpose, every station's
    range, and at last a station more.
    """
    late: tuple[type[Change], ...] = (IncludeStation, RaiseAllRanges, AddStation)
    if type(remedy[0]) in late:
        return 2 + late.index(type(remedy[0])), 0.0
    metres = [change.by_m for change in remedy if isinstance(change, _IN_METRES)]
    return (1, sum(abs(by_m) for by_m in metres)) if len(metres) == len(remedy) else (0, 0.0)
