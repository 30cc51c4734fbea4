"""What PX4's failsafe parameters must be for a flight beyond sight without a pilot's radio.

Source: PX4 1.12-1.17 parameter definitions; what real ones did, in the recordings.
"""

from __future__ import annotations

from link.autopilot.failsafe_rule import FailsafeRule, UnsafeTogether, among, has_bits, offboard_loss_timeout
from link.autopilot.parameter_catalogue import Values

_NO_STICKS = 4
"""Of COM_RC_IN_MODE: there is no pilot's input at all."""


def _has_sticks(values: Values) -> bool:
    mode = values.get("rc_input_mode")
    return mode is None or mode.value != _NO_STICKS


RULES = (
    FailsafeRule(
        "offboard_loss_action",
        among(3, 4, 5),
        "3 (return), 4 (land) or 5 (hold)",
        "what it does when the stream stops; the rest needs a pilot's radio or drops the vehicle",
        lambda v: 5,
    ),
    FailsafeRule(
        "offboard_loss_action_no_rc",
        among(0, 1, 2),
        "0 (land), 1 (hold) or 2 (return)",
        "what it does when the stream stops and there is no pilot's radio",
        lambda v: 1,
        optional=True,
    ),
    FailsafeRule(
        "data_link_loss_action",
        among(1, 2, 3),
        "1 (hold), 2 (return) or 3 (land)",
        "what it does on a lost C2 link, when every station falls silent",
        lambda v: 2,
    ),
    FailsafeRule("data_link_loss_timeout", lambda v: 3 <= v <= 60, "3 to 60 s", "how long until that", lambda v: 10),
    FailsafeRule(
        "battery_action",
        among(2, 3),
        "2 (land) or 3 (return, then land)",
        "what it does when the battery is critical; nothing else keeps it from falling",
        lambda v: 3,
    ),
    FailsafeRule(
        "battery_critical",
        lambda v: 0.05 <= v <= 0.5,
        "0.05 to 0.5",
        "charge at which the battery counts as critical",
        lambda v: 0.07,
    ),
    FailsafeRule(
        "position_loss_action",
        among(1),
        "1 (land)",
        "what it does without a position; the other choice needs a pilot's radio",
        lambda v: 1,
        optional=True,
    ),
    FailsafeRule(
        "position_error_limit",
        lambda v: 0.0 < v <= 100.0,
        "more than 0, up to 100 m",
        "from which position error on the vehicle acts by itself",
        advisory=True,
        optional=True,
    ),
    FailsafeRule(
        "return_type",
        among(0, 1, 3, 5),
        "0, 1, 3 or 5 (straight to home or a rally point)",
        "where a return goes; the others follow a mission stored in the vehicle",
        lambda v: 0,
    ),
    FailsafeRule("fence_action", lambda v: v != 4, "not 4 (terminate)", "what it does beyond its fence", lambda v: 3),
    FailsafeRule(
        "rc_loss_exceptions",
        has_bits(4),
        "bit 2 (offboard) set",
        "without a pilot's radio its loss would end the flight",
        lambda v: int(v) | 4,
        applies=_has_sticks,
    ),
)


def rules(least_s: float) -> tuple[FailsafeRule, ...]:
    """All of them, for a stream whose silence of up to ``least_s`` must be borne."""
    why = "how long the stream may be silent before the vehicle acts"
    return (offboard_loss_timeout(least_s, 5.0, why, 1.0), *RULES)


def unsafe_together(values: Values) -> list[UnsafeTogether]:
    """The battery must be critical before it is an emergency."""
    critical, emergency = values.get("battery_critical"), values.get("battery_emergency")
    if critical is None or emergency is None or not emergency.value >= critical.value:
        return []
    return [
        UnsafeTogether(
            emergency.name,
            f"not below {critical.name}, so the battery is never critical before it is an emergency",
            emergency.value,
            f"less than {critical.name} ({critical.value:g})",
            (emergency.name, 0.7 * float(critical.value)),
        )
    ]
