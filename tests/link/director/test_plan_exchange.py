"""Another plan taken over in the air: no setpoint missed, no jump, announced, flown to its end; or refused in words."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from gcs.flight import FlightState, TransitionError
from gcs.mission import read_mission
from gcs.mission.model import LocalPosition
from gcs.plan.model import Plan
from gcs.planning.replanning import Replanned, replan
from link.setpoints.setpoint import Setpoint
from tests.support.flights.virtual import Proxy, VirtualFlight
from tests.support.plans.planned import FIRST_JOIN_S, relay_plan, wide_plan

BOTH = pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
TICK_S = 0.05
HOME = LocalPosition(30.0, 20.0, 42.0)


def flight(autopilot: str, **more: Any) -> VirtualFlight:
    return VirtualFlight(wide_plan(), autopilot, frugal=True, reserve=("beside",), **more)


def fly_to(one: VirtualFlight, plan_s: float) -> VirtualFlight:
    one.run(until=lambda: one.plan_s >= plan_s, limit_s=200.0)
    assert one.core.state is FlightState.CRUISE
    return one


def recorded(one: VirtualFlight) -> list[tuple[float, Setpoint]]:
    """Every setpoint from now on, as it is sent."""
    context, sent = one.core.context, []
    send: Callable[[Setpoint], None] = context.control.send_setpoint

    def keep(setpoint: Setpoint) -> None:
        sent.append((context.timeline.now_s, setpoint))
        send(setpoint)

    context.control.send_setpoint = keep  # type: ignore[method-assign]
    return sent


def say(one: VirtualFlight, new: Replanned) -> None:
    upcoming = one.core.make_ready(new.plan.to_document())
    places = {"join_s": new.join_s, "leave_s": new.leave_s} if new.at_rest else {}
    one.core.command("replan", upcoming=upcoming, by="test", **places)


def assert_smooth(sent: list[tuple[float, Setpoint]], plan: Plan) -> None:
    """Position follows velocity, and velocity acceleration, from each setpoint to the next; the plan's jerk apart."""
    jerk_m_s3 = float(np.linalg.norm(plan.trajectory.derivative_control_points(3), axis=-1).max())
    for (t0, a), (t1, b) in pairwise(sent):
        dt = t1 - t0
        assert dt == pytest.approx(TICK_S)
        p, v, acc = (np.array(x) for x in (a.position_enu_m, a.velocity_enu_m_s, a.acceleration_enu_m_s2))
        assert np.linalg.norm(b.position_enu_m - (p + v * dt + 0.5 * acc * dt**2)) < jerk_m_s3 * dt**3 / 6.0 + 1e-4
        assert np.linalg.norm(b.velocity_enu_m_s - (v + acc * dt)) < jerk_m_s3 * dt**2 / 2.0 + 1e-4
        assert np.linalg.norm(np.subtract(b.acceleration_enu_m_s2, acc)) < jerk_m_s3 * dt + 1e-4


@BOTH
def test_a_new_destination_is_flown_to_without_a_gap_or_a_jump(autopilot: str) -> None:
    """Back home while it gathers speed; the join is 5 s ahead when a person accepts."""
    one, join_s = fly_to(flight(autopilot), 2.0), FIRST_JOIN_S
    new = replan(wide_plan(), join_s, destination=HOME, method="fast")
    sent, said_s = recorded(one), one.now_s
    say(one, new)
    one.run_for(10.0)
    assert one.core.state is FlightState.CRUISE
    assert_smooth(sent, new.plan)
    assert one.longest_gap_s(said_s - 1.0, one.now_s) <= 2.0 * TICK_S + 1e-9
    assert one.core.context.plan.plan_sha256 == new.plan.plan_sha256
    (told,) = one.said("replanned")
    assert (told.data["plan_sha256"], told.data["before"]) == (new.plan.plan_sha256, wide_plan().plan_sha256)
    # T+ is not shifted: the plan's time is the flight's.
    retimed = [e for e in one.said("retimed") if e.time_s >= said_s]
    assert retimed[0].data["shift_s"] == pytest.approx(0.0, abs=0.051)
    assert [h["index"] for h in retimed[0].data["handovers"]] == [
        h.index for h in new.plan.handovers if h.time_s > join_s
    ]
    assert one.run(limit_s=300.0) is FlightState.COMPLETED
    here = one.plan.plane.to_plane(one.vehicle.body.lat_deg, one.vehicle.body.lon_deg)
    assert np.hypot(here[0] - HOME.east_m, here[1] - HOME.north_m) < 1.0
    for accepted in one.accepted:
        assert accepted.station == accepted.holder_when_sent


@pytest.mark.slow
@BOTH
def test_a_station_that_died_is_flown_around_by_one_in_reserve(autopilot: str) -> None:
    """The flight waits before the dead station's range; from rest, a new plan leads on through the reserve."""
    old = wide_plan()
    one = flight(autopilot, request={"wait_for_station_s": 300.0})
    one.proxy.cuts.append(("s2", 12.0, 1e9))
    one.run(until=lambda: one.core.state is FlightState.HOLDING and one.core.status()["stands"], limit_s=200.0)
    one.run_for(3.0)
    assert one.core.airborne.held.text.startswith("waiting for s2")
    new = replan(
        old,
        one.plan_s,
        at_rest=True,
        excluded_stations=("s2",),
        present_s=one.plan_s,
        handovers_done=one.core.airborne.chain.leg,
        method="fast",
    )
    assert new.plan.station_ids[:2] == ("s1", "beside")
    sent = recorded(one)
    # It stands at the very end of s1's coverage: the new plan wants its margin, so it goes back a little first.
    assert 0.0 < one.plan_s - new.leave_s <= 8.0
    say(one, new)
    one.run(until=lambda: one.core.state is FlightState.CRUISE, limit_s=40.0)
    before = sent[-2:]
    sent.clear()
    assert np.linalg.norm(np.subtract(before[1][1].position_enu_m, before[0][1].position_enu_m)) < 0.01
    one.run_for(15.0)
    assert_smooth(sent, new.plan)
    assert one.run(limit_s=300.0) is FlightState.COMPLETED
    released = [e.data["to"] for e in one.said("handover", state="released")]
    assert released == list(new.plan.station_ids[1:])
    for accepted in one.accepted:
        assert accepted.station == accepted.holder_when_sent != "s2"
    assert one.said("result")[0].data["plan_sha256"] == new.plan.plan_sha256


@pytest.mark.slow
def test_after_a_replan_the_way_back_is_the_way_flown() -> None:
    """An abort on the new plan leads back over the join to where the flight began."""
    one, join_s = fly_to(flight("px4"), 2.0), FIRST_JOIN_S
    new = replan(
        wide_plan(), join_s, excluded_stations=("s4",), destination=LocalPosition(500.0, 60.0, 45.0), method="fast"
    )
    say(one, new)
    one.run(until=lambda: one.plan_s >= join_s + 6.0, limit_s=60.0)
    one.core.command("abort", by="test")
    assert one.run(limit_s=300.0) is FlightState.CONTINGENCY
    here = one.plan.plane.to_plane(one.vehicle.body.lat_deg, one.vehicle.body.lon_deg)
    # The start is the safe point.
    assert np.hypot(*here) < 3.0


def test_over_a_late_link_the_lead_is_joined_too() -> None:
    one = fly_to(flight("px4", proxy=Proxy(seed=1, latency_s=0.15)), 5.5)
    assert one.core.airborne.latency.ahead_s == pytest.approx(0.15, abs=0.03)
    new = replan(wide_plan(), FIRST_JOIN_S, destination=HOME, method="fast")
    sent = recorded(one)
    say(one, new)
    one.run_for(6.0)
    # What is told of the latency moves a little too.
    assert max(abs(b.time_s - a.time_s - TICK_S) for (_, a), (_, b) in pairwise(sent)) < 0.01
    assert one.run(limit_s=300.0) is FlightState.COMPLETED
    assert one.cross_track_m().size


@pytest.mark.slow
def test_a_plan_that_does_not_fit_is_refused_and_the_flight_goes_on() -> None:
    one = fly_to(flight("px4"), 3.0)
    core, old = one.core, wide_plan()
    late = replan(old, FIRST_JOIN_S, destination=HOME, method="fast")
    standing = replan(old, one.plan_s, at_rest=True, method="fast")

    def refuses(words: str, upcoming: Any = None, **more: Any) -> None:
        before = (
            core.context.plan,
            core.airborne.guidance.reference,
            core.airborne.chain.leg,
            len(one.said("replanned")),
        )
        with pytest.raises(TransitionError, match=words):
            core.command("replan", upcoming=upcoming, **more)
        assert before == (
            core.context.plan,
            core.airborne.guidance.reference,
            core.airborne.chain.leg,
            len(one.said("replanned")),
        )

    refuses("needs a plan made ready")
    with pytest.raises(TransitionError, match="this is no plan: plan_sha256"):
        core.make_ready({**late.plan.to_document(), "lower_bound_s": 1.0})
    with pytest.raises(TransitionError, match="s1 has id 251 in it and 241 in this flight"):
        core.make_ready(_with_ids(late.plan, 251).to_document())
    elsewhere = relay_plan(2).to_document()
    with pytest.raises(TransitionError, match=r"another plane|has no link|has id"):
        VirtualFlight(wide_plan(), "px4").core.make_ready(_moved(elsewhere))
    without = VirtualFlight(wide_plan(), "px4")
    around = replan(old, 5.0, excluded_stations=("s2",), method="fast")
    with pytest.raises(TransitionError, match="beside has no link in this flight"):
        without.core.make_ready(around.plan.to_document())
    refuses("for another plan", core.make_ready(late.plan.to_document()), plan_sha256="0" * 64)
    refuses(
        "begins at rest, and the flight does not stand",
        core.make_ready(standing.plan.to_document()),
        join_s=standing.join_s,
    )
    one.run(until=lambda: one.plan_s >= late.join_s - 0.8, limit_s=30.0)
    refuses("too late", core.make_ready(late.plan.to_document()))
    moving = core.make_ready(replan(old, old.handovers[0].time_s + 13.0, method="fast").plan.to_document())
    one.run(until=lambda: core.airborne.chain.moving, limit_s=60.0)
    refuses("control is being moved just now", moving)
    core.command("abort", by="test")
    refuses("'replan' needs a flight that is", moving)


def _with_ids(plan: Plan, first: int) -> Plan:
    from dataclasses import replace

    stations = tuple(replace(s, system_id=first + k) for k, s in enumerate(plan.mission.stations[:4]))
    return replace(plan, mission=replace(plan.mission, stations=(*stations, *plan.mission.stations[4:])))


def _moved(document: dict[str, Any]) -> dict[str, Any]:
    from gcs.planning.mission_planning import plan_mission

    mission = dict(document["mission"])
    mission["origin"] = {**mission["origin"], "lat_deg": 40.0}
    return plan_mission(read_mission(mission), fast=True).to_document()
