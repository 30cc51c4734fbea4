"""The position-and-time program: transcription, Newton steps, interior point."""

from planner.joint.sequence_planner import Effort, plan_joint

__all__ = ["Effort", "plan_joint"]
