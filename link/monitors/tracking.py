"""Watching a vehicle that flies our setpoints: does it follow, does it fall behind, does it hear us at all.

Tracking is judged on the vehicle's clock: where it said it was at a moment is compared with what was asked for at that
moment. The error is split along and across the path. A vehicle that cannot follow never complains (asked for 18 m/s,
one that tops out at 10.5 was 450 m behind), so the reference must slow down for it.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from gcs.flight import FlightState
from link.monitors.latency_compensation import LatencyCompensation
from link.session.timeline import Timeline
from link.session.vehicle import Vehicle
from link.setpoints.setpoint import Setpoint

LAG_START_M = 5.0
"""Lag, beyond what the link's delay explains, from which the reference slows down."""
LAG_GIVE_UP_M = 60.0
"""Error at which the flight is held: the vehicle is not following."""
BLIND_S = 5.0
"""So long without a position that can be judged, the vehicle is flown blind. Sped up beyond `BLIND_SPEEDUP`, as long on
the wall's clock as at that: what counts there is how this machine keeps up."""
BLIND_SPEEDUP = 5.0
NEAR_M = 8.0
"""So near to its reference the vehicle is where it was asked to be."""
LAG_TIME_S = 3.0
"""Time in which the lag is worked off."""
DELAY_S = 0.25
"""Tick and controller delay that is no fault of the vehicle, beside what of the link's latency is not compensated."""


@dataclass(frozen=True, slots=True)
class Tracking:
    """The vehicle against its reference at one moment: metres, ``behind_m`` along the path, ``beside_m`` across it."""

    time_s: float
    error_m: float
    behind_m: float
    beside_m: float
    speed_along_m_s: float


class LagMonitor:
    """Compares positions heard with the reference. `note` where it is, every tick a setpoint is sent; then `update`.

    ``speedup``: how many times as fast as the wall's the flight's clock runs.
    """

    def __init__(
        self, timeline: Timeline, vehicle: Vehicle, latency: LatencyCompensation, *, speedup: float = 1.0
    ) -> None:
        self._timeline = timeline
        self._vehicle = vehicle
        self._latency = latency
        self._blind_after_s = BLIND_S * max(1.0, speedup / BLIND_SPEEDUP)
        self._sent: deque[tuple[float, Setpoint]] = deque(maxlen=600)
        self._boot_s = -math.inf
        self._judged_s = timeline.now_s
        self.tracking: Tracking | None = None
        self.asked_down_m_s = 0.0
        """How fast it was asked to descend at that moment."""
        self.worst_m = 0.0
        self._squares = 0.0
        self._lost_since_s: float | None = None
        self._count = 0

    @property
    def rms_m(self) -> float:
        """Root of the mean square error in cruise so far."""
        return math.sqrt(self._squares / self._count) if self._count else 0.0

    def note(self, setpoint: Setpoint) -> None:
        """Remember where the vehicle ought to be now."""
        self._sent.append((self._timeline.now_s, setpoint))

    def forget(self) -> None:
        """Start anew: the stream was interrupted."""
        self._sent.clear()
        self._judged_s = self._timeline.now_s
        self.tracking = self._lost_since_s = None

    def update(self) -> None:
        """Judge the newest position, if there is a new one."""
        timeline, vehicle = self._timeline, self._vehicle
        position = vehicle.position
        if position is None or position.boot_s <= self._boot_s or len(self._sent) < 2:
            return
        time_s = vehicle.monitor.our_time_s(position.boot_s)
        if time_s is None:
            return
        self._boot_s = position.boot_s
        asked = self._asked_at(time_s)
        here = vehicle.position_enu_m()
        if asked is None or here is None:
            return
        place, velocity = asked
        off = np.array(here) - place
        speed = float(np.linalg.norm(velocity))
        vn, ve, vd = position.velocity_ned_m_s
        if speed > 0.5:
            along = velocity / speed
            behind = -float(off @ along)
            beside = float(np.linalg.norm(off + behind * along))
            flown = float(np.array([ve, vn, -vd]) @ along)
        else:
            behind, beside, flown = 0.0, float(np.linalg.norm(off)), 0.0
        error = float(np.linalg.norm(off))
        self._judged_s = timeline.now_s
        self.tracking = Tracking(time_s, error, behind, beside, flown)
        self.asked_down_m_s = -float(velocity[2])
        if not self.lost:
            self._lost_since_s = None
        elif self._lost_since_s is None:
            self._lost_since_s = timeline.now_s
        if timeline.state is not FlightState.CRUISE:
            return
        self.worst_m = max(self.worst_m, error)
        self._squares += error * error
        self._count += 1

    def _asked_at(self, time_s: float) -> tuple[np.ndarray, np.ndarray] | None:
        """Position and velocity of the reference at a moment: those noted last before it, carried on."""
        for sent_s, setpoint in reversed(self._sent):
            if sent_s <= time_s:
                carry_s = min(time_s - sent_s, 1.0)
                velocity = np.array(setpoint.velocity_enu_m_s)
                acceleration = np.array(setpoint.acceleration_enu_m_s2)
                place = np.array(setpoint.position_enu_m) + carry_s * velocity + 0.5 * carry_s**2 * acceleration
                return place, velocity
        return None

    def rate(self, speed_m_s: float) -> float:
        """Largest rate the vehicle can follow, given the curve's own speed here; 1 while it keeps up."""
        tracking = self.tracking
        if tracking is None or speed_m_s < 1.0:
            return 1.0
        allowed_m = LAG_START_M + speed_m_s * (DELAY_S + self._latency.missing_s)
        if tracking.behind_m <= allowed_m:
            return 1.0
        wanted = tracking.speed_along_m_s - (tracking.behind_m - allowed_m) / LAG_TIME_S
        return max(0.0, min(1.0, wanted / speed_m_s))

    @property
    def near(self) -> bool:
        """Whether the vehicle is known to be where it was asked to be, to `NEAR_M`."""
        tracking = self.tracking
        return self._vehicle.position is not None and tracking is not None and tracking.error_m <= NEAR_M

    def settled(self, within_m: float, slower_m_s: float) -> bool:
        """Whether the vehicle is known to stand where it was asked to be."""
        tracking, position = self.tracking, self._vehicle.position
        return (
            tracking is not None
            and position is not None
            and tracking.error_m <= within_m
            and position.speed_m_s <= slower_m_s
        )

    @property
    def off_m(self) -> float:
        """The last error; 0 while there is none."""
        return 0.0 if self.tracking is None else self.tracking.error_m

    @property
    def lost(self) -> bool:
        """Whether the vehicle is so far off that it does not follow at all."""
        return self.off_m > LAG_GIVE_UP_M

    @property
    def blind(self) -> bool:
        """Whether nothing has been known of the vehicle's place for too long."""
        return self._timeline.now_s - self._judged_s > self._blind_after_s

    @property
    def lost_for_s(self) -> float:
        """For how long it has not followed."""
        return 0.0 if self._lost_since_s is None else self._timeline.now_s - self._lost_since_s
