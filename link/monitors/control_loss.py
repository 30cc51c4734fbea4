"""Whether the vehicle is still ours: hears us, follows our stream, flies.

When the link of the station in control fails where a neighbour covers the vehicle too, and is proved, the neighbour
takes over before the autopilot acts. When the stream may have been missed for longer than the autopilot tolerates, or
the vehicle left the mode or restarted, or flies a foreign ground station's targets, it is ours no longer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from gcs.flight import FlightState
from link.handover.handover_chain import TAKEOVER_SHARE, HandoverChain
from link.monitors.range_margin import RangeWatch
from link.monitors.tracking import LagMonitor
from link.monitors.uplink import UplinkMonitor
from link.session.context import FlightContext

MODE_SETTLE_S = 0.5
"""After a mode was confirmed, HEARTBEATs from before it may still be on their way."""
LINK_LOSS_SHARE = 0.95
"""Of the autopilot's time-out: unproved for so long, the C2 link counts as lost."""
FOREIGN_LOSS_S, FOREIGN_OFF_M = 1.5, 10.0
"""Nothing but foreign targets for so long, and so far off its reference: the vehicle does not fly our setpoints."""
GROUNDED_S, GROUNDED_OFF_M = 3.0, 2.5
ALONE_AGAIN_S = 10.0


@dataclass(frozen=True, slots=True)
class ControlLoss:
    """The vehicle is ours no longer: the flight has ``ended`` so, or the C2 link is lost; ``pin``: by our silence."""

    reason: str
    pin: bool = False
    ended: FlightState | None = None


class ControlLossMonitor:
    """Judges every tick of a flight that streams. `begin` when a stream begins, then `judge`."""

    def __init__(
        self,
        flight: FlightContext,
        chain: HandoverChain,
        lag: LagMonitor,
        uplink: UplinkMonitor,
        in_range: RangeWatch,
    ) -> None:
        self._timeline = flight.timeline
        self._vehicle = flight.vehicle
        self._control = flight.control
        self._chain = chain
        self._lag = lag
        self._uplink = uplink
        self._range = in_range
        self._mode_s = -math.inf
        self._reboots = 0
        self._grounded_s = math.inf
        self._alone_s: dict[str, float] = {}

    def begin(self) -> None:
        """The vehicle has just confirmed the mode, and is as it is now."""
        self._reboots = self._vehicle.monitor.reboots
        self._mode_s = self._timeline.now_s

    def judge(self, time_s: float, *, on_plan: bool, landing: bool) -> ControlLoss | None:
        """What the flight must act on now; None while the vehicle is ours as far as can be known.

        ``time_s`` is where on the plan the flight is; only ``on_plan`` may a neighbour take over. ``landing``: the
        vehicle has been seen to land by itself as asked.
        """
        timeline, vehicle, control = self._timeline, self._vehicle, self._control
        heartbeat = vehicle.monitor.heartbeat
        fresh = heartbeat is not None and heartbeat.heard_s > self._mode_s + MODE_SETTLE_S
        if fresh and not vehicle.armed and timeline.state is not FlightState.LANDING:
            agrees = vehicle.down_since(self._mode_s + MODE_SETTLE_S)
            if agrees:
                timeline.alarm("disarmed in flight", agrees=agrees)
                ended = FlightState.CONTINGENCY if vehicle.on_ground else FlightState.LOST
                return ControlLoss("the vehicle disarmed by itself", ended=ended)
            self._tell_alone("HEARTBEAT shows motors off, nothing else does")
        if timeline.state is FlightState.LANDING and landing:
            return None
        if vehicle.monitor.reboots != self._reboots:
            return ControlLoss("the autopilot restarted")
        limit_s = LINK_LOSS_SHARE * self._vehicle.loss_timeout_s
        gap_s = timeline.now_s - control.last_setpoint_s
        if gap_s > limit_s:
            return ControlLoss(f"no setpoint was sent for {gap_s:.2f} s", pin=True)
        if vehicle.adopt_origin(control.in_force.station_id):
            timeline.alarm("EKF origin moved")
        left = fresh and not vehicle.follows and timeline.state is not FlightState.LANDING
        # One HEARTBEAT alone decides nothing; the next one does, or a target that is not ours.
        if left and (vehicle.monitor.beats_alike >= 2 or self._uplink.foreign_for_s > 0.0):
            return ControlLoss(f"the vehicle left {vehicle.profile.offboard_mode} for {vehicle.mode}")
        foreign_s = max(FOREIGN_LOSS_S, self._vehicle.loss_timeout_s)
        if self._uplink.foreign_for_s > foreign_s and self._lag.off_m > FOREIGN_OFF_M:
            return ControlLoss("the vehicle flies a target that is not ours", pin=True)
        return self._grounded() or self._unproved(time_s, limit_s, on_plan=on_plan)

    def _tell_alone(self, what: str) -> None:
        """One witness alone: told, and flown on."""
        if self._timeline.now_s - self._alone_s.get(what, -math.inf) >= ALONE_AGAIN_S:
            self._alone_s[what] = self._timeline.now_s
            self._timeline.alarm(what)

    def _grounded(self) -> ControlLoss | None:
        """The end, when the vehicle has been on the ground for a while, armed: it says so, stands, and is not where
        it was asked to be."""
        timeline, vehicle = self._timeline, self._vehicle
        if not vehicle.on_ground or timeline.state is FlightState.LANDING:
            self._grounded_s = math.inf
            return None
        self._grounded_s = min(self._grounded_s, timeline.now_s)
        if timeline.now_s - self._grounded_s < GROUNDED_S:
            return None
        still_s = timeline.now_s - vehicle.monitor.places.still_since_s
        if vehicle.position is None or still_s < GROUNDED_S or self._lag.off_m < GROUNDED_OFF_M:
            self._tell_alone("the vehicle says that it has landed, nothing else does")
            return None
        timeline.alarm("the vehicle is on the ground")
        return ControlLoss("the vehicle is on the ground, armed, and not where it should be", ended=FlightState.LOST)

    def _unproved(self, time_s: float, limit_s: float, *, on_plan: bool) -> ControlLoss | None:
        """A neighbour takes over where the station in control cannot go on; a lost C2 link where none could."""
        control, chain = self._control, self._chain
        if self._range.left and self._range.margin_m is not None and on_plan:
            chain.take_over(time_s, f"the vehicle is out of range of {control.gate.holder}")
        age_s = self._uplink.age_s
        if age_s > TAKEOVER_SHARE * self._vehicle.loss_timeout_s and on_plan:
            chain.take_over(time_s, f"link of {control.gate.holder} unproved for {age_s:.2f} s")
        if age_s > limit_s:
            return ControlLoss(f"nothing proved the link of {control.gate.holder} for {age_s:.2f} s", pin=True)
        return None
