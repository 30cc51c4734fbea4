"""Missions and plans.

Validated by `gcs` alone (one validator, with one form of complaint): these models exist for readers and for generators
of clients.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field

from api.rest.schemas.base import ENTRY_ID, NAME, Closed, Open, Whole

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


_Lat = Annotated[float, Field(ge=-90, le=90)]
_Lon = Annotated[float, Field(ge=-180, le=180)]
_Alt = Annotated[float, Field(ge=-1_000, le=50_000)]
_Span = Annotated[float, Field(ge=-1_000_000, le=1_000_000)]
_Name = Annotated[str, Field(min_length=1, max_length=200, pattern=NAME)]
_Speed = Annotated[float, Field(gt=0, le=1_000)]
_Id = Annotated[
    str,
    Field(
        pattern=ENTRY_ID,
        description="Letters, digits, blanks and . _ - : + # ( ) ' &, beginning with a letter or digit.",
    ),
]


class Place(Closed):
    """A position: latitude, longitude and altitude above mean sea level."""

    lat_deg: _Lat
    lon_deg: _Lon
    alt_amsl_m: _Alt = Field(description="Altitude above mean sea level, m.")


class LocalPlace(Closed):
    """A position in a mission with an origin: metres in its plane."""

    east_m: _Span
    north_m: _Span
    up_m: _Alt = Field(description="Altitude above the origin's, m.")


class _Crewed(Closed):
    """A ground station (remote pilot station): an antenna, the range of its C2 link, and the crew."""

    id: _Id
    range_m: float = Field(gt=0, le=500_000, description="Slant range of its C2 link to the vehicle, m.")
    name: _Name | None = None
    system_id: Whole | None = Field(
        None, ge=1, le=254, description="MAVLink id; given out when a plan uses the station."
    )
    contact: _Name | None = None
    radio_channel: _Name | None = None
    hours: _Name | None = Field(None, description="When it is staffed, for people.")
    min_elevation_deg: float | None = Field(
        None, ge=0, le=85, description="Lowest elevation at which it hears the vehicle."
    )


class StationBody(Place, _Crewed):
    """A ground station by latitude and longitude."""


class LocalStationBody(LocalPlace, _Crewed):
    """A ground station on the plane of the mission's origin."""


class _Named(Closed):
    """What a safe point is called."""

    id: _Id
    name: _Name | None = None


class SafePointBody(Place, _Named):
    """A place that contingency procedures lead to."""


class LocalSafePointBody(LocalPlace, _Named):
    """The same, on the plane of the mission's origin."""


class WindBody(Closed):
    """Where the air goes to."""

    east_m_s: float = Field(ge=-200, le=200)
    north_m_s: float = Field(ge=-200, le=200)


class LimitsBody(Closed):
    """What the vehicle can and may do; absent means unlimited."""

    min_alt_amsl_m: _Alt
    max_alt_amsl_m: _Alt
    max_speed_m_s: _Speed
    max_accel_m_s2: _Speed
    max_jerk_m_s3: float | None = Field(None, gt=0, le=100_000)
    max_climb_m_s: _Speed | None = None
    max_descent_m_s: _Speed | None = None
    max_airspeed_m_s: _Speed | None = Field(None, description="Bounds the speed against the wind.")
    wind: WindBody | None = Field(None, description="Needs max_airspeed_m_s.")
    endurance_s: float | None = Field(None, gt=0, le=1_000_000)
    reserve_s: float | None = Field(None, ge=0, le=1_000_000, description="Needs endurance_s, and is less.")


_Vector = Annotated[
    list[Annotated[float, Field(ge=-1_000, le=1_000)]],
    Field(min_length=3, max_length=3, description="[east, north, up]"),
]


class StartStateBody(Closed):
    """The start in motion."""

    velocity_m_s: _Vector | None = None
    acceleration_m_s2: _Vector | None = None


class OptionsBody(Closed):
    """How to plan. The defaults make plans that a real vehicle can fly; null stands for the default."""

    min_overlap_s: float | None = Field(
        5.0, ge=0, le=3_600, description="Around every handover both stations cover the vehicle so long."
    )
    range_margin_m: float | None = Field(25.0, ge=0, le=500_000, description="Taken off every range.")
    min_tenure_s: float | None = Field(
        10.0, ge=0, le=86_400, description="Least time a station is in control, where there are several."
    )
    handover_tolerance: float | None = Field(
        0.001,
        ge=0,
        le=1,
        description="Part of the mission time, and at least 1 s, given up for fewer handovers. "
        "0 asks for the fastest plan, and is the default where min_overlap_s is 0.",
    )
    overlap_target_s: Literal["auto"] | Annotated[float, Field(ge=0, le=3_600)] | None = Field(
        "auto",
        description="The overlap aimed at wherever it costs at most 0.1 % of the mission time, and at least 1 s, each; "
        "auto: enough after a handover to notice a failed station and to stop, nothing where handover_tolerance is 0.",
    )
    vehicle_system_id: Whole | None = Field(1, ge=1, le=254)
    on_arrival: Literal["land", "hold"] | None = "land"
    excluded_stations: list[str] | None = Field(None, max_length=100_000, description="Ids of stations of the mission.")
    max_handovers: Whole | None = Field(None, ge=0, le=100_000)
    objective: Literal["time", "energy"] | Annotated[float, Field(ge=0, le=1)] | None = Field(
        "time", description="A number is the weight of energy."
    )
    start_state: StartStateBody | None = None
    arrival_s: float | None = Field(None, gt=0, le=1_000_000)


class MissionBody(Closed):
    """A mission: start, destination, stations with ranges, limits."""

    model_config = ConfigDict(
        extra="forbid", strict=True, json_schema_extra={"examples": [MISSION_EXAMPLE, LOCAL_MISSION_EXAMPLE]}
    )

    start: Place | LocalPlace
    destination: Place | LocalPlace
    stations: list[StationBody | LocalStationBody] = Field(min_length=1)
    limits: LimitsBody
    name: _Name | None = None
    origin: Place | None = Field(None, description="Given: all positions are metres in the plane of this place.")
    safe_points: list[SafePointBody | LocalSafePointBody] | None = Field(None, max_length=1_000)
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
    fastest: dict[str, float] | None = Field(
        None,
        description="mission_time_s and handovers of the fastest plan found, where this one has fewer, and what "
        "fewer cost; absent otherwise.",
    )
