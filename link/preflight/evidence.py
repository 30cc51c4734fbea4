"""What a passed preflight holds for: this boot of the autopilot, this origin, this home, this place.

When one of them is another, or where the vehicle is is not known, nothing may be armed on it.
"""

from __future__ import annotations

import math

from gcs.plan import Place
from link.autopilot.local_frame import EkfOrigin
from link.session.context import FlightContext
from link.session.procedure import Steps, wait_until
from link.telemetry.plausibility import HomePlace, apart_m, same_origin

MOVED_M = 10.0
"""The vehicle has been moved on the ground since it was judged."""
HOME_MOVED_M = 5.0
FIX_3D = 3


class PreflightEvidence:
    """What was so when the vehicle was judged: `begin`, `known_place`, then `void` and `unfit`."""

    def __init__(self, flight: FlightContext) -> None:
        self._timeline = flight.timeline
        self._vehicle = flight.vehicle
        self._reboots = 0
        self._place: Place | None = None
        self._origin: EkfOrigin | None = None
        self._home: HomePlace | None = None
        self._armed = False

    def begin(self) -> None:
        """A preflight begins: of this boot."""
        self._reboots = self._vehicle.monitor.reboots
        self._place = self._origin = self._home = None

    def known_place(self, wait_s: float) -> Steps[Place | None]:
        """Where the vehicle stands, with its present origin and home; None where that is not known.

        What it says of its estimate is waited for, as long as arming would be: a cold vehicle takes a minute.
        """
        vehicle = self._vehicle
        yield from wait_until(self._timeline, lambda: vehicle.position is not None and not self.lacks_estimate, wait_s)
        self._place = vehicle.position_enu_m()
        self._origin, self._home = vehicle.origin, vehicle.monitor.home
        return self._place

    def armed(self) -> None:
        """It is armed, which lays home anew."""
        self._armed = True
        self._vehicle.monitor.home = None

    @property
    def lacks_estimate(self) -> str:
        """What its receiver and its estimator lack, by what they report; empty where they report nothing bad."""
        monitor = self._vehicle.monitor
        if monitor.gps_fix is not None and monitor.gps_fix[1] < FIX_3D:
            return "it has no satellite fix"
        if monitor.estimator is not None and not monitor.estimator[1]:
            return "its estimator has no position yet"
        return ""

    def void(self) -> str:
        """Why the preflight holds no more; empty where it holds."""
        monitor = self._vehicle.monitor
        if monitor.reboots != self._reboots:
            return "the autopilot restarted"
        told = [link.origin for link in monitor.links.values() if link.origin is not None and link.origin_told > 1]
        if self._origin is not None and any(not same_origin(origin, self._origin) for origin in told):
            return "the EKF origin has moved"
        if self._home is not None and monitor.home is not None and not self._armed:
            away_m = apart_m(monitor.home.lat_deg, monitor.home.lon_deg, self._home.lat_deg, self._home.lon_deg)
            if away_m > HOME_MOVED_M:
                return f"home has moved by {away_m:.0f} m"
        here = self._vehicle.position_enu_m()
        if here is not None and self._place is not None:
            away_m = math.dist(here[:2], self._place[:2])
            if away_m > MOVED_M:
                return f"the vehicle has been moved by {away_m:.0f} m"
        return ""

    def unfit(self) -> str:
        """Why nothing may be armed or climbed now; empty where it may."""
        if self._vehicle.position is None:
            return self.void() or "the vehicle's position is not known"
        return self.void() or self._vehicle.doubt
