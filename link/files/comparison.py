"""What was flown against what was planned: nearest points of the path, errors at each moment, range left."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from gcs.plan import Plan
from link.files.flight_log import Heard, Sent, station_names
from link.files.log_damage import LogDamage
from planner.arrays import Array, Flags, Indices

PATH_STEP_S = 0.02
ON_PATH_M = 0.5


@dataclass(frozen=True)
class TrackingErrors:
    """At each position heard: its distance from where it was asked to be, behind along the path, and beside it."""

    time_s: Array
    place: Array
    error_m: Array
    behind_m: Array
    beside_m: Array


def to_plane(plan: Plan, lat_deg: Array, lon_deg: Array, alt_amsl_m: Array) -> Array:
    """``(N, 3)``: places in the plan's plane, east, north, up."""
    east, north = plan.plane.to_plane(lat_deg, lon_deg)
    return np.stack([east, north, alt_amsl_m - plan.plane.alt_amsl_m], axis=-1)


class PlannedPath:
    """The planned path, for nearest points."""

    def __init__(self, plan: Plan) -> None:
        count = max(2, math.ceil(plan.mission_time_s / PATH_STEP_S) + 1)
        self._times = np.linspace(0.0, plan.mission_time_s, count)
        self._curve = plan.trajectory
        self._tree = cKDTree(plan.trajectory.evaluate(self._times))

    def nearest(self, places: Array) -> tuple[Array, Array]:
        """Times of the plan and distances (m) of the nearest points, refined between the samples."""
        if not len(places):
            return np.array([]), np.array([])
        _, index = self._tree.query(places)
        time = self._times[index]
        for _ in range(2):
            # One Newton step each along the tangent.
            off = places - self._curve.evaluate(time)
            velocity = self._curve.evaluate(time, 1)
            speed2 = np.maximum(np.einsum("ni,ni->n", velocity, velocity), 1e-6)
            step = np.einsum("ni,ni->n", off, velocity) / speed2
            time = np.clip(time + np.clip(step, -PATH_STEP_S, PATH_STEP_S), 0.0, self._times[-1])
        return time, np.linalg.norm(places - self._curve.evaluate(time), axis=-1)


def launch_time_s(time_s: Array, plan_s: Array, off_m: Array, plan: Plan) -> float:
    """When T+0 was: setpoints well under way tell, those at rest at the start do not."""
    total = plan.mission_time_s
    early = (off_m <= ON_PATH_M) & (plan_s >= min(2.0, 0.05 * total)) & (plan_s <= min(30.0, 0.5 * total))
    first = np.flatnonzero(early)
    if not len(first):
        return float(time_s[0])
    # The first pass alone: a flight may come back over the same ground.
    first = first[time_s[first] <= time_s[first[0]] + 60.0]
    return float(np.median(time_s[first] - plan_s[first]))


def last_moving(flown: Flags, place: Array, velocity_m_s: Array, plan: Plan) -> int:
    """The index where the stream of the plan ends: its first sample at rest at the end, or the last one on the path."""
    from_end = np.linalg.norm(place - plan.trajectory.evaluate(plan.mission_time_s), axis=-1)
    arrived = np.flatnonzero(flown & (from_end < 0.1) & (np.linalg.norm(velocity_m_s, axis=-1) < 1e-5))
    return int(arrived[0]) if len(arrived) else int(np.flatnonzero(flown)[-1])


def tracking_errors(
    heard: Heard, sent: Sent, arrived_s: Array, place: Array, plan: Plan, span_s: tuple[float, float]
) -> TrackingErrors:
    """The errors within ``span_s`` of the log's clock; setpoints at ``place`` reached the vehicle at ``arrived_s``."""
    inside = (heard.time_s >= max(span_s[0], float(arrived_s[0]))) & (heard.time_s <= span_s[1])
    time_s = heard.time_s[inside]
    here = to_plane(plan, heard.lat_deg[inside], heard.lon_deg[inside], heard.alt_amsl_m[inside])
    # At a handover from a slow link to a quick one the new station's first setpoints overtake the old one's last.
    arrived_s = np.maximum.accumulate(arrived_s)
    at = np.clip(np.searchsorted(arrived_s, time_s, side="right") - 1, 0, len(arrived_s) - 1)
    carry = np.clip(time_s - arrived_s[at], 0.0, 1.0)
    # Between setpoints the reference moves on: to the next one where there is one soon.
    after = np.minimum(at + 1, len(arrived_s) - 1)
    step = arrived_s[after] - arrived_s[at]
    share = np.where((step > 0) & (step < 0.5), carry / np.maximum(step, 1e-9), 0.0)[:, None]
    asked = place[at] + share * (place[after] - place[at])
    off = here - asked
    velocity = sent.velocity_m_s[at]
    speed = np.linalg.norm(velocity, axis=-1)
    along = np.where(speed[:, None] > 0.5, velocity / np.maximum(speed, 1e-9)[:, None], 0.0)
    ahead = np.einsum("ni,ni->n", off, along)
    return TrackingErrors(
        time_s, here, np.linalg.norm(off, axis=-1), -ahead, np.linalg.norm(off - ahead[:, None] * along, axis=-1)
    )


@dataclass(frozen=True)
class Margins:
    """Range left to the station in control at each position heard, m; ``station``: its index in the mission."""

    time_s: Array
    left_m: Array
    station: Indices


def margins_m(heard: Heard, sent: Sent, plan: Plan, from_s: float, to_s: float) -> Margins:
    """The range left within a span of the log's clock."""
    inside = (heard.time_s >= from_s) & (heard.time_s <= to_s)
    places = to_plane(plan, heard.lat_deg[inside], heard.lon_deg[inside], heard.alt_amsl_m[inside])
    at = np.clip(np.searchsorted(sent.time_s, heard.time_s[inside], side="right") - 1, 0, len(sent.time_s) - 1)
    names = station_names(plan)
    index = np.array([plan.mission.station_index(names[int(i)]) for i in sent.system_id[at]], dtype=np.int64)
    left = -plan.geometry.outside_m(index, places) if len(index) else np.array([])
    return Margins(heard.time_s[inside], left, index)


def least_margin(margins: Margins, plan: Plan) -> tuple[float | None, str | None]:
    """The least range left, m, and the station it was left to; None where no position was heard."""
    if not len(margins.left_m):
        return None, None
    worst = int(margins.left_m.argmin())
    return float(margins.left_m[worst]), plan.mission.stations[margins.station[worst]].id


def seen_only(heard: Heard, damage: LogDamage) -> Heard:
    """Without holes of the log: where setpoints are missing nothing can be held against the vehicle."""
    seen = np.array([not damage.hides(t, t) for t in heard.time_s], dtype=bool)
    return Heard(*(getattr(heard, name)[seen] for name in heard.__dataclass_fields__))


def gaps_s(sent: Sent, damage: LogDamage) -> list[float]:
    """Times between setpoints, where the log has no hole."""
    ends = [(float(low), float(high)) for low, high in itertools.pairwise(sent.time_s)]
    return [high - low for low, high in ends if not damage.hides(low, high)]
