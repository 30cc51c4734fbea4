"""A new plan for a flight under way, from where it is or will be: the paper's online planning.

The new plan is the whole flight again: the old curve up to the join, then a new one that takes position, velocity
and acceleration over from it. Until the join both plans ask for the same, so a flight may change from one to the other
at any moment before it and misses nothing; T+, the handovers flown and their numbers stay; the contingencies lead back
along what was truly flown; and certificate and schedule are measured on the whole.

A flight that stands on its path cannot take over a velocity. Its new plan brakes on the path behind it, comes to rest
where the flight stands, and goes on from there. A flight that waits for a station stands at the very end of the
coverage behind it, beyond any margin: then the new plan rests a little further back, where the flight has to go first.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from datetime import datetime
from typing import Any

import numpy as np

from gcs.errors import Finding, MissionInfeasible
from gcs.layout.problem_planner import PlannerLike
from gcs.mission.document import read_mission, with_options
from gcs.mission.model import LocalPosition, Mission, Position, StartState
from gcs.mission.writing import write_mission
from gcs.plan.contingency import contingencies
from gcs.plan.document import read_plan
from gcs.plan.handover_schedule import schedule
from gcs.plan.model import Plan
from gcs.planning.certification import recertify
from gcs.planning.joining import as_flown, clear_of_joints, moving_on, standing_first
from gcs.planning.mission_planning import PlanningMethod, Progress, find_plan, problem_planner
from gcs.remedies.explanation import explain
from planner import Method, Trajectory
from planner.arrays import Array

LEAST_LEFT_S = 1.0
"""A join this near the end of the plan, or nearer, is no use."""
BACK_S = (0.0, 2.0, 4.0, 8.0, 16.0)
"""How far back on the plan a flight that stands may have to go, tried in turn."""
_OTHER_STARTS = 3


@dataclass(frozen=True)
class Replanned:
    """A new plan. The flight leaves the old one at ``leave_s`` of it and goes on at ``join_s`` of the new.

    Both are the same time unless it stands (``at_rest``).
    """

    plan: Plan
    join_s: float
    at_rest: bool
    leave_s: float

    def to_document(self) -> dict[str, object]:
        """As JSON; ``plan`` is a plan document."""
        rest = {"join_s": self.join_s, "at_rest": self.at_rest, "leave_s": self.leave_s}
        return {"plan": self.plan.to_document(), **rest}


@dataclass(frozen=True)
class ReplanOrder:
    """What is to be planned anew: the plan being flown, where from, and what changes. See `replan`."""

    plan: Mapping[str, Any]
    join_s: float
    at_rest: bool = False
    destination: Mapping[str, float] | None = None
    excluded_stations: tuple[str, ...] | None = None
    elapsed_s: float | None = None
    present_s: float | None = None
    handovers_done: int | None = None

    def to_document(self) -> dict[str, Any]:
        """As JSON."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    def execute(self, **how: Any) -> Replanned:
        """`replan` as ordered; raises `PlanError` and `MissionError` too, for a plan or destination that is none."""
        plan = read_plan(self.plan)
        mission = plan.mission
        if self.destination is not None or self.excluded_stations is not None:
            document = write_mission(mission)
            if self.destination is not None:
                document["destination"] = dict(self.destination)
            mission = read_mission(document, max_stations=max(1, len(mission.stations)))
            if self.excluded_stations is not None:
                mission = with_options(mission, {"excluded_stations": list(self.excluded_stations)})
        return replan(
            plan,
            self.join_s,
            at_rest=self.at_rest,
            destination=mission.destination,
            excluded_stations=mission.options.excluded_stations,
            elapsed_s=self.elapsed_s,
            present_s=self.present_s,
            handovers_done=self.handovers_done,
            **how,
        )


def replan(
    plan: Plan,
    join_s: float,
    *,
    at_rest: bool = False,
    destination: Position | None = None,
    excluded_stations: Sequence[str] | None = None,
    elapsed_s: float | None = None,
    present_s: float | None = None,
    handovers_done: int | None = None,
    planner: PlannerLike | None = None,
    method: Method | None = None,
    time_limit_s: float | None = None,
    created_utc: datetime | None = None,
    notes: Sequence[str] = (),
    progress: Progress | None = None,
) -> Replanned:
    """Plan anew from ``join_s`` of ``plan``, or up to `LEAST_PIECE_S` later; ``at_rest``: the flight stands there.

    ``destination`` and ``excluded_stations`` (ids) replace the mission's. ``elapsed_s`` is how long the flight will
    have lasted at the join, where that is not ``join_s``: endurance counts from T+0. Handovers planned
    before ``present_s``, where the flight is now, but beyond the first ``handovers_done`` have not come about: the
    station before them is still in control. The rest is as for `gcs.planning.mission_planning.plan_mission`.

    Raises `MissionInfeasible` and `PlanningFailed` as that does; `MissionInfeasible` with reason ``"join"`` where no
    new curve can be joined on.
    """
    if not 0.0 <= join_s <= plan.mission_time_s - LEAST_LEFT_S:
        raise _no_join(
            f"The join at {join_s:.1f} s is not on the plan, which lasts {plan.mission_time_s:.1f} s.",
            "Replan earlier in the flight, or plan a new mission after landing.",
        )
    excluded = list(plan.mission.options.excluded_stations if excluded_stations is None else excluded_stations)
    how = PlanningMethod(
        problem_planner(planner, method or "joint", time_limit_s),
        created_utc=created_utc,
        notes=notes,
        progress=progress,
        plane=plan.plane,
    )
    curve = as_flown(plan.trajectory, present_s, handovers_done)
    if at_rest:
        tries = [join_s - back_s for back_s in BACK_S if back_s <= join_s]
    else:
        clear_s = min(clear_of_joints(curve, join_s)[1], plan.mission_time_s - LEAST_LEFT_S)
        tries = list(dict.fromkeys((clear_s, join_s)))
    first: MissionInfeasible | Finding | None = None
    for leave_s in tries:
        elapsed = elapsed_s if at_rest or elapsed_s is None else elapsed_s + leave_s - join_s
        try:
            return _from(plan, curve, leave_s, at_rest, destination, excluded, elapsed, how)
        except (MissionInfeasible, Finding) as error:
            first = first or error
    assert first is not None
    if isinstance(first, Finding):
        # Explained once, when every try is over: only the first one's reason is told.
        raise explain(first, how.planner) from first
    raise first


def _from(
    plan: Plan,
    curve: Trajectory,
    join_s: float,
    at_rest: bool,
    destination: Position | None,
    excluded_stations: Sequence[str],
    elapsed_s: float | None,
    how: PlanningMethod,
) -> Replanned:
    """`replan` from one place of the plan, ``curve`` being the plan's own as it was flown; raises `Finding` too."""
    excluded = list(excluded_stations)
    in_control = plan.mission.stations[int(curve.station_index[curve.segment_at(join_s)])].id
    last: MissionInfeasible | None = None
    for _ in range(_OTHER_STARTS):
        wanted = _continuation(plan, join_s, at_rest, destination, excluded, elapsed_s)
        try:
            rest = find_plan(wanted, how)
        except Finding as error:
            # What stations left out for their start alone would have made possible is not to be blamed on the mission.
            raise last or error from None
        found = _standing(plan, curve, join_s, rest) if at_rest else _moving(plan, curve, join_s, rest)
        if isinstance(found, Replanned):
            return found
        last = found
        if rest.station_ids[0] == in_control:
            break
        # Handing over to that one right at the join has too little overlap or tenure: begin with another.
        excluded.append(rest.station_ids[0])
    assert last is not None
    raise last


def _no_join(message: str, fix: str) -> MissionInfeasible:
    return MissionInfeasible("join", message, fix_text=fix)


def _continuation(
    plan: Plan,
    join_s: float,
    at_rest: bool,
    destination: Position | None,
    excluded: Sequence[str],
    elapsed_s: float | None,
) -> Mission:
    """The mission from the join on, its start in motion (true axes in a WGS84 mission) unless ``at_rest``."""
    mission, curve, geometry = plan.mission, plan.trajectory, plan.geometry
    place, velocity, acceleration = (np.array(curve.evaluate(join_s, order)) for order in (0, 1, 2))
    start: Position
    if geometry.is_local:
        start = LocalPosition(float(place[0]), float(place[1]), float(place[2]))
    else:
        start = geometry.geo(place)
        axes = plan.plane.true_axes(place[0], place[1], plan.plane.altitude_amsl_m(place[2]))
        velocity[:2], acceleration[:2] = axes @ velocity[:2], axes @ acceleration[:2]
    state = None
    if not at_rest:
        state = StartState(_three(velocity), _three(acceleration))
    limits = mission.limits
    if limits.endurance_s is not None:
        left_s = limits.endurance_s - (join_s if elapsed_s is None else elapsed_s)
        if left_s <= (limits.reserve_s or 0.0):
            raise MissionInfeasible(
                "endurance", "Nothing is left of the endurance at the join.", fix_text="Fly the contingency procedure."
            )
        limits = replace(limits, endurance_s=left_s)
    options = replace(mission.options, start_state=state, excluded_stations=tuple(excluded), arrival_s=None)
    return replace(mission, start=start, destination=destination or mission.destination, limits=limits, options=options)


def _three(vector: Array) -> tuple[float, float, float]:
    return float(vector[0]), float(vector[1]), float(vector[2])


def _moving(plan: Plan, curve: Trajectory, join_s: float, rest: Plan) -> Replanned | MissionInfeasible:
    made = _whole(plan, rest, moving_on(curve, join_s, rest.trajectory), join_s)
    return Replanned(made, join_s, False, join_s) if isinstance(made, Plan) else made


def _standing(plan: Plan, curve: Trajectory, stand_s: float, rest: Plan) -> Replanned | MissionInfeasible:
    """Brake on the path behind ``stand_s``, rest there, go on."""
    limits, options = plan.mission.limits, plan.mission.options
    ways = standing_first(
        curve,
        stand_s,
        rest.trajectory,
        max_accel_m_s2=limits.max_accel_m_s2,
        from_rest=options.start_state is None,
    )
    refused: MissionInfeasible | None = None
    for joined, join_s in ways:
        made = _whole(plan, rest, joined, stand_s)
        if isinstance(made, Plan):
            return Replanned(made, join_s, True, stand_s)
        refused = refused or made
    assert refused is not None
    return refused


def _whole(plan: Plan, rest: Plan, curve: Trajectory, join_s: float) -> Plan | MissionInfeasible:
    """The plan of a joined curve, measured anew from end to end; why not, where it does not hold."""
    flown = {plan.mission.stations[i].id for i in curve.sequence}
    excluded = tuple(s for s in rest.mission.options.excluded_stations if s not in flown)
    limits = plan.mission.limits
    options = replace(plan.mission.options, excluded_stations=excluded, arrival_s=None)
    ids = {s.id: s.system_id for s in plan.mission.stations if s.system_id is not None}
    stations = tuple(replace(s, system_id=ids.get(s.id, s.system_id)) for s in rest.mission.stations)
    mission = replace(
        plan.mission, destination=rest.mission.destination, stations=stations, limits=limits, options=options
    )
    made = replace(
        plan,
        mission=mission,
        trajectory=curve,
        handovers=(),
        contingencies=(),
        fastest=None,
        lower_bound_s=join_s + rest.lower_bound_s,
        path_length_m=curve.path_length_m(),
        solve_time_s=rest.solve_time_s,
        created_utc=rest.created_utc,
        method=f"replanned: {rest.method}",
        iterations=rest.iterations,
        notes=(*plan.notes, f"replanned from T+{join_s:.3f} s of plan {plan.plan_sha256}", *rest.notes),
    )
    certificate = recertify(made)
    if not certificate.feasible:
        broken = ", ".join(f"{name} by {value:.3g}" for name, value in certificate.broken.items())
        return _no_join(
            f"A new curve was found, but it cannot be joined on at {join_s:.1f} s of the plan: it breaks {broken}.",
            "Replan from another moment, or hold first.",
        )
    geometry = made.geometry
    return replace(
        made, certificate=certificate, handovers=schedule(geometry, curve), contingencies=contingencies(geometry, curve)
    )
