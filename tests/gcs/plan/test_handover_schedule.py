"""Handovers and ways out on curves worked by hand, in the plane and on the earth."""

from __future__ import annotations

import copy
import itertools
from typing import Any

import numpy as np
import pytest
from geographiclib.geodesic import Geodesic
from hypothesis import given, settings
from hypothesis import strategies as st

from gcs.geodesy.ellipsoid import slant_range_m
from gcs.geodesy.plane import Plane
from gcs.layout.mission_geometry import MissionGeometry, choose_plane
from gcs.mission import read_mission, write_mission
from gcs.mission.model import GeoPosition, Mission
from gcs.plan.contingency import contingencies
from gcs.plan.handover_schedule import schedule
from planner.trajectory import Trajectory
from tests.support.missions.malformed import GOOD, GOOD_LOCAL


def straight(*points: tuple[float, float, float], speed_m_s: float, stations: list[int]) -> Trajectory:
    """Constant speed from point to point (degree 1), each piece under its station."""
    at = np.array(points)
    pieces = np.stack([at[:-1], at[1:]], axis=1)
    return Trajectory(pieces, np.linalg.norm(at[1:] - at[:-1], axis=1) / speed_m_s, np.array(stations))


def two_discs(**station_changes: Any) -> Mission:
    """
    ::

          A's range: x <= 1200        B's range: x >= 800
        A=====================|...                             antennas at the flight's own height, 100 m
        0        800         1000       1200            2000   m east
                  ...|===================================B
    """
    document = copy.deepcopy(GOOD_LOCAL)
    document["start"] |= {"up_m": 100.0}
    document["destination"] |= {"east_m": 2000.0, "up_m": 100.0}
    for station, east in zip(document["stations"], (0.0, 2000.0), strict=True):
        station |= {"east_m": east, "up_m": 100.0, "range_m": 1200.0, **station_changes}
    return read_mission(document)


PATH = straight((0, 0, 100), (1000, 0, 100), (2000, 0, 100), speed_m_s=10.0, stations=[0, 1])


def test_handover_by_hand() -> None:
    mission = two_discs()
    geometry = MissionGeometry(mission, choose_plane(mission))
    (handover,) = schedule(geometry, PATH)
    assert (handover.index, handover.from_station, handover.to_station) == (1, "A", "B")
    assert handover.time_s == 100.0
    # B begins to cover at 800 m east, 80 s; A ends at 1200 m, 120 s
    assert (handover.overlap_start_s, handover.overlap_end_s) == pytest.approx((80.0, 120.0), abs=1e-9)
    assert (handover.margin_from_m, handover.margin_to_m) == pytest.approx((200.0, 200.0), abs=1e-9)
    assert handover.speed_m_s == pytest.approx(10.0, abs=1e-12)
    # due east in the plane; 1 km east of 39.96 N true north has turned by 1000 tan(lat) / R = 0.0075 deg
    assert handover.course_deg == pytest.approx(90.0075, abs=1e-3)
    exact = Geodesic.WGS84.Direct(39.96, 116.32, 90.0, 1000.0)
    assert (handover.lat_deg, handover.lon_deg) == pytest.approx((exact["lat2"], exact["lon2"]), abs=1e-12)
    assert handover.alt_amsl_m == 100.0


def test_windows_stop_at_the_mission_s_ends() -> None:
    mission = two_discs(range_m=5000.0)
    (handover,) = schedule(MissionGeometry(mission, choose_plane(mission)), PATH)
    assert (handover.overlap_start_s, handover.overlap_end_s) == (0.0, 200.0)


def test_a_flight_under_one_station_has_no_handover() -> None:
    mission = two_discs(range_m=5000.0)
    path = straight((0, 0, 100), (2000, 0, 100), speed_m_s=10.0, stations=[0])
    assert schedule(MissionGeometry(mission, choose_plane(mission)), path) == ()


def test_elevation_narrows_the_overlap() -> None:
    """Antennas 100 m below the flight that hear from 10 degrees up: within 100 / tan(10 deg) = 567.13 m."""
    document = copy.deepcopy(GOOD_LOCAL)
    document["start"] |= {"up_m": 100.0}
    document["destination"] |= {"east_m": 1000.0, "up_m": 100.0}
    for station, east in zip(document["stations"], (0.0, 1000.0), strict=True):
        station |= {"east_m": east, "up_m": 0.0, "range_m": 2000.0, "min_elevation_deg": 10.0}
    mission = read_mission(document)
    path = straight((0, 0, 100), (500, 0, 100), (1000, 0, 100), speed_m_s=10.0, stations=[0, 1])
    (handover,) = schedule(MissionGeometry(mission, choose_plane(mission)), path)
    reach = 100.0 / np.tan(np.radians(10.0))
    assert handover.overlap_start_s == pytest.approx((1000.0 - reach) / 10.0, abs=1e-6)
    assert handover.overlap_end_s == pytest.approx(reach / 10.0, abs=1e-6)


@pytest.mark.slow
@settings(max_examples=30)
@given(st.floats(-75, 75), st.floats(-180, 179), st.floats(0, 360), st.floats(2000, 60_000))
def test_windows_on_the_earth_end_where_the_true_range_does(
    lat: float, lon: float, bearing: float, distance: float
) -> None:
    """Just inside the window both true slant ranges hold, just outside one of them does not."""
    ends = [Geodesic.WGS84.Direct(lat, lon, bearing, d) for d in (0.0, distance)]
    document = copy.deepcopy(GOOD)
    for station, end in zip(document["stations"], ends, strict=True):
        station |= {"lat_deg": end["lat2"], "lon_deg": end["lon2"], "range_m": 0.7 * distance + 300.0}
    for name, end in zip(("start", "destination"), ends, strict=True):
        document[name] |= {"lat_deg": end["lat2"], "lon_deg": end["lon2"]}
    document["safe_points"] = []
    mission = read_mission(document)
    geometry = MissionGeometry(mission, choose_plane(mission))
    start, stop = geometry.enu_m([mission.start, mission.destination])
    path = straight(tuple(start), tuple((start + stop) / 2), tuple(stop), speed_m_s=25.0, stations=[0, 1])
    (handover,) = schedule(geometry, path)
    antenna = [s.position for s in mission.stations]

    def left_m(time_s: float, k: int) -> float:
        place = geometry.geo(path.evaluate(time_s))
        at = antenna[k]
        assert isinstance(at, GeoPosition)
        slant = slant_range_m(place.lat_deg, place.lon_deg, place.alt_amsl_m, at.lat_deg, at.lon_deg, at.alt_amsl_m)
        return mission.stations[k].range_m - float(slant)

    assert handover.margin_from_m == pytest.approx(left_m(handover.time_s, 0), abs=1e-6)
    assert handover.margin_to_m == pytest.approx(left_m(handover.time_s, 1), abs=1e-6)
    for edge, k, step in ((handover.overlap_start_s, 1, -1e-6), (handover.overlap_end_s, 0, 1e-6)):
        assert 0.0 < edge < path.duration_s
        assert abs(left_m(edge, k)) < 1e-5
        assert left_m(edge, k) >= -1e-7
        assert left_m(edge + step, k) < 0.0
    # Ground speed at the altitude flown: 25 m/s, longer by h / R, shorter by the plane's stretch.
    assert handover.speed_m_s == pytest.approx(25.0, rel=1e-4)


def test_the_plane_of_a_mission_lies_in_its_middle() -> None:
    """Across the antimeridian too: 179 E to 179 W has its middle at 180."""
    document = copy.deepcopy(GOOD)
    places = [document["start"], document["destination"], *document["stations"], *document["safe_points"]]
    for place, lon in zip(places, (179.9, -179.9, 179.9, -179.9, -179.9), strict=True):
        place |= {"lat_deg": 10.0, "lon_deg": lon}
    plane = choose_plane(read_mission(document))
    assert abs(abs(plane.lon_deg) - 180.0) < 1e-3
    assert plane.lat_deg == pytest.approx(10.0, abs=1e-3)
    assert plane.alt_amsl_m == 0.0
    assert choose_plane(read_mission(GOOD_LOCAL)) == Plane(39.96, 116.32, 0.0)


# --- ways out --------------------------------------------------------------------------------------------------


def with_safe_points(mission: Mission, **places: tuple[float, float]) -> MissionGeometry:
    document = write_mission(mission)
    document["safe_points"] = [
        {"id": name, "east_m": east, "north_m": north, "up_m": 0.0} for name, (east, north) in places.items()
    ]
    changed = read_mission(document)
    return MissionGeometry(changed, choose_plane(changed))


def test_ways_out_by_hand() -> None:
    """A field under A, one under B: back to A's at first, on to B's later; each 100 m down at 10 m/s at the end."""
    mission = two_discs()
    document = write_mission(mission)
    document["limits"] = {**GOOD_LOCAL["limits"], "max_speed_m_s": 10.0, "max_accel_m_s2": 2.0}
    geometry = with_safe_points(read_mission(document), west=(0.0, 0.0), east=(2000.0, 0.0))
    ways = contingencies(geometry, PATH)
    assert ways[0].from_s == 0.0
    assert ways[-1].to_s == 200.0
    assert [(a.to_s, b.from_s) for a, b in itertools.pairwise(ways)] == [(a.to_s, a.to_s) for a in ways[:-1]]
    assert {way.safe_point for way in ways[:1]} == {"west"}
    assert ways[-1].safe_point == "east"
    assert all(way.covered for way in ways)
    # from the very end: over the field already; 10 m of slack, 100 m down at 10 m/s, 10 s to stop and get going
    assert ways[-1].duration_s >= 20.0
    # the switch is where the other field is 1.3 times (and 10 s) quicker, not at every metre
    assert len(ways) == 2


def test_a_safe_point_out_of_range_is_not_flown_to() -> None:
    """The only field lies 3 km north: no station covers the way, so back along the path it is."""
    ways = contingencies(with_safe_points(two_discs(), north=(1000.0, 3000.0)), PATH)
    (way,) = ways
    assert (way.action, way.safe_point, way.covered) == ("return", None, True)
    assert way.straight_home_covered
    # 2000 m back at 50 m/s, and 2 x 50 / 5 s to stop and get going
    assert way.duration_s == pytest.approx(2000.0 / 50.0 + 20.0, abs=0.5)


def test_a_detour_home_is_seen_to_be_uncovered() -> None:
    """
    ::

        B o---.         the path goes round a corner of three discs; the straight line home from D
              |         crosses a hole
        A o   D o
    """
    document = write_mission(two_discs())
    document["stations"] = [
        {"id": name, "east_m": east, "north_m": north, "up_m": 100.0, "range_m": 800.0}
        for name, east, north in (("A", 0, 0), ("B", 0, 1500), ("C", 1500, 1500), ("D", 3000, 0))
    ]
    mission = read_mission(document)
    path = straight(
        (0, 0, 100),
        (0, 750, 100),
        (0, 1500, 100),
        (750, 1500, 100),
        (1500, 1500, 100),
        speed_m_s=10,
        stations=[0, 1, 1, 2],
    )
    ways = contingencies(MissionGeometry(mission, choose_plane(mission)), path)
    assert [way.action for way in ways] == ["return"]
    assert not ways[0].straight_home_covered
    assert ways[0].covered


def test_return_leaves_the_path_where_a_field_is_near() -> None:
    """A field beside the path at 1300 m: later on, where the straight way to it is not covered, back there and over."""
    document = write_mission(two_discs())
    document["stations"] = [
        {"id": name, "east_m": east, "north_m": north, "up_m": 100.0, "range_m": 620.0}
        for name, east, north in (("A", 0, 0), ("B", 1000, 0), ("C", 2000, 0), ("N", 1200, 1000))
    ]
    document["limits"] = {**GOOD_LOCAL["limits"], "max_speed_m_s": 10.0}
    mission = read_mission(document)
    path = straight((0, 0, 100), (500, 0, 100), (1500, 0, 100), (2000, 0, 100), speed_m_s=10.0, stations=[0, 1, 2])
    ways = contingencies(with_safe_points(mission, field=(1300.0, 900.0)), path)
    last = ways[-1]
    assert (last.action, last.safe_point) == ("return", "field")
    assert last.leave_path_s is not None
    assert 110.0 < last.leave_path_s < 190.0
    assert any(way.action == "divert" and way.safe_point == "field" for way in ways)


@settings(max_examples=40)
@given(st.integers(0, 2**31))
def test_ways_out_said_to_be_covered_are(seed: int) -> None:
    """Random stations and fields along a path: every divert, from any time of its span, stays in some range."""
    rng = np.random.default_rng(seed)
    document = write_mission(two_discs())
    document["stations"] = [
        {
            "id": f"s{k}",
            "east_m": 800.0 * k,
            "north_m": float(rng.uniform(-300, 300)),
            "up_m": float(rng.uniform(0, 50)),
            "range_m": float(rng.uniform(700, 1500)),
            **({"min_elevation_deg": float(rng.uniform(1, 4))} if rng.random() < 0.3 else {}),
        }
        for k in range(5)
    ]
    mission = read_mission(document)
    fields = {f"f{k}": (float(rng.uniform(-500, 4000)), float(rng.uniform(-1500, 1500))) for k in range(4)}
    geometry = with_safe_points(mission, **fields)
    path = straight((0, 0, 110), (1600, 200, 105), (3200, -100, 115), speed_m_s=40.0, stations=[0, 3])
    everywhere = np.arange(len(mission.stations))
    for way in contingencies(geometry, path):
        assert way.covered
        if way.action == "divert":
            target = np.array([*fields[way.safe_point or ""], 0.0])
            for time in np.linspace(way.from_s, way.to_s, 7):
                begin = path.evaluate(time)
                over = np.array([target[0], target[1], begin[2]])
                u = np.linspace(0, 1, 60)[:, None]
                line = np.concatenate([begin + u * (over - begin), over + u * (target - over)])
                outside = geometry.outside_m(everywhere[:, None], np.broadcast_to(line, (len(everywhere), *line.shape)))
                assert outside.min(axis=0).max() <= 1e-9
        if way.straight_home_covered:
            for time in np.linspace(way.from_s, way.to_s, 7):
                begin, home = path.evaluate(time), path.evaluate(0.0)
                line = begin + np.linspace(0, 1, 60)[:, None] * (np.array([home[0], home[1], begin[2]]) - begin)
                outside = geometry.outside_m(everywhere[:, None], np.broadcast_to(line, (len(everywhere), *line.shape)))
                assert outside.min(axis=0).max() <= 1e-9
