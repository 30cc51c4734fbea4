"""What a flight is asked to do, checked at the door."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from enum import StrEnum
from typing import Any

from gcs.errors import InputFault, PlanError
from gcs.plan import Plan, read_plan
from link.autopilot.registry import PROFILES
from link.errors import EndpointUrlError, FlightRequestError
from link.transport.url import parse_url


class HandoverWay(StrEnum):
    """How a vehicle is told of a handover: see `link.handover.handover`."""

    AUTO = "auto"
    """As the vehicle's autopilot and version allow."""
    GATE = "gate"
    RANGE = "range"
    PARAMETER = "parameter"
    OPERATOR_CONTROL = "operator_control"


HANDOVER_WAYS = tuple(way.value for way in HandoverWay)
SET_PARAMETERS = ("auto", "yes", "no")
LAST_RESORTS = ("return", "land", "stay")
MIN_START_REST_M_S = 0.01
_KEYS = {"lay_geofence": "fence"}
"""Fields that documents name otherwise."""


@dataclass(frozen=True)
class FlightRequest:
    """A flight, as data that can be sent to the streamer process.

    ``plan`` is the plan document, ``links`` maps each used station's id to its URL, or to several (one sends, see
    `link.telemetry.link_path`); stations may share one. Stations of the mission that the plan does not use may have
    links too, where they have system ids: a new plan in flight may use them then. Times are seconds of the flight's
    clock.

    - ``auto_launch``: go as soon as the preflight has passed; otherwise wait for the launch command.
    - ``authorised_until_s``: T+ of the plan up to which the flight may go on without a further command (None: all).
    - ``confirmation_time_s``: how long a handover may wait for the vehicle's evidence. A plan whose overlaps are
      shorter than this and ``overlap_guard_s`` of the way is refused.
    - ``lead_limit_s``: by how much of the link's latency, at most, setpoints are asked for ahead; 0: not at all.
    - ``tracking_error_m``: how far beside the path the vehicle is expected at most; a plan with a smaller range margin
      is refused.
    - ``set_parameters``: whether failsafe parameters found unsafe are set (and read back): ``"auto"`` on our simulator
      alone, ``"yes"``, or ``"no"``: then the flight is refused with what to set.
    - ``rally``: upload the mission's safe points as rally points (what the vehicle held comes back after the flight);
      ``lay_geofence``: lay a geofence around the plan for the flight (``fence`` in a document).
    - ``operator_words``: each handover needs the command of the receiving station's operator.
    - ``wait_for_station_s``: how long to stand before a station that is not ready until the contingency is flown.
    - ``hold_limit_s``: how long a hold nobody asked for lasts until the contingency is flown.
    - ``last_resort``: the autopilot's own mode, set when nobody commands anything after the C2 link was lost.
    - ``lost_after_s``: silence of the vehicle after the C2 link was lost until the flight is given up as lost.
    - ``rescue``: take a vehicle that is locked to other stations' ids (ArduPilot) by using its own id.
    - ``signing_key``: ``file:PATH`` or ``env:NAME``; ``signing_state`` the folder its stamps are kept in.
    """

    plan: Mapping[str, Any]
    autopilot: str
    links: Mapping[str, str | Sequence[str]]
    rate_hz: float = 20.0
    speedup: float = 1.0
    log_path: str | None = None
    flight_id: str = "flight"
    auto_launch: bool = True
    authorised_until_s: float | None = None
    confirmation_time_s: float = 3.0
    overlap_guard_s: float = 2.0
    tracking_error_m: float = 3.0
    lead_limit_s: float = 0.5
    set_parameters: str = "auto"
    handover_way: str = "auto"
    rally: bool = True
    lay_geofence: bool = False
    operator_words: bool = False
    wait_for_station_s: float = 60.0
    hold_limit_s: float = 300.0
    last_resort: str = "return"
    rescue: bool = False
    allow_unsigned: bool = False
    signing_key: str | None = None
    signing_state: str | None = None
    connect_timeout_s: float = 30.0
    arm_timeout_s: float = 120.0
    launch_timeout_s: float = 3600.0
    max_transit_m: float = 500.0
    transit_speed_m_s: float = 8.0
    climb_m_s: float = 2.5
    arrival_hold_s: float = 5.0
    lost_after_s: float = 120.0
    _plan_object: Plan | None = field(default=None, compare=False, repr=False)

    def __post_init__(self) -> None:
        problems = [*self._numbers(), *self._choices()]
        plan: Plan | None = None
        try:
            plan = read_plan(self.plan)
        except PlanError as error:
            problems.append(InputFault(error.where or "plan", str(error), fix="plan the mission again"))
        if plan is not None:
            problems += self._links(plan)
            problems += launch_problems(plan, self)
        if problems:
            raise FlightRequestError(problems)
        object.__setattr__(self, "_plan_object", plan)

    @property
    def flown_plan(self) -> Plan:
        """The plan, read and checked."""
        assert self._plan_object is not None
        return self._plan_object

    @property
    def urls(self) -> dict[str, tuple[str, ...]]:
        """The URLs of each station, the first the one that sends at first."""
        return {
            station: (urls,) if isinstance(urls, str) else tuple(dict.fromkeys(urls))
            for station, urls in self.links.items()
        }

    def shown(self, station_id: str) -> str:
        """A station's URLs for people."""
        return ", ".join(self.urls[station_id])

    @property
    def stations(self) -> tuple[str, ...]:
        """Stations with a link: the plan's in flight order, then those in reserve."""
        return tuple(dict.fromkeys([*self.flown_plan.station_ids, *self.links]))

    @property
    def system_ids(self) -> dict[str, int]:
        """The MAVLink system id of each of `stations`."""
        mission = self.flown_plan.mission
        return {s: int(mission.stations[mission.station_index(s)].system_id or 0) for s in self.stations}

    def _numbers(self) -> list[InputFault]:
        limits = {
            "rate_hz": (5.0, 100.0),
            "speedup": (0.1, 1000.0),
            "confirmation_time_s": (0.5, 60.0),
            "overlap_guard_s": (0.0, 60.0),
            "tracking_error_m": (0.0, 1000.0),
            "lead_limit_s": (0.0, 0.5),
            "wait_for_station_s": (0.0, 86400.0),
            "hold_limit_s": (0.0, 86400.0),
            "connect_timeout_s": (1.0, 3600.0),
            "arm_timeout_s": (1.0, 3600.0),
            "launch_timeout_s": (1.0, 86400.0),
            "max_transit_m": (0.0, 10_000.0),
            "transit_speed_m_s": (0.5, 50.0),
            "climb_m_s": (0.2, 20.0),
            "arrival_hold_s": (0.0, 3600.0),
            "lost_after_s": (5.0, 86400.0),
        }
        problems = []
        for name, (low, high) in limits.items():
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
                problems.append(
                    InputFault(name, "out of range", value, f"{low:g} to {high:g}", "choose a value in that range")
                )
        until = self.authorised_until_s
        if until is not None and not (isinstance(until, int | float) and math.isfinite(until) and until >= 0.0):
            problems.append(
                InputFault("authorised_until_s", "not a time", until, "0 or more, or none", "give T+ in seconds")
            )
        return problems

    def _choices(self) -> list[InputFault]:
        allowed: dict[str, tuple[str, ...]] = {
            "autopilot": tuple(sorted(PROFILES)),
            "handover_way": HANDOVER_WAYS,
            "set_parameters": SET_PARAMETERS,
            "last_resort": LAST_RESORTS,
        }
        problems = [
            InputFault(name, "not one of those", getattr(self, name), ", ".join(words), "choose one")
            for name, words in allowed.items()
            if getattr(self, name) not in words
        ]
        profile = PROFILES.get(self.autopilot)
        if self.handover_way == HandoverWay.PARAMETER and profile is not None and not profile.filters_station_ids:
            allowed_ways = ", ".join(way for way in HANDOVER_WAYS if way != HandoverWay.PARAMETER)
            what = f"{profile.title} has no parameter that says whom it hears"
            problems.append(InputFault("handover_way", what, "parameter", allowed_ways, "choose gate"))
        key = self.signing_key
        if key is not None and not (key.startswith(("file:", "env:")) and len(key.split(":", 1)[1]) > 0):
            # The value is not shown: it may be the key itself.
            problems.append(
                InputFault("signing_key", "not a reference to a key", None, "file:PATH or env:NAME", "name it")
            )
        return problems

    def _links(self, plan: Plan) -> list[InputFault]:
        problems = [
            InputFault(
                f"links.{station}", "the plan uses this station and it has no link", None, "a link URL", "add it"
            )
            for station in dict.fromkeys(plan.station_ids)
            if station not in self.links
        ]
        with_ids = {station.id for station in plan.mission.stations if station.system_id is not None}
        for station, urls in self.urls.items():
            for url in urls:
                try:
                    parse_url(url)
                except EndpointUrlError as error:
                    problems.append(InputFault(f"links.{station}", str(error)))
            if not urls:
                problems.append(InputFault(f"links.{station}", "no link", None, "a link URL", "give one"))
            if station not in with_ids:
                problems.append(
                    InputFault(
                        f"links.{station}",
                        "the plan does not use this station, and it has no system id",
                        station,
                        ", ".join(sorted(with_ids)),
                        "leave it out, or give it an id in the mission",
                    )
                )
        return problems

    def to_document(self) -> dict[str, Any]:
        """As a JSON object."""
        document = {_KEYS.get(f.name, f.name): getattr(self, f.name) for f in fields(self) if f.name[0] != "_"}
        document["links"] = {s: urls[0] if len(urls) == 1 else list(urls) for s, urls in self.urls.items()}
        document["plan"] = dict(self.plan)
        return document

    @classmethod
    def from_document(cls, document: Mapping[str, Any]) -> FlightRequest:
        """From `to_document`. Raises `FlightRequestError` for unknown or missing fields too."""
        known = {_KEYS.get(f.name, f.name): f.name for f in fields(cls) if f.name[0] != "_"}
        problems = [
            InputFault(name, "no such field", allowed=", ".join(sorted(known)))
            for name in document
            if name not in known
        ]
        problems += [InputFault(name, "missing") for name in ("plan", "autopilot", "links") if name not in document]
        if problems:
            raise FlightRequestError(problems)
        return cls(**{known[key]: value for key, value in document.items()})


def launch_problems(plan: Plan, request: FlightRequest) -> list[InputFault]:
    """Why this plan must not be flown under this request: overlaps, margin, start in motion, its own certificate."""
    problems = []
    needed_s = request.confirmation_time_s + request.overlap_guard_s
    for handover in plan.handovers:
        overlap_s = handover.overlap_end_s - handover.overlap_start_s
        if overlap_s < needed_s - 1e-3:
            pair = f"{handover.from_station} and {handover.to_station}"
            parts = f"{request.confirmation_time_s:g} s to confirm and {request.overlap_guard_s:g} s more"
            problems.append(
                InputFault(
                    f"plan.handovers[{handover.index}].overlap",
                    f"{pair} cover the vehicle together too briefly to hand over",
                    round(overlap_s, 3),
                    f"at least {needed_s:g} s ({parts})",
                    f"plan with min_overlap_s {needed_s:g} or more",
                )
            )
    margin_m = -plan.certificate.worst["range_m"]
    if margin_m < request.tracking_error_m:
        problems.append(
            InputFault(
                "plan.certificate.worst.range_m",
                "the margin to range is smaller than the vehicle may be beside the path",
                round(margin_m, 3),
                f"a margin of at least {request.tracking_error_m:g} m (tracking_error_m)",
                f"plan with range_margin_m {request.tracking_error_m:g} or more",
            )
        )
    start_speed = math.hypot(*(float(v) for v in plan.trajectory.evaluate(0.0, 1)))
    if start_speed > MIN_START_REST_M_S:
        problems.append(
            InputFault(
                "plan.segments[0]",
                "the plan starts in motion",
                start_speed,
                "a start at rest",
                "plan without start_state",
            )
        )
    if not plan.certificate.feasible:
        problems.append(
            InputFault("plan.certificate", "the plan does not hold its own limits", False, "true", "plan again")
        )
    return problems
