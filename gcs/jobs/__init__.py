"""Planning as jobs in processes of their own."""

from gcs.jobs.planning_pool import PlanningPool

__all__ = ["PlanningPool"]
