"""Whose range the vehicle is in, by where it says it is.

A station out of range is no choice while one in range is heard, however well its link is proved: a loopback, a cable or
a reflection says nothing of where the vehicle can be flown.
"""

from __future__ import annotations

import numpy as np

from link.session.context import FlightContext

FRESH_S = 5.0
HEARD_S = 5.0


def margin_m(flight: FlightContext, station_id: str) -> float | None:
    """Range of a station left, metres; negative outside; None while the vehicle's place is not known freshly."""
    position, here = flight.vehicle.monitor.position, flight.vehicle.position_enu_m()
    if position is None or here is None or flight.timeline.now_s - position.heard_s > FRESH_S:
        return None
    index = np.array([flight.plan.mission.station_index(station_id)])
    return -float(flight.plan.geometry.outside_m(index, np.array([here]))[0])


def choices(flight: FlightContext) -> list[str]:
    """The stations that may be chosen for the vehicle now: those in range that are heard; all, where there is none."""
    monitor, now_s = flight.vehicle.monitor, flight.timeline.now_s
    heard = [station for station in monitor.links if monitor.heard_within(now_s, station, HEARD_S)]
    margins = {station: margin_m(flight, station) for station in heard}
    inside = [station for station, margin in margins.items() if margin is not None and margin >= 0.0]
    return inside or list(monitor.links)


def nearest(flight: FlightContext) -> tuple[str, float] | None:
    """The station with the most range left for the vehicle, and that in metres; None while its place is not known."""
    margins = [(margin, s) for s in flight.vehicle.monitor.links if (margin := margin_m(flight, s)) is not None]
    return (max(margins)[1], max(margins)[0]) if margins else None
