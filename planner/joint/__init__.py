"""The joint program over positions and times: transcription, Newton steps, interior point.

The fastest curve along one corridor, all at once. `control_rows` writes control points as combinations of joint states,
`transcription` the constraints as functions of those rows and `objective` what is minimised; `newton` condenses one
step to a banded system, `interior_point` iterates. `program` scales a problem into this form, `solver` runs it from
several starts, and `sequence_planner` makes of a station sequence a certified trajectory.
"""

from planner.joint.sequence_planner import Effort, plan_joint

__all__ = ["Effort", "plan_joint"]
