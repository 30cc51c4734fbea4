"""The service behind REST: its parts wired, flights commanded and watched, replanning, metrics, logs."""

from __future__ import annotations

from api.service.changes import Changes
from api.service.errors import (
    ReplanError,
    ReplanFailedError,
    ReplanInfeasibleError,
    ReplanStateError,
    ServiceError,
    StillStoppingError,
)
from api.service.flight_status import FlightStatus, outer_state
from api.service.flights import FlightService
from api.service.logs import configure_logging
from api.service.metrics import Metrics
from api.service.replanning import Proposal, Replanning
from api.service.services import Services
from api.service.vehicles import restore_vehicle

__all__ = [
    "Changes",
    "FlightService",
    "FlightStatus",
    "Metrics",
    "Proposal",
    "ReplanError",
    "ReplanFailedError",
    "ReplanInfeasibleError",
    "ReplanStateError",
    "Replanning",
    "ServiceError",
    "Services",
    "StillStoppingError",
    "configure_logging",
    "outer_state",
    "restore_vehicle",
]
