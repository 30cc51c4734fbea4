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
from link.context import VEHICLE_STATION, FlightContext
from link.setpoints import Setpoint

LAG_START_M = 5.0
"""Lag, beyond what the link's delay explains, from which the reference slows down."""
LAG_GIVE_UP_M = 60.0
"""Error at which the flight is held: the vehicle is not following."""
BLIND_S = 5.0
"""So long without a position that can be judged, the vehicle is flown blind. Sped up beyond `BLIND_SPEEDUP`, as long on
the wall's clock as at that: what counts there is how this machine keeps up."""
BLIND_SPEEDUP = 5.0
LAG_TIME_S = 3.0
"""Time in which the lag is worked off."""
STRANGE_M = 5.0
STRANGE_COUNT, STRANGE_WITHIN_S, STRANGE_AGAIN_S = 2, 2.0, 10.0
"""So many targets this far from every setpoint of ours within so long are told, and told again at most so often.

A stranger's setpoint holds until our next one. With the echoes of `link.launch.STREAMED_MESSAGES` one that holds for a
quarter of the time is seen twice within a second, for an eighth of it within two; less is seen as the echoes drift
through the ticks, and moves the vehicle as little.
"""
GRACE_S = 1.0
"""Until our first setpoints are in, the vehicle rightly shows a target of its own, as after a take-off."""
DELAY_S = 0.25
"""Tick and controller delay that is no fault of the vehicle, beside what of the link's latency is not led."""
LEAD_STEP_S, LEAD_SETTLED_S = 0.015, 0.002
"""The lead follows the latency once they are so far apart, until so near: noise of the measurement moves nothing."""
LEAD_SLEW = 0.05
"""How fast the lead changes, seconds a second."""


@dataclass(frozen=True, slots=True)
class Tracking:
    """The vehicle against its reference at one moment: metres, ``behind_m`` along the path, ``beside_m`` across it."""

    time_s: float
    error_m: float
    behind_m: float
    beside_m: float
    speed_along_m_s: float


class LagMonitor:
    """Compares positions heard with the reference. `note` where it is, every tick a setpoint is sent; then `update`."""

    def __init__(self, context: FlightContext, lead: Lead) -> None:
        self._c = context
        self._lead = lead
        self._sent: deque[tuple[float, Setpoint]] = deque(maxlen=600)
        self._boot_s = -math.inf
        self._judged_s = context.now_s
        self.tracking: Tracking | None = None
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
        self._sent.append((self._c.now_s, setpoint))

    def forget(self) -> None:
        """Start anew: the stream was interrupted."""
        self._sent.clear()
        self._judged_s = self._c.now_s
        self.tracking = self._lost_since_s = None

    def update(self) -> None:
        """Judge the newest position, if there is a new one."""
        position = self._c.monitor.position
        if position is None or position.boot_s <= self._boot_s or len(self._sent) < 2:
            return
        time_s = self._c.monitor.our_time_s(position.boot_s)
        if time_s is None:
            return
        self._boot_s = position.boot_s
        asked = self._asked_at(time_s)
        here = self._c.position_enu_m()
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
        self._judged_s = self._c.now_s
        self.tracking = Tracking(time_s, error, behind, beside, flown)
        if not self.lost:
            self._lost_since_s = None
        elif self._lost_since_s is None:
            self._lost_since_s = self._c.now_s
        if self._c.state is not FlightState.CRUISE:
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
        allowed_m = LAG_START_M + speed_m_s * (DELAY_S + self._lead.missing_s)
        if tracking.behind_m <= allowed_m:
            return 1.0
        wanted = tracking.speed_along_m_s - (tracking.behind_m - allowed_m) / LAG_TIME_S
        return max(0.0, min(1.0, wanted / speed_m_s))

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
        patience_s = BLIND_S * max(1.0, self._c.request.speedup / BLIND_SPEEDUP)
        return self._c.now_s - self._judged_s > patience_s

    @property
    def lost_for_s(self) -> float:
        """For how long it has not followed."""
        return 0.0 if self._lost_since_s is None else self._c.now_s - self._lost_since_s


class Lead:
    """How far ahead of the reference the setpoints are asked for, so that they are in time when they arrive.

    A setpoint that takes L seconds to the vehicle is v L behind when it gets there. So the reference is looked up that
    much ahead: by the latency of the station in control, half its round trip, at most ``lead_limit_s`` of the request.
    At a handover it changes at once with the link, for then every setpoint is right at its arrival.
    """

    def __init__(self, context: FlightContext) -> None:
        self._c = context
        self.seconds = 0.0
        self._station = ""
        self._moving = False

    def update(self, dt_s: float) -> None:
        """Follow the latency; once a tick."""
        station = self._c.fence.station_id
        latency_s = self._c.monitor.links[station].latency_s
        if latency_s is None:
            return
        wanted = min(latency_s, self._c.request.lead_limit_s)
        if station != self._station:
            self._station, self.seconds, self._moving = station, wanted, False
            return
        off = wanted - self.seconds
        self._moving = abs(off) > (LEAD_SETTLED_S if self._moving else LEAD_STEP_S)
        if self._moving:
            self.seconds += math.copysign(min(abs(off), LEAD_SLEW * dt_s), off)

    @property
    def missing_s(self) -> float:
        """Latency that is not led."""
        latency_s = self._c.monitor.links[self._c.fence.station_id].latency_s
        return 0.0 if latency_s is None else max(0.0, latency_s - self.seconds)


class RangeWatch:
    """How much of the range of the station in control is left, by where the vehicle says it is, not by the plan."""

    def __init__(self, context: FlightContext) -> None:
        self._c = context
        self._seen: tuple[float, str] | None = None
        self.margin_m: float | None = None
        """Range left, metres; negative outside. None while nothing is known."""
        self.left = False
        """Whether the vehicle is outside."""

    def update(self) -> None:
        """Measure the newest position; once a tick."""
        c = self._c
        position, holder = c.monitor.position, c.gate.holder
        here = c.position_enu_m()
        if position is None or holder is None or here is None:
            return
        station = holder.removesuffix(VEHICLE_STATION)
        if self._seen == (position.boot_s, station):
            return
        self._seen = (position.boot_s, station)
        index = np.array([c.plan.mission.station_index(station)])
        self.margin_m = -float(c.plan.ground.outside_m(index, np.array([here]))[0])
        # A metre of doubt, so that it is told once.
        was, self.left = self.left, self.margin_m < (0.0 if not self.left else 1.0)
        if self.left and not was:
            c.alarm("the vehicle is out of range", station=station, outside_m=round(-self.margin_m, 1))


class UplinkMonitor:
    """How long ago a frame of ours was last known to have reached the vehicle.

    Proof is an answered probe of the station in control, or a setpoint that the vehicle repeats, whoever sent it.
    When it grows older than the autopilot's time-out, the vehicle may have acted on our silence, whatever we hear.
    """

    def __init__(self, context: FlightContext) -> None:
        self._c = context
        self._target_s = -math.inf
        self._proven_s = -math.inf
        self._strange_since_s: float | None = None
        self._strange: deque[float] = deque(maxlen=STRANGE_COUNT)
        self._told_s = -math.inf
        self._ours_from_s = -math.inf

    def restart(self) -> None:
        """Count from now on: the stream begins."""
        self._proven_s = self._c.now_s
        self._strange_since_s = None
        self._strange.clear()
        self._ours_from_s = self._c.now_s + GRACE_S

    def update(self) -> None:
        """Look at the newest answers; once a tick."""
        c = self._c
        self._proven_s = max(self._proven_s, c.monitor.links[c.fence.station_id].proven_s)
        if c.monitor.target is None or c.monitor.target_s <= self._target_s:
            return
        self._target_s = c.monitor.target_s
        self._notice_strangers()
        held = c.echoes.held(c.monitor.target)
        if held:
            # The oldest it may be: proof must not be younger than what it proves.
            self._proven_s = max(self._proven_s, held[0].sent_s)

    def _notice_strangers(self) -> None:
        """A target nowhere near our setpoints: somebody else streams, or the vehicle no longer takes ours."""
        c = self._c
        # Landing, and after a lapse, the vehicle flies a target of its own.
        other = c.state in (FlightState.LANDING, FlightState.LAPSED) or c.now_s < self._ours_from_s
        if other or c.echoes.distance_m(c.monitor.target) <= STRANGE_M:
            self._strange_since_s = None
            return
        if self._strange_since_s is None:
            self._strange_since_s = c.now_s
        self._strange.append(c.now_s)
        often = len(self._strange) == STRANGE_COUNT and c.now_s - self._strange[0] <= STRANGE_WITHIN_S
        if often and c.now_s - self._told_s > STRANGE_AGAIN_S:
            self._told_s = c.now_s
            c.alarm("the vehicle holds a target that is not ours")

    @property
    def strange_for_s(self) -> float:
        """How long the vehicle has shown nothing but targets that are not ours."""
        return 0.0 if self._strange_since_s is None else self._c.now_s - self._strange_since_s

    @property
    def age_s(self) -> float:
        """Seconds since the newest frame known to have arrived was sent."""
        return self._c.now_s - self._proven_s
