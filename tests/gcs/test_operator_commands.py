"""The table of commands and states as those who accept commands read it: effects, refusals in words, limits in time."""

from __future__ import annotations

import pytest

from gcs.flight import FlightState, OperatorCommand, TransitionError
from gcs.operator_commands import (
    EFFECTS,
    OVERTIME_S,
    TRANSIT_OVERTIME_S,
    Effect,
    check_operator_command,
    effect_of,
    overtime_s,
    refusal,
)


@pytest.mark.parametrize("state", FlightState)
@pytest.mark.parametrize("command", OperatorCommand)
def test_each_cell_gives_its_effect_or_is_refused_in_words(command: OperatorCommand, state: FlightState) -> None:
    effect = effect_of(command, state)
    assert effect is EFFECTS[command].get(state, Effect.REFUSED)
    if effect is not Effect.REFUSED:
        assert check_operator_command(command, state) is effect
        return
    with pytest.raises(TransitionError) as refused:
        check_operator_command(command, state)
    assert str(refused.value) == refusal(command, state)
    for allowed in EFFECTS[command]:
        assert allowed.value in str(refused.value)


def test_a_refusal_says_what_is_needed_what_is_and_what_may_be_commanded_instead() -> None:
    assert refusal(OperatorCommand.LAUNCH, FlightState.LAPSED) == (
        "'launch' needs a flight that is ready; this one is lapsed: nothing is streamed to it; 'resume', 'land' or"
        " 'abort' is what it takes"
    )
    # Nothing instead of it: the sentence ends there.
    assert refusal(OperatorCommand.LAUNCH, FlightState.CRUISE) == (
        "'launch' needs a flight that is ready; this one is cruise"
    )


def test_a_way_may_take_four_times_its_time_and_a_grace() -> None:
    assert overtime_s(100.0) == 400.0 + OVERTIME_S == 1000.0
    assert overtime_s(100.0, TRANSIT_OVERTIME_S) == 460.0
    assert overtime_s(0.0, 5.0) == 5.0
