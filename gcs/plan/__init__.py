"""The plan: curve, handover schedule, contingencies, its document."""

from gcs.plan.document import read_plan
from gcs.plan.failsafe_return import FailsafeReturn, Place, ReturnRules, failsafe_returns
from gcs.plan.model import Plan

__all__ = ["FailsafeReturn", "Place", "Plan", "ReturnRules", "failsafe_returns", "read_plan"]
