"""Every parameter a preflight judges, with values safe and unsafe, for both autopilots, under every name it has had."""

from __future__ import annotations

import json
import math

import pytest

from link.autopilot.failsafe_rule import FailsafeRule
from link.autopilot.registry import PROFILES
from link.microservices.parameter import Asking
from link.microservices.parameter_value import Parameter
from link.preflight.check import Check, Level
from link.preflight.failsafe_parameters import judge_failsafes

RATE_HZ = 20.0
NAN = math.nan
SAFE: dict[str, dict[str, float]] = {
    "px4": {
        "COM_OF_LOSS_T": 1.0,
        "COM_OBL_RC_ACT": 5,
        "COM_OBL_ACT": 1,
        "NAV_DLL_ACT": 2,
        "COM_DL_LOSS_T": 10,
        "COM_RCL_EXCEPT": 4,
        "COM_RC_IN_MODE": 1,
        "NAV_RCL_ACT": 2,
        "COM_LOW_BAT_ACT": 3,
        "BAT_CRIT_THR": 0.07,
        "BAT_EMERGEN_THR": 0.05,
        "COM_POSCTL_NAVL": 1,
        "COM_POS_FS_EPH": 5.0,
        "RTL_TYPE": 0,
        "GF_ACTION": 2,
    },
    "ardupilot": {
        "GUID_TIMEOUT": 3.0,
        "FS_GCS_ENABLE": 1,
        "FS_GCS_TIMEOUT": 5,
        "FS_OPTIONS": 4,
        "FS_EKF_ACTION": 1,
        "FS_EKF_THRESH": 0.8,
        "BATT_FS_LOW_ACT": 2,
        "BATT_FS_CRT_ACT": 1,
        "BATT_LOW_VOLT": 10.5,
        "BATT_LOW_MAH": 0,
        "FENCE_ACTION": 1,
    },
}
STOCK: dict[str, dict[str, float]] = {
    "px4": {
        **SAFE["px4"],
        "COM_OBL_RC_ACT": 0,
        "NAV_DLL_ACT": 0,
        "COM_RCL_EXCEPT": 0,
        "COM_LOW_BAT_ACT": 0,
        "COM_POS_FS_EPH": -1,
    },
    "ardupilot": {
        **SAFE["ardupilot"],
        "FS_GCS_ENABLE": 0,
        "FS_OPTIONS": 16,
        "BATT_FS_LOW_ACT": 0,
        "BATT_FS_CRT_ACT": 0,
    },
}
UNSAFE: list[tuple[str, str, tuple[float, ...], float | None]] = [
    # autopilot, name, unsafe values, the remedy of the first (None: a person decides)
    ("px4", "COM_OF_LOSS_T", (0.1, 0.0, 60.0, NAN), 1.0),  # shorter than a few ticks
    ("px4", "COM_OBL_RC_ACT", (0, 1, 2, 6, 7, -1, NAN), 5),  # a pilot's modes, terminate, disarm
    ("px4", "COM_OBL_ACT", (-1, 3, 4), 1),
    ("px4", "NAV_DLL_ACT", (0, 5, 6), 2),
    ("px4", "COM_DL_LOSS_T", (600, 1), 10),
    ("px4", "COM_RCL_EXCEPT", (3, 0), 7),  # keeps what was set
    ("px4", "COM_LOW_BAT_ACT", (0, 1), 3),
    ("px4", "BAT_CRIT_THR", (0.01, 0.9), 0.07),
    ("px4", "COM_POSCTL_NAVL", (0,), 1),
    ("px4", "RTL_TYPE", (2, 4), 0),  # along a mission nobody knows of
    ("px4", "GF_ACTION", (4,), 3),
    ("ardupilot", "GUID_TIMEOUT", (5.0, 0.1, NAN), 3.0),
    ("ardupilot", "FS_GCS_ENABLE", (0, 2, 8), 1),  # 2 went on in AUTO
    ("ardupilot", "FS_GCS_TIMEOUT", (120, 1), 5),
    ("ardupilot", "FS_EKF_ACTION", (0, 2), 1),  # a report; a pilot's mode
    ("ardupilot", "FS_EKF_THRESH", (0.0, 5.0), 0.8),
    ("ardupilot", "BATT_FS_LOW_ACT", (0, 5), 2),
    ("ardupilot", "BATT_FS_CRT_ACT", (5,), 1),
    ("ardupilot", "FENCE_ACTION", (8,), 1),
]
TOLD_ONLY = {("px4", "COM_POS_FS_EPH"): (-1.0, 0.0, 500.0), ("ardupilot", "FS_OPTIONS"): (0, 16)}
TOGETHER: list[tuple[str, dict[str, float], str]] = [
    ("px4", {"BAT_CRIT_THR": 0.07, "BAT_EMERGEN_THR": 0.07}, "BAT_EMERGEN_THR"),
    ("px4", {"BAT_CRIT_THR": 0.1, "BAT_EMERGEN_THR": 0.2}, "BAT_EMERGEN_THR"),
    ("ardupilot", {"BATT_LOW_VOLT": 0, "BATT_LOW_MAH": 0}, "BATT_LOW_VOLT"),
]


def judged(autopilot: str, rate_hz: float = RATE_HZ, **changes: float | None) -> dict[str, Check]:
    """The findings, with some values changed; None: the vehicle does not know the name."""
    table = {k: v for k, v in {**SAFE[autopilot], **changes}.items() if v is not None}
    values: dict[str, Parameter | None] = {}
    for parameter in PROFILES[autopilot].parameters:
        name = next((n for n in parameter.names if n in table), None)
        values[parameter.key] = None if name is None else Parameter(name, table[name], 9)
    return {check.name: check for check in judge_failsafes(PROFILES[autopilot], values, rate_hz)}


def rules(autopilot: str) -> tuple[FailsafeRule, ...]:
    return PROFILES[autopilot].failsafe_rules(0.3)


def level_of(rule: FailsafeRule) -> Level:
    return Level.WARNING if rule.advisory else Level.FAILURE


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_safe_parameters_pass_and_the_stock_ones_do_not(autopilot: str) -> None:
    assert {c.level for c in judged(autopilot).values()} == {Level.PASS}
    stock = judged(autopilot, **STOCK[autopilot])
    failures = {c.name: c.set for c in stock.values() if c.level is Level.FAILURE}
    assert (
        failures
        == {
            "px4": {
                "COM_OBL_RC_ACT": ("COM_OBL_RC_ACT", 5),
                "NAV_DLL_ACT": ("NAV_DLL_ACT", 2),
                "COM_RCL_EXCEPT": ("COM_RCL_EXCEPT", 4),
                "COM_LOW_BAT_ACT": ("COM_LOW_BAT_ACT", 3),
            },
            "ardupilot": {
                "FS_GCS_ENABLE": ("FS_GCS_ENABLE", 1),
                "BATT_FS_LOW_ACT": ("BATT_FS_LOW_ACT", 2),
            },
        }[autopilot]
    )


@pytest.mark.parametrize(
    ("autopilot", "name", "value"), [(a, name, value) for a, name, values, _ in UNSAFE for value in values]
)
def test_every_unsafe_value_of_every_parameter_is_refused_with_a_remedy_that_is_safe(
    autopilot: str, name: str, value: float
) -> None:
    check = judged(autopilot, **{name: value})[name]
    assert check.blocks
    assert check.remedy
    json.dumps(check.to_document(), allow_nan=False)
    assert check.set is not None
    assert check.set[0] == name
    assert judged(autopilot, **{name: check.set[1]})[name].level is Level.PASS


@pytest.mark.parametrize(("autopilot", "name", "values", "remedy"), UNSAFE)
def test_the_remedies_by_hand(autopilot: str, name: str, values: tuple[float, ...], remedy: float) -> None:
    assert judged(autopilot, **{name: values[0]})[name].set == (name, remedy)


@pytest.mark.parametrize(("autopilot", "changes", "name"), TOGETHER)
def test_values_that_are_unsafe_together_are_refused(autopilot: str, changes: dict[str, float], name: str) -> None:
    check = judged(autopilot, **changes)[name]
    assert check.blocks
    assert check.remedy


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_no_rule_is_without_an_unsafe_value_in_these_tables(autopilot: str) -> None:
    tried = {name for a, name, _, _ in UNSAFE if a == autopilot} | {name for a, name in TOLD_ONLY if a == autopilot}
    for rule in rules(autopilot):
        names = set(PROFILES[autopilot].parameter(rule.key).names)
        assert names & tried, f"{rule.key} is judged and never tried"
    for (a, name), values in TOLD_ONLY.items():
        if a == autopilot:
            assert {judged(a, **{name: value})[name].level for value in values} == {Level.WARNING}


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_a_parameter_that_is_not_told_is_a_failure_unless_firmware_without_it_is_safe(autopilot: str) -> None:
    for rule in rules(autopilot):
        name = PROFILES[autopilot].parameter(rule.key).names[0]
        found = judged(autopilot, **{name: None})
        if rule.optional:
            assert name not in found
        else:
            assert (found[name].level, found[name].set) == (level_of(rule), None)
            assert "not told by the vehicle" in found[name].message
            assert found[name].remedy


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_a_lost_answer_is_told_apart_from_a_parameter_the_vehicle_does_not_have(autopilot: str) -> None:
    profile = PROFILES[autopilot]
    every = frozenset(name for parameter in profile.parameters for name in parameter.names)
    for rule in rules(autopilot):
        names = profile.parameter(rule.key).names

        def found(asking: Asking, names: tuple[str, ...] = names) -> Check | None:
            checks = {c.name: c for c in judge_failsafes(profile, {}, RATE_HZ, asking)}
            return checks.get(" or ".join(names))

        # Half of the questions unanswered: one in 256 of those asked eight times is lost, and one in 60,000 of 16.
        lossy = found(Asking(8, 0.5))
        assert lossy is not None
        assert lossy.level is (Level.WARNING if rule.optional or rule.advisory else Level.ERROR)
        assert "no answer to 8 questions, and the C2 link loses 50%" in lossy.message
        assert "better the C2 link" in lossy.remedy
        # The vehicle's own word counts on any link.
        for told, asking in (
            ("not told by the vehicle (no answer to 16 questions)", Asking(16, 0.5)),
            ("not told by the vehicle (no answer to 8 questions)", Asking(8, 0.1)),
            ("not told by the vehicle (no answer to 8 questions)", Asking(8, None)),
            ("the vehicle says that it has no such parameter", Asking(8, 0.5, every)),
        ):
            check = found(asking)
            if rule.optional:
                assert check is None
            else:
                assert check is not None
                assert check.message.startswith(told)
                assert check.level is level_of(rule)
                assert "autopilot and firmware" in check.remedy


def test_the_time_out_must_bear_a_few_missed_ticks_of_this_stream() -> None:
    assert judged("px4", 5.0, COM_OF_LOSS_T=0.6)["COM_OF_LOSS_T"].blocks  # 4 ticks of 0.2 s
    assert not judged("px4", 20.0, COM_OF_LOSS_T=0.6)["COM_OF_LOSS_T"].blocks


def test_a_vehicle_without_stick_input_needs_no_exception_for_its_loss() -> None:
    assert "COM_RCL_EXCEPT" not in judged("px4", COM_RC_IN_MODE=4, COM_RCL_EXCEPT=0)
