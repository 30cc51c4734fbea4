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

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from datetime import datetime
from typing import Any

import numpy as np

from gcs.errors import MissionInfeasible
from gcs.mission.document import read_mission, with_options
from gcs.mission.model import LocalPosition, Mission, Position, StartState
from gcs.mission.writing import write_mission
from gcs.plan.contingency import contingencies
from gcs.plan.document import read_plan
from gcs.plan.handover_schedule import schedule
from gcs.plan.model import Plan
from gcs.planning.certification import recertify
from gcs.planning.mission_planning import Progress, plan_mission
from gcs.planning.solve import PlannerLike
from planner import Method, Trajectory, bezier
from planner.arrays import Array, Indices

QUINTIC = 5
LEAST_LEFT_S = 1.0
"""A join this near the end of the plan, or nearer, is no use."""
BRAKING_SHARES = (0.6, 0.45, 0.3, 0.8)
"""Peak braking, of the acceleration limit, tried in turn for a flight that stands."""
BACK_S = (0.0, 2.0, 4.0, 8.0, 16.0)
"""How far back on the plan a flight that stands may have to go, tried in turn."""
LEAST_PIECE_S = 2.0
"""Shortest piece a join leaves: coordinates of 100 km round to 1e-11 m, and an acceleration is their second difference
over the piece's time squared, so that shorter pieces would not be continuous to the certificate's tolerance."""
_BRAKING_PIECE_S = 1.5
_SAME_S = 1e-6
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
    how = {
        "planner": planner,
        "method": method,
        "time_limit_s": time_limit_s,
        "created_utc": created_utc,
        "notes": notes,
        "progress": progress,
        "plane": plan.plane,
    }
    curve = _as_flown(plan, present_s, handovers_done)
    if at_rest:
        tries = [join_s - back_s for back_s in BACK_S if back_s <= join_s]
    else:
        clear_s = min(_clear_of_joints(curve, join_s)[1], plan.mission_time_s - LEAST_LEFT_S)
        tries = list(dict.fromkeys((clear_s, join_s)))
    first: MissionInfeasible | None = None
    for leave_s in tries:
        elapsed = elapsed_s if at_rest or elapsed_s is None else elapsed_s + leave_s - join_s
        try:
            return _from(plan, curve, leave_s, at_rest, destination, excluded, elapsed, how)
        except MissionInfeasible as error:
            first = first or error
    assert first is not None
    raise first


def _from(
    plan: Plan,
    curve: Trajectory,
    join_s: float,
    at_rest: bool,
    destination: Position | None,
    excluded_stations: Sequence[str],
    elapsed_s: float | None,
    how: Mapping[str, Any],
) -> Replanned:
    """`replan` from one place of the plan, ``curve`` being the plan's own as it was flown."""
    excluded = list(excluded_stations)
    in_control = plan.mission.stations[int(curve.station_index[curve.segment_at(join_s)])].id
    last: MissionInfeasible | None = None
    for _ in range(_OTHER_STARTS):
        wanted = _continuation(plan, join_s, at_rest, destination, excluded, elapsed_s)
        try:
            rest = plan_mission(wanted, **how)
        except MissionInfeasible as error:
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


def _as_flown(plan: Plan, present_s: float | None, handovers_done: int | None) -> Trajectory:
    """The plan's curve with the stations that truly were in control until now."""
    curve = plan.trajectory
    if present_s is None or handovers_done is None or not 0 <= handovers_done < len(curve.sequence):
        return curve
    stations = np.array(curve.station_index)
    due = int(np.count_nonzero(curve.handover_times_s <= present_s))
    late = (curve.leg_index > handovers_done) & (curve.leg_index <= due)
    stations[late] = curve.sequence[handovers_done]
    return Trajectory(curve.control_points_m, curve.durations_s, stations)


def _clear_of_joints(curve: Trajectory, time_s: float) -> tuple[float, float]:
    """The nearest times before and after, or the time itself, at which to split the curve leaves no short piece."""
    before = int(np.searchsorted(curve.knots_s, time_s + _SAME_S, side="right")) - 1
    knot_s = float(curve.knots_s[before])
    if time_s <= knot_s + _SAME_S:
        return knot_s, knot_s
    if time_s >= knot_s + LEAST_PIECE_S:
        return time_s, time_s
    return knot_s, min(knot_s + LEAST_PIECE_S, float(curve.knots_s[before + 1]))


def _until(curve: Trajectory, time_s: float) -> tuple[Array, Array, Indices]:
    """Control points, durations and stations of a curve up to a time of it."""
    parts = curve.split([time_s])
    count = int(np.searchsorted(parts.knots_s, time_s + _SAME_S, side="right")) - 1
    return parts.control_points_m[:count], parts.durations_s[:count], parts.station_index[:count]


def _snapped(rest: Trajectory, place: Array, velocity: Array, acceleration: Array) -> Array:
    """Control points of ``rest``, which begins exactly with that state: what a solver leaves of a residual is gone."""
    points = np.array(rest.control_points_m)
    degree, duration = rest.degree, float(rest.durations_s[0])
    one = velocity * duration / degree
    points[0, 0] = place
    points[0, 1] = place + one
    points[0, 2] = place + 2.0 * one + acceleration * duration**2 / (degree * (degree - 1))
    return points


def _moving(plan: Plan, curve: Trajectory, join_s: float, rest: Plan) -> Replanned | MissionInfeasible:
    degree = max(curve.degree, rest.trajectory.degree)
    points, durations, stations = _until(curve, join_s)
    state = [np.asarray(curve.evaluate(join_s, order)) for order in (0, 1, 2)]
    rest_points = _snapped(rest.trajectory, *state)
    whole = Trajectory(
        np.concatenate([bezier.elevate(points, degree), bezier.elevate(rest_points, degree)]),
        np.concatenate([durations, rest.trajectory.durations_s]),
        np.concatenate([stations, rest.trajectory.station_index]),
    )
    made = _whole(plan, rest, whole, join_s)
    return Replanned(made, join_s, False, join_s) if isinstance(made, Plan) else made


def _standing(plan: Plan, curve: Trajectory, stand_s: float, rest: Plan) -> Replanned | MissionInfeasible:
    """Brake on the path behind ``stand_s``, rest there, go on."""
    place = np.asarray(curve.evaluate(stand_s))
    still = np.zeros(3)
    degree = max(curve.degree, rest.trajectory.degree, QUINTIC)
    rest_points = bezier.elevate(_snapped(rest.trajectory, place, still, still), degree)
    speed = float(np.linalg.norm(curve.evaluate(np.linspace(0.0, stand_s, 200), 1), axis=-1).max())
    result: Replanned | MissionInfeasible | None = None
    for share in BRAKING_SHARES:
        lasts_s = 1.5 * speed / (share * plan.mission.limits.max_accel_m_s2)
        begin_s = _clear_of_joints(curve, max(0.0, stand_s - 0.5 * lasts_s))[0]
        if begin_s == 0.0 and plan.mission.options.start_state is None:
            # From rest to rest, as slowly as need be.
            lasts_s = max(lasts_s, LEAST_PIECE_S)
        else:
            lasts_s = 2.0 * (stand_s - begin_s)
        points, durations, stations = _nothing(degree)
        if begin_s > _SAME_S:
            points, durations, stations = _until(curve, begin_s)
        brake, pieces_s = _braking(curve, begin_s, stand_s, lasts_s, degree)
        ends = curve.station_index[curve.segment_at(np.array([begin_s, stand_s]))]
        # Around a handover the station before it may be the one that covers all of the braking.
        for station in dict.fromkeys(ends[::-1].tolist()):
            whole = Trajectory(
                np.concatenate([bezier.elevate(points, degree), brake, rest_points]),
                np.concatenate([durations, pieces_s, rest.trajectory.durations_s]),
                np.concatenate([stations, np.full(len(pieces_s), station), rest.trajectory.station_index]),
            )
            made = _whole(plan, rest, whole, stand_s)
            if isinstance(made, Plan):
                return Replanned(made, begin_s + lasts_s, True, stand_s)
            result = result or made
    assert result is not None
    return result


def _braking(curve: Trajectory, begin_s: float, stand_s: float, lasts_s: float, degree: int) -> tuple[Array, Array]:
    """The way from ``begin_s`` to rest at ``stand_s`` of the same path: control points and durations of its pieces.

    The rate along the plan falls from its first value to 0 as 1 - 3 u^2 + 2 u^3 with u the share of the time taken,
    ``lasts_s``. That is twice the plan's time, and the first value 1, or more from rest. Each piece is the quintic with
    the right position, velocity and acceleration at both ends.
    """
    if stand_s - begin_s < _SAME_S:
        return np.empty((0, degree + 1, 3)), np.empty(0)
    count = max(1, math.floor(lasts_s / _BRAKING_PIECE_S))
    u = np.linspace(0.0, 1.0, count + 1)
    span_s = 2.0 * (stand_s - begin_s)
    on_plan = begin_s + span_s * (u - u**3 + 0.5 * u**4)
    on_plan[-1] = stand_s
    rate = span_s / lasts_s * (1.0 - 3.0 * u**2 + 2.0 * u**3)
    change = span_s / lasts_s**2 * (-6.0 * u + 6.0 * u**2)
    rate[-1] = change[-1] = 0.0
    place, first, second = (np.asarray(curve.evaluate(on_plan, order)) for order in (0, 1, 2))
    velocity = rate[:, None] * first
    acceleration = (rate**2)[:, None] * second + change[:, None] * first
    each_s = lasts_s / count
    one, two = each_s / QUINTIC, each_s**2 / (QUINTIC * (QUINTIC - 1))
    begin, end = slice(0, -1), slice(1, None)
    points = np.stack(
        [
            place[begin],
            place[begin] + one * velocity[begin],
            place[begin] + 2.0 * one * velocity[begin] + two * acceleration[begin],
            place[end] - 2.0 * one * velocity[end] + two * acceleration[end],
            place[end] - one * velocity[end],
            place[end],
        ],
        axis=1,
    )
    return bezier.elevate(points, degree), np.full(count, each_s)


def _nothing(degree: int) -> tuple[Array, Array, Indices]:
    return np.empty((0, degree + 1, 3)), np.empty(0), np.empty(0, dtype=np.int64)


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
