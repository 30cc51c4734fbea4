"""Setpoints the vehicle reports back, matched with those sent."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class Sent:
    """A setpoint that went out: when, from whom, under which grant, and what it asked in the local frame (NED)."""

    sent_s: float
    station_id: str
    grant: int
    position_m: tuple[float, float, float]
    velocity_m_s: tuple[float, float, float]
    acceleration_m_s2: tuple[float, float, float]


class EchoTracker:
    """Which of our setpoints the vehicle holds, from its POSITION_TARGET_LOCAL_NED (85), as far as that can be told.

    ``runs_on``: the vehicle moves the target on along its velocity between setpoints (ArduPilot), so that its position
    proves nothing by itself; the acceleration it repeats must then be one of ours too. Otherwise (PX4) the
    position is that of the setpoint. Setpoints too alike to be told apart give no answer.
    """

    POSITION_TOLERANCE_M = 0.25
    ACCELERATION_TOLERANCE_M_S2 = 2e-4
    TELLING_ACCELERATION_M_S2 = 0.02
    RUN_ON_S = 0.5
    """How far along its velocity a target may be past its setpoint. ArduPilot runs on for up to 3 s (GUID_TIMEOUT) when
    setpoints stop coming, and is not followed so far on purpose. As proof (`held`) such a target tells nothing new:
    the setpoint it began with was proved while it was fresh, and a longer reach would take more of them for possible.
    As a place (`distance_m`) it is near what we send meanwhile, which goes on too: in 2.85 s without uplink, after
    which the C2 link counts as lost, it comes 0.7 m away from that in cruise, and 5.1 m in a stop at 2.5 m/s^2 from
    15 m/s: 7.5 m are allowed here and 5 m more by `link.monitors.uplink.FOREIGN_TARGET_M`. A vehicle that brakes twice
    as hard may get an alarm of a foreign target in the last half second before that loss; it never brings the loss
    about."""
    LATELY_S = 1.5

    def __init__(self, *, runs_on: bool, memory: int = 100) -> None:
        self._runs_on = runs_on
        self._sent: deque[Sent] = deque(maxlen=memory)

    def note(self, sent: Sent) -> None:
        """Remember a setpoint that went out."""
        self._sent.append(sent)

    def distance_m(self, target: Any) -> float:
        """How far ``target`` is from the nearest setpoint sent lately, run-on allowed for; infinite without a place."""
        position = (target.x, target.y, target.z)
        if target.type_mask & 7 or not all(map(math.isfinite, position)):
            return math.inf
        nearest = math.inf
        for sent in reversed(self._sent):
            if sent.sent_s < self._sent[-1].sent_s - self.LATELY_S:
                break
            reach_m = self.RUN_ON_S * math.hypot(*sent.velocity_m_s) if self._runs_on else 0.0
            nearest = min(nearest, math.dist(position, sent.position_m) - reach_m)
        return max(0.0, nearest)

    def held(self, target: Any) -> tuple[Sent, ...]:
        """The setpoints of ours that ``target`` may be, oldest first; empty when it is none, or could be any."""
        position = (target.x, target.y, target.z)
        acceleration = (target.afx, target.afy, target.afz)
        if self._runs_on:
            if math.hypot(*acceleration) < self.TELLING_ACCELERATION_M_S2:
                return ()
            return tuple(
                s
                for s in self._sent
                if math.dist(acceleration, s.acceleration_m_s2) <= self.ACCELERATION_TOLERANCE_M_S2
                and math.dist(position, s.position_m)
                <= self.POSITION_TOLERANCE_M + self.RUN_ON_S * math.hypot(*s.velocity_m_s)
            )
        return tuple(s for s in self._sent if math.dist(position, s.position_m) <= self.POSITION_TOLERANCE_M)
