"""The streaming process and its supervisor."""

from link.streamer.flight_register import RegisteredFlight, ask, flight_on, registered_flights
from link.streamer.scheduling import raise_priority
from link.streamer.supervisor import FlightResult, RunningFlight, attach, epitaph, events_of, start_flight
from link.streamer.vehicle_client import VehicleClient, open_vehicle_client

__all__ = [
    "FlightResult",
    "RegisteredFlight",
    "RunningFlight",
    "VehicleClient",
    "ask",
    "attach",
    "epitaph",
    "events_of",
    "flight_on",
    "open_vehicle_client",
    "raise_priority",
    "registered_flights",
    "start_flight",
]
