"""MAVLink system ids of stations: those given, and the rest from the smallest contiguous range."""

from __future__ import annotations

from collections.abc import Sequence

from gcs.errors import InputFault, MissionError

# MAVLink system ids run from 1 to 255; 255 is what ground-station programs come with, and 0 is everybody.
LOWEST_SYSTEM_ID, HIGHEST_SYSTEM_ID = 1, 254
# All but the vehicle's own.
MOST_STATIONS = HIGHEST_SYSTEM_ID - LOWEST_SYSTEM_ID
FIRST_DEFAULT_SYSTEM_ID = 241


def assign_system_ids(given: Sequence[int | None], used: Sequence[int], vehicle_id: int) -> list[int | None]:
    """Ids of all stations, those of ``used`` filled in from the smallest contiguous range that holds those given.

    ArduPilot accepts ground stations by one range of ids (MAV_GCS_SYSID .. MAV_GCS_SYSID_HI), so the stations of one
    plan should fill one, without the vehicle's own id in it. Among ranges of equal length the first that begins
    at the lowest given id (241 when none is) or above wins, else the nearest below. Ids are
    given out in flight order, ascending. Stations outside ``used`` keep what they have.

    Raises `MissionError` when no range between 1 and 254 will do.
    """
    result = list(given)
    missing = [i for i in used if given[i] is None]
    if not missing:
        return result
    held = sorted(i for i in (given[k] for k in used) if i is not None)
    taken = {i for i in given if i is not None} - set(held)
    preferred = held[0] if held else FIRST_DEFAULT_SYSTEM_ID
    shortest = held[-1] - held[0] + 1 if held else 1
    for length in range(max(shortest, len(used)), HIGHEST_SYSTEM_ID - LOWEST_SYSTEM_ID + 2):
        lows = range(LOWEST_SYSTEM_ID, HIGHEST_SYSTEM_ID - length + 2)
        for low in sorted(lows, key=lambda low: (low < preferred, abs(low - preferred))):
            window = range(low, low + length)
            if vehicle_id in window or any(i not in window for i in held):
                continue
            free = [i for i in window if i not in taken and i not in held]
            if len(free) >= len(missing):
                for index, system_id in zip(missing, free, strict=False):
                    result[index] = system_id
                return result
    room = MOST_STATIONS
    if len(used) > room:
        what = f"{len(used)} are flown, and system ids tell no more than {room} apart"
        fix = "lower max_handovers, or fly it as several missions"
        raise MissionError([InputFault("stations", what, len(used), f"at most {room} in one flight", fix)])
    raise MissionError(
        [
            InputFault(
                "stations",
                f"no contiguous range of system ids holds those given and has room for the {len(missing)} missing",
                held or None,
                f"{LOWEST_SYSTEM_ID} to {HIGHEST_SYSTEM_ID} without the vehicle's own id {vehicle_id}",
                "give every station an id, or leave them all out",
            )
        ]
    )
