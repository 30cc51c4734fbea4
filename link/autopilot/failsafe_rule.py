"""What a failsafe parameter must be: the form in which each autopilot's rules are written down.

Judged in `link.preflight.failsafe_parameters`, which knows no autopilot by name.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from link.autopilot.parameter_catalogue import Values


@dataclass(frozen=True)
class FailsafeRule:
    """What one parameter, named by its `ParameterName.key`, must be.

    ``fix`` makes the value to set of the one found, None where a person decides. ``advisory``: a value that breaks it
    is not advisable, but no reason to stay on the ground. ``optional``: firmware without it does what is required.
    ``applies``: whether the rule counts, given the vehicle's other values.
    """

    key: str
    holds: Callable[[float], bool]
    required: str
    why: str
    fix: Callable[[float], int | float] | None = None
    advisory: bool = False
    optional: bool = False
    applies: Callable[[Values], bool] = lambda values: True


@dataclass(frozen=True)
class UnsafeTogether:
    """Values each fine by itself and unsafe beside another: ``name`` is the one to look at, ``set`` or ``fix`` the
    remedy."""

    name: str
    why: str
    value: int | float
    required: str
    set: tuple[str, int | float] | None = None
    fix: str = ""


def among(*allowed: int) -> Callable[[float], bool]:
    """Holds for these values."""
    return lambda value: value in allowed


def has_bits(bits: int) -> Callable[[float], bool]:
    """Holds where all of these bits are set."""
    return lambda value: int(value) & bits == bits


def offboard_loss_timeout(least_s: float, most_s: float, why: str, fix_s: float) -> FailsafeRule:
    """The rule for how long the stream may be silent: it must bear a few missed setpoints, ``least_s``."""
    return FailsafeRule(
        "offboard_loss_timeout",
        lambda v: least_s <= v <= most_s,
        f"{least_s:g} to {most_s:g} s",
        why,
        lambda v: fix_s,
    )
