"""The streaming process and its supervisor."""

from link.streamer.scheduling import raise_priority
from link.streamer.supervisor import FlightResult, RunningFlight, attach, start_flight

__all__ = ["FlightResult", "RunningFlight", "attach", "raise_priority", "start_flight"]
