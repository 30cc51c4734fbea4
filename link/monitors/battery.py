"""The vehicle's batteries in flight, by its SYS_STATUS and each one's BATTERY_STATUS: what a person must know in time.

What the autopilot does when its battery is low is its own, judged before launch (`link.preflight.failsafe_parameters`).
Flown beyond sight that may end the flight far from everybody, so it is told earlier here: when little is left, when
very little is, and when what is left will not last to the end of the plan.
"""

from __future__ import annotations

from collections import deque

from link.dialect import mavlink
from link.session.timeline import Timeline
from link.session.vehicle import Vehicle

LOW_PERCENT, CRITICAL_PERCENT = 20, 10
RESERVE_PERCENT = 10.0
"""What must be left at the end of the plan for the battery to be said to last."""
FEWEST_STEPS, MOST_STEPS = 4, 11
"""SYS_STATUS counts in whole per cents: the rate is that between the newest of its steps, so many of them."""
AGAIN_PERCENT = 3.0
"""So much worse than what was told is told again."""


BAD_STATES = {
    mavlink.MAV_BATTERY_CHARGE_STATE_LOW: "low",
    mavlink.MAV_BATTERY_CHARGE_STATE_CRITICAL: "critical",
    mavlink.MAV_BATTERY_CHARGE_STATE_EMERGENCY: "an emergency",
    mavlink.MAV_BATTERY_CHARGE_STATE_FAILED: "failed",
    mavlink.MAV_BATTERY_CHARGE_STATE_UNHEALTHY: "unhealthy",
}
"""MAV_BATTERY_CHARGE_STATE that a person is told, worse ones later."""


class BatteryWatch:
    """Raises each alarm once: "battery low", "battery critical", and "the battery will not last".

    A battery's own charge state and, but for the first, whose figure SYS_STATUS has, its own charge are told once a
    level: "battery 1 is critical".
    """

    def __init__(self, timeline: Timeline, vehicle: Vehicle) -> None:
        self._timeline = timeline
        self._vehicle = vehicle
        self._steps: deque[tuple[float, int]] = deque(maxlen=MOST_STEPS)
        self._told = 101
        self._told_at_end = RESERVE_PERCENT
        self._told_of: dict[int, int] = {}
        """The worst charge state told of every battery."""

    def update(self, left_s: float | None) -> None:
        """Look at the newest figure; once a tick. ``left_s``: time to the end of the plan, None where off it."""
        self._each()
        timeline = self._timeline
        percent = self._vehicle.monitor.battery_percent
        if percent is None:
            return
        for level, what in ((CRITICAL_PERCENT, "battery critical"), (LOW_PERCENT, "battery low")):
            if percent < level <= self._told:
                self._told = level - 1
                timeline.alarm(what, percent=percent)
                break
        if self._steps and percent == self._steps[-1][1]:
            return
        if self._steps and percent > self._steps[-1][1]:
            self._steps.clear()  # another battery, or a better estimate
        self._steps.append((timeline.now_s, percent))
        if left_s is None or len(self._steps) < FEWEST_STEPS:
            return
        since_s, first = self._steps[0]
        at_end = percent - (first - percent) / (timeline.now_s - since_s) * left_s
        if at_end < self._told_at_end:
            self._told_at_end = at_end - AGAIN_PERCENT
            timeline.alarm(
                "the battery will not last", percent=percent, at_end_percent=round(at_end, 1), left_s=round(left_s, 1)
            )

    def _each(self) -> None:
        """Each battery by its own words."""
        for number, battery in self._vehicle.monitor.batteries.items():
            state, percent = battery.charge_state, battery.percent
            if number and percent is not None and percent < LOW_PERCENT:
                low, critical = mavlink.MAV_BATTERY_CHARGE_STATE_LOW, mavlink.MAV_BATTERY_CHARGE_STATE_CRITICAL
                state = max(state if state in BAD_STATES else 0, critical if percent < CRITICAL_PERCENT else low)
            if state in BAD_STATES and state > self._told_of.get(number, 0):
                self._told_of[number] = state
                self._timeline.alarm(f"battery {number} is {BAD_STATES[state]}", battery=number, percent=percent)
