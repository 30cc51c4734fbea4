"""Bodies of requests and answers, as the OpenAPI document describes them; a module a group of routes."""

from __future__ import annotations

from api.rest.schemas.base import BAD_INPUT_EXAMPLE, ENTRY_ID, INFEASIBLE_EXAMPLE, InfeasibleDetails, ProblemDetails
from api.rest.schemas.flights import (
    CommandBody,
    FlightDetail,
    FlightEvents,
    FlightPage,
    FlightSummary,
    LaunchCommand,
    NewFlight,
    ReplanCommand,
    ReplanProposal,
    ReplanRequest,
)
from api.rest.schemas.missions import (
    LOCAL_MISSION_EXAMPLE,
    MISSION_EXAMPLE,
    MissionBody,
    MissionDetail,
    MissionPage,
    MissionProblem,
    MissionSummary,
    PlanBody,
    Status,
    VersionList,
)
from api.rest.schemas.registries import (
    LinkEntry,
    RegisteredLink,
    RegisteredStation,
    RegisteredVehicle,
    RegistryPage,
    StationEntry,
    VehicleEntry,
)

__all__ = [
    "BAD_INPUT_EXAMPLE",
    "ENTRY_ID",
    "INFEASIBLE_EXAMPLE",
    "LOCAL_MISSION_EXAMPLE",
    "MISSION_EXAMPLE",
    "CommandBody",
    "FlightDetail",
    "FlightEvents",
    "FlightPage",
    "FlightSummary",
    "InfeasibleDetails",
    "LaunchCommand",
    "LinkEntry",
    "MissionBody",
    "MissionDetail",
    "MissionPage",
    "MissionProblem",
    "MissionSummary",
    "NewFlight",
    "PlanBody",
    "ProblemDetails",
    "RegisteredLink",
    "RegisteredStation",
    "RegisteredVehicle",
    "RegistryPage",
    "ReplanCommand",
    "ReplanProposal",
    "ReplanRequest",
    "StationEntry",
    "Status",
    "VehicleEntry",
    "VersionList",
]
