"""Which station has the flight, and how it gets to the next: the chain of handovers along a plan, both ways."""

from __future__ import annotations

import math

from gcs.flight import HandoverState, TransitionError
from link.handover.handover import Border, Handover, borders
from link.session.context import FlightContext
from link.session.request import FlightRequest

BORDER_GUARD_S = 0.5
"""The flight stops this much (of the plan's time) before the end of a station's coverage."""
TAKEOVER_SHARE = 0.6
"""Of the autopilot's time-out: so long one attempt at a handover, and an unproved link, may last."""
TAKEOVER_PROVEN_S = 0.6
"""A neighbour that takes over at once must have been proved this lately."""


def attempt_time_s(request: FlightRequest, loss_timeout_s: float) -> float:
    """How long one attempt at a handover may last before the old station goes on."""
    return min(0.5 * request.confirmation_time_s, TAKEOVER_SHARE * loss_timeout_s)


class Relay:
    """The legs of a plan and the handover under way. ``leg`` is the one whose station is in control."""

    def __init__(self, context: FlightContext) -> None:
        self._c = context
        self.borders = borders(context.plan)
        self.leg = 0
        self.handover: Handover | None = None
        self.loss_timeout_s = 1.0
        self._accepted: set[int] = set()
        self._refused: dict[int, str] = {}
        self._distrusted_s: dict[str, float] = {}

    @property
    def way(self) -> str:
        """How this vehicle is told of a handover; see `link.handover.handover`."""
        c = self._c
        if c.request.handover_way != "auto":
            return c.request.handover_way
        if math.isfinite(c.monitor.control_s):
            return "operator_control"
        return "range" if c.profile.filters_station_ids else "gate"

    @property
    def moving(self) -> bool:
        """Whether control is being moved right now."""
        return self.handover is not None and self.handover.state is HandoverState.REQUESTED

    def ahead(self, *, backwards: bool) -> Border | None:
        """The border the flight comes to next; the one control is being moved over, while it is."""
        if self.moving and self.handover is not None:
            return self.handover.border
        if backwards:
            return self.borders[self.leg - 1].mirrored() if self.leg > 0 else None
        return self.borders[self.leg] if self.leg < len(self.borders) else None

    def limits(self, *, backwards: bool) -> tuple[float, float]:
        """Between which times of the plan the flight may be: to the end of coverage while the next is not proved."""
        border = self.ahead(backwards=backwards)
        if border is None or self._for(border).open:
            return -math.inf, math.inf
        if border.forward:
            return -math.inf, border.limit_s - BORDER_GUARD_S
        return border.limit_s + BORDER_GUARD_S, math.inf

    def step(self, time_s: float, *, backwards: bool) -> None:
        """Let the handover ahead act, the flight being at ``time_s`` of the plan. Once a tick, before the setpoint."""
        border = self.ahead(backwards=backwards)
        if border is not None:
            self._for(border).step(time_s)
            self._settle()

    def take_over(self, time_s: float, reason: str) -> bool:
        """The link of the station in control has failed: a neighbour that covers the vehicle and is proved takes over.

        Whether control is being moved.
        """
        if self.moving:
            return True
        c = self._c
        for border in (self.ahead(backwards=False), self.ahead(backwards=True)):
            if border is None or not border.covered_by_next(time_s):
                continue
            if not c.monitor.proven_within(c.now_s, border.to_station, TAKEOVER_PROVEN_S):
                continue
            self._distrusted_s[border.from_station] = c.now_s
            self._for(border).step(time_s, at_once=reason)
            moved = self.moving or (self.handover is not None and self.handover.done)
            self._settle()
            if moved:
                return True
        return False

    def adopt(self, leg: int) -> None:
        """The plan has been exchanged (`FlightContext.plan`), and the flight is on ``leg`` of the new one."""
        self.forget()
        self.borders = borders(self._c.plan)
        self.leg = leg
        # Words for handovers to come were for those of the other plan.
        self._accepted = {index for index in self._accepted if index <= leg}
        self._refused.clear()

    def forget(self) -> None:
        """Give up the handover under way: the flight lapsed."""
        self.handover = None
        self._c.gate.accompany(None)
        if self._c.keeper is not None:
            self._c.keeper.claimed = None

    def accept(self, index: int) -> None:
        """An operator's word for handover ``index``."""
        self._check(index)
        self._refused.pop(index, None)
        self._accepted.add(index)
        if self.handover is not None and self.handover.border.index == index:
            self.handover.accept()

    def refuse(self, index: int, reason: str) -> None:
        """An operator's refusal of handover ``index``. Raises `TransitionError` when it is under way or done."""
        self._check(index)
        if index <= self.leg:
            raise TransitionError(f"handover {index} is done")
        if self.handover is not None and self.handover.border.index == index:
            self.handover.refuse(reason)
        self._refused[index] = reason
        self._accepted.discard(index)

    def _check(self, index: int) -> None:
        if not 1 <= index <= len(self.borders):
            raise TransitionError(f"there is no handover {index}; the plan has {len(self.borders)}")

    def _for(self, border: Border) -> Handover:
        """The handover over a border: the one at hand, or a new one."""
        if self.handover is not None and self.handover.border == border:
            return self.handover
        attempt_s = attempt_time_s(self._c.request, self.loss_timeout_s)
        distrusted_s = self._distrusted_s.get(border.to_station, -math.inf)
        self.handover = Handover(self._c, border, self.way, attempt_s, distrusted_s)
        if border.index in self._accepted:
            self.handover.accept()
        if border.index in self._refused:
            self.handover.refuse(self._refused[border.index])
        return self.handover

    def _settle(self) -> None:
        if self.handover is not None and self.handover.done:
            self.leg = self.handover.border.to_leg
            self.handover = None
