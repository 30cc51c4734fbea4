"""What the ground side raises.

GcsError
├── MissionError        a mission document is malformed: every fault at once, each with its place (bad input)
├── PlanError           a plan document is malformed, altered, or not of this product (bad input)
├── ExportError         an export was asked for in a way that makes no sense (bad input)
├── Finding             why a mission cannot be flown, not explained yet: never leaves `gcs.planning`
├── MissionInfeasible   a sound mission that no flight can fulfil: why, where, by how much, the smallest fix
├── PlanningFailed      every planning method gave up, or a result failed its own check (a fault of ours)
├── PlanningCancelled   somebody asked for the planning to stop
└── StoreError
    ├── NotFoundError       no such row
    ├── QueueFullError      too many missions wait for a planner
    ├── ConflictError       the row is in a state that forbids this (a flight uses it, a key was used for another body)
    └── StoreUnavailable    the database is locked, full, damaged or unreachable
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

MAX_SHOWN_FAULTS = 20


class GcsError(Exception):
    """Base of everything the ground side raises on purpose."""


@dataclass(frozen=True)
class InputFault:
    """One thing wrong with a document.

    ``where`` is a path such as ``stations[3].range_m``; ``what`` says what is wrong, ``value`` what stands there (None
    where nothing does), ``allowed`` what may stand there, ``fix`` what to do.
    """

    where: str
    what: str
    value: object = None
    allowed: str = ""
    fix: str = ""

    def __str__(self) -> str:
        parts = [f"{self.where}: {self.what}"]
        details = [f"value {show(self.value)}"] if self.value is not None else []
        if self.allowed:
            details.append(f"allowed: {self.allowed}")
        if details:
            parts.append(f"({'; '.join(details)})")
        if self.fix:
            parts.append(f"- {self.fix}")
        return " ".join(parts)

    def to_document(self) -> dict[str, object]:
        """As JSON: the value is kept where it is a short plain one, else shown as text."""
        value = self.value
        plain = value is None or isinstance(value, bool | int | str) or (isinstance(value, float) and _finite(value))
        if not plain or len(show(value)) > 80:
            value = show(value)
        return {"where": self.where, "what": self.what, "value": value, "allowed": self.allowed, "fix": self.fix}


def _finite(value: float) -> bool:
    return math.isfinite(value)


def show(value: object, limit: int = 80) -> str:
    """A value as short text for a message: JSON where it can be, shortened, without line breaks."""
    try:
        text = json.dumps(value, ensure_ascii=True)
    except (TypeError, ValueError, RecursionError):
        text = type(value).__name__
    return text if len(text) <= limit else text[: limit - 3] + "..."


class MissionError(GcsError, ValueError):
    """A mission document is malformed; ``.problems`` lists every fault found."""

    def __init__(self, problems: Sequence[InputFault]) -> None:
        self.problems = tuple(problems)
        shown = [str(fault) for fault in self.problems[:MAX_SHOWN_FAULTS]]
        if len(self.problems) > MAX_SHOWN_FAULTS:
            shown.append(f"and {len(self.problems) - MAX_SHOWN_FAULTS} more")
        count = len(self.problems)
        head = "the mission has a fault:" if count == 1 else f"the mission has {count} faults:"
        super().__init__("\n  ".join([head, *shown]))

    def to_document(self) -> list[dict[str, object]]:
        """The faults as JSON."""
        return [fault.to_document() for fault in self.problems]


class PlanError(GcsError, ValueError):
    """A plan document cannot be used: ``where`` is the path of the field, or empty for the whole."""

    def __init__(self, message: str, where: str = "") -> None:
        super().__init__(f"{where}: {message}" if where else message)
        self.where = where


class ExportError(GcsError, ValueError):
    """An export was asked for in a way that makes no sense: unknown format or station, bad launch time."""


class Finding(GcsError):  # noqa: N818 - reads as what was found
    """A mission cannot be flown, and this is what showed it; nobody has looked yet for what would help.

    `gcs.planning` explains it to its callers, as `MissionInfeasible`.
    """


class MissionInfeasible(GcsError):  # noqa: N818 - the name is part of the interface
    """No flight can fulfil this mission.

    ``reason`` is a word for programs (those of `planner.errors.Infeasibility`, and ``"endurance"``, ``"arrival"``);
    ``stations`` are ids; ``where`` holds ``lat_deg``, ``lon_deg``, ``alt_amsl_m`` (and ``east_m``, ``north_m``,
    ``up_m``) of the place, or is None; ``gap_m`` is the missing range; ``fix`` is the smallest single remedy as data,
    ``fix_text`` in words. ``causes``: where more than one thing stands in the way, all of them in flight order, each an
    object of the same names with what mends it alone.
    """

    def __init__(
        self,
        reason: str,
        message: str,
        *,
        stations: Sequence[str] = (),
        where: Mapping[str, float] | None = None,
        gap_m: float | None = None,
        fix: Mapping[str, object] | None = None,
        fix_text: str = "",
        causes: Sequence[Mapping[str, object]] = (),
    ) -> None:
        super().__init__(f"{message} {fix_text}".strip())
        self.reason = reason
        self.message = message
        self.stations = tuple(stations)
        self.where = dict(where) if where is not None else None
        self.gap_m = gap_m
        self.fix = dict(fix) if fix is not None else None
        self.fix_text = fix_text
        self.causes = tuple(dict(cause) for cause in causes)

    def to_document(self) -> dict[str, object]:
        """As JSON, for a 409 and for the store."""
        return {
            "reason": self.reason,
            "message": self.message,
            "stations": list(self.stations),
            "where": self.where,
            "gap_m": self.gap_m,
            "fix": self.fix,
            "fix_text": self.fix_text,
            "causes": [dict(cause) for cause in self.causes],
        }

    def __reduce__(self) -> tuple[object, ...]:
        # Exceptions with keyword arguments do not pickle by themselves, and this one crosses process borders.
        return _rebuild_infeasible, (self.to_document(),)


def _rebuild_infeasible(document: dict[str, object]) -> MissionInfeasible:
    return infeasible_from_document(document)


def infeasible_from_document(document: Mapping[str, object]) -> MissionInfeasible:
    """The error again from `MissionInfeasible.to_document`."""
    stations = document.get("stations")
    where, fix, gap = document.get("where"), document.get("fix"), document.get("gap_m")
    causes = document.get("causes")
    return MissionInfeasible(
        str(document["reason"]),
        str(document["message"]),
        stations=[str(s) for s in stations] if isinstance(stations, list) else (),
        where=where if isinstance(where, dict) else None,
        gap_m=float(gap) if isinstance(gap, int | float) else None,
        fix=fix if isinstance(fix, dict) else None,
        fix_text=str(document.get("fix_text", "")),
        causes=[cause for cause in causes if isinstance(cause, dict)] if isinstance(causes, list) else (),
    )


class PlanningFailed(GcsError):  # noqa: N818 - reads as what happened
    """Every method gave up, or a plan failed its own certificate: a fault of ours, not of the mission."""


class PlanningCancelled(GcsError):  # noqa: N818 - reads as what happened
    """The planning was stopped on request."""


class StoreError(GcsError):
    """Base of the store's errors."""


class NotFoundError(StoreError, LookupError):
    """No such row."""


class QueueFullError(StoreError):
    """Too many missions wait for a planner; try again later."""


class ConflictError(StoreError):
    """The present state of the row forbids what was asked."""


class StoreUnavailable(StoreError):  # noqa: N818 - reads as what happened
    """The database cannot be used just now: locked, full, damaged or unreachable."""
