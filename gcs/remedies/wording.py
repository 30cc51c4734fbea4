"""Remedies in words: figures are rounded towards the safe side, so that what is read suffices."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from gcs.remedies.changes import (
    AddStation,
    Change,
    EarlierArrival,
    IncludeStation,
    LaterArrival,
    Location,
    LowerElevation,
    LowerElevations,
    LowerLimit,
    LowerMargin,
    LowerOption,
    LowerStartSpeed,
    LowerWind,
    Move,
    RaiseAllRanges,
    RaiseLimit,
    RaiseRange,
    SetAltitude,
    WidenBand,
)
from gcs.remedies.remedy import Remedy

# Parts a figure is rounded to: tenths, and hundredths where a tenth is much.
_TENTHS, _HUNDREDTHS = 10.0, 100.0


def words_of(remedies: Sequence[Remedy], times_s: Mapping[Remedy, float] | None = None) -> str:
    """Remedies as one sentence; empty without any. ``times_s``: how long the flight takes after some of them."""
    told = (
        " and ".join(words(change) for change in remedy) + _price((times_s or {}).get(remedy)) for remedy in remedies
    )
    text = "; or ".join(told)
    return f"{text[:1].upper()}{text[1:]}." if text else ""


def _price(time_s: float | None) -> str:
    if time_s is None:
        return ""
    minutes, seconds = divmod(round(time_s), 60)
    return f" (the flight then takes {minutes // 60}:{minutes % 60:02d}:{seconds:02d})"


def words(change: Change) -> str:
    """A change as an order, without a capital or a full stop."""
    match change:
        case RaiseRange(station, by_m, range_m):
            return f"raise the range of {station} by {_up(by_m)} m to {_up(range_m)} m"
        case RaiseAllRanges(by_m):
            return f"raise every range by {_up(by_m)} m"
        case LowerMargin(_, range_margin_m):
            return f"lower range_margin_m to {_down(range_margin_m)} m"
        case LowerOption(option, _, to):
            return f"lower {option} to {_down(to)} s"
        case LowerElevation(station, None):
            return f"drop the lowest elevation of {station}"
        case LowerElevation(station, to_deg):
            assert to_deg is not None
            return f"lower min_elevation_deg of {station} to {_down(to_deg, _HUNDREDTHS)} degrees"
        case LowerElevations(by_deg):
            return f"lower every min_elevation_deg by {_up(by_deg, _HUNDREDTHS)} degrees"
        case WidenBand(low_m, high_m):
            if low_m is not None:
                return f"lower min_alt_amsl_m to {_down(low_m)} m"
            assert high_m is not None
            return f"raise max_alt_amsl_m to {_up(high_m)} m"
        case SetAltitude(of, alt_amsl_m):
            return f"set the altitude of the {of} to {alt_amsl_m:.10g} m AMSL"
        case Move(of, location, by_m):
            return f"move the {of} by {_up(by_m)} m to {_place(location)}"
        case AddStation(location, range_m):
            return f"add a station with a range of {_up(range_m)} m at {_place(location)}"
        case IncludeStation(station):
            return f"do not exclude {station}"
        case RaiseLimit("max_handovers", _, to):
            return f"allow {int(to)} handover{'' if int(to) == 1 else 's'} (max_handovers)"
        case RaiseLimit(limit, _, to):
            return f"raise {limit} to {_up(to, _HUNDREDTHS)} {_unit(limit)}"
        case LowerLimit(limit, _, to):
            return f"lower {limit} to {_down(to, _HUNDREDTHS)} {_unit(limit)}"
        case LowerWind(below_m_s):
            return f"wait until the wind is below {_down(below_m_s)} m/s"
        case LowerStartSpeed(below_m_s):
            return f"start at {_down(below_m_s, _HUNDREDTHS)} m/s or less in the same direction"
        case LaterArrival(_, arrival_s):
            return f"ask for arrival_s of {_up(arrival_s)} s or later"
        case EarlierArrival(_, arrival_s):
            return f"ask for arrival_s of {_down(arrival_s)} s or earlier"


def _place(location: Location) -> str:
    """A place in the mission's own frame."""
    local, geo = location.local, location.geo
    if local is not None:
        return f"east {local.east_m:.1f} m, north {local.north_m:.1f} m, up {local.up_m:.1f} m"
    return f"{geo.lat_deg:.6f}, {geo.lon_deg:.6f}, {geo.alt_amsl_m:.1f} m AMSL"


def _unit(limit: str) -> str:
    """The unit a limit's name ends with."""
    for suffix, unit in (("_m_s3", "m/s^3"), ("_m_s2", "m/s^2"), ("_m_s", "m/s"), ("_s", "s")):
        if limit.endswith(suffix):
            return unit
    return ""


def _up(value: float, parts: float = _TENTHS) -> str:
    return _shown(math.ceil(value * parts - 1e-9) / parts, parts)


def _down(value: float, parts: float = _TENTHS) -> str:
    return _shown(math.floor(value * parts + 1e-9) / parts, parts)


def _shown(value: float, parts: float) -> str:
    return f"{value:.{round(math.log10(parts))}f}"
