"""Changes of a problem that would give it a plan, in the plane the problem lives in.

A remedy is one change, or several carried out one after the other; `planner.infeasibility.remedied` carries it out.
Stations are indices of the problem, metres are those of its plane, altitudes share the reference of its third axis.
What a change asks of a mission on the earth is not the planner's business.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

End: TypeAlias = Literal["start", "destination"]
Point: TypeAlias = tuple[float, float, float]


@dataclass(frozen=True)
class RaiseRange:
    """The range of one station, raised by ``by_m``."""

    station: int
    by_m: float


@dataclass(frozen=True)
class RaiseAllRanges:
    """Every range, raised by ``by_m``: what a smaller margin would give."""

    by_m: float


@dataclass(frozen=True)
class SetAltitude:
    """An end brought to ``alt_m``, inside the altitude band; ``by_m`` is how far up, negative down."""

    of: End
    alt_m: float
    by_m: float


@dataclass(frozen=True)
class WidenBand:
    """The altitude band widened by ``by_m``: down to ``min_alt_m`` or up to ``max_alt_m``, whichever is given."""

    by_m: float
    min_alt_m: float | None = None
    max_alt_m: float | None = None


@dataclass(frozen=True)
class LowerElevation:
    """The lowest elevation of one station, lowered by ``by_deg`` to ``to_deg``; -90 takes its mask away."""

    station: int
    to_deg: float
    by_deg: float


@dataclass(frozen=True)
class LowerElevations:
    """Every lowest elevation, lowered by ``by_deg``, down to the horizon at most."""

    by_deg: float


@dataclass(frozen=True)
class Move:
    """An end moved by ``by_m`` to ``position_m``, the nearest place in range."""

    of: End
    position_m: Point
    by_m: float


@dataclass(frozen=True)
class AddStation:
    """One more station at ``position_m``, without a mask."""

    position_m: Point
    range_m: float


@dataclass(frozen=True)
class RaiseLimit:
    """A limit raised to ``to``: one of `planner.problem.Limits`, or ``"max_handovers"`` of the problem (a count)."""

    limit: str
    to: float


@dataclass(frozen=True)
class LowerStartSpeed:
    """A start that moves slower: below ``below_m_s``, or vertically at most ``vertical_to_m_s``."""

    below_m_s: float | None = None
    vertical_to_m_s: float | None = None


Change: TypeAlias = (
    RaiseRange
    | RaiseAllRanges
    | SetAltitude
    | WidenBand
    | LowerElevation
    | LowerElevations
    | Move
    | AddStation
    | RaiseLimit
    | LowerStartSpeed
)
Remedy: TypeAlias = tuple[Change, ...]
"""Changes to be made together, the one that matters most first; never empty."""
