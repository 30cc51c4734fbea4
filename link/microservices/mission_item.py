"""MAVLink's mission microservice: mission, fence and rally items as data, and their MISSION_ITEM_INT.

Positions are degrees; what ``alt_m`` counts from is the item's frame. No vehicle checks all of this: PX4 stores
latitude 95 as it is, so an item is checked when it is made.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from link.dialect import mavlink
from link.errors import MissionItemError

MISSION = mavlink.MAV_MISSION_TYPE_MISSION
FENCE = mavlink.MAV_MISSION_TYPE_FENCE
RALLY = mavlink.MAV_MISSION_TYPE_RALLY
TYPE_NAMES = {MISSION: "mission", FENCE: "fence", RALLY: "rally points"}

AMSL = mavlink.MAV_FRAME_GLOBAL
RELATIVE = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT
TERRAIN = mavlink.MAV_FRAME_GLOBAL_TERRAIN_ALT
NO_PLACE = mavlink.MAV_FRAME_MISSION
# The older frames with _INT mean the same; autopilots store one and give back the other.
_SAME_FRAME = {
    mavlink.MAV_FRAME_GLOBAL_INT: AMSL,
    mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT: RELATIVE,
    mavlink.MAV_FRAME_GLOBAL_TERRAIN_ALT_INT: TERRAIN,
}
_FRAMES = (AMSL, RELATIVE, TERRAIN, NO_PLACE)
ALTITUDE_BAND_M = (-1_000.0, 20_000.0)
COORDINATE_TOLERANCE_E7 = 2
ALTITUDE_TOLERANCE_M = 0.02
"""ArduPilot keeps centimetres."""


@dataclass(frozen=True)
class MissionItem:
    """One item. ``parameters`` are param1 to param4 (NaN: the vehicle's default); ``frame`` says what ``alt_m`` means.

    Raises `MissionItemError` for a place that is none, or a number that is infinite.
    """

    command: int
    lat_deg: float = 0.0
    lon_deg: float = 0.0
    alt_m: float = 0.0
    frame: int = AMSL
    parameters: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    current: bool = False
    autocontinue: bool = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "frame", _SAME_FRAME.get(self.frame, self.frame))
        if self.frame not in _FRAMES:
            raise MissionItemError(f"item frame is {self.frame}, allowed are {', '.join(map(str, _FRAMES))}")
        if not 0 <= self.command <= 0xFFFF:
            raise MissionItemError(f"item command is {self.command}, allowed is 0 to 65535")
        for name, value, low, high in (
            ("lat_deg", self.lat_deg, -90.0, 90.0),
            ("lon_deg", self.lon_deg, -180.0, 180.0),
            ("alt_m", self.alt_m, *ALTITUDE_BAND_M),
        ):
            if not low <= value <= high:
                raise MissionItemError(f"item {name} is {value}, allowed is {low:g} to {high:g}")
        if any(math.isinf(p) or abs(p) > 3e38 for p in self.parameters):
            raise MissionItemError(f"item parameters are {self.parameters}, allowed are finite numbers and NaN")

    @property
    def has_place(self) -> bool:
        """Whether latitude, longitude and altitude mean something."""
        return self.frame != NO_PLACE and (self.lat_deg != 0.0 or self.lon_deg != 0.0)

    def message(self, sequence: int, mission_type: int, target_system: int, target_component: int) -> Any:
        """The MISSION_ITEM_INT (73) of this item at a place in the list."""
        return mavlink.MAVLink_mission_item_int_message(
            target_system,
            target_component,
            sequence,
            self.frame,
            self.command,
            int(self.current),
            int(self.autocontinue),
            *self.parameters,
            round(self.lat_deg * 1e7),
            round(self.lon_deg * 1e7),
            self.alt_m,
            mission_type,
        )

    @classmethod
    def from_message(cls, message: Any) -> MissionItem:
        """From MISSION_ITEM_INT (73). Raises `MissionItemError` when the vehicle holds something that is no item."""
        return cls(
            command=int(message.command),
            lat_deg=message.x * 1e-7,
            lon_deg=message.y * 1e-7,
            alt_m=float(message.z),
            frame=int(message.frame),
            parameters=(
                float(message.param1),
                float(message.param2),
                float(message.param3),
                float(message.param4),
            ),
            current=bool(message.current),
            autocontinue=bool(message.autocontinue),
        )

    def same_as(
        self, other: MissionItem, *, parameters: bool = True, altitude_tolerance_m: float = ALTITUDE_TOLERANCE_M
    ) -> bool:
        """Whether a vehicle that was sent this item and gives back ``other`` holds what was meant.

        Places are compared where the item has one, to 2e-7 degrees and the tolerance. Pass ``parameters=False`` for
        ArduPilot, which keeps only what a command uses, in narrow types.
        """
        if self.command != other.command:
            return False
        if self.has_place:
            if self.frame != other.frame or abs(self.alt_m - other.alt_m) > altitude_tolerance_m:
                return False
            for a, b in ((self.lat_deg, other.lat_deg), (self.lon_deg, other.lon_deg)):
                if abs(round(a * 1e7) - round(b * 1e7)) > COORDINATE_TOLERANCE_E7:
                    return False
        if not parameters:
            return True
        return all(
            (math.isnan(a) and math.isnan(b)) or math.isclose(a, b, rel_tol=1e-6, abs_tol=1e-6)
            for a, b in zip(self.parameters, other.parameters, strict=True)
        )


def rally_point(lat_deg: float, lon_deg: float, alt_m: float, *, frame: int = RELATIVE) -> MissionItem:
    """A place to return to (MAV_CMD_NAV_RALLY_POINT). Above home by default: older ArduPilots take nothing else."""
    return MissionItem(mavlink.MAV_CMD_NAV_RALLY_POINT, lat_deg, lon_deg, alt_m, frame)


def inclusion_fence(corners: Sequence[tuple[float, float]]) -> list[MissionItem]:
    """A polygon (latitude, longitude in degrees) the vehicle must stay in; at least three corners."""
    if len(corners) < 3:
        raise MissionItemError(f"a fence has at least 3 corners, not {len(corners)}")
    return [
        MissionItem(
            mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION,
            lat,
            lon,
            frame=AMSL,
            parameters=(float(len(corners)), 0.0, 0.0, 0.0),
        )
        for lat, lon in corners
    ]
