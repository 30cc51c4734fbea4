"""The search for the smallest change that makes a mission possible."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gcs.errors import GcsError
from gcs.mission.model import Mission
from gcs.remedies.actions import Fix, apply_fix

# Plans made in search of fixes for one mission, at most, and how near a fix comes to the least one that will do.
MAX_PLANS = 24
NEARNESS = 0.008
# Limits of the vehicle that cost time, and how far a fix may raise each.
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
    """Something that can be given up in part: ``fix(share)`` for shares from 0 (nothing) to 1 (all of it).

    ``offset`` is what stays however much is given up, in shares: what a share is measured against (`NEARNESS`).
    """

    fix: Callable[[float], Fix]
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

    def time_fixes(self) -> list[Fix]:
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
        fixes = [fix for knob in knobs if (fix := self._least(knob)) is not None]
        if options.max_handovers is not None:
            fixes += self._first([{"action": "raise_limit", "limit": "max_handovers", "to": options.max_handovers + 1}])
        return fixes + self._first([{"action": "include_station", "station": s} for s in options.excluded_stations[:4]])

    def start_fixes(self, limit: str | None = None) -> list[Fix]:
        """What lets a start state be taken up: less of it, or more of what stops it, ``limit`` if that is known."""
        state = self._mission.options.start_state
        assert state is not None
        velocity, acceleration = np.array(state.velocity_m_s), np.array(state.acceleration_m_s2)

        def slower(share: float) -> Fix:
            left = (1.0 - share) * velocity
            return {
                "action": "lower_start_speed",
                "below_m_s": float(np.linalg.norm(left)),
                "velocity_m_s": [float(x) for x in left],
                "acceleration_m_s2": [float(x) for x in (1.0 - share) * acceleration],
            }

        limits = self._mission.limits
        knobs = [_Knob(slower, offset=0.5)]
        for name in ("max_accel_m_s2", "max_jerk_m_s3") if limit is None else (limit,):
            given = getattr(limits, name)
            if given is not None:
                knobs.append(_raising(name, given))
        if velocity[2] != 0.0 and limit is None:
            room = float(velocity[2]) ** 2 / limits.max_accel_m_s2 + 10.0
            knobs.append(_Knob(_widening(self._mission, room, up=bool(velocity[2] > 0.0))))
        return [fix for knob in knobs if (fix := self._least(knob)) is not None]

    def _first(self, fixes: list[Fix]) -> list[Fix]:
        """The first of several fixes that will do, if any."""
        for fix in fixes:
            if self._left > 0 and self._try(fix) <= 0.0:
                return [fix]
        return []

    def _least(self, knob: _Knob) -> Fix | None:
        """The smallest share of a knob that will do, as its fix; None when all of it would not.

        Times do not always grow with what is asked (another sequence may suddenly be better), so less may do at times.
        The excess is interpolated between what is too little and what is enough (regula falsi), every step a little
        to the safe side; where that does not halve what is open, the next step does.
        """
        if self._left <= 0:
            return None
        low, high = 0.0, 1.0
        before, after = self._now, self._try(knob.fix(1.0))
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
            excess = self._try(knob.fix(middle))
            if excess <= 0.0:
                high, after = middle, excess
            else:
                low, before = middle, excess
            halve = high - low > 0.5 * open_part
        return knob.fix(high)

    def _try(self, fix: Fix) -> float:
        self._left -= 1
        try:
            return self._excess(apply_fix(self._mission, fix))
        except GcsError:
            return math.inf


def lower_margin(given_m: float, to_m: float) -> Fix:
    """The fix that takes ``to_m`` off every range instead of ``given_m``."""
    return {"action": "lower_margin", "by_m": given_m - to_m, "range_margin_m": to_m}


def _lowering_option(name: str, given_s: float) -> Callable[[float], Fix]:
    return lambda x: {"action": "lower_option", "option": name, "by_s": x * given_s, "to": (1.0 - x) * given_s}


def _raising(name: str, given: float) -> _Knob:
    most = (_RAISABLE[name] - 1.0) * given
    return _Knob(
        lambda x: {"action": "raise_limit", "limit": name, "by": x * most, "to": given + x * most},
        offset=given / most,
    )


def _widening(mission: Mission, room_m: float, *, up: bool) -> Callable[[float], Fix]:
    limits = mission.limits
    if up:
        return lambda x: {
            "action": "widen_band",
            "max_alt_amsl_m": limits.max_alt_amsl_m + x * room_m,
            "by_m": x * room_m,
        }
    return lambda x: {"action": "widen_band", "min_alt_amsl_m": limits.min_alt_amsl_m - x * room_m, "by_m": x * room_m}
