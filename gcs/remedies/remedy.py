"""Remedies: changes made together, their order, and the contract's ``fix``.

What is offered to people is a list of remedies, the smallest first, each of which cures everything.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypeAlias

from gcs.remedies.changes import (
    AddStation,
    Change,
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


def document_of(remedies: Sequence[Remedy], times_s: Mapping[Remedy, float] | None = None) -> dict[str, object] | None:
    """Remedies as the contract's ``fix``: the first one, what it needs beside it under ``also``, and the others under
    ``alternatives``; ``mission_time_s`` is how long the flight then takes, of those in ``times_s``. None without any.
    """
    if not remedies:
        return None
    first, *others = (_document(remedy, (times_s or {}).get(remedy)) for remedy in remedies)
    return {**first, "alternatives": others} if others else first


def _document(remedy: Remedy, time_s: float | None) -> dict[str, object]:
    first, *also = (to_document(change) for change in remedy)
    return {
        **first,
        **({"also": also} if also else {}),
        **({} if time_s is None else {"mission_time_s": time_s}),
    }


def cost_order(remedy: Remedy) -> tuple[int, float]:
    """What remedies are sorted by: what is asked of the mission, then metres in all, then what asks for many or a new
    one.

    An option or an angle first; one place's metres next, where a mistyped altitude is doubted before the airspace is
    widened; every station's range, and at last a station more.
    """
    metres = sum(abs(change.by_m) for change in remedy if isinstance(change, _IN_METRES))
    if any(isinstance(change, AddStation) for change in remedy):
        return 5, float(len(remedy))
    if any(isinstance(change, RaiseAllRanges) for change in remedy):
        return 4, metres
    if any(isinstance(change, WidenBand) for change in remedy):
        return 2, metres
    return (1, metres) if any(isinstance(change, _IN_METRES) for change in remedy) else (0, 0.0)
