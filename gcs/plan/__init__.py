"""The plan: curve, handover schedule, contingencies, its document."""

from gcs.plan.document import read_plan
from gcs.plan.failsafe_return import OwnReturn, Place, ReturnRules, own_returns
from gcs.plan.model import Plan

__all__ = ["OwnReturn", "Place", "Plan", "ReturnRules", "own_returns", "read_plan"]
