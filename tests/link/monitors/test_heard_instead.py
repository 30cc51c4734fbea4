"""What is heard in the vehicle's stead is named for what it is: another id, another key, no signature."""

from __future__ import annotations

from collections import deque
from types import SimpleNamespace

import pytest

from gcs.flight import FlightState
from link.dialect import mavlink
from tests.support.flights.tampered import TamperedFlight, in_the_air
from tests.support.plans.planned import relay_plan

BOTH = pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])


@BOTH
def test_a_vehicle_with_another_system_id_is_named(autopilot: str) -> None:
    one = TamperedFlight(relay_plan(2), autopilot, frugal=True, request={"connect_timeout_s": 4.0})
    one.tamper = lambda now_s, link, message: ()
    voice = mavlink.MAVLink(None, srcSystem=7, srcComponent=1)
    kind = one.core.context.vehicle.profile.autopilot_id
    for _ in range(6):
        beat = mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_QUADROTOR, kind, 0, 0, 3, 3)
        for link in one.links:
            one.core.receive(link.split("/")[0], bytes(beat.pack(voice)), one.now_s, one._urls[link])
        one.run_for(1.0)
    assert one.core.state is FlightState.REFUSED
    reason = one.said("state")[-1].data["reason"]
    assert "no heartbeat of system 1" in str(reason)
    assert "system 7 is heard: set vehicle_system_id" in str(reason)


@pytest.mark.parametrize(
    ("verdicts", "words"),
    [
        ({"wrong signature": 12}, "12 frames come signed with another key"),
        ({"unsigned": 5, "MAVLink 1": 2}, "7 frames come unsigned, and this link has a key"),
        ({"stamp not newer than the last": 3}, ""),
    ],
)
def test_frames_that_signing_refuses_are_told_with_their_reason(verdicts: dict[str, int], words: str) -> None:
    watch = in_the_air("px4").core.one_vehicle
    assert watch.heard_instead() == ""
    watch.reflected(SimpleNamespace(stats=SimpleNamespace(refused=verdicts), returned=deque()))  # type: ignore[arg-type]
    assert (words in watch.heard_instead()) if words else watch.heard_instead() == ""
