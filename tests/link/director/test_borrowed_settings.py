"""Rally points and fences: uploaded and read back before the flight, judged, and given back after it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from gcs.flight import FlightState
from sitl_fixtures.mavlink import FENCE, RALLY, Item
from tests.support.flights.on_ground import FIELDS, GROUND_M, checks, on_ground, safe_plan
from tests.support.flights.virtual import Proxy, VirtualFlight
from tests.support.plans.planned import relay_plan

BOTH = pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
OLD = Item(5100, 3, (0.0, 0.0, 0.0, 0.0), 529_505_000, 47_905_000, 12.0)
BAD = {"loss": 0.15, "latency_s": 0.05, "jitter_s": 0.1, "duplicates": 0.1}


def flight_with(
    autopilot: str,
    *,
    rally: tuple[Item, ...] = (),
    fence: tuple[Item, ...] = (),
    limit_s: float = 400.0,
    **settings: Any,
) -> VirtualFlight:
    """A flight whose vehicle holds lists already; judged, waiting for its word."""
    request = {"auto_launch": False, **settings.pop("request", {})}
    one = VirtualFlight(settings.pop("plan", None) or safe_plan(), autopilot, frugal=True, request=request, **settings)
    one.vehicle.missions.plans[RALLY] = list(rally)
    one.vehicle.missions.plans[FENCE] = list(fence)
    one.run(until=lambda: one.core.state is FlightState.READY, limit_s=limit_s)
    return one


def held(one: VirtualFlight, kind: int = RALLY) -> list[tuple[int, int, float]]:
    return [(i.x, i.y, i.z) for i in one.vehicle.missions.plans[kind]]


# -- rally points -----------------------------------------------------------------------------------------------------


@BOTH
@pytest.mark.parametrize("links", ["good", "bad"])
def test_the_covered_safe_points_become_rally_points_and_go_again_after_the_flight(autopilot: str, links: str) -> None:
    one = on_ground(autopilot, proxy=Proxy(seed=5, **(BAD if links == "bad" else {})))
    plan = one.plan
    expected = []
    for point in plan.mission.safe_points:
        if point.id in FIELDS:
            place = plan.geometry.geo(plan.geometry.enu_m([point.position])[0])
            # PX4 takes it above sea level; ArduPilot above home, which is 35 m up: 28 m is below it.
            altitude_m = GROUND_M if autopilot == "px4" else 0.0
            expected.append((round(place.lat_deg * 1e7), round(place.lon_deg * 1e7), altitude_m))
    found = sorted(held(one))
    assert len(found) == len(FIELDS)
    for item, wanted in zip(found, sorted(expected), strict=True):
        assert item == pytest.approx(wanted, abs=0.01)
    told = checks(one)
    assert told["rally points"]["level"] == "pass"
    assert told["safe points"]["level"] == "warning"
    assert "far: in no station's range" in told["safe points"]["message"]
    one.core.command("abort", by="pilot")
    assert one.run(limit_s=200.0) is FlightState.REFUSED
    assert held(one) == []
    assert not one.said("alarm")


@pytest.mark.slow
@BOTH
def test_what_the_vehicle_held_comes_back_after_a_flight(autopilot: str) -> None:
    one = flight_with(autopilot, rally=(OLD,))
    assert "the 1 it held come back after the flight" in checks(one)["rally points"]["message"]
    assert len(held(one)) == 3
    one.core.command("launch")
    assert one.run(limit_s=400.0) is FlightState.COMPLETED
    assert held(one) == [(OLD.x, OLD.y, OLD.z)]


@BOTH
def test_a_vehicle_that_holds_them_already_is_not_written_to(autopilot: str) -> None:
    first = on_ground(autopilot)
    one = flight_with(autopilot, rally=tuple(first.vehicle.missions.plans[RALLY]))
    assert "held already" in checks(one)["rally points"]["message"]
    assert not one.sent_messages("MISSION_COUNT")
    one.core.command("abort")
    one.run(limit_s=100.0)
    assert len(held(one)) == 3


@BOTH
def test_a_vehicle_that_refuses_rally_points_flies_and_its_own_return_goes_home(autopilot: str) -> None:
    one = flight_with(autopilot, limit_s=0.0)
    missions = one.vehicle.missions
    missions.rules = replace(missions.rules, capacity={**missions.rules.capacity, RALLY: 2})
    one.run(until=lambda: one.core.state is FlightState.READY, limit_s=400.0)
    assert one.core.state is FlightState.READY
    told = checks(one)
    assert told["rally points"]["level"] == "warning"
    assert "more items than it has room for" in told["rally points"]["message"]
    assert told["failsafe return"]["value"]["places"] == ["home"]


@BOTH
def test_a_vehicle_that_says_no_and_keeps_them_all_the_same_is_refused(autopilot: str) -> None:
    one = on_ground(autopilot, config={"faults": ("mission-refused",)})
    assert one.core.state is FlightState.REFUSED
    assert checks(one)["rally points"]["level"] == "error"
    assert held(one) == []  # cleared again: it held none before


@BOTH
def test_a_vehicle_that_tells_nothing_of_its_lists_is_refused_unless_that_is_meant(autopilot: str) -> None:
    one = on_ground(autopilot, config={"faults": ("mission-silent",)})
    assert one.core.state is FlightState.REFUSED
    told = checks(one)["rally points"]
    assert told["level"] == "error"
    assert "--no-rally" in told["fix"]
    ardupilot = autopilot == "ardupilot"
    meant = on_ground(autopilot, config={"faults": ("mission-silent",)}, request={"rally": False})
    # PX4's stored fence is always in force, so it must be known; ArduPilot's is off.
    assert meant.core.state is (FlightState.READY if ardupilot else FlightState.REFUSED)
    assert checks(meant)["rally points"]["level"] == "warning"


@BOTH
def test_a_vehicle_left_with_half_a_list_is_refused_and_gets_its_own_back(autopilot: str) -> None:
    """The vehicle changes an item on its way into the store: read back, it is another place."""
    one = flight_with(autopilot, rally=(OLD,), request={"auto_launch": False}, limit_s=0.0)
    handlers, spoilt = one.vehicle._handlers, [True]
    handle = handlers["MISSION_ITEM_INT"]

    def spoil(link: int, message: Any) -> None:
        if spoilt[0]:
            message.x += 1000
        handle(link, message)

    handlers["MISSION_ITEM_INT"] = spoil
    one.run(until=lambda: bool(one.said("check")), limit_s=400.0)
    spoilt[0] = False
    assert one.run(limit_s=400.0) is FlightState.REFUSED
    told = checks(one)["rally points"]
    assert told["level"] == "error"
    assert "nobody knows what the vehicle holds now" in told["message"]
    assert held(one) == [(OLD.x, OLD.y, OLD.z)]
    assert not one.said("alarm")


def test_rally_points_of_its_own_are_where_its_return_goes() -> None:
    one = flight_with("px4", rally=(OLD,), plan=relay_plan(2))
    told = checks(one)
    assert told["rally points"]["message"] == "the vehicle holds 1 of its own"
    assert "rally point 1" in told["failsafe return"]["value"]["places"]
    assert len(held(one)) == 1


def test_the_limit_that_makes_ardupilot_ignore_rally_points_is_lifted_on_the_simulator_and_told_elsewhere() -> None:
    lifted = on_ground("ardupilot", config={"parameters": ("RALLY_LIMIT_KM=0.05",)})
    assert lifted.vehicle.parameters["RALLY_LIMIT_KM"] == 0.0
    assert lifted.said("parameter", name="RALLY_LIMIT_KM")
    safe = ("RALLY_LIMIT_KM=0.05", "FS_GCS_ENABLE=1", "BATT_FS_LOW_ACT=2")
    one = on_ground("ardupilot", config={"parameters": safe}, request={"set_parameters": "no"})
    assert one.core.state is FlightState.READY
    told = checks(one)
    assert told["RALLY_LIMIT_KM"]["level"] == "warning"
    assert told["RALLY_LIMIT_KM"]["fix"] == "set RALLY_LIMIT_KM to 0"
    # 50 m from the path no field counts: everything returns home.
    assert told["failsafe return"]["value"]["places"] == ["home"]


@BOTH
def test_a_lost_vehicle_keeps_what_was_changed_and_that_is_said(autopilot: str) -> None:
    one = flight_with(autopilot, rally=(OLD,), config={"faults": ("disarm-in-flight@T8",)})
    one.core.command("launch")
    assert one.run(limit_s=400.0) is FlightState.LOST
    (alarm,) = one.said("alarm", what="the vehicle keeps what this flight changed")
    assert "rally points" in alarm.data["changed"]
    assert len(held(one)) == 3


# -- fences -----------------------------------------------------------------------------------------------------------


def square(half_deg: float, command: int = 5001) -> tuple[Item, ...]:
    """A square around the relay's stations, or one that cuts its path where ``half_deg`` is small."""
    corners = ((-1, -1), (-1, 1), (1, 1), (1, -1))
    return tuple(
        Item(
            command,
            0,
            (4.0, 0.0, 0.0, 0.0),
            529_500_000 + round(a * half_deg * 1e7),
            47_900_000 + round(b * half_deg * 1e7),
            0.0,
        )
        for a, b in corners
    )


@BOTH
def test_a_fence_on_request_holds_path_home_and_rally_points_and_goes_again(autopilot: str) -> None:
    one = on_ground(autopilot, request={"lay_geofence": True}, proxy=Proxy(seed=2, **BAD))
    assert one.core.state is FlightState.READY
    corners = held(one, FENCE)
    assert len(corners) == 16
    plane = one.plan.plane
    east, north = plane.to_plane([x * 1e-7 for x, _, _ in corners], [y * 1e-7 for _, y, _ in corners])
    # 15 m/s for 5 s is 75 m around the path from (0, 0) to (840, 20) and the fields at (100..940, 150).
    assert min(east) == pytest.approx(-75.0 / 0.98, abs=8.0)
    assert max(east) > 940.0 + 74.0
    assert min(north) <= -74.0
    assert max(north) >= 150.0 + 74.0
    told = checks(one)["fence"]
    assert (told["level"], "answers a breach with" in told["message"]) == ("pass", True)
    if autopilot == "ardupilot":
        assert [one.vehicle.parameters[n] for n in ("FENCE_TYPE", "FENCE_ENABLE")] == [4, 1]
    one.core.command("abort")
    assert one.run(limit_s=200.0) is FlightState.REFUSED
    assert held(one, FENCE) == []
    if autopilot == "ardupilot":
        assert [one.vehicle.parameters[n] for n in ("FENCE_TYPE", "FENCE_ENABLE")] == [7, 0]


def test_a_stored_fence_that_would_act_inside_the_plan_refuses_the_flight() -> None:
    one = flight_with("px4", fence=square(0.001))
    assert one.core.state is FlightState.REFUSED
    told = checks(one)["fence"]
    assert (told["level"], "which answers with: hold" in told["message"]) == ("failure", True)
    assert "--fence" in told["fix"]
    assert flight_with("px4", fence=square(0.1)).core.state is FlightState.READY
    assert flight_with("px4", fence=square(0.0005, 5002)).core.state is FlightState.REFUSED
    # Where the fence only talks, a person is told.
    talks = flight_with("px4", fence=square(0.001), config={"parameters": ("GF_ACTION=1",)})
    assert checks(talks)["fence"]["level"] == "warning"
    # ArduPilot's is off: it is not asked for.
    assert "fence" not in checks(flight_with("ardupilot", fence=square(0.001)))
    acts = flight_with("ardupilot", fence=square(0.001), config={"parameters": ("FENCE_ENABLE=1", "FENCE_TYPE=4")})
    assert checks(acts)["fence"]["level"] == "failure"


@pytest.mark.parametrize(
    ("autopilot", "parameters", "name"),
    [
        ("ardupilot", ("FENCE_ENABLE=1",), "FENCE_RADIUS"),  # 300 m about home, and the plan goes 840 m
        ("ardupilot", ("FENCE_ENABLE=1", "FENCE_TYPE=1", "FENCE_ALT_MAX=5"), "FENCE_ALT_MAX"),
        ("px4", ("GF_MAX_HOR_DIST=200",), "GF_MAX_HOR_DIST"),
        ("px4", ("GF_MAX_VER_DIST=5",), "GF_MAX_VER_DIST"),
    ],
)
def test_a_fence_about_home_that_the_plan_leaves_refuses_the_flight(
    autopilot: str, parameters: tuple[str, ...], name: str
) -> None:
    one = on_ground(autopilot, config={"parameters": parameters})
    assert one.core.state is FlightState.REFUSED
    assert checks(one)[name]["level"] == "failure"
    assert f"raise {name} above" in checks(one)[name]["fix"]
