"""A plan with safe points, and flights of it up to the end of their preflight."""

from __future__ import annotations

from functools import cache
from typing import Any

from gcs.flight import FlightState
from gcs.mission import read_mission
from gcs.plan.model import Plan
from gcs.planning.mission_planning import plan_mission
from tests.support.flights.virtual import VirtualFlight
from tests.support.plans.planned import relay_document

FIELDS = ("field-0", "field-1", "field-2")
FAR = "far"
GROUND_M = 28.0


@cache
def safe_plan(stations: int = 3) -> Plan:
    """The relay's plan with a field by each station, and one that no station reaches."""
    document = relay_document(stations)
    document["safe_points"] = [
        {"id": f"field-{k}", "east_m": 420.0 * k + 100.0, "north_m": 150.0, "up_m": GROUND_M} for k in range(stations)
    ] + [{"id": FAR, "east_m": 5000.0, "north_m": 5000.0, "up_m": GROUND_M}]
    return plan_mission(read_mission(document), fast=True)


def on_ground(autopilot: str, plan: Plan | None = None, **settings: Any) -> VirtualFlight:
    """A flight that has been judged and waits for its word, or has been refused."""
    request = {"auto_launch": False, **settings.pop("request", {})}
    settings.setdefault("frugal", True)
    one = VirtualFlight(plan or safe_plan(), autopilot, request=request, **settings)
    one.run(until=lambda: one.core.state is FlightState.READY, limit_s=400.0)
    return one


def checks(one: VirtualFlight) -> dict[str, Any]:
    """The last preflight's checks by name: (level, message, fix)."""
    return {str(e.data["name"]): e.data for e in one.said("check", preflight=one.core.launch.preflight_id)}
