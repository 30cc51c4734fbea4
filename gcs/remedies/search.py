"""The search for the smallest change that makes a mission possible."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from gcs.errors import GcsError
from gcs.mission.model import Mission
from gcs.remedies.application import apply
from gcs.remedies.changes import (
    Change,
    IncludeStation,
    LowerMargin,
    LowerOption,
    LowerStartSpeed,
    RaiseLimit,
    Triple,
    WidenBand,
)
from planner.arrays import Array

# Plans made in search of changes for one mission, at most, and how near a change comes to the least one that will do.
MAX_PLANS = 24
NEARNESS = 0.008
# Limits of the vehicle that cost time, and how far a change may raise each.
_RAISABLE = {
    "max_speed_m_s": 4.0,
    "max_accel_m_s2": 10.0,
    "max_jerk_m_s3": 100.0,
    "max_climb_m_s": 10.0,
    "max_descent_m_s": 10.0,
    "max_airspeed_m_s": 4.0,
}


Excess = Callable[[Mission], float]


@dataclass(frozen=True)
class _Knob:
    """Something that can be given up in part: ``change(share)`` for shares from 0 (nothing) to 1 (all of it).

    ``offset`` is what stays however much is given up, in shares: what a share is measured against (`NEARNESS`).
    """

    change: Callable[[float], Change]
    offset: float = 0.0


class Search:
    """Looks for the least changes after which ``excess`` of a mission is at most zero.

    ``excess``: how much a mission misses what is asked, e.g. seconds too many; infinite when it has no plan at all.
    ``now`` is that of ``mission`` as it is; ``plans`` how many may be made.
    """

    def __init__(self, mission: Mission, excess: Excess, now: float, *, plans: int = MAX_PLANS) -> None:
        self._mission = mission
        self._excess = excess
        self._now = now
        self._left = plans

    def time_changes(self) -> list[Change]:
        """What can be given up to be sooner: overlap, tenure, margin, handovers, limits; the cheapest to try first."""
        options, limits = self._mission.options, self._mission.limits
        knobs: list[_Knob] = []
        for name in ("min_overlap_s", "min_tenure_s"):
            given = getattr(options, name)
            if given > 0.0:
                knobs.append(_Knob(_lowering_option(name, given)))
        margin = options.range_margin_m
        if margin > 0.0:
            knobs.append(_Knob(lambda x: lower_margin(margin, (1.0 - x) * margin)))
        knobs += [_raising(n, v) for n in _RAISABLE if (v := getattr(limits, n)) is not None]
        found = [change for knob in knobs if (change := self._least(knob)) is not None]
        if options.max_handovers is not None:
            found += self._first([RaiseLimit("max_handovers", None, options.max_handovers + 1)])
        return found + self._first([IncludeStation(station) for station in options.excluded_stations[:4]])

    def start_changes(self, limit: str | None = None) -> list[Change]:
        """What lets a start state be taken up: less of it, or more of what stops it, ``limit`` if that is known."""
        state = self._mission.options.start_state
        assert state is not None
        velocity, acceleration = np.array(state.velocity_m_s), np.array(state.acceleration_m_s2)

        def slower(share: float) -> Change:
            left = (1.0 - share) * velocity
            return LowerStartSpeed(float(np.linalg.norm(left)), _three(left), _three((1.0 - share) * acceleration))

        limits = self._mission.limits
        knobs = [_Knob(slower, offset=0.5)]
        for name in ("max_accel_m_s2", "max_jerk_m_s3") if limit is None else (limit,):
            given = getattr(limits, name)
            if given is not None:
                knobs.append(_raising(name, given))
        if velocity[2] != 0.0 and limit is None:
            room = float(velocity[2]) ** 2 / limits.max_accel_m_s2 + 10.0
            knobs.append(_Knob(_widening(self._mission, room, up=bool(velocity[2] > 0.0))))
        return [change for knob in knobs if (change := self._least(knob)) is not None]

    def _first(self, changes: Sequence[Change]) -> list[Change]:
        """The first of several changes that will do, if any."""
        for change in changes:
            if self._left > 0 and self._try(change) <= 0.0:
                return [change]
        return []

    def _least(self, knob: _Knob) -> Change | None:
        """The smallest share of a knob that will do, as a change; None when all of it would not.

        Times do not always grow with what is asked (another sequence may suddenly be better), so less may do at times.
        The excess is interpolated between what is too little and what is enough (regula falsi), every step a little
        to the safe side; where that does not halve what is open, the next step does.
        """
        if self._left <= 0:
            return None
        low, high = 0.0, 1.0
        before, after = self._now, self._try(knob.change(1.0))
        if after > 0.0:
            return None
        halve = False
        near = NEARNESS * knob.offset
        while high - low > near + NEARNESS * high and self._left > 0:
            open_part = high - low
            middle = 0.5 * (low + high)
            if not halve and math.isfinite(before) and math.isfinite(after):
                root = low + open_part * before / max(before - after, 1e-12) + 0.3 * (near + NEARNESS * high)
                # Close to what is enough already: is a little less too little?
                middle = min(max(root, low + 0.01 * open_part), high - 0.9 * (near + NEARNESS * high))
                middle = max(middle, low + 0.01 * open_part)
            excess = self._try(knob.change(middle))
            if excess <= 0.0:
                high, after = middle, excess
            else:
                low, before = middle, excess
            halve = high - low > 0.5 * open_part
        return knob.change(high)

    def _try(self, change: Change) -> float:
        self._left -= 1
        try:
            return self._excess(apply(self._mission, change))
        except GcsError:
            return math.inf


def lower_margin(given_m: float, to_m: float) -> LowerMargin:
    """The change that takes ``to_m`` off every range instead of ``given_m``."""
    return LowerMargin(given_m - to_m, to_m)


def _lowering_option(name: str, given_s: float) -> Callable[[float], Change]:
    return lambda x: LowerOption(name, x * given_s, (1.0 - x) * given_s)


def _raising(name: str, given: float) -> _Knob:
    most = (_RAISABLE[name] - 1.0) * given
    return _Knob(lambda x: RaiseLimit(name, x * most, given + x * most), offset=given / most)


def _widening(mission: Mission, room_m: float, *, up: bool) -> Callable[[float], Change]:
    limits = mission.limits
    if up:
        return lambda x: WidenBand(max_alt_amsl_m=limits.max_alt_amsl_m + x * room_m, by_m=x * room_m)
    return lambda x: WidenBand(min_alt_amsl_m=limits.min_alt_amsl_m - x * room_m, by_m=x * room_m)


def _three(vector: Array) -> Triple:
    return float(vector[0]), float(vector[1]), float(vector[2])
