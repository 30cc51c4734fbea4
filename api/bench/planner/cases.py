"""What is measured on: the missions that ship with the product, and others drawn from a seed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gcs.errors import MissionInfeasible
from gcs.layout import lay_out
from gcs.mission import MissionOptions, read_mission
from planner import Limits, Problem

Array = NDArray[np.float64]

# The paper's own problem, and what a mission gets that asks for nothing.
PAPER_OPTIONS = {"min_overlap_s": 0, "range_margin_m": 0, "min_tenure_s": 0}
DEFAULT_OPTIONS = {name: getattr(MissionOptions(), name) for name in PAPER_OPTIONS}
# Table 2 of Qi, Dou and Xin 2023: stations and side of the square.
SIZES = ((30, 10_000.0), (100, 20_000.0), (300, 30_000.0))
_RANGES_M = (500.0, 1500.0)
_ALTITUDES_M = (100.0, 120.0)
_SPEED_M_S, _ACCEL_M_S2 = 50.0, 5.0
_MAX_DRAWS = 10_000


@dataclass(frozen=True)
class Case:
    """One mission to measure."""

    name: str
    document: Any


def fixed(documents: Sequence[tuple[str, Any]], *, quick: bool = False) -> list[Case]:
    """Missions as given; ``quick``: the first of each number of stations."""
    cases = [Case(name.removesuffix(".json"), document) for name, document in documents]
    cases.sort(key=lambda case: (_station_count(case.document), case.name))
    if not quick:
        return cases
    firsts = {_station_count(case.document): case for case in reversed(cases)}
    return [firsts[count] for count in sorted(firsts)]


def _station_count(document: Any) -> int:
    stations = document.get("stations") if isinstance(document, dict) else None
    return len(stations) if isinstance(stations, list) else 0


def drawn(count: int, seed: int) -> list[Case]:
    """``count`` new missions of each size of the paper's Table 2, the same for the same seed.

    Stations uniform in the square, ranges in [500, 1500] m, antennas on the ground, altitude 100 to 120 m, 50 m/s,
    5 m/s^2; start and destination uniform in the ranges of two stations at least half the square apart. Draws whose
    ranges do not chain together are drawn again, as a mission of the paper has a plan.
    """
    rng = np.random.default_rng(seed)
    cases = []
    for stations, side_m in SIZES:
        for number in range(1, count + 1):
            for _ in range(_MAX_DRAWS):
                document = _draw(rng, f"R{stations}_{number:02d}", stations, side_m)
                if document is not None and _has_a_way(document):
                    cases.append(Case(str(document["name"]), document))
                    break
            else:
                raise RuntimeError(f"no feasible mission of {stations} stations in {_MAX_DRAWS} draws")
    return cases


def _draw(rng: np.random.Generator, name: str, count: int, side_m: float) -> dict[str, Any] | None:
    at = rng.uniform(0.0, side_m, (count, 2))
    ranges = rng.uniform(*_RANGES_M, count)
    first, last = rng.choice(count, 2, replace=False)
    if not _chained(at, ranges, first, last):
        return None
    ends = []
    for station in (first, last):
        angle, up = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(*_ALTITUDES_M)
        radius = math.sqrt(rng.uniform() * max(0.0, ranges[station] ** 2 - up**2))
        place = at[station] + radius * np.array([math.cos(angle), math.sin(angle)])
        ends.append({"east_m": float(place[0]), "north_m": float(place[1]), "up_m": float(up)})
    apart = math.hypot(ends[0]["east_m"] - ends[1]["east_m"], ends[0]["north_m"] - ends[1]["north_m"])
    if apart < 0.5 * side_m:
        return None
    return _document(name, ends, at, ranges)


def _chained(at: Any, ranges: Any, first: int, last: int) -> bool:
    """Whether overlapping discs lead from one station to the other: most draws are sorted out here, quickly."""
    from scipy.sparse.csgraph import connected_components

    reach = np.sqrt(ranges**2 - _ALTITUDES_M[0] ** 2)
    apart = np.linalg.norm(at[:, None] - at[None], axis=-1)
    _, group = connected_components(apart < reach[:, None] + reach[None], directed=False)
    return bool(group[first] == group[last])


def _has_a_way(document: dict[str, Any]) -> bool:
    from planner import InfeasibleError
    from planner.paper import shortest_sequence

    try:
        shortest_sequence(lay_out(read_mission(document)).problem)
    except (InfeasibleError, MissionInfeasible):
        return False
    return True


def chain(segments: int, seed: int) -> Case:
    """A mission that takes ``segments`` stations, each needed: neighbours meet, and no others do.

    The chain wanders: every course differs from the one before by up to 0.5 rad and stays within 0.7 rad of east.
    """
    rng = np.random.default_rng([seed, segments])
    low, _ = _ALTITUDES_M
    ranges = rng.uniform(*_RANGES_M, segments)
    reach = np.sqrt(ranges**2 - low**2)
    at, course = np.zeros((segments, 2)), 0.0
    for k in range(1, segments):
        for _ in range(_MAX_DRAWS):
            turned = float(np.clip(course + rng.uniform(-0.5, 0.5), -0.7, 0.7))
            step = rng.uniform(0.8, 0.95) * (reach[k - 1] + reach[k])
            at[k] = at[k - 1] + step * np.array([math.cos(turned), math.sin(turned)])
            if (np.linalg.norm(at[: k - 1] - at[k], axis=1) > reach[: k - 1] + reach[k]).all():
                course = turned
                break
            # A small range between two large ones: another size for this station.
            ranges[k] = rng.uniform(*_RANGES_M)
            reach[k] = math.sqrt(ranges[k] ** 2 - low**2)
        else:
            raise RuntimeError(f"no chain of {segments} stations in {_MAX_DRAWS} draws")
    ends = [{"east_m": float(e), "north_m": float(n), "up_m": 110.0} for e, n in (at[0], at[-1])]
    return Case(f"chain of {segments}", _document(f"chain of {segments}", ends, at, ranges))


def crowd(stations: int, seed: int) -> Problem:
    """A problem of so many stations, to be crossed from corner to corner.

    Twice as dense as the paper's largest map, whose ranges at that density hardly chain together over long distances.
    The ends are the stations nearest two opposite corners among those that most others are chained to. Built in the
    plane: routing alone is asked of it.
    """
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    from planner.coverage import adjacent_pairs

    rng = np.random.default_rng([seed, stations])
    largest, side = SIZES[-1]
    side_m = side * math.sqrt(stations / largest / 2.0)
    at = rng.uniform(0.0, side_m, (stations, 2))
    problem = Problem(
        start_m=np.array([*at[0], 110.0]),
        destination_m=np.array([*at[0], 110.0]),
        station_positions_m=np.column_stack([at, np.zeros(stations)]),
        ranges_m=rng.uniform(*_RANGES_M, stations),
        limits=Limits(*_ALTITUDES_M, _SPEED_M_S, _ACCEL_M_S2),
    )
    pairs = adjacent_pairs(problem).pairs
    graph = csr_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(stations, stations))
    _, group = connected_components(graph, directed=False)
    chained = np.flatnonzero(group == np.bincount(group).argmax())
    along = at[chained].sum(axis=1)
    first, last = at[chained[along.argmin()]], at[chained[along.argmax()]]
    return replace(problem, start_m=np.array([*first, 110.0]), destination_m=np.array([*last, 110.0]))


def _document(name: str, ends: list[dict[str, float]], at: Array, ranges: Array) -> dict[str, Any]:
    return {
        "name": name,
        "origin": {"lat_deg": 39.96, "lon_deg": 116.32, "alt_amsl_m": 0.0},
        "start": ends[0],
        "destination": ends[1],
        "stations": [
            {"id": f"S{k + 1:03d}", "east_m": float(e), "north_m": float(n), "up_m": 0.0, "range_m": float(r)}
            for k, ((e, n), r) in enumerate(zip(at, ranges, strict=True))
        ],
        "limits": {
            "min_alt_amsl_m": _ALTITUDES_M[0],
            "max_alt_amsl_m": _ALTITUDES_M[1],
            "max_speed_m_s": _SPEED_M_S,
            "max_accel_m_s2": _ACCEL_M_S2,
        },
        "options": dict(PAPER_OPTIONS),
    }
