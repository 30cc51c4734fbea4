"""Parameters read over bad links: asked again as the link asks for it, and a vehicle's no is a no."""

from __future__ import annotations

from typing import Any

import pytest

from link.dialect import mavlink
from link.director import launch as launch_module
from link.microservices.parameter import ATTEMPTS, ParameterClient
from link.transport.gate import ControlGrant, Sender
from tests.support.flights.virtual import Proxy, VirtualFlight
from tests.support.plans.planned import relay_plan

GRANT = ControlGrant(1, Sender("s1"))


def client() -> tuple[ParameterClient, list[str]]:
    sent: list[str] = []
    return ParameterClient(lambda _, message: sent.append(str(message.param_id)), 1, "c_cast"), sent


def refusal(name: str, error: int = mavlink.MAV_PARAM_ERROR_DOES_NOT_EXIST) -> Any:
    return mavlink.MAVLink_param_error_message(241, 190, name.encode(), -1, error)


def test_a_name_the_vehicle_says_it_does_not_have_is_not_asked_again() -> None:
    parameters, sent = client()
    unknown, other = parameters.read(["GUID_TIMEOUT", "FS_OPTIONS"], GRANT)
    parameters.step(0.0)
    parameters.on_error(refusal("GUID_TIMEOUT"))
    parameters.on_error(refusal("NEVER_ASKED"))
    # What else can be wrong with a parameter says nothing about its being there.
    parameters.on_error(refusal("FS_OPTIONS", mavlink.MAV_PARAM_ERROR_PERMISSION_DENIED))
    assert (unknown.finished, unknown.denied, unknown.answer) == (True, True, None)
    assert (other.finished, other.denied) == (False, False)
    for k in range(1, 20):
        parameters.step(0.6 * k)
    assert sent == ["GUID_TIMEOUT"] + ["FS_OPTIONS"] * ATTEMPTS
    assert (other.finished, other.denied, other.answer) == (True, False, None)


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_over_a_link_that_loses_a_third_each_way_nothing_the_vehicle_has_is_missed(autopilot: str) -> None:
    # Of eight questions all go unanswered once in 150: of forty parameters one in four flights would miss one.
    missing = {}
    for seed in range(2):
        flight = VirtualFlight(
            relay_plan(2), autopilot, proxy=Proxy(seed=seed, loss=0.32), request={"auto_launch": False}
        )
        launch = flight.core.launch
        flight.run(lambda: launch.preflight_id > 0, limit_s=300.0)  # noqa: B023
        told = [c.name for c in launch.checks if "no answer" in c.message]
        missing[seed] = (launch.preflight_id, told, launch.asking.attempts > ATTEMPTS)
    assert missing == dict.fromkeys(range(2), (1, [], True))


def test_where_hardly_anything_comes_back_the_link_is_blamed_and_the_flight_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(launch_module, "MOST_ATTEMPTS", ATTEMPTS)
    patient = {"auto_launch": False, "connect_timeout_s": 120.0}
    flight = VirtualFlight(relay_plan(2), "px4", proxy=Proxy(seed=0, loss=0.6), request=patient)
    launch = flight.core.launch
    flight.run(lambda: launch.preflight_id > 0, limit_s=900.0)
    lost = [check for check in launch.checks if "no answer" in check.message]
    assert all("the C2 link loses" in check.message and "better the C2 link" in check.remedy for check in lost)
    assert any(check.blocks for check in lost)
    flight.run(limit_s=60.0)
    assert flight.states[-1] == "refused"
