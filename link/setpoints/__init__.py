"""Setpoints: the plan resampled, the reference that is streamed."""

from link.setpoints.sampler import RATE_LIMITS_HZ, SetpointStream

__all__ = ["RATE_LIMITS_HZ", "SetpointStream"]
