"""The seed paper's experiments: enumeration, rivals, the readable cvxpy reference."""

from planner.experiments.cvxpy_reference import plan_paper_cvxpy
from planner.experiments.enumeration import Evaluation, enumerate_plans
from planner.experiments.rivals import plan_by_rival

__all__ = ["Evaluation", "enumerate_plans", "plan_by_rival", "plan_paper_cvxpy"]
