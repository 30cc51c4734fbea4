"""Bodies of requests and answers, as the OpenAPI document describes them.

Missions and plans are validated by `gcs` alone (one validator, with one form of complaint); the models of this module
that describe them exist for readers and generators of clients. Small bodies are validated here.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

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
INFEASIBLE_EXAMPLE: dict[str, Any] = {
    "type": "urn:skyrelay:problem:infeasible",
    "title": "No flight can fulfil this mission",
    "status": 409,
    "detail": "There is a gap of 2113.4 m between terschelling and ballum.",
    "request_id": "5f0c6f7a3f1b4a0c9f5c0a3b8d6e2f11",
    "errors": [],
    "reason": "broken_chain",
    "place": {"lat_deg": 53.41, "lon_deg": 5.44, "alt_amsl_m": 90.0},
    "gap_m": 2113.4,
    "stations": ["terschelling", "ballum"],
    "fix": {"action": "raise_range", "station": "ballum", "by_m": 2113.5},
    "fix_text": "Raise the range of ballum by 2113.5 m.",
}
BAD_INPUT_EXAMPLE: dict[str, Any] = {
    "type": "urn:skyrelay:problem:bad-input",
    "title": "Bad input",
    "status": 422,
    "detail": "the mission has a fault",
    "request_id": "5f0c6f7a3f1b4a0c9f5c0a3b8d6e2f11",
    "errors": [
        {
            "where": "stations[0].range_m",
            "what": "must not be negative",
            "value": -5.0,
            "allowed": "more than 0 up to 500000 m",
        }
    ],
}


class Open(BaseModel):
    """A document that may grow further fields."""

    model_config = ConfigDict(extra="allow")


class Closed(BaseModel):
    """A body in which an unknown field is a mistake worth telling."""

    model_config = ConfigDict(extra="forbid", str_strip_whitespace=False)


class ProblemError(Open):
    """One thing wrong."""

    where: str = Field(description="Path of the field, such as stations[3].range_m.")
    what: str = Field(description="What is wrong.")
    value: Any = Field(None, description="What stands there.")
    allowed: str | None = Field(None, description="What may stand there.")
    fix: str | None = Field(None, description="What to do.")


class Problem(Open):
    """Problem details (RFC 9457)."""

    type: str = Field(description="A name for this kind of problem.")
    title: str
    status: int
    detail: str
    request_id: str | None = Field(None, description="Finds the request in the service's log.")
    errors: list[ProblemError] = Field(default_factory=list)


class InfeasibleProblem(Problem):
    """Why no flight can fulfil the mission."""

    reason: str | None = Field(None, description="A word for programs: broken_chain, start_uncovered, ...")
    place: dict[str, float] | None = Field(None, description="Where.")
    gap_m: float | None = Field(None, description="How much range is missing.")
    stations: list[str] | None = None
    fix: dict[str, Any] | None = Field(None, description="The smallest single remedy, as data.")
    fix_text: str | None = Field(None, description="The same in words.")


class Place(Closed):
    """A position: latitude, longitude and altitude above mean sea level; or, with an origin, metres in its plane."""

    lat_deg: float | None = Field(None, ge=-90, le=90)
    lon_deg: float | None = Field(None, ge=-180, le=180)
    alt_amsl_m: float | None = Field(None, description="Altitude above mean sea level, m.")
    east_m: float | None = Field(None, description="With an origin only.")
    north_m: float | None = Field(None, description="With an origin only.")
    up_m: float | None = Field(None, description="Altitude above the origin's, m. With an origin only.")


class StationBody(Place):
    """A ground station: an antenna, its range, and the people at it."""

    id: str = Field(description="Letters, digits, blanks and . _ - : + # ( ) ' &, beginning with a letter or digit.")
    range_m: float = Field(gt=0, description="Slant range within which the vehicle hears it, m.")
    name: str | None = None
    system_id: int | None = Field(None, ge=1, le=254, description="MAVLink id; given out when a plan uses the station.")
    contact: str | None = None
    radio_channel: str | None = None
    hours: str | None = Field(None, description="When it is staffed, for people.")
    min_elevation_deg: float | None = Field(None, description="Lowest elevation at which it hears the vehicle.")


class SafePointBody(Place):
    """A place to go to when the flight cannot go on."""

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


class Health(Closed):
    """How the service is."""

    status: Literal["ok", "ready"]
    version: str
    checks: dict[str, str]


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


ENTRY_ID = r"^[^\W_][\w .:+#()'&-]{0,63}$"


class RegisteredStation(Closed):
    """A ground station known by name."""

    lat_deg: float = Field(ge=-90, le=90, allow_inf_nan=False, examples=[52.9234])
    lon_deg: float = Field(ge=-180, le=180, allow_inf_nan=False, examples=[4.7806])
    alt_amsl_m: float = Field(ge=-1000, le=50_000, description="Of the antenna, above mean sea level.", examples=[1.0])
    range_m: float = Field(gt=0, le=500_000, description="Slant range, m.", examples=[16000.0])
    name: str | None = Field(None, max_length=200)
    system_id: int | None = Field(None, ge=1, le=254, description="Its MAVLink id.")
    contact: str | None = Field(None, max_length=200)
    radio_channel: str | None = Field(None, max_length=200)
    hours: str | None = Field(None, max_length=200, description="When it is staffed, for people.")
    min_elevation_deg: float | None = Field(None, ge=-90, le=90)


class RegisteredLink(Closed):
    """Where a station's radio is reached."""

    url: str = Field(
        max_length=200,
        description="udpout:HOST:PORT, udpin:HOST:PORT, tcp:HOST:PORT or serial:DEVICE:BAUD.",
        examples=["udpout:127.0.0.1:14540"],
    )
    description: str | None = Field(None, max_length=500)


class RegisteredVehicle(Closed):
    """A vehicle and the links that lead to it."""

    autopilot: Literal["px4", "ardupilot"]
    links: dict[str, str] = Field(
        min_length=1,
        max_length=1000,
        description="Link by station id; `*` stands for every station not named.",
        examples=[{"*": "simulator"}],
    )
    name: str | None = Field(None, max_length=200)


class Entry(Closed):
    """What the registry adds to an entry."""

    id: str
    revision: int = Field(ge=1, description="How often it was written; for If-Match.")
    created_utc: str
    changed_utc: str


class StationEntry(Entry, RegisteredStation):
    """A ground station as the registry shows it."""


class LinkEntry(Entry, RegisteredLink):
    """A link as the registry shows it."""


class VehicleEntry(Entry, RegisteredVehicle):
    """A vehicle as the registry shows it."""


class RegistryPage(Closed):
    """Entries in order of their names. ``next`` goes into ``cursor`` for the page after this one; null at the end."""

    items: list[dict[str, Any]]
    next: str | None


class NewFlight(Closed):
    """Which plan is to be flown by which vehicle."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={
            "examples": [
                {
                    "mission_id": "0b6f3c1e8e0f4c0d9b1f2a3c4d5e6f70",
                    "plan_sha256": "9d16bbfe1563bb52c3dda9d9af87dbbe40beb98733fe982f8da0e0fefccdfe26",
                    "vehicle_id": "medic-1",
                }
            ]
        },
    )

    mission_id: str = Field(max_length=64)
    plan_sha256: str = Field(pattern=r"^[0-9a-f]{64}$", description="Of the plan that is meant: another is refused.")
    vehicle_id: str = Field(max_length=64)
    version: int | None = Field(None, ge=1, le=2**31 - 1, description="Of the mission; default the latest.")
    rate_hz: float | None = Field(None, ge=5, le=100, description="Setpoints a second; default 20.")
    speedup: float | None = Field(None, ge=0.1, le=1000, description="Our simulator at this factor, on loopback alone.")
    operator_words: bool | None = Field(None, description="Each handover waits for the next operator's `ready`.")
    rally: bool | None = Field(
        None, description="Upload the mission's safe points as rally points for the flight; default true."
    )
    fence: bool | None = Field(
        None, description="Lay a fence around the plan and every straight way home, for the flight; default false."
    )
    handover_way: Literal["auto", "gate", "range", "parameter", "operator_control"] | None = Field(
        None,
        description="How the vehicle is told of a handover; default `auto`: by what it offers. `parameter`: ArduPilot "
        "hears one station at a time and is told of each.",
    )


class LaunchWord(Closed):
    """The word to launch."""

    plan_sha256: str = Field(pattern=r"^[0-9a-f]{64}$")
    preflight_id: int = Field(ge=0, le=2**31 - 1, description="`preflight.id` of the flight.")
    by: str | None = Field(None, max_length=100, description="Who says so, for the record.")


class Said(Closed):
    """Who says a word, and why; both for the record."""

    by: str | None = Field(None, max_length=100)
    reason: str | None = Field(None, max_length=500)


class ReplanWish(Said):
    """What a new plan from the present state is to be; what is left out stays as it was planned."""

    destination: dict[str, float] | None = Field(None, description="In the mission's frame, as in the mission.")
    excluded_stations: list[Annotated[str, Field(max_length=64)]] | None = Field(
        None, max_length=10_000, description="In place of those excluded so far."
    )
    ahead_s: float = Field(
        30.0, ge=5, le=600, description="How far ahead, in flight, the new plan begins: time to plan, and to decide in."
    )


class ReplanProposal(Closed):
    """A plan the flight could go on by. Nothing has changed until it is accepted.

    ``join_s`` is the time of the new plan from which it is new; it must be accepted before ``decide_by_t_plus_s``
    (null: the flight stands and waits). ``handovers`` are those to come, with the T+ expected. ``checks`` judge it by
    the rules of a launch, the worst first: overlaps, margin, room to stop at each handover to come; it will be refused
    where one is a ``failure``.
    """

    plan_sha256: str
    at_rest: bool
    join_s: float
    decide_by_t_plus_s: float | None
    mission_time_s: float
    stations: list[str]
    handovers: list[dict[str, Any]]
    checks: list[dict[str, Any]]
    plan: dict[str, Any]


class ReplanWord(Said):
    """Which proposal is accepted."""

    plan_sha256: str = Field(pattern=r"^[0-9a-f]{64}$")


class FlightSummary(Closed):
    """A flight, as lists show it. ``state`` is ``preflight`` until the word to launch; ``phase`` is finer."""

    id: str
    mission_id: str
    version: int
    plan_sha256: str
    vehicle_id: str
    state: str
    phase: str
    created_utc: str
    changed_utc: str
    ended_utc: str | None


class Preflight(Closed):
    """The last preflight: every check with its level, and whether it passed."""

    id: int | None
    passed: bool
    age_s: float | None
    checks: list[dict[str, Any]]


class FlightDetail(FlightSummary):
    """A flight with its preflight, where it is, and how it ended."""

    preflight: Preflight
    live: dict[str, Any]
    handover_states: dict[str, str]
    alarms: list[dict[str, Any]]
    result: dict[str, Any] | None


class FlightPage(Closed):
    """Flights, newest first. ``next`` goes into ``cursor`` for the page after this one; null at the end."""

    items: list[FlightSummary]
    next: str | None


class FlightEvents(Closed):
    """Events in order."""

    items: list[dict[str, Any]]
