"""Problems for the planner's tests: the paper-like missions read from their JSON, and small hand-made scenes."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from geographiclib.geodesic import Geodesic

from planner import Corridor, Limits, Problem, Solution, build_corridor
from planner.paper import shortest_sequence
from tests.support.paths import MISSIONS

PAPER_LIKE = tuple(sorted(path.stem for path in (MISSIONS / "paper_like").glob("*.json")))


def paper_problem(
    name: str,
    *,
    margin_m: float = 0.0,
    min_overlap_s: float = 0.0,
    min_tenure_s: float = 0.0,
    limits: dict[str, Any] | None = None,
) -> Problem:
    """A paper-like mission (``"M30_01"`` .. ``"M300_10"``) in its local plane, ranges less ``margin_m``."""
    document = json.loads((MISSIONS / "paper_like" / f"{name}.json").read_text(encoding="utf-8"))
    base = document["origin"]["alt_amsl_m"]
    given = document["limits"]
    stations = document["stations"]
    return Problem(
        start_m=_local(document["start"]),
        destination_m=_local(document["destination"]),
        station_positions_m=np.array([_local(station) for station in stations]),
        ranges_m=np.array([station["range_m"] - margin_m for station in stations]),
        limits=Limits(
            min_alt_m=given["min_alt_amsl_m"] - base,
            max_alt_m=given["max_alt_amsl_m"] - base,
            max_speed_m_s=given["max_speed_m_s"],
            max_accel_m_s2=given["max_accel_m_s2"],
            **(limits or {}),
        ),
        min_overlap_s=min_overlap_s,
        min_tenure_s=min_tenure_s,
    )


def wadden_problem(*, margin_m: float = 25.0, min_overlap_s: float = 5.0, min_tenure_s: float = 10.0) -> Problem:
    """The Wadden Sea mission: 14 stations, ranges of 12 to 21 km, 150 km to fly.

    In an azimuthal-equidistant plane around its start, good enough for a test of the mathematics.
    """
    document = json.loads((MISSIONS / "wadden_relay.json").read_text(encoding="utf-8"))
    origin, limits = document["start"], document["limits"]

    def plane(position: dict[str, float]) -> list[float]:
        line = Geodesic.WGS84.Inverse(origin["lat_deg"], origin["lon_deg"], position["lat_deg"], position["lon_deg"])
        azimuth = np.radians(line["azi1"])
        return [line["s12"] * np.sin(azimuth), line["s12"] * np.cos(azimuth), position["alt_amsl_m"]]

    rows = [[*plane(station), station["range_m"] - margin_m] for station in document["stations"]]
    return make_problem(
        plane(document["start"]),
        plane(document["destination"]),
        rows,
        band=(limits["min_alt_amsl_m"], limits["max_alt_amsl_m"]),
        speed_m_s=limits["max_speed_m_s"],
        accel_m_s2=limits["max_accel_m_s2"],
        min_overlap_s=min_overlap_s,
        min_tenure_s=min_tenure_s,
    )


def _local(position: dict[str, float]) -> list[float]:
    return [position["east_m"], position["north_m"], position["up_m"]]


def make_problem(
    start: Sequence[float],
    destination: Sequence[float],
    stations: Sequence[Sequence[float]],
    *,
    band: tuple[float, float] = (100.0, 120.0),
    speed_m_s: float = 50.0,
    accel_m_s2: float = 5.0,
    limits: dict[str, Any] | None = None,
    **options: Any,
) -> Problem:
    """A small scene: ``stations`` are rows (east, north, altitude, range); other options go to `Problem`."""
    rows = np.asarray(stations, dtype=float)
    return Problem(
        start_m=np.asarray(start, dtype=float),
        destination_m=np.asarray(destination, dtype=float),
        station_positions_m=rows[:, :3],
        ranges_m=rows[:, 3],
        limits=Limits(band[0], band[1], speed_m_s, accel_m_s2, **(limits or {})),
        **options,
    )


# Scenes at the edge of what there is; each has a plan.
HARD_SCENES = {
    "tangent": make_problem([0, 0, 100], [1000, 0, 100], [[0, 0, 100, 500], [1000 - 1.001e-3, 0, 100, 500]]),
    "tangent far away": make_problem(
        [3e5, 0, 100], [3e5 + 1e5, 0, 100], [[3e5, 0, 100, 5e4], [3e5 + 1e5 - 1.01e-3, 0, 100, 5e4]]
    ),
    "coincident": make_problem([0, 0, 100], [900, 0, 100], [[0, 0, 0, 600], [0, 0, 0, 600], [900, 0, 0, 600]]),
    "start is destination": make_problem([5, 5, 110], [5, 5, 110], [[0, 0, 0, 600], [0, 10, 0, 600]]),
    "flat band": make_problem([0, 0, 100], [900, 50, 100], [[0, 0, 0, 600], [900, 0, 0, 600]], band=(100.0, 100.0)),
    "a millimetre of band": make_problem(
        [0, 0, 100], [900, 50, 100.001], [[0, 0, 0, 600], [900, 0, 0, 600]], band=(100.0, 100.001)
    ),
    "ends on the edge": make_problem([-500, 0, 100], [1400, 0, 100], [[0, 0, 100, 500], [900, 0, 100, 500]]),
    "cap barely in the band": make_problem([0, 0, 100], [1, 0, 100], [[0, 0, 0, 100.00001], [1, 0, 0, 100.01]]),
    "one inside the other": make_problem([0, 0, 100], [10, 0, 100], [[0, 0, 0, 5000], [10, 0, 80, 30]]),
    "elevation": make_problem(
        [0, 0, 150],
        [500, 0, 150],
        [[0, 0, 0, 600], [500, 0, 0, 600]],
        band=(100, 300),
        min_elevation_deg=np.array([30.0, 0.0]),
    ),
}
# The way through, where Dijkstra's is not the point.
HARD_SEQUENCES = {
    "coincident": (0, 1, 2),
    "elevation": (0, 1),
    "start is destination": (0, 1),
    "one inside the other": (0, 1),
}


def corridor_of(problem: Problem, **options: Any) -> Corridor:
    """The corridor along Dijkstra's sequence."""
    return build_corridor(problem, shortest_sequence(problem), **options)


def random_chain(seed: int) -> Problem | None:
    """A hostile chain of one to six stations; None where the drawn heights share no altitude of the band.

    Ranges from 3 m to 3,000 km, up to a thousandfold apart in one scene; antennas below, in and above the band; bands
    from none to a range high; overlaps from a millimetre to a whole range deep; coincident stations; ends on the very
    edge of range and band; limits, overlap and tenure far too large or small for the distances.
    """
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 7))
    scale = 10 ** rng.uniform(1, 5)
    spread = 0.3 if rng.random() < 0.7 else 1.5
    ranges = scale * 10 ** rng.uniform(-spread, spread, count)
    floor = float(rng.choice([0.0, 100.0, 0.5 * ranges.min()]))
    width = float(rng.choice([0.0, 1e-6, 1e-3, 1.0, 20.0, ranges.min()]))
    heights = [
        np.zeros(count),
        rng.uniform(0.0, floor + width, count),
        np.full(count, floor + 0.5 * width),
        floor + rng.uniform(-0.5, 0.5, count) * ranges,
    ][int(rng.integers(0, 4))]
    altitudes = np.linspace(floor, floor + width, 201)

    def radii(k: int) -> np.ndarray:
        return np.sqrt(np.maximum(ranges[k] ** 2 - (altitudes - heights[k]) ** 2, 0.0))

    positions = np.column_stack([np.full((count, 2), float(rng.choice([0.0, 1e4, 3e5]))), heights])
    course = rng.uniform(0, 2 * np.pi)
    for k in range(1, count):
        course += rng.normal()
        shared = (np.abs(altitudes - heights[[k - 1, k]][:, None]) <= ranges[[k - 1, k]][:, None]).all(axis=0)
        if not shared.any():
            return None
        reach = float((radii(k - 1) + radii(k))[shared].max())
        depth = float(rng.choice([1.01e-3, 2e-3, 0.1, 0.2 * reach, 0.7 * reach, reach]))
        step = max(reach - depth, 0.0)
        positions[k, :2] = positions[k - 1, :2] + step * np.array([np.cos(course), np.sin(course)])

    def end(k: int) -> list[float]:
        altitude = float(rng.choice([floor, floor + width, rng.uniform(floor, floor + width)]))
        altitude = float(
            np.clip(np.clip(altitude, *(heights[k] + ranges[k] * np.array([-1, 1]))), floor, floor + width)
        )
        radius = np.sqrt(max(ranges[k] ** 2 - (altitude - heights[k]) ** 2, 0.0)) * rng.choice(
            [0.0, 1 - 1e-12, rng.random()]
        )
        angle = rng.uniform(0, 2 * np.pi)
        return [positions[k, 0] + radius * np.cos(angle), positions[k, 1] + radius * np.sin(angle), altitude]

    start = end(0)
    speed = 10 ** rng.uniform(0, 2.5)
    limits: dict[str, Any] = {}
    if rng.random() < 0.3:
        limits["max_jerk_m_s3"] = 10 ** rng.uniform(-1, 2)
    if rng.random() < 0.3:
        limits["max_climb_m_s"] = speed * 10 ** rng.uniform(-2, 0.5)
    if rng.random() < 0.3:
        limits["max_descent_m_s"] = speed * 10 ** rng.uniform(-2, 0.5)
    if rng.random() < 0.3:
        limits["max_airspeed_m_s"] = speed * rng.uniform(0.7, 1.5)
        limits["wind_m_s"] = tuple(float(w) for w in speed * rng.uniform(-0.4, 0.4, 2))
    options: dict[str, Any] = {}
    if rng.random() < 0.15:
        options["min_elevation_deg"] = rng.choice([-90.0, 0.0, 3.0, 10.0], count)
    return make_problem(
        start,
        end(count - 1) if rng.random() < 0.9 else start,
        np.column_stack([positions, ranges]),
        band=(floor, floor + width),
        speed_m_s=speed,
        accel_m_s2=10 ** rng.uniform(-1, 1.5),
        limits=limits,
        min_overlap_s=float(rng.choice([0.0, 0.0, 5.0, 0.01, 60.0])),
        min_tenure_s=float(rng.choice([0.0, 0.0, 10.0, 300.0])),
        **options,
    )


def scene(*stations: tuple[float, float, float, float], **options: object) -> Problem:
    """Ends at the first and last station's axes, 100 m up, band 100 to 120 m."""
    first, last = stations[0], stations[-1]
    return make_problem([first[0], first[1], 100], [last[0], last[1], 100], stations, **options)


def digest(solution: Solution) -> str:
    """A hash of a plan's every bit."""
    trajectory = solution.trajectory
    return hashlib.sha256(
        trajectory.control_points_m.tobytes() + trajectory.durations_s.tobytes() + trajectory.station_index.tobytes()
    ).hexdigest()
