"""Missions and plans.

Validated by `gcs` alone (one validator, with one form of complaint): these models exist for readers and for generators
of clients.
"""

from __future__ import annotations

from typing import Any, Literal

from pydantic import ConfigDict, Field

from api.rest.schemas.base import Closed, Open

MISSION_EXAMPLE: dict[str, Any] = {
    "name": "Den Helder to Texel",
    "start": {"lat_deg": 52.9234, "lon_deg": 4.7806, "alt_amsl_m": 100.0},
    "destination": {"lat_deg": 53.1153, "lon_deg": 4.8336, "alt_amsl_m": 100.0},
    "stations": [
        {
            "id": "den-helder",
            "name": "Den Helder airfield",
            "lat_deg": 52.9234,
            "lon_deg": 4.7806,
            "alt_amsl_m": 1.0,
            "range_m": 16000.0,
            "contact": "+31 000",
            "radio_channel": "C2-4",
        },
        {
            "id": "texel",
            "name": "Texel airfield",
            "lat_deg": 53.1153,
            "lon_deg": 4.8336,
            "alt_amsl_m": 1.0,
            "range_m": 18000.0,
        },
    ],
    "limits": {"min_alt_amsl_m": 90.0, "max_alt_amsl_m": 120.0, "max_speed_m_s": 30.0, "max_accel_m_s2": 2.5},
    "safe_points": [{"id": "texel-field", "lat_deg": 53.1153, "lon_deg": 4.8336, "alt_amsl_m": 30.0}],
    "options": {"min_overlap_s": 5.0, "range_margin_m": 25.0},
}
LOCAL_MISSION_EXAMPLE: dict[str, Any] = {
    "name": "Two stations on a map plane",
    "origin": {"lat_deg": 39.96, "lon_deg": 116.32, "alt_amsl_m": 0.0},
    "start": {"east_m": 0.0, "north_m": 0.0, "up_m": 110.0},
    "destination": {"east_m": 1800.0, "north_m": 0.0, "up_m": 110.0},
    "stations": [
        {"id": "west", "east_m": 0.0, "north_m": 0.0, "up_m": 0.0, "range_m": 1200.0},
        {"id": "east", "east_m": 1800.0, "north_m": 0.0, "up_m": 0.0, "range_m": 1200.0},
    ],
    "limits": {"min_alt_amsl_m": 100.0, "max_alt_amsl_m": 120.0, "max_speed_m_s": 50.0, "max_accel_m_s2": 5.0},
}


class Place(Closed):
    """A position: latitude, longitude and altitude above mean sea level; or, with an origin, metres in its plane."""

    lat_deg: float | None = Field(None, ge=-90, le=90)
    lon_deg: float | None = Field(None, ge=-180, le=180)
    alt_amsl_m: float | None = Field(None, description="Altitude above mean sea level, m.")
    east_m: float | None = Field(None, description="With an origin only.")
    north_m: float | None = Field(None, description="With an origin only.")
    up_m: float | None = Field(None, description="Altitude above the origin's, m. With an origin only.")


class StationBody(Place):
    """A ground station (remote pilot station): an antenna, the range of its C2 link, and the crew."""

    id: str = Field(description="Letters, digits, blanks and . _ - : + # ( ) ' &, beginning with a letter or digit.")
    range_m: float = Field(gt=0, description="Slant range of its C2 link to the vehicle, m.")
    name: str | None = None
    system_id: int | None = Field(None, ge=1, le=254, description="MAVLink id; given out when a plan uses the station.")
    contact: str | None = None
    radio_channel: str | None = None
    hours: str | None = Field(None, description="When it is staffed, for people.")
    min_elevation_deg: float | None = Field(None, description="Lowest elevation at which it hears the vehicle.")


class SafePointBody(Place):
    """A place that contingency procedures lead to."""

    id: str
    name: str | None = None


class LimitsBody(Closed):
    """What the vehicle can and may do; absent means unlimited."""

    min_alt_amsl_m: float
    max_alt_amsl_m: float
    max_speed_m_s: float = Field(gt=0)
    max_accel_m_s2: float = Field(gt=0)
    max_jerk_m_s3: float | None = None
    max_climb_m_s: float | None = None
    max_descent_m_s: float | None = None
    max_airspeed_m_s: float | None = Field(None, description="Bounds the speed against the wind.")
    wind: dict[str, float] | None = Field(None, description="{east_m_s, north_m_s}: where the air goes to.")
    endurance_s: float | None = None
    reserve_s: float | None = None


class OptionsBody(Open):
    """How to plan. The defaults make plans that a real vehicle can fly."""

    min_overlap_s: float = Field(5.0, description="Around every handover both stations cover the vehicle so long.")
    range_margin_m: float = Field(25.0, description="Taken off every range.")
    min_tenure_s: float = Field(10.0, description="Least time a station is in control, where there are several.")
    vehicle_system_id: int = Field(1, ge=1, le=255)
    on_arrival: Literal["land", "hold"] = "land"
    excluded_stations: list[str] = Field(default_factory=list)
    max_handovers: int | None = None
    objective: Literal["time", "energy"] | float = "time"
    arrival_s: float | None = None


class MissionBody(Closed):
    """A mission: start, destination, stations with ranges, limits."""

    model_config = ConfigDict(extra="forbid", json_schema_extra={"examples": [MISSION_EXAMPLE, LOCAL_MISSION_EXAMPLE]})

    start: Place
    destination: Place
    stations: list[StationBody]
    limits: LimitsBody
    name: str | None = None
    origin: Place | None = Field(None, description="Given: all positions are metres in the plane of this place.")
    safe_points: list[SafePointBody] | None = None
    options: OptionsBody | None = None


Status = Literal["queued", "planning", "planned", "infeasible", "failed"]


class Progress(Closed):
    """Where planning stands."""

    phase: str = Field(description="A word: queued, preparing, planning, scheduling, ...")
    fraction: float = Field(ge=0, le=1)


class MissionProblem(Open):
    """Why a version has no plan."""

    title: str
    detail: str
    reason: str | None = None
    place: dict[str, float] | None = None
    gap_m: float | None = None
    stations: list[str] | None = None
    fix: dict[str, Any] | None = None
    fix_text: str | None = None
    causes: list[dict[str, Any]] = Field(
        default_factory=list, description="Where several things stand in the way: all of them, in flight order."
    )


class MissionSummary(Closed):
    """One version of a mission, as lists show it."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={
            "examples": [
                {
                    "id": "0b6f3c1e8e0f4c0d9b1f2a3c4d5e6f70",
                    "name": "Den Helder to Texel",
                    "version": 1,
                    "latest_version": 1,
                    "status": "planned",
                    "progress": {"phase": "planned", "fraction": 1.0},
                    "plan_sha256": "9d16bbfe1563bb52c3dda9d9af87dbbe40beb98733fe982f8da0e0fefccdfe26",
                    "mission_time_s": 760.2,
                    "handover_count": 1,
                    "problem": None,
                    "created_utc": "2026-11-22T09:00:00.000000Z",
                    "changed_utc": "2026-11-22T09:00:00.412000Z",
                    "archived_utc": None,
                }
            ]
        },
    )

    id: str
    name: str
    version: int
    latest_version: int
    status: Status
    progress: Progress
    plan_sha256: str | None
    mission_time_s: float | None
    handover_count: int | None
    problem: MissionProblem | None
    created_utc: str
    changed_utc: str
    archived_utc: str | None


class Formats(Closed):
    """The forms in which a plan can be fetched."""

    handovers: list[str]
    setpoints: list[str]
    export: list[str]


class MissionDetail(MissionSummary):
    """One version of a mission with its document (every default filled in)."""

    mission: dict[str, Any]
    formats: Formats


class MissionPage(Closed):
    """Missions, newest first. ``next`` goes into ``cursor`` for the page after this one; null at the end."""

    items: list[MissionSummary]
    next: str | None


class VersionList(Closed):
    """Every version of a mission, oldest first."""

    items: list[MissionSummary]


class Segment(Open):
    """One Bézier piece of the curve; time inside it is linear in the curve parameter."""

    station: str
    start_s: float
    duration_s: float
    control_points: list[list[float]] = Field(description="degree + 1 points, [east, north, up] m.")


class PlanBody(Open):
    """A plan: self-contained, everything downstream needs this document alone."""

    plan_sha256: str = Field(description="SHA-256 of the RFC 8785 form without itself, solve_time_s and created_utc.")
    created_utc: str
    planner: dict[str, Any]
    mission: dict[str, Any] = Field(description="The mission, every default and system id filled in.")
    mission_time_s: float
    path_length_m: float
    lower_bound_s: float = Field(description="A time no trajectory of this mission can beat.")
    solve_time_s: float
    origin: dict[str, float]
    projection: dict[str, str]
    stations: list[str] = Field(description="In flight order.")
    segments: list[Segment]
    handovers: list[dict[str, Any]]
    contingencies: list[dict[str, Any]]
    certificate: dict[str, Any] = Field(description="feasible, and the worst signed excess of every limit.")
