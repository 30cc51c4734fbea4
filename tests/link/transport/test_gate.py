"""One door, one station at a time, whoever holds which old key; numbers that only rise, counts that are right."""

from __future__ import annotations

import pytest
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from link.errors import GateClosed
from link.transport.gate import ControlGrant, GateStats, Sender, TransmitterGate
from link.wire.codec import StationCodec
from tests.support.link.gate_messages import STATIONS, command, heartbeat, new_gate, timesync


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


def test_fencing_numbers_rise_by_one_with_every_change_of_hands_a_release_included() -> None:
    gate = new_gate()
    assert gate.grant("a").number == 1
    assert gate.grant("a").number == 2
    gate.revoke()
    after = gate.grant("b")
    assert (after.number, after.station_id) == (4, "b")
    assert gate.in_force is after
    assert gate.holder == "b"


def test_nobody_is_in_control_of_a_new_gate_and_nobody_after_a_release() -> None:
    gate = new_gate()
    assert (gate.in_force, gate.holder, gate.incoming) == (None, None, None)
    grant = gate.grant("a")
    gate.accompany("b")
    assert gate.incoming == "b"
    gate.revoke()
    assert (gate.in_force, gate.holder, gate.incoming) == (None, None, None)
    assert not gate.admits(grant)
    assert not gate.admits(None)
    # Not even the station control was being moved to speaks on, and it is not taken up again with the next grant.
    assert [gate.heartbeat(s, heartbeat()) for s in STATIONS] == [False] * 3
    gate.grant("c")
    assert [gate.heartbeat(s, heartbeat()) for s in STATIONS] == [False, False, True]


def test_a_grant_leaves_the_station_that_accompanies_it() -> None:
    gate = new_gate()
    gate.grant("a")
    gate.accompany("b")
    gate.grant("b")
    assert gate.incoming == "b"
    gate.accompany("a")
    assert [gate.heartbeat(s, heartbeat()) for s in STATIONS] == [True, True, False]


def test_what_is_sent_is_given_back_and_kept_in_order() -> None:
    gate = new_gate()
    grant = gate.grant("a")
    frame = gate.send(grant, command())
    gate.heartbeat("a", heartbeat())
    gate.probe("c", timesync())
    outgoing = gate.take_outgoing()
    assert [str(sender) for sender, _ in outgoing] == ["a", "a", "c"]
    assert outgoing[0][1] == frame
    assert [frame[7] for _, frame in outgoing] == [76, 0, 111]  # COMMAND_LONG, HEARTBEAT, TIMESYNC
    assert gate.take_outgoing() == []


def test_frames_are_counted_by_door_and_those_turned_away_apart() -> None:
    gate = new_gate()
    assert gate.stats == GateStats(control=0, heartbeats=0, probes=0, blocked=0)
    grant = gate.grant("a")
    gate.send(grant, command())
    gate.send(grant, command())
    gate.heartbeat("a", heartbeat())
    gate.probe("b", timesync())
    gate.heartbeat("b", heartbeat())
    with pytest.raises(GateClosed):
        gate.send(None, command())
    assert gate.stats == GateStats(control=2, heartbeats=1, probes=1, blocked=2)
    gate.heartbeat("a", heartbeat())
    gate.probe("c", timesync())
    assert gate.stats == GateStats(control=2, heartbeats=2, probes=2, blocked=2)


def test_a_message_at_the_wrong_door_is_an_error_and_not_sent_whoever_holds_control() -> None:
    gate = new_gate()
    gate.grant("a")
    for door in (gate.heartbeat, gate.probe):
        with pytest.raises(GateClosed, match="COMMAND_LONG is not a"):
            door("a", command())
    with pytest.raises(GateClosed, match="TIMESYNC is not a heartbeat"):
        gate.heartbeat("a", timesync())
    with pytest.raises(GateClosed, match="HEARTBEAT is not a probe"):
        gate.probe("a", heartbeat())
    assert gate.take_outgoing() == []
    assert gate.stats == GateStats()


def test_a_sender_reads_back_from_its_text() -> None:
    for sender, text in ((Sender("a"), "a"), (Sender("a", as_vehicle=True), "a!")):
        assert str(sender) == text
        assert Sender.from_text(text) == sender


def test_no_heartbeat_is_sent_of_a_station_whose_link_carries_the_vehicles_own_id() -> None:
    encode = {s: StationCodec(n).encode for s, n in STATIONS.items()}
    gate = TransmitterGate(encode, encode)
    gate.grant("a", as_vehicle=True)
    assert gate.holder == "a"
    gate.accompany("b")
    assert [gate.heartbeat(s, heartbeat()) for s in STATIONS] == [False, True, False]
    gate.probe("a", timesync())
    gate.probe("a", timesync(), as_vehicle=True)
    assert [str(sender) for sender, _ in gate.take_outgoing()] == ["b", "a", "a!"]
    with pytest.raises(KeyError, match="'d!'"):
        gate.grant("d", as_vehicle=True)


def test_the_vehicles_own_id_is_a_voice_of_the_station_in_control_and_of_no_other() -> None:
    own = {s: StationCodec(1, 190).encode for s in STATIONS}
    gate = TransmitterGate({s: StationCodec(n).encode for s, n in STATIONS.items()}, own)
    grant = gate.grant("a")
    gate.send(grant, command(), sender=Sender("a", as_vehicle=True))
    gate.send(grant, command(), sender=Sender("a"))
    # And back again: a grant to the vehicle's own id is one to its station.
    rescue = gate.grant("a", as_vehicle=True)
    gate.send(rescue, command())
    gate.send(rescue, command(), sender=Sender("a"))
    spoken = [(str(sender), frame[5]) for sender, frame in gate.take_outgoing()]
    assert spoken == [("a!", 1), ("a", 241), ("a!", 1), ("a", 241)]
    for sender in (Sender("b"), Sender("b", as_vehicle=True)):
        with pytest.raises(GateClosed, match=f"COMMAND_LONG of {sender} was not sent: a is in control"):
            gate.send(rescue, command(), sender=sender)
    assert gate.take_outgoing() == []
    assert gate.stats == GateStats(control=4, blocked=2)
