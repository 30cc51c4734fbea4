"""What a vehicle's failsafe parameters must be, judged from what was read back; `link.autopilot.parameter_names` names
them.

Both autopilots ship with their failsafes off or meaningless for a flight without a pilot's radio: the stream of
setpoints may stop without effect, a silent ground is nobody's business, an empty battery is a text. A flight beyond
sight depends on them, so every unsafe value, and every value unsafe beside another, is a failure with its remedy.

Sources: ArduCopter 4.3-4.7 and PX4 1.12-1.17 parameter definitions; what real ones did, in the recordings.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from gcs.plan import Plan
from link.autopilot.profile import AutopilotProfile
from link.microservices.parameter import Asking
from link.microservices.parameter_value import Parameter
from link.preflight.check import Check, Level

Values = Mapping[str, Parameter | None]

LEAST_TICKS = 4.0
"""The autopilot must bear the loss of so many setpoints in a row."""
LEAST_LOSS_TIMEOUT_S = 0.3


@dataclass(frozen=True)
class Rule:
    """What one parameter must be. ``fix`` makes the value to set of the one found, None where a person decides.

    ``optional``: firmware without it does what is required.
    """

    key: str
    holds: Callable[[float], bool]
    required: str
    why: str
    fix: Callable[[float], int | float] | None = None
    level: Level = Level.FAILURE
    optional: bool = False


def _among(*allowed: int) -> Callable[[float], bool]:
    return lambda value: value in allowed


def _rules_px4(least_s: float, values: Values) -> list[Rule]:
    pilot = values.get("rc_input_mode")
    rules = [
        Rule(
            "offboard_loss_timeout",
            lambda v: least_s <= v <= 5.0,
            f"{least_s:g} to 5 s",
            "how long the stream may be silent before the vehicle acts",
            lambda v: 1.0,
        ),
        Rule(
            "offboard_loss_action",
            _among(3, 4, 5),
            "3 (return), 4 (land) or 5 (hold)",
            "what it does when the stream stops; the rest needs a pilot's radio or drops the vehicle",
            lambda v: 5,
        ),
        Rule(
            "offboard_loss_action_no_rc",
            _among(0, 1, 2),
            "0 (land), 1 (hold) or 2 (return)",
            "what it does when the stream stops and there is no pilot's radio",
            lambda v: 1,
            optional=True,
        ),
        Rule(
            "data_link_loss_action",
            _among(1, 2, 3),
            "1 (hold), 2 (return) or 3 (land)",
            "what it does when every station falls silent",
            lambda v: 2,
        ),
        Rule("data_link_loss_timeout", lambda v: 3 <= v <= 60, "3 to 60 s", "how long until that", lambda v: 10),
        Rule(
            "battery_action",
            _among(2, 3),
            "2 (land) or 3 (return, then land)",
            "what it does when the battery is critical; nothing else keeps it from falling",
            lambda v: 3,
        ),
        Rule(
            "battery_critical",
            lambda v: 0.05 <= v <= 0.5,
            "0.05 to 0.5",
            "charge at which the battery counts as critical",
            lambda v: 0.07,
        ),
        Rule(
            "position_loss_action",
            _among(1),
            "1 (land)",
            "what it does without a position; the other way needs a pilot's radio",
            lambda v: 1,
            optional=True,
        ),
        Rule(
            "position_error_limit",
            lambda v: 0.0 < v <= 100.0,
            "more than 0, up to 100 m",
            "from which position error on the vehicle acts by itself",
            level=Level.WARNING,
            optional=True,
        ),
        Rule(
            "return_type",
            _among(0, 1, 3, 5),
            "0, 1, 3 or 5 (straight to home or a rally point)",
            "where a return goes; the others follow a mission stored in the vehicle",
            lambda v: 0,
        ),
        Rule(
            "fence_action",
            lambda v: v != 4,
            "not 4 (terminate)",
            "what it does beyond its fence",
            lambda v: 3,
        ),
    ]
    if pilot is None or pilot.value != 4:
        rules.append(
            Rule(
                "rc_loss_exceptions",
                lambda v: bool(int(v) & 4),
                "bit 2 (offboard) set",
                "without a pilot's radio its loss would end the flight",
                lambda v: int(v) | 4,
            )
        )
    return rules


def _rules_ardupilot(least_s: float, values: Values) -> list[Rule]:
    return [
        Rule(
            "offboard_loss_timeout",
            lambda v: least_s <= v <= 3.0,
            f"{least_s:g} to 3 s",
            "how long the vehicle runs on along its last velocity when the stream stops",
            lambda v: 3.0,
        ),
        Rule(
            "gcs_failsafe",
            _among(1, 3, 4, 5, 6, 7),
            "1 (return) or 3 to 7",
            "what it does when the owner's heartbeat stops",
            lambda v: 1,
        ),
        Rule("gcs_failsafe_timeout", lambda v: 2 <= v <= 30, "2 to 30 s", "how long until that", lambda v: 5),
        Rule(
            "failsafe_options",
            lambda v: bool(int(v) & 4),
            "bit 2 set where a pilot's radio is fitted",
            "else the loss of that radio ends GUIDED",
            level=Level.WARNING,
        ),
        Rule(
            "ekf_failsafe",
            _among(1, 3),
            "1 or 3 (land)",
            "what it does without a position; the others do nothing or need a pilot's radio",
            lambda v: 1,
        ),
        Rule(
            "ekf_threshold",
            lambda v: 0.0 < v <= 1.0,
            "more than 0, up to 1",
            "from when its position counts as lost",
            lambda v: 0.8,
        ),
        Rule(
            "battery_action",
            _among(1, 2, 3, 4, 6, 7),
            "1 to 4, 6 or 7 (land or return)",
            "what it does when the battery is low; nothing else keeps it from falling",
            lambda v: 2,
        ),
        Rule(
            "battery_critical_action",
            lambda v: v != 5,
            "not 5 (terminate)",
            "what it does when the battery is critical",
            lambda v: 1,
        ),
        Rule(
            "fence_action",
            _among(0, 1, 2, 3, 4, 5),
            "0 to 5",
            "what it does beyond its fence",
            lambda v: 1,
        ),
    ]


def judge_failsafes(
    profile: AutopilotProfile, values: Values, rate_hz: float, asking: Asking | None = None
) -> list[Check]:
    """Findings about the parameters, for a stream of ``rate_hz`` setpoints a second.

    ``values`` by `ParameterName.key`, None where the vehicle told none of its names; ``asking``: how it was asked,
    where that is known.
    """
    least_s = max(LEAST_LOSS_TIMEOUT_S, LEAST_TICKS / rate_hz)
    rules = _rules_px4(least_s, values) if profile.name == "px4" else _rules_ardupilot(least_s, values)
    checks = []
    for rule in rules:
        parameter = values.get(rule.key)
        if parameter is not None:
            checks.append(_judge(rule, parameter))
        else:
            checks += _missing(rule, profile.parameter(rule.key).names, asking)
    return checks + (_together_px4(values) if profile.name == "px4" else _together_ardupilot(values))


def _missing(rule: Rule, names: tuple[str, ...], asking: Asking | None) -> list[Check]:
    """A parameter without a value: the link may have lost it, or the vehicle has none."""
    denied = asking is not None and asking.denied.issuperset(names)
    if asking is not None and asking.unsure and not denied:
        # It may be there and unsafe, whatever firmware without it would do.
        level = Level.WARNING if rule.optional or rule.level < Level.FAILURE else Level.ERROR
        told = (
            f"no answer to {asking.attempts} questions, and the link loses {asking.loss:.0%} of them or of the answers"
        )
        fix = "whether the vehicle has it is not known: better the link (nearer, another channel or antenna), ask again"
    elif rule.optional:
        return []
    elif denied:
        level, told = rule.level, "the vehicle says that it has no such parameter"
        fix = "is it the autopilot and firmware it should be?"
    else:
        silent = "" if asking is None else f" (no answer to {asking.attempts} questions)"
        level, told = rule.level, f"not told by the vehicle{silent}"
        fix = "it has no such parameter, as it seems: is it the autopilot and firmware it should be, and the link good?"
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


def _judge(rule: Rule, parameter: Parameter) -> Check:
    name, value = parameter.name, parameter.value
    if math.isfinite(value) and rule.holds(value):
        return Check(name, Level.PASS, rule.why, value, rule.required)
    finite = math.isfinite(value)
    remedy = None if rule.fix is None else (name, rule.fix(value if finite else 0.0))
    fix = "" if remedy is not None else f"look at {name}: it is for the crew to decide"
    word = "unsafe" if rule.level >= Level.FAILURE else "not advisable"
    return Check(name, rule.level, f"{word}: {rule.why}", value if finite else str(value), rule.required, remedy, fix)


def _together_px4(values: Values) -> list[Check]:
    critical, emergency = values.get("battery_critical"), values.get("battery_emergency")
    if critical is None or emergency is None or not emergency.value >= critical.value:
        return []
    return [
        Check(
            emergency.name,
            Level.FAILURE,
            f"unsafe: not below {critical.name}, so the battery is never critical before it is an emergency",
            emergency.value,
            f"less than {critical.name} ({critical.value:g})",
            (emergency.name, 0.7 * float(critical.value)),
        )
    ]


def _together_ardupilot(values: Values) -> list[Check]:
    """The battery's action needs a level at which to act."""
    volt, charge = values.get("battery_low_voltage"), values.get("battery_low_charge")
    if volt is None or charge is None or volt.value > 0.0 or charge.value > 0.0:
        return []
    return [
        Check(
            volt.name,
            Level.FAILURE,
            f"unsafe: neither it nor {charge.name} says when the battery is low, so its failsafe never acts",
            volt.value,
            "more than 0 in one of them",
            fix=f"set {volt.name} or {charge.name} to what this battery needs",
        )
    ]
