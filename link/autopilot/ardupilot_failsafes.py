"""What ArduPilot's failsafe parameters must be for a flight beyond sight without a pilot's radio.

Source: ArduCopter 4.3-4.7 parameter definitions; what real ones did, in the recordings.
"""

from __future__ import annotations

from link.autopilot.failsafe_rule import FailsafeRule, UnsafeTogether, among, has_bits, offboard_loss_timeout
from link.autopilot.parameter_catalogue import Values

RULES = (
    FailsafeRule(
        "gcs_failsafe",
        among(1, 3, 4, 5, 6, 7),
        "1 (return) or 3 to 7",
        "what it does on a lost C2 link, when the owner's heartbeat stops",
        lambda v: 1,
    ),
    FailsafeRule("gcs_failsafe_timeout", lambda v: 2 <= v <= 30, "2 to 30 s", "how long until that", lambda v: 5),
    FailsafeRule(
        "failsafe_options",
        has_bits(4),
        "bit 2 set where a pilot's radio is fitted",
        "else the loss of that radio ends GUIDED",
        advisory=True,
    ),
    FailsafeRule(
        "ekf_failsafe",
        among(1, 3),
        "1 or 3 (land)",
        "what it does without a position; the others do nothing or need a pilot's radio",
        lambda v: 1,
    ),
    FailsafeRule(
        "ekf_threshold",
        lambda v: 0.0 < v <= 1.0,
        "more than 0, up to 1",
        "from when its position counts as lost",
        lambda v: 0.8,
    ),
    FailsafeRule(
        "battery_action",
        among(1, 2, 3, 4, 6, 7),
        "1 to 4, 6 or 7 (land or return)",
        "what it does when the battery is low; nothing else keeps it from falling",
        lambda v: 2,
    ),
    FailsafeRule(
        "battery_critical_action",
        lambda v: v != 5,
        "not 5 (terminate)",
        "what it does when the battery is critical",
        lambda v: 1,
    ),
    FailsafeRule("fence_action", among(0, 1, 2, 3, 4, 5), "0 to 5", "what it does beyond its fence", lambda v: 1),
)


def rules(least_s: float) -> tuple[FailsafeRule, ...]:
    """All of them, for a stream whose silence of up to ``least_s`` must be borne."""
    why = "how long the vehicle runs on along its last velocity when the stream stops"
    return (offboard_loss_timeout(least_s, 3.0, why, 3.0), *RULES)


def unsafe_together(values: Values) -> list[UnsafeTogether]:
    """The battery's action needs a level at which to act."""
    volt, charge = values.get("battery_low_voltage"), values.get("battery_low_charge")
    if volt is None or charge is None or volt.value > 0.0 or charge.value > 0.0:
        return []
    return [
        UnsafeTogether(
            volt.name,
            f"neither it nor {charge.name} says when the battery is low, so its failsafe never acts",
            volt.value,
            "more than 0 in one of them",
            fix=f"set {volt.name} or {charge.name} to what this battery needs",
        )
    ]
