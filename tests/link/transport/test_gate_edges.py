"""The gate's smaller promises: numbers that only rise, silence that is complete, counts that are right."""

from __future__ import annotations

import pytest

from link.errors import GateClosed
from link.transport.gate import GateStats, Sender, TransmitterGate
from link.wire.codec import StationCodec
from tests.support.gate_messages import STATIONS, command, heartbeat, new_gate, timesync


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
