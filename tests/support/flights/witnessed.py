"""Flights for the tests of evidence: ready on the ground, or in the air on their plan, each message open to change."""

from __future__ import annotations

from typing import Any

import pytest

from gcs.flight import FlightState
from tests.support.flights.tampered import TamperedFlight
from tests.support.plans.planned import relay_plan

BOTH = pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])


def in_the_air(autopilot: str, plan_s: float = 6.0, **request: Any) -> TamperedFlight:
    one = TamperedFlight(relay_plan(2), autopilot, frugal=True, request=request)
    one.run(until=lambda: one.plan_s >= plan_s, limit_s=300.0)
    assert one.core.state is FlightState.CRUISE
    return one


def ready(autopilot: str, **request: Any) -> TamperedFlight:
    one = TamperedFlight(relay_plan(2), autopilot, frugal=True, request={"auto_launch": False, **request})
    one.run(until=lambda: one.core.state is FlightState.READY, limit_s=120.0)
    assert one.core.state is FlightState.READY
    one.run_for(2.0)
    return one
