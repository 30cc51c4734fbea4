"""The handover schedule: when, where, between whom, how long both cover the vehicle, and how much range is left.

Coverage windows are roots, not samples. In a local mission they are the roots of the squared distance polynomial
(`planner.coverage.window`). In a WGS84 mission two such windows, of a ball inside and of a ball outside the true range
(`gcs.geodesy.range_bounds`), enclose each end, and the end itself is the root of the true slant range between the two.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import elementwise

from gcs.layout.mission_geometry import MissionGeometry
from planner import Trajectory
from planner.arrays import Array, Indices
from planner.coverage import Stations, coverage_windows

# Looks inside the enclosure of a window's end, and inside a window where elevation counts.
_LOOKS = 17
_ELEVATION_STEP_S = 0.5
# A vehicle this far outside a range is at its edge.
_ROUNDING_M = 1e-9


@dataclass(frozen=True)
class Handover:
    """One change of the station in control.

    ``index`` counts from 1. Both stations truly cover the vehicle from ``overlap_start_s`` to ``overlap_end_s``
    (full ranges); ``margin_from_m`` and ``margin_to_m`` are the range left at ``time_s``. Speed is over ground and
    climb together, the course is true, 0 to 360 degrees (0 when hovering).
    """

    index: int
    time_s: float
    from_station: str
    to_station: str
    lat_deg: float
    lon_deg: float
    alt_amsl_m: float
    speed_m_s: float
    course_deg: float
    overlap_start_s: float
    overlap_end_s: float
    margin_from_m: float
    margin_to_m: float

    def to_document(self) -> dict[str, object]:
        """As in the plan document."""
        return {
            "index": self.index,
            "time_s": self.time_s,
            "from": self.from_station,
            "to": self.to_station,
            "position": {"lat_deg": self.lat_deg, "lon_deg": self.lon_deg, "alt_amsl_m": self.alt_amsl_m},
            "speed_m_s": self.speed_m_s,
            "course_deg": self.course_deg,
            "overlap": {"start_s": self.overlap_start_s, "end_s": self.overlap_end_s},
            "margin": {"from_m": self.margin_from_m, "to_m": self.margin_to_m},
        }


def schedule(geometry: MissionGeometry, trajectory: Trajectory) -> tuple[Handover, ...]:
    """Every handover of a trajectory whose station indices are those of the mission."""
    times = trajectory.handover_times_s
    if not len(times):
        return ()
    sequence = np.array(trajectory.sequence)
    before, after = sequence[:-1], sequence[1:]
    # The windows of both stations around every handover, from-stations first.
    early, late = _windows(geometry, trajectory, np.concatenate([before, after]), np.concatenate([times, times]))
    count = len(times)
    start = np.maximum(early[:count], early[count:])
    end = np.minimum(late[:count], late[count:])
    place = trajectory.evaluate(times)
    lat, lon, speed, course = _motion(geometry, place, trajectory.evaluate(times, 1))
    left_from = geometry.full_ranges_m[before] - geometry.true_range_m(before, place)
    left_to = geometry.full_ranges_m[after] - geometry.true_range_m(after, place)
    altitude = geometry.plane.altitude_amsl_m(place[:, 2])
    ids = [station.id for station in geometry.mission.stations]
    return tuple(
        Handover(
            index=k + 1,
            time_s=float(times[k]),
            from_station=ids[before[k]],
            to_station=ids[after[k]],
            lat_deg=float(lat[k]),
            lon_deg=float(lon[k]),
            alt_amsl_m=float(altitude[k]),
            speed_m_s=float(speed[k]),
            course_deg=float(course[k]),
            overlap_start_s=float(start[k]),
            overlap_end_s=float(end[k]),
            margin_from_m=float(left_from[k]),
            margin_to_m=float(left_to[k]),
        )
        for k in range(count)
    )


def _motion(geometry: MissionGeometry, place: Array, velocity: Array) -> tuple[Array, Array, Array, Array]:
    """Latitude, longitude, speed and true course at plane points ``(N, 3)``."""
    altitude = geometry.plane.altitude_amsl_m(place[:, 2])
    lat, lon, axes = geometry.plane.geodetic_and_axes(place[:, 0], place[:, 1], altitude)
    true = np.einsum("nij,nj->ni", axes, velocity[:, :2])
    flat = np.hypot(true[:, 0], true[:, 1])
    course = np.where(flat > 1e-6, np.degrees(np.arctan2(true[:, 0], true[:, 1])) % 360.0, 0.0)
    course[course >= 360.0] = 0.0
    speed = np.linalg.norm(velocity, axis=1) if geometry.is_local else np.hypot(flat, velocity[:, 2])
    return lat, lon, speed, course


def _windows(geometry: MissionGeometry, trajectory: Trajectory, stations: Indices, times: Array) -> tuple[Array, Array]:
    """The longest spans around ``times`` in which each of ``stations`` truly covers the vehicle."""
    at, full, mask = geometry.stations_enu_m, geometry.full_ranges_m, geometry.elevation_mask.at(stations)

    def around(radius: Array, *, cone: bool) -> tuple[Array, Array]:
        covering = Stations(at[stations], radius[stations], mask if cone else None)
        return coverage_windows(trajectory, covering, times, slack_m=_ROUNDING_M)

    if geometry.is_local:
        return around(full, cone=True)
    early, late = around(geometry.inner_ranges_m(full), cone=False)
    sooner, later = around(geometry.outer_ranges_m(full), cone=False)
    late = _first_outside(geometry, trajectory, stations, late, np.maximum(later, late), _LOOKS)
    early = _first_outside(geometry, trajectory, stations, early, np.minimum(sooner, early), _LOOKS)
    which = np.flatnonzero(mask.limited)
    if len(which):
        looks = 2 + int(trajectory.duration_s / _ELEVATION_STEP_S)
        late[which] = _first_outside(geometry, trajectory, stations[which], times[which], late[which], looks)
        early[which] = _first_outside(geometry, trajectory, stations[which], times[which], early[which], looks)
    return early, late


def _first_outside(
    geometry: MissionGeometry,
    trajectory: Trajectory,
    stations: Indices,
    from_s: Array,
    to_s: Array,
    looks: int,
) -> Array:
    """Going from ``from_s`` to ``to_s``: where coverage is first lost, ``to_s`` where it never is.

    ``from_s`` itself where there is none there: in range, but too low over the horizon.
    """
    grid = from_s[:, None] + (to_s - from_s)[:, None] * np.linspace(0.0, 1.0, looks)
    lost = geometry.outside_m(stations[:, None], trajectory.evaluate(grid)) > 0
    result = np.where(lost[:, 0], from_s, to_s)
    which = np.flatnonzero(lost.any(axis=1) & ~lost[:, 0])
    if len(which):
        first = lost[which].argmax(axis=1)
        a, b = grid[which, first - 1], grid[which, first]

        def outside(time: Array, station: Array) -> Array:
            return geometry.outside_m(station.astype(np.int64), trajectory.evaluate(time))

        found = elementwise.find_root(
            outside, (a, b), args=(stations[which].astype(float),), tolerances={"xatol": 1e-10, "fatol": 1e-9}
        )
        result[which] = found.x
    return result
