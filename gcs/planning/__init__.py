"""From mission to plan, and a flight planned anew under way."""

from gcs.planning.certification import recertify
from gcs.planning.mission_planning import default_planner, plan_mission, product_version
from gcs.planning.option_costs import with_costs
from gcs.planning.replanning import ReplanOrder, replan

__all__ = [
    "ReplanOrder",
    "default_planner",
    "plan_mission",
    "product_version",
    "recertify",
    "replan",
    "with_costs",
]
