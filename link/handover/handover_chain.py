"""Which station has the flight, and how it gets to the next: the chain of handovers along a plan, both ways."""

from __future__ import annotations

import math

from gcs.flight import HandoverState, TransitionError
from link.handover.handover import Handover, HandoverWindow, handover_windows
from link.session.context import FlightContext
from link.session.coverage import choices
from link.session.request import FlightRequest, HandoverWay

WINDOW_GUARD_S = 0.5
"""The flight stops this much (of the plan's time) before the end of a station's coverage."""
TAKEOVER_SHARE = 0.6
"""Of the autopilot's time-out: so long one attempt at a handover, and an unproved link, may last."""
TAKEOVER_PROVEN_S = 0.6
"""A neighbour that takes over at once must have been proved this lately."""


def attempt_time_s(request: FlightRequest, loss_timeout_s: float) -> float:
    """How long one attempt at a handover may last before the old station goes on."""
    return min(0.5 * request.confirmation_time_s, TAKEOVER_SHARE * loss_timeout_s)


class HandoverChain:
    """The legs of a plan and the handover under way. ``leg`` is the one whose station is in control."""

    def __init__(self, flight: FlightContext) -> None:
        self._flight = flight
        self._request = flight.request
        self._timeline = flight.timeline
        self._vehicle = flight.vehicle
        self._control = flight.control
        self.windows = handover_windows(flight.plan)
        self.leg = 0
        self.done_forward = self.done_back = 0
        """Handovers confirmed so far, along the plan and back."""
        self.handover: Handover | None = None
        self._accepted: set[int] = set()
        self._refused: dict[int, str] = {}
        self._distrusted_s: dict[str, float] = {}

    @property
    def way(self) -> HandoverWay:
        """How this vehicle is told of a handover; see `link.handover.handover`."""
        asked, vehicle = HandoverWay(self._request.handover_way), self._vehicle
        if asked is not HandoverWay.AUTO:
            return asked
        if math.isfinite(vehicle.monitor.control_s):
            return HandoverWay.OPERATOR_CONTROL
        return HandoverWay.RANGE if vehicle.profile.filters_station_ids else HandoverWay.GATE

    @property
    def moving(self) -> bool:
        """Whether control is being moved right now."""
        return self.handover is not None and self.handover.state is HandoverState.REQUESTED

    def ahead(self, *, backwards: bool) -> HandoverWindow | None:
        """The window the flight comes to next; the one control is being moved over, while it is."""
        if self.moving and self.handover is not None:
            return self.handover.window
        if backwards:
            return self.windows[self.leg - 1].mirrored() if self.leg > 0 else None
        return self.windows[self.leg] if self.leg < len(self.windows) else None

    def limits(self, *, backwards: bool) -> tuple[float, float]:
        """Between which times of the plan the flight may be: to the end of coverage while the next is not proved."""
        window = self.ahead(backwards=backwards)
        if window is None or self._for(window).open:
            return -math.inf, math.inf
        if window.forward:
            return -math.inf, window.limit_s - WINDOW_GUARD_S
        return window.limit_s + WINDOW_GUARD_S, math.inf

    def step(self, time_s: float, *, backwards: bool) -> None:
        """Let the handover ahead act, the flight being at ``time_s`` of the plan. Once a tick, before the setpoint."""
        window = self.ahead(backwards=backwards)
        if window is not None:
            self._for(window).step(time_s)
            self._settle()

    def take_over(self, time_s: float, reason: str) -> bool:
        """The link of the station in control has failed: a neighbour that covers the vehicle and is proved takes over.

        Whether control is being moved.
        """
        if self.moving:
            return True
        timeline = self._timeline
        for window in (self.ahead(backwards=False), self.ahead(backwards=True)):
            if window is None or not window.covered_by_next(time_s):
                continue
            if not self._vehicle.monitor.proven_within(timeline.now_s, window.to_station, TAKEOVER_PROVEN_S):
                continue
            if window.to_station not in choices(self._flight):
                continue
            self._distrusted_s[window.from_station] = timeline.now_s
            self._for(window).step(time_s, at_once=reason)
            moved = self.moving or (self.handover is not None and self.handover.done)
            self._settle()
            if moved:
                return True
        return False

    def adopt(self, leg: int) -> None:
        """The plan has been exchanged (`FlightContext.plan`), and the flight is on ``leg`` of the new one."""
        self.forget()
        self.windows = handover_windows(self._flight.plan)
        self.leg = leg
        # Commands for handovers to come were for those of the other plan.
        self._accepted = {index for index in self._accepted if index <= leg}
        self._refused.clear()

    def forget(self) -> None:
        """Give up the handover under way: the C2 link is lost, or another plan is flown."""
        control = self._control
        self.handover = None
        control.gate.accompany(None)
        if control.id_manager is not None:
            control.id_manager.claimed = None

    def accept(self, index: int) -> None:
        """An operator stands by for handover ``index``."""
        self._check(index)
        self._refused.pop(index, None)
        self._accepted.add(index)
        if self.handover is not None and self.handover.window.index == index:
            self.handover.accept()

    def refuse(self, index: int, reason: str) -> None:
        """An operator's refusal of handover ``index``. Raises `TransitionError` when it is under way or done."""
        self._check(index)
        if index <= self.leg:
            raise TransitionError(f"handover {index} is done")
        if self.handover is not None and self.handover.window.index == index:
            self.handover.refuse(reason)
        self._refused[index] = reason
        self._accepted.discard(index)

    def _check(self, index: int) -> None:
        if not 1 <= index <= len(self.windows):
            raise TransitionError(f"there is no handover {index}; the plan has {len(self.windows)}")

    def _for(self, window: HandoverWindow) -> Handover:
        """The handover over a window: the one at hand, or a new one."""
        if self.handover is not None and self.handover.window == window:
            return self.handover
        attempt_s = attempt_time_s(self._request, self._vehicle.loss_timeout_s)
        distrusted_s = self._distrusted_s.get(window.to_station, -math.inf)
        self.handover = Handover(self._flight, window, self.way, attempt_s, distrusted_s)
        if window.index in self._accepted:
            self.handover.accept()
        if window.index in self._refused:
            self.handover.refuse(self._refused[window.index])
        return self.handover

    def _settle(self) -> None:
        if self.handover is not None and self.handover.done:
            self.leg = self.handover.window.to_leg
            if self.handover.window.forward:
                self.done_forward += 1
            else:
                self.done_back += 1
            self.handover = None
