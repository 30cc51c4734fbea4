"""The command protocol: repeats, confirmation counts, IN_PROGRESS, other people's acks, control that moves on."""

from __future__ import annotations

from typing import Any

import pytest

from link.dialect import mavlink
from link.microservices.command import Commander
from link.transport.gate import TransmitterGate
from link.wire.codec import StationCodec

ARM = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
IDS = {"a": 241, "b": 242}


class Bench:
    """A gate, a commander, and what went out."""

    def __init__(self) -> None:
        self.gate = TransmitterGate({name: StationCodec(number).encode for name, number in IDS.items()})
        self.commander = Commander(self.gate.send, IDS)
        self.grant = self.gate.grant("a")

    def start(self, now_s: float = 0.0, **options: Any) -> Any:
        return self.commander.start(now_s, self.grant, "arm", ARM, (1.0,), target_system=1, **options)

    def sent(self) -> list[Any]:
        decoder = StationCodec(250)
        return [message for _, frame in self.gate.take_outgoing() for message in decoder.decode(frame)]

    def ack(self, now_s: float, result: int, target: int = 241, command: int = ARM) -> Any:
        message = mavlink.MAVLink_command_ack_message(command, result, 0, 0, target, 190)
        return self.commander.on_ack(now_s, message)


def test_a_command_is_repeated_with_a_rising_confirmation_until_it_is_answered() -> None:
    bench = Bench()
    ticket = bench.start()
    for now in (0.2, 0.5, 0.6, 1.0):
        bench.commander.step(now)
    messages = bench.sent()
    assert [m.confirmation for m in messages] == [0, 1, 2]
    assert {(m.command, m.param1, m.target_system, m.target_component) for m in messages} == {(400, 1.0, 1, 1)}
    bench.ack(1.1, mavlink.MAV_RESULT_ACCEPTED)
    assert ticket.finished
    assert ticket.accepted
    bench.commander.step(5.0)
    assert bench.sent() == []


def test_silence_is_given_up_without_a_result() -> None:
    bench = Bench()
    ticket = bench.start(attempts=3)
    for k in range(10):
        bench.commander.step(0.5 * k)
    assert len(bench.sent()) == 3
    assert (ticket.finished, ticket.result, ticket.outcome) == (True, None, "no answer")


def test_in_progress_lengthens_the_wait_and_is_no_answer() -> None:
    bench = Bench()
    ticket = bench.start()
    bench.ack(0.1, mavlink.MAV_RESULT_IN_PROGRESS)
    bench.commander.step(4.0)
    assert len(bench.sent()) == 1
    assert not ticket.finished
    bench.commander.step(5.2)
    assert [m.confirmation for m in bench.sent()] == [1]


@pytest.mark.parametrize(("result", "name"), [(1, "TEMPORARILY_REJECTED"), (2, "DENIED"), (10, "NOT_IN_CONTROL")])
def test_a_refusal_ends_it_in_the_vehicles_words(result: int, name: str) -> None:
    bench = Bench()
    ticket = bench.start()
    bench.ack(0.1, result)
    assert (ticket.finished, ticket.accepted, ticket.outcome) == (True, False, name)


def test_an_ack_for_another_station_or_another_command_is_not_ours() -> None:
    bench = Bench()
    ticket = bench.start()
    assert bench.ack(0.1, 0, target=242) is None
    assert bench.ack(0.1, 0, command=22) is None
    assert not ticket.finished
    # An old peer does not address its acks.
    assert bench.ack(0.1, 0, target=0) is ticket


def test_a_second_ack_of_the_same_command_is_harmless() -> None:
    """PX4 acknowledges DO_SET_MODE twice."""
    bench = Bench()
    first = bench.start()
    bench.ack(0.1, 0)
    second = bench.start(1.0)
    assert bench.ack(1.0, 4) is second
    assert first.accepted
    assert bench.ack(1.1, 0) is None


def test_a_command_of_a_station_that_lost_control_is_not_repeated() -> None:
    bench = Bench()
    ticket = bench.start()
    bench.sent()
    bench.gate.grant("b")
    bench.commander.step(1.0)
    assert bench.sent() == []
    assert (ticket.finished, ticket.outcome) == (True, "control moved on")


def test_the_same_command_again_replaces_the_one_under_way() -> None:
    bench = Bench()
    first, second = bench.start(), bench.start(0.1)
    assert first.outcome == "replaced"
    bench.commander.cancel(second)
    assert second.outcome == "cancelled"
    bench.commander.step(9.0)
    assert len(bench.sent()) == 2
