"""A mission laid out on its plane: from positions on the earth to the planner's problem."""

from gcs.layout.planning_problem import lay_out

__all__ = ["lay_out"]
