"""Changes of a mission that would give it a plan, in the mission document's own terms.

Data alone: `gcs.remedies.application` makes them, `gcs.remedies.wording` says them, and `to_document` writes them, one
step of the contract's ``fix`` each. Stations are ids, altitudes above mean sea level.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import ClassVar, TypeAlias

from gcs.mission.model import GeoPosition, LocalPosition, Position

Triple: TypeAlias = tuple[float, float, float]


@dataclass(frozen=True)
class Location:
    """A place in every frame its mission has: ``local`` is None in a WGS84 mission."""

    geo: GeoPosition
    local: LocalPosition | None = None

    @property
    def position(self) -> Position:
        """In the mission's own frame."""
        return self.geo if self.local is None else self.local

    def to_document(self) -> dict[str, float]:
        """As JSON: the names of both frames."""
        return {**vars(self.geo), **({} if self.local is None else vars(self.local))}


@dataclass(frozen=True)
class RaiseRange:
    """The range of one station (an id) raised by ``by_m`` to ``range_m``."""

    action: ClassVar[str] = "raise_range"
    station: str
    by_m: float
    range_m: float


@dataclass(frozen=True)
class RaiseAllRanges:
    """Every range raised."""

    action: ClassVar[str] = "raise_all_ranges"
    by_m: float


@dataclass(frozen=True)
class LowerMargin:
    """The range margin lowered by ``by_m`` to ``range_margin_m``."""

    action: ClassVar[str] = "lower_margin"
    by_m: float
    range_margin_m: float


@dataclass(frozen=True)
class LowerOption:
    """An option in seconds lowered by ``by_s`` to ``to``."""

    action: ClassVar[str] = "lower_option"
    option: str
    by_s: float
    to: float


@dataclass(frozen=True)
class LowerElevation:
    """The lowest elevation of one station lowered to ``to_deg``; None: it has none any more."""

    action: ClassVar[str] = "lower_elevation"
    station: str
    to_deg: float | None
    by_deg: float


@dataclass(frozen=True)
class LowerElevations:
    """Every lowest elevation lowered, and dropped where it is no higher than that."""

    action: ClassVar[str] = "lower_elevations"
    by_deg: float


@dataclass(frozen=True)
class WidenBand:
    """The altitude band widened by ``by_m``: its floor or its ceiling, whichever is given."""

    action: ClassVar[str] = "widen_band"
    min_alt_amsl_m: float | None = None
    max_alt_amsl_m: float | None = None
    by_m: float = 0.0


@dataclass(frozen=True)
class SetAltitude:
    """The start or the destination (``of``) brought to an altitude inside the band."""

    action: ClassVar[str] = "set_altitude"
    of: str
    alt_amsl_m: float
    by_m: float


@dataclass(frozen=True)
class Move:
    """The start or the destination moved to the nearest place in range."""

    action: ClassVar[str] = "move"
    of: str
    position: Location
    by_m: float


@dataclass(frozen=True)
class AddStation:
    """One more station."""

    action: ClassVar[str] = "add_station"
    position: Location
    range_m: float


@dataclass(frozen=True)
class IncludeStation:
    """A station that was excluded may be used again."""

    action: ClassVar[str] = "include_station"
    station: str


@dataclass(frozen=True)
class RaiseLimit:
    """A limit of the mission raised to ``to``, or the count of handovers allowed (``"max_handovers"``, a whole number).

    ``by`` is left out where it is not told.
    """

    action: ClassVar[str] = "raise_limit"
    limit: str
    by: float | None
    to: float


@dataclass(frozen=True)
class LowerLimit:
    """A limit of the mission lowered: a reserve."""

    action: ClassVar[str] = "lower_limit"
    limit: str
    by: float
    to: float


@dataclass(frozen=True)
class LowerWind:
    """Less wind from where it comes: the flight has to wait for it."""

    action: ClassVar[str] = "lower_wind"
    below_m_s: float
    east_m_s: float
    north_m_s: float


@dataclass(frozen=True)
class LowerStartSpeed:
    """A start that moves slower."""

    action: ClassVar[str] = "lower_start_speed"
    below_m_s: float
    velocity_m_s: Triple
    acceleration_m_s2: Triple


@dataclass(frozen=True)
class LaterArrival:
    """Arrival asked for later."""

    action: ClassVar[str] = "later_arrival"
    by_s: float
    arrival_s: float


@dataclass(frozen=True)
class EarlierArrival:
    """Arrival asked for earlier."""

    action: ClassVar[str] = "earlier_arrival"
    by_s: float
    arrival_s: float


Change: TypeAlias = (
    RaiseRange
    | RaiseAllRanges
    | LowerMargin
    | LowerOption
    | LowerElevation
    | LowerElevations
    | WidenBand
    | SetAltitude
    | Move
    | AddStation
    | IncludeStation
    | RaiseLimit
    | LowerLimit
    | LowerWind
    | LowerStartSpeed
    | LaterArrival
    | EarlierArrival
)


def to_document(change: Change) -> dict[str, object]:
    """A change as JSON, by the names of its fields; what is None is left out, but for an elevation dropped."""
    given = {field.name: getattr(change, field.name) for field in fields(change)}
    kept = {name: _plain(value) for name, value in given.items() if value is not None or name == "to_deg"}
    return {"action": change.action, **kept}


def _plain(value: object) -> object:
    """A field as JSON has it."""
    if isinstance(value, Location):
        return value.to_document()
    return list(value) if isinstance(value, tuple) else value
