"""Setpoints: the plan resampled, the reference that is streamed."""
