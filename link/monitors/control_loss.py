"""Whether the vehicle is still ours: hears us, follows our stream, flies.

When the link of the station in control fails where a neighbour covers the vehicle too, and is proved, the neighbour
takes over before the autopilot acts. When the stream may have been missed for longer than the autopilot tolerates, or
the vehicle left the mode or restarted, or flies somebody else's targets, it is ours no longer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from gcs.flight import FlightState
from link.director.launch import Launch
from link.handover.handover_chain import TAKEOVER_SHARE, Relay
from link.monitors.range_margin import RangeWatch
from link.monitors.tracking import LagMonitor
from link.monitors.uplink import UplinkMonitor
from link.session.context import FlightContext

MODE_SETTLE_S = 0.5
"""After a mode was confirmed, HEARTBEATs from before it may still be on their way."""
LAPSE_SHARE = 0.95
"""Of the autopilot's time-out: unproved for so long, the stream counts as lapsed."""
STRANGE_LAPSE_S, STRANGE_OFF_M = 1.5, 10.0
"""Nothing but strange targets for so long, and so far off its reference: the vehicle does not fly our setpoints."""
GROUNDED_S = 3.0


@dataclass(frozen=True, slots=True)
class Loss:
    """The vehicle is ours no longer: the flight has ``ended`` so, or has lapsed; ``pin``: by our silence."""

    reason: str
    pin: bool = False
    ended: FlightState | None = None


class Custody:
    """Judges every tick of a flight that streams. `begin` when a stream begins, then `judge`."""

    def __init__(
        self,
        context: FlightContext,
        launch: Launch,
        relay: Relay,
        lag: LagMonitor,
        uplink: UplinkMonitor,
        in_range: RangeWatch,
    ) -> None:
        self._c = context
        self._launch = launch
        self._relay = relay
        self._lag = lag
        self._uplink = uplink
        self._range = in_range
        self._mode_s = -math.inf
        self._reboots = 0
        self._grounded_s = math.inf

    def begin(self) -> None:
        """The vehicle has just confirmed the mode, and is as it is now."""
        self._reboots = self._c.monitor.reboots
        self._mode_s = self._c.now_s

    def judge(self, time_s: float, *, on_plan: bool, landing: bool) -> Loss | None:
        """What the flight must act on now; None while the vehicle is ours as far as can be known.

        ``time_s`` is where on the plan the flight is; only ``on_plan`` may a neighbour take over. ``landing``: the
        vehicle has been seen to land by itself as asked.
        """
        c, heartbeat = self._c, self._c.monitor.heartbeat
        fresh = heartbeat is not None and heartbeat.heard_s > self._mode_s + MODE_SETTLE_S
        if fresh and not c.armed:
            if c.state is FlightState.LANDING:
                return None
            c.alarm("disarmed in flight")
            ended = FlightState.CONTINGENCY if c.on_ground else FlightState.LOST
            return Loss("the vehicle disarmed by itself", ended=ended)
        if c.state is FlightState.LANDING and landing:
            return None
        if c.monitor.reboots != self._reboots:
            return Loss("the autopilot restarted")
        limit_s = LAPSE_SHARE * self._launch.loss_timeout_s
        gap_s = c.now_s - c.last_setpoint_s
        if gap_s > limit_s:
            return Loss(f"no setpoint was sent for {gap_s:.2f} s", pin=True)
        if c.adopt_origin(c.in_force.station_id):
            c.alarm("EKF origin moved")
        if fresh and not c.follows and c.state is not FlightState.LANDING:
            return Loss(f"the vehicle left {c.profile.offboard_mode} for {c.mode}")
        strange_s = max(STRANGE_LAPSE_S, self._launch.loss_timeout_s)
        if self._uplink.strange_for_s > strange_s and self._lag.off_m > STRANGE_OFF_M:
            return Loss("the vehicle flies a target that is not ours", pin=True)
        return self._grounded() or self._unproved(time_s, limit_s, on_plan=on_plan)

    def _grounded(self) -> Loss | None:
        """The end, when the vehicle has been on the ground for a while, still armed."""
        c = self._c
        if not c.on_ground or c.state is FlightState.LANDING:
            self._grounded_s = math.inf
            return None
        self._grounded_s = min(self._grounded_s, c.now_s)
        if c.now_s - self._grounded_s < GROUNDED_S:
            return None
        c.alarm("the vehicle is on the ground")
        return Loss("the vehicle is on the ground, armed, and not where it should be", ended=FlightState.LOST)

    def _unproved(self, time_s: float, limit_s: float, *, on_plan: bool) -> Loss | None:
        """A neighbour takes over where the station in control cannot go on; a lapse where none could."""
        c, relay = self._c, self._relay
        if self._range.left and on_plan:
            relay.take_over(time_s, f"the vehicle is out of range of {c.gate.holder}")
        age_s = self._uplink.age_s
        if age_s > TAKEOVER_SHARE * self._launch.loss_timeout_s and on_plan:
            relay.take_over(time_s, f"link of {c.gate.holder} unproved for {age_s:.2f} s")
        if age_s > limit_s:
            return Loss(f"nothing proved the link of {c.gate.holder} for {age_s:.2f} s", pin=True)
        return None
