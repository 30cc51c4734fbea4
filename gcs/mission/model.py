"""What is to be flown: a mission, as frozen data. Reading it from JSON is `gcs.mission.document`.

A mission is given in one of two frames. ``"wgs84"``: latitude, longitude and altitude above mean sea level.
``"local"``: an origin, and east, north and up in metres of its map plane (`gcs.geodesy.plane.Plane`), used exactly as
they are. Limits are above mean sea level in both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from gcs.mission.system_ids import assign_system_ids

MAX_STATIONS = 100_000


@dataclass(frozen=True)
class GeoPosition:
    """A place on WGS84; altitude above mean sea level."""

    lat_deg: float
    lon_deg: float
    alt_amsl_m: float


@dataclass(frozen=True)
class LocalPosition:
    """A place in the plane of the mission's origin; ``up_m`` is altitude above the origin's."""

    east_m: float
    north_m: float
    up_m: float


Position = GeoPosition | LocalPosition


@dataclass(frozen=True)
class Station:
    """A ground station: an antenna and the people at it.

    ``range_m`` is the slant range within which the vehicle hears it; ``min_elevation_deg`` the lowest elevation at
    which it does; ``system_id`` its MAVLink id, given or assigned when a plan uses the station; ``hours`` when it is
    staffed, for people.
    """

    id: str
    position: Position
    range_m: float
    name: str
    system_id: int | None = None
    contact: str | None = None
    radio_channel: str | None = None
    hours: str | None = None
    min_elevation_deg: float | None = None


@dataclass(frozen=True)
class SafePoint:
    """A place to go to when the flight cannot go on."""

    id: str
    position: Position
    name: str


@dataclass(frozen=True)
class MissionLimits:
    """What the vehicle can and may do; ``None`` is unlimited.

    ``wind_m_s`` is (east, north), where the air goes to; ``max_airspeed_m_s`` bounds the speed against it. The flight
    must last at most ``endurance_s`` less ``reserve_s``.
    """

    min_alt_amsl_m: float
    max_alt_amsl_m: float
    max_speed_m_s: float
    max_accel_m_s2: float
    max_jerk_m_s3: float | None = None
    max_climb_m_s: float | None = None
    max_descent_m_s: float | None = None
    max_airspeed_m_s: float | None = None
    wind_m_s: tuple[float, float] | None = None
    endurance_s: float | None = None
    reserve_s: float | None = None

    @property
    def allowed_s(self) -> float | None:
        """How long a flight may take: endurance less reserve; None without an endurance."""
        return None if self.endurance_s is None else self.endurance_s - (self.reserve_s or 0.0)


@dataclass(frozen=True)
class StartState:
    """Velocity and acceleration at T+0, (east, north, up), along true axes in a WGS84 mission."""

    velocity_m_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    acceleration_m_s2: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class MissionOptions:
    """How to plan; the defaults make plans a real vehicle can fly.

    Around every handover both stations cover the vehicle ``min_overlap_s``, half of it before and half after;
    ``range_margin_m`` is taken off every range; a station is in control at least ``min_tenure_s`` where there is more
    than one. ``handover_tolerance`` is the part of the fastest plan's time, and at least a second, given up for fewer
    handovers: 0 asks for the fastest plan, and is the default where ``min_overlap_s`` is 0. ``objective`` is
    ``"time"``, ``"energy"`` or the weight of energy between 0 and 1; ``arrival_s`` the mission time wished for.
    ``overlap_target_s`` is the overlap aimed at where it costs little, what it has over ``min_overlap_s`` after the
    handover; ``"auto"`` is what it takes to notice a failed station and to stop, nothing where no tolerance is given.
    """

    min_overlap_s: float = 5.0
    range_margin_m: float = 25.0
    min_tenure_s: float = 10.0
    vehicle_system_id: int = 1
    on_arrival: str = "land"
    excluded_stations: tuple[str, ...] = ()
    max_handovers: int | None = None
    handover_tolerance: float = 0.001
    overlap_target_s: str | float = "auto"
    objective: str | float = "time"
    start_state: StartState | None = None
    arrival_s: float | None = None

    @property
    def energy_weight(self) -> float:
        """w of the objective (1 - w) time + w energy: 0 for ``"time"``, 1 for ``"energy"``.

        Energy is in seconds of staying aloft, as `planner.energy` has it: the time itself, and manoeuvring and drag.
        """
        return {"time": 0.0, "energy": 1.0}[self.objective] if isinstance(self.objective, str) else self.objective


# Until a handover is confirmed and, should the new station fail at once, the old one has taken over again: answers
# there and back, and the part of the autopilot's time-out (3 s at most by default) after which a station has failed.
ANSWERS_S, NOTICED_S = 0.3, 0.6 * 3.0
# A stop takes a little longer where the path bends.
BEND_S = 0.5


def overlap_after_target_s(options: MissionOptions, limits: MissionLimits) -> float:
    """How long after a handover the old station is to cover the vehicle, where that costs little; 0: not aimed at.

    By default what it takes to notice that the new one failed and to stop, v / 2a of the path at full speed.
    """
    if isinstance(options.overlap_target_s, str):
        if options.handover_tolerance == 0.0:
            return 0.0
        return ANSWERS_S + NOTICED_S + limits.max_speed_m_s / (2.0 * limits.max_accel_m_s2) + BEND_S
    return max(0.0, options.overlap_target_s - 0.5 * options.min_overlap_s)


@dataclass(frozen=True)
class Mission:
    """Start, destination, stations, limits and options. ``origin`` is given in a local mission, None otherwise.

    ``left_out`` are ids of stations of the document that are too far from the start to matter, and not among these.
    """

    start: Position
    destination: Position
    stations: tuple[Station, ...]
    limits: MissionLimits
    name: str = "Unnamed mission"
    safe_points: tuple[SafePoint, ...] = ()
    options: MissionOptions = field(default_factory=MissionOptions)
    origin: GeoPosition | None = None
    left_out: tuple[str, ...] = ()

    @property
    def frame(self) -> str:
        """``"wgs84"`` or ``"local"``."""
        return "wgs84" if self.origin is None else "local"

    def station_index(self, station_id: str) -> int:
        """Index of a station by id; ``KeyError`` when there is none."""
        for index, station in enumerate(self.stations):
            if station.id == station_id:
                return index
        raise KeyError(station_id)

    def with_system_ids(self, used: Sequence[int]) -> Mission:
        """Every station of ``used`` (indices, in flight order) has a system id; see `assign_system_ids`."""
        assigned = assign_system_ids(
            [s.system_id for s in self.stations], list(dict.fromkeys(used)), self.options.vehicle_system_id
        )
        stations = tuple(replace(s, system_id=i) for s, i in zip(self.stations, assigned, strict=True))
        return replace(self, stations=stations)


def amsl_m(mission: Mission, position: Position) -> float:
    """A position's altitude above mean sea level, in whichever frame it is."""
    if isinstance(position, GeoPosition):
        return position.alt_amsl_m
    assert mission.origin is not None
    return mission.origin.alt_amsl_m + position.up_m
