"""What the parts of one flight share: its request, clock, events, control."""

from link.session.request import FlightRequest

__all__ = ["FlightRequest"]
