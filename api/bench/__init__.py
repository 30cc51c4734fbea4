"""Measurements behind ``skyrelay bench``."""
