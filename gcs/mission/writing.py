"""A mission as JSON, with every default filled in."""

from __future__ import annotations

from dataclasses import fields

from gcs.mission.model import Mission, MissionLimits, MissionOptions, Position, Station


def write_mission(mission: Mission) -> dict[str, object]:
    """The document of a mission, every default filled in; what is None and has no default is left out."""
    document: dict[str, object] = {"name": mission.name}
    if mission.origin is not None:
        document["origin"] = position_document(mission.origin)
    document["start"] = position_document(mission.start)
    document["destination"] = position_document(mission.destination)
    document["stations"] = [_station_document(station) for station in mission.stations]
    limits = {f.name: getattr(mission.limits, f.name) for f in fields(MissionLimits) if f.name != "wind_m_s"}
    document["limits"] = {name: value for name, value in limits.items() if value is not None}
    if mission.limits.wind_m_s is not None:
        east, north = mission.limits.wind_m_s
        document["limits"] |= {"wind": {"east_m_s": east, "north_m_s": north}}  # type: ignore[operator]
    document["safe_points"] = [
        {"id": point.id, "name": point.name, **position_document(point.position)} for point in mission.safe_points
    ]
    options = {f.name: getattr(mission.options, f.name) for f in fields(MissionOptions)}
    options["excluded_stations"] = list(mission.options.excluded_stations)
    state = mission.options.start_state
    if state is not None:
        options["start_state"] = {
            "velocity_m_s": list(state.velocity_m_s),
            "acceleration_m_s2": list(state.acceleration_m_s2),
        }
    document["options"] = options
    return document


def position_document(position: Position) -> dict[str, float]:
    """A position as JSON, by the names of its frame."""
    return {f.name: getattr(position, f.name) for f in fields(position)}


def _station_document(station: Station) -> dict[str, object]:
    document: dict[str, object] = {"id": station.id, "name": station.name, **position_document(station.position)}
    for name in ("range_m", "system_id", "contact", "radio_channel", "hours", "min_elevation_deg"):
        value = getattr(station, name)
        if value is not None:
            document[name] = value
    return document
