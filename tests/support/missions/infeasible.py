"""Well-formed missions that no flight can fulfil: (name, document, reason, words the message or its fix must hold).

::

      start                                   destination
        |   A (1000 m)          B (1000 m)        |
     ---+----( * )----------------( * )-----------+---     GOOD_LOCAL has A at 0 and B at 1500 m east
"""

from __future__ import annotations

import copy
from typing import Any

from tests.support.missions.malformed import GOOD, GOOD_LOCAL

Document = dict[str, Any]


def local(**changes: Any) -> Document:
    """`GOOD_LOCAL` with fields at dotted paths (``__`` for dots) replaced."""
    return _changed(GOOD_LOCAL, changes)


def wgs84(**changes: Any) -> Document:
    """`GOOD` with fields replaced likewise."""
    return _changed(GOOD, changes)


def _changed(base: Document, changes: dict[str, Any]) -> Document:
    document = copy.deepcopy(base)
    for path, value in changes.items():
        place: Any = document
        *parents, last = path.split("__")
        for part in parents:
            place = place[int(part)] if isinstance(place, list) else place.setdefault(part, {})
        if isinstance(place, list):
            place[int(last)] = value
        else:
            place[last] = value
    return document


INFEASIBLE: list[tuple[str, Document, str, tuple[str, ...]]] = [
    (
        # A reaches 1000 m from the ground, so 994.0 m at 110 m up; the start is 1200 m west of it
        "start out of every range",
        local(start__east_m=-1200.0),
        "start_uncovered",
        ("start", "A", "205.0 m"),
    ),
    (
        "destination out of every range",
        local(destination__east_m=4000.0),
        "destination_uncovered",
        ("destination", "Raise the range of B"),
    ),
    (
        # at the band's floor the discs have radius sqrt(1000^2 - 100^2) = 994.99 m: 2500 - 1989.97 = 510.03 m apart
        "broken chain",
        local(stations__1__east_m=2500.0, destination__east_m=2500.0),
        "broken_chain",
        ("A", "B", "gap"),
    ),
    (
        # the discs of 994.99 m overlap by 19.97 m; less a margin of 25 m each they are 30 m apart
        "overlap too small for the margin",
        local(stations__1__east_m=1970.0, destination__east_m=1970.0, options__range_margin_m=25.0),
        "broken_chain",
        ("margin of 25 m", "ower range_margin_m to"),
    ),
    (
        "start below the band",
        local(start__up_m=20.0),
        "start_altitude",
        ("start", "100 to 120 m", "80.0 m", "Set the altitude"),
    ),
    (
        "destination above the band",
        local(destination__up_m=500.0),
        "destination_altitude",
        ("destination", "380.0 m"),
    ),
    (
        "ranges that do not reach the band",
        local(stations__0__range_m=90.0, stations__1__range_m=90.0),
        "start_uncovered",
        ("start", "A"),
    ),
    (
        "a margin that leaves no range",
        local(options__range_margin_m=5000.0),
        "start_uncovered",
        ("margin of 5000 m", "ower range_margin_m"),
    ),
    (
        "too few handovers",
        local(options__max_handovers=0),
        "limits",
        ("1 handover",),
    ),
    (
        # 1500 m at 50 m/s and 5 m/s^2 takes at least 1500/50 + 50/5 = 40 s
        "too little endurance",
        local(limits__endurance_s=45.0, limits__reserve_s=10.0),
        "limits",
        ("endurance",),
    ),
    (
        "arrival before anything could arrive",
        local(options__arrival_s=30.0),
        "arrival",
        ("30 s",),
    ),
    (
        "arrival later than the endurance",
        local(limits__endurance_s=100.0, limits__reserve_s=40.0, options__arrival_s=70.0),
        "endurance",
        ("70 s", "60 s"),
    ),
    (
        "wind stronger than the vehicle",
        local(limits__max_airspeed_m_s=15.0, limits__wind={"east_m_s": 12.0, "north_m_s": 9.5}),
        "limits",
        ("wind",),
    ),
    (
        "the only way is excluded",
        local(options__excluded_stations=["B"]),
        "destination_uncovered",
        ("A",),
    ),
    (
        # at 110 m up and 1500 m away A sees the vehicle 4.2 degrees high
        "below the lowest elevation",
        local(stations__0__range_m=9000.0, stations__0__min_elevation_deg=20.0, stations__1__range_m=20.0),
        "destination_uncovered",
        ("A",),
    ),
    (
        # den-helder reaches 16 km, the airfields are 21.65 km apart
        "broken chain on the earth",
        wgs84(stations__1__range_m=4000.0),
        "broken_chain",
        ("den-helder", "texel", "gap"),
    ),
    (
        "start out of range on the earth",
        wgs84(start__lat_deg=52.7),
        "start_uncovered",
        ("den-helder",),
    ),
    (
        "start below the band on the earth",
        wgs84(start__alt_amsl_m=5.0),
        "start_altitude",
        ("90 to 120 m AMSL", "85.0 m"),
    ),
]
