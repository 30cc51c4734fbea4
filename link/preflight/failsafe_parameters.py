"""A vehicle's failsafe parameters, judged from what was read back by the rules of its `AutopilotProfile`.

Both autopilots ship with their failsafes off or meaningless for a flight without a pilot's radio: the stream of
setpoints may stop without effect, a lost C2 link is nobody's business, an empty battery is a text. A flight beyond
sight depends on them, so every unsafe value, and every value unsafe beside another, is a failure with its remedy.
"""

from __future__ import annotations

import math

import numpy as np

from gcs.plan import Plan
from link.autopilot.failsafe_rule import FailsafeRule
from link.autopilot.parameter_catalogue import Values
from link.autopilot.profile import AutopilotProfile
from link.microservices.parameter import Asking
from link.microservices.parameter_value import Parameter
from link.preflight.check import Check, Level

LEAST_TICKS = 4.0
"""The autopilot must bear the loss of so many setpoints in a row."""
LEAST_LOSS_TIMEOUT_S = 0.3


def judge_failsafes(
    profile: AutopilotProfile, values: Values, rate_hz: float, asking: Asking | None = None
) -> list[Check]:
    """Findings about the parameters, for a stream of ``rate_hz`` setpoints a second.

    ``values`` by `ParameterName.key`, None where the vehicle told none of its names; ``asking``: how it was asked,
    where that is known.
    """
    least_s = max(LEAST_LOSS_TIMEOUT_S, LEAST_TICKS / rate_hz)
    checks = []
    for rule in profile.failsafe_rules(least_s):
        if not rule.applies(values):
            continue
        parameter = values.get(rule.key)
        if parameter is not None:
            checks.append(_judge(rule, parameter))
        else:
            checks += _missing(rule, profile.parameter(rule.key).names, asking)
    return checks + [
        Check(found.name, Level.FAILURE, f"unsafe: {found.why}", found.value, found.required, found.set, found.fix)
        for found in profile.unsafe_together(values)
    ]


def _level(rule: FailsafeRule) -> Level:
    return Level.WARNING if rule.advisory else Level.FAILURE


def _missing(rule: FailsafeRule, names: tuple[str, ...], asking: Asking | None) -> list[Check]:
    """A parameter without a value: the C2 link may have lost it, or the vehicle has none."""
    denied = asking is not None and asking.denied.issuperset(names)
    if asking is not None and asking.unsure and not denied:
        # It may be there and unsafe, whatever firmware without it would do.
        level = Level.WARNING if rule.optional or rule.advisory else Level.ERROR
        lost = f"the C2 link loses {asking.loss:.0%} of them or of the answers"
        told = f"no answer to {asking.attempts} questions, and {lost}"
        remedy = "better the C2 link (nearer, another channel or antenna), ask again"
        fix = f"whether the vehicle has it is not known: {remedy}"
    elif rule.optional:
        return []
    elif denied:
        level, told = _level(rule), "the vehicle says that it has no such parameter"
        fix = "is it the autopilot and firmware it should be?"
    else:
        silent = "" if asking is None else f" (no answer to {asking.attempts} questions)"
        level, told = _level(rule), f"not told by the vehicle{silent}"
        questions = "is it the autopilot and firmware it should be, and the C2 link good?"
        fix = f"it has no such parameter, as it seems: {questions}"
    return [Check(" or ".join(names), level, f"{told}: {rule.why}", None, rule.required, fix=fix)]


def judge_rally_limit(values: Values, plan: Plan, *, wanted: bool) -> list[Check]:
    """ArduPilot: whether the mission's safe points count as rally points wherever the flight is (RALLY_LIMIT_KM)."""
    parameter = values.get("rally_limit")
    if parameter is None or not wanted:
        return []
    name, limit_km = parameter.name, float(parameter.value)
    points = plan.geometry.enu_m([point.position for point in plan.mission.safe_points])
    path = plan.trajectory.evaluate(np.linspace(0.0, plan.mission_time_s, 200))
    away_m = np.linalg.norm(path[:, None, :2] - points[None, :, :2], axis=-1).min(axis=1).max()
    fits = limit_km <= 0.0 or 1000.0 * limit_km >= away_m
    required = f"0 (any distance) or at least {away_m / 1000.0:.2f} km"
    told = f"the nearest safe point is up to {away_m / 1000.0:.2f} km from the path"
    if fits:
        return [Check(name, Level.PASS, told, parameter.value, required)]
    return [Check(name, Level.WARNING, f"{told}: beyond its limit it does not count", limit_km, required, (name, 0))]


def _judge(rule: FailsafeRule, parameter: Parameter) -> Check:
    name, value = parameter.name, parameter.value
    if math.isfinite(value) and rule.holds(value):
        return Check(name, Level.PASS, rule.why, value, rule.required)
    finite = math.isfinite(value)
    remedy = None if rule.fix is None else (name, rule.fix(value if finite else 0.0))
    fix = "" if remedy is not None else f"look at {name}: it is for the crew to decide"
    word = "not advisable" if rule.advisory else "unsafe"
    return Check(name, _level(rule), f"{word}: {rule.why}", value if finite else str(value), rule.required, remedy, fix)
