"""One door, one station at a time, whoever holds which old key."""

from __future__ import annotations

import pytest
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from link.errors import GateClosed
from link.transport.gate import ControlGrant, Sender
from tests.support.gate_messages import STATIONS, command, heartbeat, new_gate, timesync


def test_control_traffic_goes_out_under_the_system_id_of_the_station_in_control() -> None:
    gate = new_gate()
    gate.send(gate.grant("b"), command())
    ((sender, frame),) = gate.take_outgoing()
    assert sender == Sender("b")
    assert frame[5] == 242  # the system id in a MAVLink 2 header
    assert gate.take_outgoing() == []


def test_an_old_grant_opens_nothing_and_says_who_is_in_control() -> None:
    gate = new_gate()
    old = gate.grant("a")
    gate.grant("b")
    with pytest.raises(GateClosed, match=r"COMMAND_LONG under grant 1 of a was not sent: b \(2\) is in control"):
        gate.send(old, command())
    # Not even when its station is in control again: that is another grant.
    gate.grant("a")
    with pytest.raises(GateClosed):
        gate.send(old, command())
    assert gate.take_outgoing() == []
    assert gate.stats.blocked == 2


def test_a_forged_grant_with_the_right_number_and_another_name_is_refused() -> None:
    gate = new_gate()
    gate.grant("a")
    with pytest.raises(GateClosed):
        gate.send(ControlGrant(1, Sender("b")), command())


def test_nobody_in_control_means_silence() -> None:
    gate = new_gate()
    grant = gate.grant("a")
    gate.revoke()
    with pytest.raises(GateClosed, match="nobody is in control"):
        gate.send(grant, command())
    with pytest.raises(GateClosed, match="no grant"):
        gate.send(None, command())
    assert not gate.heartbeat("a", heartbeat())


def test_heartbeats_come_from_the_owner_and_from_whom_control_moves_to() -> None:
    gate = new_gate()
    gate.grant("a")
    assert [gate.heartbeat(s, heartbeat()) for s in STATIONS] == [True, False, False]
    gate.accompany("b")
    assert [gate.heartbeat(s, heartbeat()) for s in STATIONS] == [True, True, False]
    gate.accompany(None)
    assert [gate.heartbeat(s, heartbeat()) for s in STATIONS] == [True, False, False]


def test_the_side_doors_let_nothing_else_through() -> None:
    gate = new_gate()
    gate.grant("a")
    with pytest.raises(GateClosed, match="not a heartbeat"):
        gate.heartbeat("a", command())
    with pytest.raises(GateClosed, match="not a probe"):
        gate.probe("b", command())
    gate.probe("b", timesync())
    assert [sender for sender, _ in gate.take_outgoing()] == [Sender("b")]


def test_unknown_stations_are_an_error_of_the_caller() -> None:
    with pytest.raises(KeyError):
        new_gate().grant("nobody")
    with pytest.raises(KeyError):
        new_gate().accompany("nobody")


class GateMachine(RuleBasedStateMachine):
    """Any order of grants, releases and attempts with any grant ever given out."""

    @initialize()
    def begin(self) -> None:
        self.gate = new_gate()
        self.grants: list[ControlGrant] = []
        self.owner: ControlGrant | None = None
        self.incoming: str | None = None

    @rule(station=st.sampled_from(sorted(STATIONS)))
    def grant(self, station: str) -> None:
        self.owner = self.gate.grant(station)
        assert all(self.owner.number > grant.number for grant in self.grants)
        self.grants.append(self.owner)

    @rule()
    def revoke(self) -> None:
        self.gate.revoke()
        self.owner = self.incoming = None

    @rule(station=st.sampled_from([None, *sorted(STATIONS)]))
    def accompany(self, station: str | None) -> None:
        self.gate.accompany(station)
        self.incoming = station

    @precondition(lambda self: self.grants)
    @rule(data=st.data())
    def send(self, data: st.DataObject) -> None:
        grant = data.draw(st.sampled_from(self.grants))
        try:
            self.gate.send(grant, command())
        except GateClosed:
            assert grant != self.owner
            assert self.gate.take_outgoing() == []
        else:
            assert grant == self.owner
            ((sender, frame),) = self.gate.take_outgoing()
            assert sender == grant.sender
            assert frame[5] == STATIONS[sender.station_id]

    @rule(station=st.sampled_from(sorted(STATIONS)))
    def beat(self, station: str) -> None:
        passed = self.gate.heartbeat(station, heartbeat())
        allowed = self.owner is not None and station in (self.owner.station_id, self.incoming)
        assert passed == allowed
        assert bool(self.gate.take_outgoing()) == allowed

    @invariant()
    def exactly_one_grant_is_admitted(self) -> None:
        admitted = [grant for grant in self.grants if self.gate.admits(grant)]
        assert admitted == ([] if self.owner is None else [self.owner])


TestGateMachine = GateMachine.TestCase
