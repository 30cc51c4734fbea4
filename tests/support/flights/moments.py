"""A flight taken to its cruise, and work done at many moments of it."""

from __future__ import annotations

import random
from collections.abc import Iterable
from typing import Any

from gcs.flight import FlightState
from tests.scorecard.soak import counted
from tests.support.flights.forks import in_fork
from tests.support.flights.virtual import VirtualFlight
from tests.support.plans.planned import relay_plan

SETPOINTS = ("SET_POSITION_TARGET_GLOBAL_INT", "SET_POSITION_TARGET_LOCAL_NED")


def in_cruise(autopilot: str, plan_s: float = 1.0, stations: int = 2, **request: Any) -> VirtualFlight:
    """A flight at a time of its plan."""
    one = VirtualFlight(relay_plan(stations), autopilot, frugal=True, request=request)
    one.run(until=lambda: one.plan_s >= plan_s, limit_s=300.0)
    assert one.core.state is FlightState.CRUISE
    return one


def at_moments(one: VirtualFlight, count: int, seed: int, work: Any, numbers: Iterable[int] | None = None) -> list[Any]:
    """``work(one, draw)`` in forks of one flight, at so many drawn moments of its cruise; or at ``numbers`` of them."""
    draw = random.Random(seed)
    last_s = relay_plan(2).mission_time_s - 3.0
    moments_s = sorted(draw.uniform(1.0, last_s) for _ in range(count))
    dice = [draw.random() for _ in moments_s]
    found = []
    for number in range(count) if numbers is None else numbers:
        one.run(until=lambda moment_s=moments_s[number]: one.plan_s >= moment_s, limit_s=200.0)  # type: ignore[misc]
        found.append(in_fork(lambda seed=dice[number]: work(one, random.Random(seed))))  # type: ignore[misc]
    return found


def soak_moments(what: str, one: VirtualFlight, count: int, seed: int, work: Any) -> list[Any]:
    """`at_moments` of a long run: those of its part, told as they are done."""
    return at_moments(one, count, seed, work, counted(what, range(count)))
