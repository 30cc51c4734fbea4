"""What the parts of one flight share: its request, its timeline, its vehicle, its control."""

from link.session.request import FlightRequest

__all__ = ["FlightRequest"]
