"""What must hold before anything is armed."""

from link.preflight.check import Check, Level, worst, worst_first
from link.preflight.failsafe_parameters import judge_failsafes
from link.preflight.identity import Identity, judge_identity

__all__ = ["Check", "Identity", "Level", "judge_failsafes", "judge_identity", "worst", "worst_first"]
