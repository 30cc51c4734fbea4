"""A plan: the curve with its names, its places on the earth, its schedule and its proof. One self-contained document.

`gcs.plan.document.read_plan` and `Plan.to_document` are inverse to one another, to the last digit, and the hash of the
document (RFC 8785 form, without itself, ``solve_time_s`` and ``created_utc``) tells one plan from another wherever it
turns up.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property

import rfc8785

from gcs.errors import PlanError
from gcs.geodesy.plane import Plane
from gcs.layout.mission_geometry import MissionGeometry
from gcs.mission.model import Mission, Station
from gcs.mission.writing import write_mission
from gcs.plan.contingency import Contingency
from gcs.plan.handover_schedule import Handover
from planner import Certificate, Trajectory

UNHASHED = ("plan_sha256", "solve_time_s", "created_utc")
# In a plan's costs: all its options at once.
TOGETHER = "together"
PROJECTION = {"name": "aeqd", "ellipsoid": "WGS84"}


@dataclass(frozen=True)
class OptionCost:
    """What an ``option`` of the mission, set to ``value`` (in words), costs: seconds the flight takes longer for it.

    None: not known, no plan was found without it. See `gcs.planning.option_costs`.
    """

    option: str
    value: str
    cost_s: float | None


@dataclass(frozen=True)
class Fastest:
    """The fastest plan found, where the one made has fewer handovers: its time, its handovers, what fewer cost."""

    mission_time_s: float
    handovers: int
    fewer_cost_s: float


@dataclass(frozen=True, eq=False)
class Plan:
    """A certified plan.

    ``trajectory`` has station indices of ``mission.stations`` and lives in ``plane``. ``method`` and ``notes`` say
    how it came about; ``planner_version`` is the version of this product. ``costs`` are there when asked for,
    ``fastest`` where handovers were saved.
    """

    mission: Mission
    trajectory: Trajectory
    plane: Plane
    handovers: tuple[Handover, ...]
    contingencies: tuple[Contingency, ...]
    certificate: Certificate
    lower_bound_s: float
    path_length_m: float
    solve_time_s: float
    created_utc: str
    method: str
    planner_version: str
    iterations: int = 0
    notes: tuple[str, ...] = field(default=())
    costs: tuple[OptionCost, ...] = ()
    fastest: Fastest | None = None

    @property
    def mission_time_s(self) -> float:
        """Seconds from launch to rest at the destination."""
        return self.trajectory.duration_s

    @cached_property
    def geometry(self) -> MissionGeometry:
        """Mission and plane together, to measure with."""
        return MissionGeometry(self.mission, self.plane)

    @cached_property
    def station_ids(self) -> tuple[str, ...]:
        """Ids in flight order, one per leg."""
        return tuple(self.mission.stations[i].id for i in self.trajectory.sequence)

    def station_at(self, time_s: float) -> Station:
        """The station in control at a time: the new one at a handover, the last one after the end."""
        return self.mission.stations[int(self.trajectory.station_index[self.trajectory.segment_at(time_s)])]

    @cached_property
    def plan_sha256(self) -> str:
        """Hash of the document, hexadecimal."""
        return hash_of(self._body())

    def to_document(self) -> dict[str, object]:
        """The plan document of the contract; plain JSON values, numbers unrounded."""
        body = self._body()
        return {
            "plan_sha256": self.plan_sha256,
            "created_utc": self.created_utc,
            "solve_time_s": self.solve_time_s,
            **body,
        }

    def _body(self) -> dict[str, object]:
        ids = [station.id for station in self.mission.stations]
        curve = self.trajectory
        return {
            "planner": {
                "version": self.planner_version,
                "method": self.method,
                "iterations": self.iterations,
                "notes": list(self.notes),
            },
            "mission": write_mission(self.mission),
            "mission_time_s": self.mission_time_s,
            "path_length_m": self.path_length_m,
            "lower_bound_s": self.lower_bound_s,
            "origin": {
                "lat_deg": self.plane.lat_deg,
                "lon_deg": self.plane.lon_deg,
                "alt_amsl_m": self.plane.alt_amsl_m,
            },
            "projection": dict(PROJECTION),
            "stations": list(self.station_ids),
            "segments": [
                {
                    "station": ids[station],
                    "start_s": float(start),
                    "duration_s": float(duration),
                    "control_points": points.tolist(),
                }
                for station, start, duration, points in zip(
                    curve.station_index, curve.knots_s, curve.durations_s, curve.control_points_m, strict=False
                )
            ],
            "handovers": [handover.to_document() for handover in self.handovers],
            "contingencies": [contingency.to_document() for contingency in self.contingencies],
            "certificate": {"feasible": self.certificate.feasible, "worst": dict(self.certificate.worst)},
            **({"fastest": asdict(self.fastest)} if self.fastest else {}),
            **({"costs": [asdict(cost) for cost in self.costs]} if self.costs else {}),
        }


def hash_of(document: Mapping[str, object]) -> str:
    """SHA-256, hexadecimal, of a plan document in RFC 8785 form without the fields in `UNHASHED`.

    Raises `PlanError` for values RFC 8785 has no form for.
    """
    body = {key: value for key, value in document.items() if key not in UNHASHED}
    try:
        return hashlib.sha256(rfc8785.dumps(body)).hexdigest()  # type: ignore[arg-type]
    except (rfc8785.CanonicalizationError, RecursionError, UnicodeError) as error:
        raise PlanError(f"cannot be put into canonical form: {error}") from None
