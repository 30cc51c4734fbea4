"""The flight director: procedures and states from preflight to landing."""

from link.director.launch import PREFLIGHT_VALID_S
from link.director.plan_exchange import judge_next

__all__ = ["PREFLIGHT_VALID_S", "judge_next"]
