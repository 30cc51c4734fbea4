"""Handovers: one station in control at every instant, evidence before release, else the old station goes on.

First whole handovers on a bench, then one at its edges: limits to the last step, what it tells, and what each refusal
or silence leaves behind.
"""

from __future__ import annotations

import contextlib
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from gcs.flight import HandoverState, TransitionError
from link.autopilot.local_frame import EkfOrigin
from link.dialect import mavlink
from link.errors import GateClosed
from link.handover.handover import Handover, HandoverWindow
from link.telemetry.setpoint_echo import Sent
from link.transport.gate import ControlGrant, Sender
from tests.support.link.handover_bench import FIRST, STATIONS, Bench


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


PLANNED_S = FIRST.time_s
OLD, NEW = 241, 242


class One:
    """One handover driven by hand: its clock, its links, what it sends."""

    def __init__(
        self, way: str = "gate", window: HandoverWindow = FIRST, attempt_s: float = 0.5, **changes: Any
    ) -> None:
        self.bench = Bench(**changes)
        self.c = self.bench.c
        self.c.timeline.now_s = 64.0
        self.bench.hear()
        self.handover = Handover(self.c, window, way, attempt_s)
        self.link = self.c.vehicle.monitor.links["s2"]
        # A station of several ways is judged by the one that sends.
        self.way: Any = getattr(self.link, "active", self.link)

    def step(self, time_s: float = PLANNED_S, after_s: float = 0.0, **options: Any) -> HandoverState:
        self.c.timeline.now_s += after_s
        self.handover.step(time_s, **options)
        return self.handover.state

    def prove(self) -> None:
        self.bench.hear()

    def commands(self) -> list[tuple[str, Any]]:
        """(station, message) of the commands sent since the last look."""
        frames = self.c.control.gate.take_outgoing()
        found = [(sender.station_id, m) for sender, frame in frames for m in self.bench.decoder.decode(frame)]
        return [(station, m) for station, m in found if m.get_type() == "COMMAND_LONG"]

    def answer(self, result: int, command: int, station_id: int) -> None:
        ack = mavlink.MAVLink_command_ack_message(command, result, 0, 0, station_id, 190)
        self.c.control.commander.on_ack(self.c.timeline.now_s, ack)

    def told(self) -> list[tuple[str, str, str]]:
        return [(e.data["before"], e.data["event"], e.data["state"]) for e in self.bench.said()]


def window(time_s: float = 10.0, open_s: float = 5.0, limit_s: float = 20.0, forward: bool = True) -> HandoverWindow:
    return HandoverWindow(1, 0, 1, "s1", "s2", time_s, open_s, limit_s, forward)


# -- the window -------------------------------------------------------------------------------------------------------


def test_a_handover_window_is_due_a_microsecond_early_and_covered_from_its_very_edge() -> None:
    ahead, back = window(1.0), window(1.0, forward=False)
    assert ahead.due(1.0 - 1e-6)
    assert not ahead.due(1.0 - 2e-6)
    assert back.due(1.0 + 1e-6)
    assert not back.due(1.0 + 2e-6)
    assert ahead.covered_by_next(5.0)
    assert not ahead.covered_by_next(4.999)
    assert back.covered_by_next(5.0)
    assert not back.covered_by_next(5.001)


def test_the_next_station_is_watched_from_a_minute_before_its_coverage() -> None:
    ahead, back = window(200.0, 100.0), window(200.0, 300.0, forward=False)
    assert ahead.near(40.0)
    assert not ahead.near(39.99)
    assert back.near(360.0)
    assert not back.near(360.01)


def test_far_from_the_window_nothing_is_told_unless_it_must_be_at_once() -> None:
    one = One(window=window(200.0, 100.0))
    assert one.step(39.9) is HandoverState.PLANNED
    assert one.told() == []
    assert one.step(40.0) is HandoverState.READY
    hurried = One(window=window(200.0, 100.0))
    # Told to hurry it looks at once, but asks for control only where the next station covers the vehicle.
    assert hurried.step(39.9, at_once="link lost") is HandoverState.READY
    assert hurried.step(99.9, at_once="link lost") is HandoverState.READY
    assert hurried.step(100.0, at_once="link lost") is HandoverState.REQUESTED
    assert hurried.bench.said(event="request")[0].data["reason"] == "link lost"


def test_due_but_not_covered_is_not_asked_for() -> None:
    one = One(window=window(10.0, 15.0))
    assert one.step(12.0) is HandoverState.READY
    assert one.step(14.99) is HandoverState.READY
    assert one.step(15.0) is HandoverState.REQUESTED


# -- readiness --------------------------------------------------------------------------------------------------------


def test_a_new_handover_has_tried_nothing_and_is_shut() -> None:
    one = One()
    assert (one.handover.state, one.handover.attempts, one.handover.reason) == (HandoverState.PLANNED, 0, "")
    assert not one.handover.open
    assert not one.handover.done


@pytest.mark.parametrize(
    ("heard_ago_s", "proven_ago_s", "missing"),
    [
        (1.5, 1.0, ""),
        (1.51, 0.0, "telemetry over its link"),
        (0.0, 1.01, "an answer over its link"),
    ],
)
def test_how_fresh_a_link_must_be(heard_ago_s: float, proven_ago_s: float, missing: str) -> None:
    one = One()
    one.way.heard_s, one.way.proven_s = 64.0 - heard_ago_s, 64.0 - proven_ago_s
    assert one.handover.missing() == missing


def test_a_link_that_failed_must_be_proved_by_a_frame_sent_after_that() -> None:
    one = One()
    again = Handover(one.c, FIRST, "gate", 0.5, 63.5)
    one.way.proven_s = 63.5
    assert again.missing() == "an answer over its link"
    one.way.proven_s = 63.501
    assert again.missing() == ""


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize(("off_m", "missing"), [(0.19, ""), (0.21, "the same EKF origin")])
def test_the_next_station_must_know_the_same_origin_to_a_hand(axis: int, off_m: float, missing: str) -> None:
    one = One()
    lat, lon, alt = 52.95, 4.79, 30.0
    one.c.vehicle.origin, one.c.vehicle.origin_s = EkfOrigin(lat, lon, alt), 50.0
    per_m = (180.0 / math.pi / 6_371_000.0, 180.0 / math.pi / 6_371_000.0 / math.cos(math.radians(lat)), 1.0)
    moved = [lat, lon, alt]
    moved[axis] += off_m * per_m[axis]
    one.link.origin, one.link.origin_s = EkfOrigin(*moved), 50.1
    assert one.handover.missing() == missing


def test_an_origin_told_before_ours_or_to_nobody_is_no_disagreement() -> None:
    one = One()
    far = EkfOrigin(52.95, 4.79, 90.0)
    one.link.origin, one.link.origin_s = far, 50.0
    assert one.handover.missing() == ""  # we know none
    one.c.vehicle.origin, one.c.vehicle.origin_s = EkfOrigin(52.95, 4.79, 30.0), 50.0
    assert one.handover.missing() == ""  # told at the same moment: not newer
    one.link.origin_s = 50.1
    assert one.handover.missing() == "the same EKF origin"
    one.link.origin = None
    assert one.handover.missing() == ""


def test_a_station_that_is_not_ready_when_due_is_late_once_and_ready_when_proved() -> None:
    one = One()
    one.way.heard_s = -math.inf
    assert one.step(PLANNED_S - 1.0) is HandoverState.PLANNED
    assert one.step() is HandoverState.LATE
    assert one.step() is HandoverState.LATE
    assert one.handover.reason == "s2 lacks telemetry over its link"
    one.prove()
    assert one.step(PLANNED_S) is HandoverState.REQUESTED
    assert [event for _, event, _ in one.told()] == ["due", "proved", "request"]


def test_a_station_that_was_ready_and_fails_is_told_with_what_it_lacks() -> None:
    one = One()
    assert one.step(PLANNED_S - 1.0) is HandoverState.READY
    assert one.handover.open
    one.way.proven_s = 62.9
    assert one.step(PLANNED_S - 0.9) is HandoverState.PLANNED
    assert one.handover.reason == "s2 lacks an answer over its link"
    assert not one.handover.open


# -- words ------------------------------------------------------------------------------------------------------------


def test_where_operators_speak_a_word_is_needed_and_lasts() -> None:
    one = One(operator_words=True)
    assert one.handover.missing() == "operator's word"
    one.handover.accept()
    assert one.handover.missing() == ""
    assert one.handover.state is HandoverState.PLANNED
    one.handover.refuse("jammed")
    assert (one.handover.state, one.handover.reason) == (HandoverState.REFUSED, "jammed")
    assert one.step() is HandoverState.REFUSED
    one.handover.accept()
    assert (one.handover.state, one.handover.reason) == (HandoverState.PLANNED, "operator's word")
    assert one.step() is HandoverState.REQUESTED


@pytest.mark.parametrize(("operator_words", "missing"), [(True, "operator's word"), (False, "")])
def test_a_no_that_comes_too_late_changes_nothing_now_and_counts_for_the_next_try(
    operator_words: bool, missing: str
) -> None:
    one = One(operator_words=operator_words)
    one.handover.accept()
    assert one.step() is HandoverState.REQUESTED
    with pytest.raises(TransitionError):
        one.handover.refuse("too late")
    assert one.handover.state is HandoverState.REQUESTED
    assert one.step(after_s=0.5) is HandoverState.TIMED_OUT
    one.c.timeline.now_s += 0.1
    one.prove()
    assert one.handover.missing() == missing


# -- asking -----------------------------------------------------------------------------------------------------------


def test_control_moves_at_once_and_the_new_station_asks_for_an_answer_every_fifth_of_a_second() -> None:
    one = One(attempt_s=20.0)
    assert one.step() is HandoverState.REQUESTED
    assert one.handover.attempts == 1
    assert (one.c.control.gate.holder, one.c.control.gate.incoming) == ("s2", "s1")
    ((station, message),) = one.commands()
    assert (station, message.command, message.param1) == ("s2", 512, 148.0)
    asked = [0.0]
    for k in range(1, 700):
        one.c.control.commander.step(64.0 + 0.01 * k)
        asked += [0.01 * k] * len(one.commands())
    assert len(asked) == 30
    assert np.diff(asked) == pytest.approx(0.2, abs=0.011)


def test_the_way_stays_open_for_half_an_attempt() -> None:
    one = One(attempt_s=2.0)
    one.step()
    one.c.timeline.now_s = 65.0
    assert one.handover.open
    one.c.timeline.now_s = 65.0 + 1e-9
    assert not one.handover.open


def test_no_evidence_ends_the_attempt_to_the_moment_and_the_next_is_half_a_second_later() -> None:
    one = One()
    assert one.step() is HandoverState.REQUESTED
    before = one.c.control.in_force.number
    one.c.timeline.now_s = 64.5 - 1e-6
    assert one.step() is HandoverState.REQUESTED
    one.c.timeline.now_s = 64.5
    assert one.step() is HandoverState.TIMED_OUT
    assert one.handover.reason == "no evidence from the vehicle"
    assert (one.c.control.gate.holder, one.c.control.gate.incoming) == ("s1", None)
    assert one.c.control.in_force.number == before + 1
    grants = [e.data["reason"] for e in one.c.timeline.events if e.kind.value == "gate"]
    assert grants[-2:] == ["handover 1", "handover 1 not confirmed"]
    one.commands()
    one.c.control.commander.step(67.0)
    assert one.commands() == []  # nobody goes on asking
    for now_s, state in ((64.99, HandoverState.TIMED_OUT), (65.0, HandoverState.REQUESTED)):
        one.c.timeline.now_s = now_s
        one.prove()
        assert one.step() is state
    assert one.handover.attempts == 2
    assert one.bench.said(event="request")[-1].data["attempt"] == 2


def test_after_a_failure_only_a_proof_from_afterwards_counts() -> None:
    one = One()
    one.step()
    one.step(after_s=0.5)
    one.c.timeline.now_s = 65.25
    one.way.heard_s, one.way.proven_s = 65.25, 64.5
    assert one.step() is HandoverState.TIMED_OUT
    one.way.proven_s = 64.51
    assert one.step() is HandoverState.REQUESTED


def test_confirmed_and_released_in_one_step_and_then_nothing_more() -> None:
    one = One()
    one.step()
    one.answer(mavlink.MAV_RESULT_DENIED, 512, NEW)
    assert one.step(after_s=0.05) is HandoverState.RELEASED
    assert [state for _, _, state in one.told()] == ["ready", "requested", "confirmed", "released"]
    evidence, release = one.bench.said()[-2:]
    assert evidence.data["reason"] == "a command of it was answered"
    assert release.data["reason"] == "s1 is silent"
    assert one.c.control.gate.incoming is None
    assert one.handover.done
    assert one.handover.open
    assert one.step(after_s=5.0) is HandoverState.RELEASED
    assert len(one.told()) == 4


def test_every_change_says_who_how_and_why() -> None:
    one = One(way="range")
    one.step()
    (event,) = one.bench.said(event="request")
    assert dict(event.data) == {
        "index": 1,
        "from": "s1",
        "to": "s2",
        "before": "ready",
        "state": "requested",
        "event": "request",
        "reason": "",
        "attempt": 1,
        "way": "range",
        "forward": True,
    }


def test_not_in_control_is_a_no() -> None:
    one = One()
    one.step()
    one.answer(10, 512, NEW)
    assert one.step(after_s=0.05) is HandoverState.FAILED
    assert one.handover.reason.startswith("the vehicle answered ")
    assert one.c.control.gate.holder == "s1"


# -- evidence from what the vehicle repeats ---------------------------------------------------------------------------


class Target:
    """POSITION_TARGET_LOCAL_NED at a place."""

    type_mask = 0
    afx = afy = afz = 0.0

    def __init__(self, north_m: float) -> None:
        self.x, self.y, self.z = north_m, 0.0, 0.0


def sent(one: One, grant: int, north_m: float) -> None:
    one.c.control.echoes.note(
        Sent(one.c.timeline.now_s, "?", grant, (north_m, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    )


def test_a_repeated_setpoint_is_evidence_when_only_the_new_station_can_have_sent_it() -> None:
    one = One()
    one.step()
    old, new = one.c.control.in_force.number - 1, one.c.control.in_force.number
    sent(one, old, 0.0)
    sent(one, new, 10.0)
    # Nobody's, the old station's, or one that either may have sent: no evidence.
    for place_m in (5.0, 0.0):
        one.c.vehicle.monitor.target, one.c.vehicle.monitor.target_s = Target(place_m), one.c.timeline.now_s + 0.01
        assert one.step(after_s=0.02) is HandoverState.REQUESTED
    sent(one, old, 10.1)
    one.c.vehicle.monitor.target, one.c.vehicle.monitor.target_s = Target(10.05), one.c.timeline.now_s + 0.01
    assert one.step(after_s=0.02) is HandoverState.REQUESTED
    one.c.vehicle.monitor.target = Target(9.8)
    assert one.step(after_s=0.02) is HandoverState.RELEASED
    assert one.bench.said(event="evidence")[0].data["reason"] == "its setpoint is held"
    one.commands()
    one.c.control.commander.step(one.c.timeline.now_s + 1.0)
    assert one.commands() == []  # what was asked beside is no longer asked


def test_what_was_repeated_before_control_moved_is_no_evidence() -> None:
    one = One()
    one.c.vehicle.monitor.target, one.c.vehicle.monitor.target_s = Target(10.0), 64.0
    one.step()
    sent(one, one.c.control.in_force.number, 10.0)
    assert one.step(after_s=0.02) is HandoverState.REQUESTED
    one.c.vehicle.monitor.target_s = 64.001
    assert one.step() is HandoverState.RELEASED


# -- the operator-control protocol ------------------------------------------------------------------------------------


def asked(one: One) -> tuple[str, int, tuple[float, ...]]:
    ((station, m),) = one.commands()
    return station, m.command, (m.param1, m.param2, m.param3, m.param4, m.param5)


def test_the_old_station_allows_then_the_new_one_asks_and_is_granted() -> None:
    one = One(way="operator_control", attempt_s=5.0)
    assert one.step() is HandoverState.REQUESTED
    # Until the vehicle has taken that, control stays, and both are heard.
    assert (one.c.control.gate.holder, one.c.control.gate.incoming) == ("s1", "s2")
    assert asked(one) == ("s1", 32100, (1.0, 1.0, 10.0, float(OLD), 0.0))
    one.c.control.commander.step(64.19)
    assert one.commands() == []
    one.c.control.commander.step(64.21)
    assert len(one.commands()) == 1
    assert one.step(after_s=0.3) is HandoverState.REQUESTED
    assert one.c.control.gate.holder == "s1"
    one.answer(0, 32100, OLD)
    assert one.step(after_s=0.05) is HandoverState.REQUESTED
    assert (one.c.control.gate.holder, one.c.control.gate.incoming) == ("s2", "s1")
    assert asked(one) == ("s2", 32100, (1.0, 0.0, 10.0, float(NEW), 0.0))
    moved_s, repeated = one.c.timeline.now_s, []
    for k in range(1, 400):
        one.c.control.commander.step(moved_s + 0.01 * k)
        repeated += [0.01 * k] * len(one.commands())
    assert len(repeated) == 29
    assert np.diff(repeated) == pytest.approx(0.1, abs=0.011)


@pytest.mark.parametrize("status", [None, NEW])
def test_a_grant_is_believed_and_where_the_vehicle_tells_who_it_obeys_that_must_agree(status: int | None) -> None:
    one = One(way="operator_control", attempt_s=5.0)
    one.step()
    one.answer(0, 32100, OLD)
    one.step(after_s=0.05)
    if status is not None:
        one.c.vehicle.monitor.control_main, one.c.vehicle.monitor.control_s = OLD, one.c.timeline.now_s
    assert one.step() is HandoverState.REQUESTED
    one.answer(0, 32100, NEW)
    if status is not None:
        assert one.step(after_s=0.05) is HandoverState.REQUESTED
        one.c.vehicle.monitor.control_main = status
    assert one.step(after_s=0.05) is HandoverState.RELEASED
    assert one.bench.said(event="evidence")[0].data["reason"] == "control granted to it"


def test_what_it_repeats_proves_nothing_where_the_vehicle_arbitrates() -> None:
    one = One(way="operator_control", attempt_s=5.0)
    one.step()
    one.answer(0, 32100, OLD)
    one.step(after_s=0.05)
    sent(one, one.c.control.in_force.number, 10.0)
    one.c.vehicle.monitor.target, one.c.vehicle.monitor.target_s = Target(10.0), one.c.timeline.now_s + 0.01
    assert one.step(after_s=0.02) is HandoverState.REQUESTED


@pytest.mark.parametrize("result", [2, 4])
def test_a_takeover_that_is_not_allowed_or_not_granted_leaves_the_old_station(result: int) -> None:
    word = {2: "DENIED", 4: "FAILED"}[result]
    first = One(way="operator_control", attempt_s=5.0)
    first.step()
    number = first.c.control.in_force.number
    first.answer(result, 32100, OLD)
    assert first.step(after_s=0.05) is HandoverState.FAILED
    assert first.handover.reason == f"the vehicle answered {word}"
    assert first.c.control.in_force.number == number  # control never moved
    assert first.c.control.gate.incoming is None
    second = One(way="operator_control", attempt_s=5.0)
    second.step()
    second.answer(0, 32100, OLD)
    second.step(after_s=0.05)
    second.answer(result, 32100, NEW)
    assert second.step(after_s=0.05) is HandoverState.FAILED
    assert second.handover.reason == f"the vehicle answered {word}"
    assert second.c.control.gate.holder == "s1"


def test_a_vehicle_that_does_not_answer_the_old_station_times_out_where_it_was() -> None:
    one = One(way="operator_control", attempt_s=2.0)
    one.step()
    for k in range(1, 40):
        one.c.timeline.now_s = 64.0 + 0.05 * k
        one.c.control.commander.step(one.c.timeline.now_s)
        assert one.step() is HandoverState.REQUESTED
    one.c.timeline.now_s = 66.0
    assert one.step() is HandoverState.TIMED_OUT
    assert one.c.control.gate.holder == "s1"
    one.commands()
    one.c.control.commander.step(69.0)
    assert one.commands() == []


def test_a_second_attempt_asks_anew_from_the_beginning() -> None:
    one = One(way="operator_control", attempt_s=1.0)
    one.step()
    one.answer(0, 32100, OLD)
    one.step(after_s=0.05)
    assert one.step(after_s=1.0) is HandoverState.TIMED_OUT
    one.commands()
    one.c.timeline.now_s += 0.6
    one.prove()
    assert one.step() is HandoverState.REQUESTED
    assert one.c.control.gate.holder == "s1"
    assert asked(one)[0] == "s1"
    one.answer(0, 32100, OLD)
    assert one.step(after_s=0.05) is HandoverState.REQUESTED
    assert one.c.control.gate.holder == "s2"
    assert asked(one)[0] == "s2"


# -- GCS ids by parameter ---------------------------------------------------------------------------------------------


class IdManager:
    """Stands for the one that writes the parameters: which stations the vehicle hears, and which one is to be heard."""

    def __init__(self, *, ranged: bool) -> None:
        self.ranged = ranged
        self.claimed: str | None = None
        self.heard = {"s1"}

    def hears(self, station: str) -> bool:
        return station in self.heard


def by_parameter(*, ranged: bool) -> tuple[One, IdManager]:
    one = One(way="parameter", attempt_s=2.0)
    manager: Any = IdManager(ranged=ranged)
    one.c.control.id_manager = manager
    return one, manager


def test_where_two_can_be_heard_control_moves_once_both_are() -> None:
    one, manager = by_parameter(ranged=True)
    assert one.step() is HandoverState.REQUESTED
    assert (one.c.control.gate.holder, one.c.control.gate.incoming, manager.claimed) == ("s1", "s2", None)
    assert one.step(after_s=0.9) is HandoverState.REQUESTED
    assert one.c.control.gate.holder == "s1"
    manager.heard.add("s2")
    assert one.step(after_s=0.05) is HandoverState.REQUESTED
    assert (one.c.control.gate.holder, one.c.control.gate.incoming) == ("s2", "s1")
    # A repeated setpoint is no evidence here: only an answer shows whom the vehicle hears.
    sent(one, one.c.control.in_force.number, 10.0)
    one.c.vehicle.monitor.target, one.c.vehicle.monitor.target_s = Target(10.0), one.c.timeline.now_s + 0.01
    assert one.step(after_s=0.02) is HandoverState.REQUESTED
    one.answer(mavlink.MAV_RESULT_ACCEPTED, 512, NEW)
    assert one.step() is HandoverState.RELEASED


def test_where_two_can_be_heard_and_the_new_one_never_is_the_old_one_goes_on() -> None:
    one, _ = by_parameter(ranged=True)
    one.step()
    assert one.step(after_s=1.99) is HandoverState.REQUESTED
    assert one.c.control.gate.holder == "s1"
    assert one.step(after_s=0.01) is HandoverState.TIMED_OUT
    assert (one.c.control.gate.holder, one.c.control.gate.incoming) == ("s1", None)


def test_where_one_is_heard_alone_the_new_one_is_claimed_and_tried_after_half_of_the_attempt() -> None:
    one, manager = by_parameter(ranged=False)
    assert one.step() is HandoverState.REQUESTED
    assert (one.c.control.gate.holder, manager.claimed) == ("s1", "s2")
    one.step(after_s=0.99)
    assert (one.c.control.gate.holder, manager.claimed) == ("s1", "s2")
    one.step(after_s=0.01)
    # It speaks for itself now.
    assert (one.c.control.gate.holder, manager.claimed) == ("s2", None)


def test_where_one_is_heard_alone_control_moves_with_the_answer() -> None:
    one, manager = by_parameter(ranged=False)
    one.step()
    manager.heard = {"s2"}
    one.step(after_s=0.05)
    assert (one.c.control.gate.holder, manager.claimed) == ("s2", None)
    # Unanswered, the old one takes it back.
    assert one.step(after_s=1.95) is HandoverState.TIMED_OUT
    assert (one.c.control.gate.holder, manager.claimed) == ("s1", None)


def test_a_neighbour_of_a_dead_link_does_not_wait_for_the_dead_one_to_write() -> None:
    one, manager = by_parameter(ranged=False)
    one.step(at_once="its link is silent")
    assert (one.c.control.gate.holder, manager.claimed) == ("s2", None)


def test_a_vehicle_whose_parameters_are_not_kept_is_moved_at_once() -> None:
    one = One(way="parameter")
    assert one.step() is HandoverState.REQUESTED
    assert (one.c.control.gate.holder, one.c.control.gate.incoming) == ("s2", "s1")
