"""Flying what was uploaded: the legs of a mission, and the place a return goes to.

A mission is flown item by item: NAV_TAKEOFF climbs on the spot, NAV_WAYPOINT and the loiters are flown to, NAV_LAND and
NAV_RETURN_TO_LAUNCH end it; commands that are not navigation are passed over.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl_fixtures.dynamics.guidance import Vector
from sitl_fixtures.mavlink.mission_protocol import (
    MISSION,
    NAVIGATION,
    RALLY,
    RELATIVE_FRAMES,
    TERRAIN_FRAMES,
    Item,
    Missions,
)
from sitl_fixtures.mavlink.parameters import ParameterSet
from sitl_fixtures.vehicle_protocol import VehicleProtocol

WAYPOINT, LOITER_UNLIMITED, LOITER_TURNS, LOITER_TIME, RETURN, LAND, TAKEOFF = 16, 17, 18, 19, 20, 21, 22
RETURN_TYPES_WITH_RALLY = (0, 3)


@dataclass(frozen=True, slots=True)
class Leg:
    """Where to go now: ``kind`` is ``climb``, ``fly``, ``land`` or ``return``; position local NED, m."""

    kind: str
    position: Vector


class MissionFlight:
    """Progress along the mission in hand."""

    def __init__(self, vehicle: VehicleProtocol, missions: Missions, parameters: ParameterSet) -> None:
        self._vehicle = vehicle
        self._missions = missions
        self._parameters = parameters
        self._held_since_s: float | None = None

    def _local(self, item: Item) -> Vector:
        vehicle = self._vehicle
        estimate, home = vehicle.estimator, vehicle.autopilot.home
        if estimate.projection is None or estimate.origin is None:
            return vehicle.autopilot.position
        north, east = estimate.projection.to_local(math.radians(item.x / 1e7), math.radians(item.y / 1e7))
        if item.x == 0 and item.y == 0:
            north, east = estimate.n, estimate.e
        base = home[2] if home is not None and item.frame in (*RELATIVE_FRAMES, *TERRAIN_FRAMES) else 0.0
        return north, east, estimate.origin[2] - (item.z + base)

    def leg(self) -> Leg | None:
        """The leg to fly now; moves on to the next item where one is done. None when there is nothing left."""
        vehicle = self._vehicle
        missions, items = self._missions, self._missions.plans[MISSION]
        first = 1 if missions.rules.item_zero_is_home else 0
        missions.current = max(missions.current, first)
        while missions.current < len(items):
            item = items[missions.current]
            if item.command not in NAVIGATION:
                missions.current += 1
                continue
            if item.command == RETURN:
                return Leg("return", vehicle.autopilot.home_local())
            place = self._local(item)
            if item.command == LAND:
                return Leg("land", place)
            here = vehicle.autopilot.position
            if item.command == TAKEOFF:
                if here[2] > place[2] + 0.5:
                    return Leg("climb", (here[0], here[1], place[2]))
            elif not self._arrived(item, place, here):
                return Leg("fly", place)
            self._held_since_s = None
            vehicle.send(mavlink.MAVLink_mission_item_reached_message(missions.current))
            missions.current += 1
        return None

    def _arrived(self, item: Item, place: Vector, here: Vector) -> bool:
        radius = self._vehicle.autopilot.acceptance_radius_m
        if math.dist(place, here) > max(radius, 0.5):
            return False
        if item.command in (LOITER_UNLIMITED, LOITER_TURNS):
            return False
        now = self._vehicle.time_s
        if self._held_since_s is None:
            self._held_since_s = now
        wait_s = item.params[0] if item.command in (WAYPOINT, LOITER_TIME) else 0.0
        return now - self._held_since_s >= wait_s

    def rally_place(self) -> Vector | None:
        """The rally point a return goes to from here, local NED; None: home.

        The nearest of home and the rally points, within RALLY_LIMIT_KM on ArduPilot; on PX4 with RTL_TYPE 0 or 3.
        """
        autopilot, p = self._vehicle.autopilot, self._parameters
        points = [self._local(item) for item in self._missions.plans[RALLY]]
        if not points or ("RTL_TYPE" in p and int(p["RTL_TYPE"]) not in RETURN_TYPES_WITH_RALLY):
            return None
        here = autopilot.position
        nearest = min(points, key=lambda point: math.dist(point[:2], here[:2]))
        reach = math.dist(nearest[:2], here[:2])
        if "RALLY_LIMIT_KM" in p and 0.0 < p["RALLY_LIMIT_KM"] * 1000.0 < reach:
            return None
        home_counts = "RALLY_INCL_HOME" not in p or p["RALLY_INCL_HOME"]
        if home_counts and math.dist(autopilot.home_local()[:2], here[:2]) <= reach:
            return None
        return nearest
