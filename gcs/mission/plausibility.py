"""Whether heights make sense beside each other: the absurd is refused at the door, the odd is told in the plan."""

from __future__ import annotations

import math
from collections.abc import Sequence

from gcs.document_reader import FaultList
from gcs.mission.model import GeoPosition, Mission, Position, amsl_m

# No ground is higher (Mount Everest, 8,849 m), nor any mast on it.
HIGHEST_MAST_M = 9_000.0
METRES_A_FOOT = 0.3048
# A ceiling so far below every antenna, or an antenna so far above the ceiling, is told.
UNDER_ANTENNAS_M = 100.0
OVER_CEILING_M = 3_000.0
# A wind above this part of the airspeed makes flights of hours into days.
WINDY = 0.9


def check_masts(places: Sequence[tuple[str, Position]], origin: GeoPosition | None, faults: FaultList) -> None:
    """Notes antennas higher than any ground: feet, most likely."""
    for i, (_, position) in enumerate(places):
        if isinstance(position, GeoPosition):
            key, given, altitude = "alt_amsl_m", position.alt_amsl_m, position.alt_amsl_m
        else:
            key, given = "up_m", position.up_m
            altitude = given + (origin.alt_amsl_m if origin else 0.0)
        if altitude > HIGHEST_MAST_M:
            faults.add(
                f"stations[{i}].{key}",
                "is higher than any ground",
                given,
                f"at most {HIGHEST_MAST_M:.0f} m above mean sea level",
                f"give it in metres: {altitude:g} ft are {altitude * METRES_A_FOOT:.1f} m",
            )


def doubts(mission: Mission) -> list[str]:
    """What is odd about a mission that can be flown, a sentence each."""
    told: list[str] = []
    ceiling, floor = mission.limits.max_alt_amsl_m, mission.limits.min_alt_amsl_m
    heights = {station.id: amsl_m(mission, station.position) for station in mission.stations}
    lowest = min(heights, key=lambda station: heights[station])
    if ceiling < heights[lowest] - UNDER_ANTENNAS_M:
        told.append(
            f"check the altitude band: {floor:g} to {ceiling:g} m AMSL is {heights[lowest] - ceiling:.0f} m and more "
            f"below every antenna (the lowest is {lowest}'s): is it meant above ground?"
        )
    high = [station for station, height in heights.items() if height > ceiling + OVER_CEILING_M]
    if high:
        told.append(
            f"check the altitude of {high[0]}{f' and {len(high) - 1} more' if len(high) > 1 else ''}: the antenna is "
            f"{heights[high[0]] - ceiling:.0f} m above the band; {heights[high[0]]:g} ft would be "
            f"{heights[high[0]] * METRES_A_FOOT:.0f} m"
        )
    wind, airspeed = math.hypot(*(mission.limits.wind_m_s or (0.0, 0.0))), mission.limits.max_airspeed_m_s
    if airspeed is not None and wind > WINDY * airspeed:
        told.append(
            f"check the wind: {wind:.2f} m/s leave {airspeed - wind:.2f} m/s of the airspeed of {airspeed:g} m/s "
            "to fly against it with"
        )
    if mission.start == mission.destination:
        told.append("start and destination are one place")
    if mission.left_out:
        count = len(mission.left_out)
        told.append(
            f"{count} station{'' if count == 1 else 's'} more than 1000 km from the start left out: "
            f"{', '.join(mission.left_out[:5])}{', ...' if count > 5 else ''}"
        )
    return told
