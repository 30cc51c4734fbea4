"""Planning as jobs in processes of their own."""

from gcs.jobs.opening import open_jobs
from gcs.jobs.planning_jobs import PlanningJobs

__all__ = ["PlanningJobs", "open_jobs"]
