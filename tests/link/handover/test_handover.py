"""Handovers: one station in control at every instant, evidence before release, else the old station goes on."""

from __future__ import annotations

import contextlib
import math

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from gcs.flight import HandoverState, TransitionError
from link.dialect import mavlink
from link.errors import GateClosed
from link.transport.gate import ControlGrant, Sender
from tests.support.handover_bench import FIRST, STATIONS, Bench


def test_the_handover_windows_of_a_plan_forwards_and_backwards() -> None:
    assert (FIRST.from_station, FIRST.to_station) == ("s1", "s2")
    assert FIRST.open_s < FIRST.time_s < FIRST.limit_s
    back = FIRST.mirrored()
    assert (back.from_station, back.to_station, back.from_leg, back.to_leg) == ("s2", "s1", 1, 0)
    assert (back.open_s, back.limit_s) == (FIRST.limit_s, FIRST.open_s)
    assert back.mirrored() == FIRST
    assert not FIRST.due(FIRST.time_s - 0.01)
    assert FIRST.due(FIRST.time_s)
    assert back.due(FIRST.time_s)
    assert not back.due(FIRST.time_s + 0.01)
    assert back.covered_by_next(FIRST.limit_s - 0.1)
    assert not back.covered_by_next(FIRST.limit_s + 0.1)


def test_control_moves_between_two_setpoints_and_is_released_on_evidence() -> None:
    bench = Bench()
    bench.tick(FIRST.time_s - 0.03)
    assert bench.senders == ["s1"]
    assert bench.said(state="ready")
    bench.tick(FIRST.time_s + 0.02)
    assert bench.senders == ["s2"]
    assert bench.chain.moving
    assert bench.c.control.gate.incoming == "s1"
    bench.tick()
    assert [e.data["state"] for e in bench.said(index=1)] == ["ready", "requested", "confirmed", "released"]
    assert bench.chain.leg == 1
    assert bench.c.control.gate.incoming is None


def test_without_evidence_the_old_station_goes_on_and_it_is_tried_again() -> None:
    bench = Bench()
    bench.obeys.discard("s2")
    senders = []
    for _ in range(60):
        bench.tick(FIRST.time_s + 0.02)
        senders += bench.senders
    assert bench.chain.leg == 0
    assert [e.data["state"] for e in bench.said(event="timeout")][:1] == ["timed_out"]
    # 0.6 s a try (0.6 of the autopilot's second), then at least half a second with the old station.
    first = senders.index("s1", 1)
    assert senders[:first] == ["s2"] * 12
    assert senders[first : first + 10] == ["s1"] * 10
    assert len(bench.said(event="request")) >= 2
    bench.obeys.add("s2")
    for _ in range(40):
        bench.tick()
    assert bench.chain.leg == 1


def test_a_station_that_is_proved_and_never_obeyed_does_not_let_the_flight_out_of_its_coverage() -> None:
    bench = Bench()
    bench.obeys.discard("s2")
    bench.tick(FIRST.time_s - 1.0)
    assert bench.chain.limits(backwards=False) == (-math.inf, math.inf)  # ready, not tried yet
    highs = set()
    for _ in range(200):
        bench.tick(FIRST.time_s + 0.02)
        if bench.said(event="timeout"):
            highs.add(bench.chain.limits(backwards=False)[1])
    assert len(bench.said(event="request")) >= 4
    assert list(highs) == [pytest.approx(FIRST.limit_s - 0.5)]
    bench.obeys.add("s2")
    for _ in range(40):
        bench.tick()
    assert bench.chain.leg == 1


def test_a_station_that_is_not_proved_is_late_and_stops_the_flight_before_the_end_of_coverage() -> None:
    bench = Bench()
    bench.up["s2"] = False
    for _ in range(50):
        bench.tick(0.0)
    low, high = bench.chain.limits(backwards=False)
    assert (low, high) == (-math.inf, pytest.approx(FIRST.limit_s - 0.5))
    bench.tick(FIRST.time_s + 0.1)
    assert bench.said(state="late")[0].data["reason"] == "s2 lacks telemetry over its link"
    assert bench.senders == ["s1"]
    bench.up["s2"] = True
    bench.tick()
    bench.tick()
    assert bench.chain.leg == 1


@pytest.mark.parametrize("what", ["operator", "origin", "plan"])
def test_readiness_needs_the_operator_the_same_origin_and_the_same_plan(what: str) -> None:
    bench = Bench(operator_words=what == "operator")
    if what == "origin":
        from link.autopilot.local_frame import EkfOrigin

        bench.c.vehicle.origin, bench.c.vehicle.origin_s = EkfOrigin(52.95, 4.79, 30.0), 0.0
        link = bench.c.vehicle.monitor.links["s2"]
        link.origin, link.origin_s = EkfOrigin(52.95, 4.79, 31.0), 1.0
    if what == "plan":
        with pytest.raises(TransitionError, match="another plan"):
            bench.core.command("ready", handover=1, plan_sha256="0" * 64)
        bench.core.command("ready", handover=1, plan_sha256=bench.c.plan.plan_sha256)
    bench.tick(FIRST.time_s + 0.1)
    bench.tick()
    if what == "plan":
        assert bench.chain.leg == 1
        return
    lacks = {"operator": "operator's word", "origin": "the same EKF origin"}[what]
    assert bench.said(state="late")[0].data["reason"] == f"s2 lacks {lacks}"
    if what == "operator":
        bench.core.command("ready", handover=1, by="operator of s2")
        bench.tick()
        bench.tick()
        assert bench.chain.leg == 1


def test_a_refusal_holds_until_taken_back_and_cannot_undo_what_is_done() -> None:
    bench = Bench()
    bench.core.command("refuse", handover=1, reason="jammed")
    for _ in range(5):
        bench.tick(FIRST.time_s + 0.1)
    assert bench.chain.leg == 0
    assert bench.chain.handover is not None
    assert bench.chain.handover.state is HandoverState.REFUSED
    bench.core.command("accept", handover=1)
    for _ in range(3):
        bench.tick()
    assert bench.chain.leg == 1
    with pytest.raises(TransitionError, match="handover 1 is done"):
        bench.core.command("refuse", handover=1)
    with pytest.raises(TransitionError, match="there is no handover 7; the plan has 2"):
        bench.core.command("ready", handover=7)


def test_a_dead_links_neighbour_takes_over_where_it_covers_and_nowhere_else() -> None:
    bench = Bench()
    bench.up["s1"] = False
    bench.tick(FIRST.open_s - 0.5)
    assert not bench.chain.take_over(bench.plan_s, "test")
    bench.tick(FIRST.open_s + 0.5)
    assert bench.chain.take_over(bench.plan_s, "test")
    assert bench.c.control.gate.holder == "s2"
    bench.deliver()
    bench.tick()
    assert bench.chain.leg == 1
    assert bench.said(event="request")[0].data["reason"] == "test"


def test_a_station_whose_link_failed_must_be_proved_anew_before_it_gets_control_back() -> None:
    bench = Bench()
    for time_s in (FIRST.time_s + 0.02, FIRST.time_s + 0.07):
        bench.tick(time_s)
    assert bench.chain.leg == 1
    bench.up["s2"] = False
    assert bench.chain.take_over(bench.plan_s, "link lost")  # back to s1, which still covers
    bench.deliver()
    for _ in range(4):
        bench.tick()
    # The proof of s2 from before is still young, but it is from before.
    assert (bench.chain.leg, bench.c.control.gate.holder) == (0, "s1")
    bench.up["s2"] = True
    for _ in range(4):
        bench.tick()
    assert (bench.chain.leg, bench.c.control.gate.holder) == (1, "s2")


@pytest.mark.parametrize(
    ("result", "ends"),
    [(mavlink.MAV_RESULT_ACCEPTED, "released"), (mavlink.MAV_RESULT_UNSUPPORTED, "released"), (10, "failed")],
)
def test_any_answer_to_the_new_station_is_evidence_but_not_in_control(result: int, ends: str) -> None:
    bench = Bench()
    bench.obeys.clear()
    bench.tick(FIRST.time_s + 0.02)
    ack = mavlink.MAVLink_command_ack_message(mavlink.MAV_CMD_REQUEST_MESSAGE, result, 0, 0, 242, 190)
    bench.c.control.commander.on_ack(bench.c.timeline.now_s, ack)
    bench.tick()
    assert bench.said(index=1)[-1].data["state"] == ends


def test_an_ack_for_the_old_station_is_no_evidence_for_the_new_one() -> None:
    bench = Bench()
    bench.obeys.clear()
    bench.tick(FIRST.time_s + 0.02)
    old = bench.c.control.system_ids["s1"]
    ack = mavlink.MAVLink_command_ack_message(mavlink.MAV_CMD_REQUEST_MESSAGE, 0, 0, 0, old, 190)
    bench.c.control.commander.on_ack(bench.c.timeline.now_s, ack)
    bench.tick()
    assert bench.chain.moving


class RelayMachine(RuleBasedStateMachine):
    """Links that come and go, a vehicle that obeys whom it likes, words, takeovers, flying to and fro."""

    @initialize(before_s=st.floats(0.0, 5.0))
    def begin(self, before_s: float) -> None:
        self.bench = Bench()
        self.bench.plan_s = FIRST.time_s - before_s
        self.backwards = False
        self.note()

    @rule(down=st.sets(st.sampled_from(STATIONS), max_size=1))
    def links(self, down: set[str]) -> None:
        self.bench.up = {station: station not in down for station in STATIONS}

    @rule(deaf_to=st.sets(st.sampled_from(STATIONS), max_size=1))
    def vehicle(self, deaf_to: set[str]) -> None:
        self.bench.obeys = set(STATIONS) - deaf_to

    def note(self) -> None:
        """Whom the vehicle can have answered: an answer of the last tick counts in the next. Once a tick."""
        now = {station for station in self.bench.obeys if self.bench.up[station]}
        self.may_obey = now | getattr(self, "now", now)
        self.now = now

    @rule(ticks=st.integers(1, 40), step_s=st.sampled_from([0.05, 0.05, 0.4, 1.0]))
    def fly(self, ticks: int, step_s: float) -> None:
        """Keeps the limits, as the reference does."""
        for _ in range(ticks):
            low, high = self.bench.chain.limits(backwards=self.backwards)
            wanted = self.bench.plan_s + (-step_s if self.backwards else step_s)
            self.tick(min(max(wanted, min(low, self.bench.plan_s), 0.0), max(high, self.bench.plan_s), 63.0))

    @rule()
    def turn(self) -> None:
        self.backwards = not self.backwards

    @rule()
    def take_over(self) -> None:
        self.bench.chain.take_over(self.bench.plan_s, "drawn")

    @rule(index=st.integers(1, 2), yes=st.booleans())
    def word(self, index: int, yes: bool) -> None:
        with contextlib.suppress(TransitionError):
            self.bench.core.command("accept" if yes else "refuse", handover=index)

    def tick(self, to_s: float) -> None:
        bench = self.bench
        self.note()
        told = len(bench.c.timeline.events)
        bench.tick(to_s, backwards=self.backwards)
        # One setpoint, from the one station in control.
        assert bench.senders == [bench.c.control.gate.holder]
        # Nobody else gets a word in, whatever grant it still holds.
        for station in STATIONS:
            stale = ControlGrant(bench.c.control.in_force.number - 1, Sender(station))
            with pytest.raises(GateClosed):
                bench.c.control.gate.send(stale, mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
        for event in bench.c.timeline.events[told:]:
            if event.data.get("event") == "evidence":
                assert event.data["to"] in self.may_obey, "a station was confirmed that the vehicle did not obey"

    @invariant()
    def the_holder_is_the_legs_station_or_the_one_it_is_moving_to(self) -> None:
        chain, gate = self.bench.chain, self.bench.c.control.gate
        own = self.bench.c.plan.station_ids[chain.leg]
        if chain.moving and chain.handover is not None:
            assert gate.holder in (own, chain.handover.window.to_station)
            assert {gate.holder, gate.incoming} == {own, chain.handover.window.to_station}
        else:
            assert gate.holder == own
            assert gate.incoming is None


TestRelayMachine = RelayMachine.TestCase
TestRelayMachine.settings = settings(max_examples=60, stateful_step_count=25)
