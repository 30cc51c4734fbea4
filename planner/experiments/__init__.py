"""The seed paper's experiments: enumeration, rivals, the readable cvxpy reference.

What Tables 3 and 4 of Qi, Dou and Xin 2023 compare alternating minimisation (`planner.paper`) with. Only benchmarks
import this room; cvxpy and NLopt, which it needs, come with the optional extra ``bench``.

==================  ===================================================================================
enumeration         EM of Table 3: every station sequence planned, or passed over by a bound
sequence_bound      that bound: a time nothing that begins with a given sequence can beat
rivals              the seven optimisers of Table 4, over the durations with P5 inside
cvxpy_reference     P4 and P5 in cvxpy, as the paper writes them; the whole method through it
==================  ===================================================================================
"""

from planner.experiments.cvxpy_reference import plan_paper_cvxpy
from planner.experiments.enumeration import Evaluation, enumerate_plans
from planner.experiments.rivals import plan_by_rival

__all__ = ["Evaluation", "enumerate_plans", "plan_by_rival", "plan_paper_cvxpy"]
