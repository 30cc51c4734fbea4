"""Figures of the stream: rates and punctuality."""
