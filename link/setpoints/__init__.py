"""Setpoints: the plan resampled, and the reference trajectory that is streamed.

What is sent is always a `Setpoint`; `SetpointSampler` gives a plan's at any time of it.
"""

from link.setpoints.sampler import RATE_LIMITS_HZ, SetpointSampler
from link.setpoints.setpoint import Setpoint

__all__ = ["RATE_LIMITS_HZ", "Setpoint", "SetpointSampler"]
