"""Scorecard 32: nothing the vehicle says raises, ends a flight that flies, or launches one on the unknown."""

from __future__ import annotations

from typing import Any

import pytest

from gcs.flight import FlightState, OperatorCommand, TransitionError
from link.session.containment import FAULT
from tests.scorecard.soak import counted
from tests.support.flights import telemetry_fuzz as fuzz
from tests.support.flights.forks import in_fork
from tests.support.flights.tampered import TamperedFlight
from tests.support.plans.planned import relay_plan

BOTH = pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
MOST_SEEDS = 60
STATES = ("preflight", "ready", "arming", "takeoff", "transit", "cruise", "holding", "returning", "lapsed", "landing")


def at(autopilot: str, state: str) -> TamperedFlight:
    """A flight in a state."""
    one = TamperedFlight(relay_plan(2), autopilot, frugal=True, request={"auto_launch": state != "ready"})
    after = {"holding": OperatorCommand.HOLD, "returning": OperatorCommand.ABORT, "landing": OperatorCommand.LAND}
    if state == "lapsed":
        one.run(until=lambda: one.plan_s > 5.0, limit_s=200.0)
        one.core.airborne._lose_link("a test", pin=True)
    elif state in after:
        one.run(until=lambda: one.plan_s > 5.0, limit_s=200.0)
        one.core.command(after[state])
    else:
        one.run(until=lambda: one.core.state.value == state, limit_s=200.0)
    assert one.core.state.value == state
    return one


def judged(one: TamperedFlight, seed: int, seconds: float) -> tuple[int, list[str]]:
    """How many messages were said, and what went wrong under them."""
    ready = one.core.state is FlightState.READY
    said = fuzz.harass(one, seed, seconds)
    if ready and one.said("state", to=FlightState.ARMING.value):
        return said, [f"launched, and nobody commanded it: {[e.data['reason'] for e in one.said('state')]}"]
    problems = [f"{FAULT}: {e.data}" for e in one.said("alarm", what=FAULT)]
    if one.core.state.ended and one.vehicle.autopilot.armed and not one.vehicle.body.on_ground:
        problems.append(f"ended {one.core.state} while it flew: {one.said('state')[-1].data['reason']}")
    return said, problems


def some(one: TamperedFlight, first: int, count: int, seconds: float, least: int) -> tuple[int, list[str]]:
    """`judged` from here by ``count`` seeds from the first on, and by more until ``least`` messages were said.

    On the ground a flight may end at any of them (another board, another station in control): then little was said.
    """
    said, problems, seed = 0, [], first
    while seed < first + count or (said < least and seed < first + MOST_SEEDS):
        more, found = in_fork(lambda seed=seed: judged(one, seed, seconds))  # type: ignore[misc]
        said += more
        problems += [f"seed {seed}: {p}" for p in found]
        seed += 1
    return said, problems


@BOTH
def test_every_kind_once_in_cruise_raises_nothing(autopilot: str) -> None:
    import random

    one = at(autopilot, "cruise")
    draw = random.Random(7)
    for message_id in fuzz.KINDS:
        one.say(fuzz.message(draw, message_id, int(one.vehicle.time_s * 1e3)))
    one.run_for(0.5)
    assert [dict(e.data) for e in one.said("alarm", what=FAULT)] == []


@BOTH
@pytest.mark.parametrize("state", ["cruise", "ready"])
def test_a_little_of_everything_raises_nothing_and_ends_nothing(autopilot: str, state: str) -> None:
    said, problems = some(at(autopilot, state), 0, 2, 2.0, 61)
    assert problems == []
    assert said > 60


@BOTH
@pytest.mark.slow
@pytest.mark.parametrize("state", STATES)
def test_everything_in_every_state_raises_nothing_and_ends_nothing(autopilot: str, state: str) -> None:
    said, problems = some(at(autopilot, state), 100, 4, 5.0, 201)
    assert problems == []
    assert said > 200


@BOTH
@pytest.mark.soak
@pytest.mark.parametrize("state", STATES)
def test_a_hundred_times_everything_in_every_state(autopilot: str, state: str) -> None:
    one, told = at(autopilot, state), 0
    for seed in counted(f"fuzz {autopilot} {state}", range(100)):
        said, problems = in_fork(lambda seed=seed: judged(one, 1000 + seed, 10.0))  # type: ignore[misc]
        assert problems == [], seed
        told += said
    print(f"{told} messages")


@BOTH
@pytest.mark.slow
def test_no_launch_on_the_unknown(autopilot: str) -> None:
    """Fuzzed while ready, and launched: armed is only what has a position then."""
    one = at(autopilot, "ready")

    def launched(seed: int) -> Any:
        fuzz.harass(one, seed, 3.0)
        try:
            one.core.command(OperatorCommand.LAUNCH)
        except TransitionError:
            return True
        one.run(until=lambda: one.vehicle.autopilot.armed or one.core.finished, limit_s=60.0)
        return one.core.context.vehicle.position is not None or one.core.state is FlightState.REFUSED

    assert all(in_fork(lambda seed=seed: launched(seed)) for seed in range(4))  # type: ignore[misc]
