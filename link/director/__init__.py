"""The flight director: procedures and states from preflight to landing."""

from link.director.plan_exchange import judge_next

__all__ = ["judge_next"]
