"""Flight and handover states: what may follow what, whoever asks."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gcs.flight import (
    FLIGHT_TRANSITIONS,
    EventKind,
    FlightEvent,
    FlightState,
    HandoverEvent,
    HandoverState,
    OperatorCommand,
    TransitionError,
    advance,
    handover_step,
)
from gcs.operator_commands import check_operator_command


def reachable(start: FlightState) -> set[FlightState]:
    seen, todo = set(), [start]
    while todo:
        state = todo.pop()
        if state not in seen:
            seen.add(state)
            todo += FLIGHT_TRANSITIONS[state]
    return seen


def test_the_way_of_a_flight_without_incident() -> None:
    state = FlightState.CONNECTING
    for to in ("identifying", "preflight", "ready", "arming", "takeoff", "transit", "cruise", "arrived", "landing"):
        state = advance(state, FlightState(to))
    state = advance(state, FlightState.COMPLETED)
    assert state.ended
    assert state.exit_code == 0


def test_every_state_can_be_reached_and_every_open_one_can_end() -> None:
    assert reachable(FlightState.CONNECTING) == set(FlightState)
    for state in FlightState:
        assert state.ended or any(s.ended for s in reachable(state))


def test_no_flight_that_left_the_ground_is_called_refused_and_no_grounded_one_completed() -> None:
    for state in FlightState:
        if state.airborne:
            assert FlightState.REFUSED not in reachable(state)
        if FlightState.COMPLETED in FLIGHT_TRANSITIONS[state]:
            assert state.airborne


def test_a_lapsed_stream_never_goes_back_to_cruise_directly() -> None:
    """Re-entry is a transit from where the vehicle is, on a person's word."""
    assert FlightState.CRUISE not in FLIGHT_TRANSITIONS[FlightState.LAPSED]
    check_operator_command(OperatorCommand.RESUME, FlightState.LAPSED)


@pytest.mark.parametrize("end", [s for s in FlightState if s.ended])
def test_only_a_flight_completed_or_landed_as_commanded_exits_with_zero(end: FlightState) -> None:
    assert end.exit_code == (0 if end in (FlightState.COMPLETED, FlightState.LANDED) else 4)
    with pytest.raises(TransitionError, match="it has ended"):
        advance(end, FlightState.CRUISE)


def test_a_wrong_step_names_both_states_and_what_is_allowed() -> None:
    with pytest.raises(TransitionError, match=r"ready cannot become cruise; allowed is: arming, preflight, refused"):
        advance(FlightState.READY, FlightState.CRUISE)
    with pytest.raises(TransitionError, match="no result yet"):
        _ = FlightState.CRUISE.exit_code


@pytest.mark.parametrize(
    ("word", "state"),
    [
        (OperatorCommand.LAUNCH, "preflight"),
        (OperatorCommand.LAUNCH, "cruise"),
        (OperatorCommand.RESUME, "cruise"),
        (OperatorCommand.HOLD, "lapsed"),
        (OperatorCommand.LAND, "ready"),
        (OperatorCommand.ABORT, "completed"),
    ],
)
def test_words_out_of_place_are_refused(word: OperatorCommand, state: str) -> None:
    with pytest.raises(TransitionError, match=f"'{word}' needs a flight that is"):
        check_operator_command(word, FlightState(state))


@given(st.lists(st.sampled_from(HandoverEvent), max_size=40))
def test_no_handover_is_released_without_evidence_after_its_last_request(events: list[HandoverEvent]) -> None:
    state, history = HandoverState.PLANNED, []
    for event in events:
        try:
            state = handover_step(state, event)
        except TransitionError:
            continue
        history.append(event)
    if state is HandoverState.RELEASED:
        assert history[-3:] == [HandoverEvent.REQUEST, HandoverEvent.EVIDENCE, HandoverEvent.RELEASE]
        assert HandoverEvent.PROVED in history
    if state is HandoverState.REQUESTED:
        # Asked for on proof that still stood.
        before = [e for e in history if e in (HandoverEvent.PROVED, HandoverEvent.UNPROVED, HandoverEvent.REFUSE)]
        assert before[-1] is HandoverEvent.PROVED


def test_a_refusal_stands_until_it_is_taken_back() -> None:
    state = handover_step(HandoverState.READY, HandoverEvent.REFUSE)
    for event in set(HandoverEvent) - {HandoverEvent.ACCEPT}:
        with pytest.raises(TransitionError, match="allowed is: accept"):
            handover_step(state, event)
    assert handover_step(state, HandoverEvent.ACCEPT) is HandoverState.PLANNED


def test_events_survive_their_document() -> None:
    event = FlightEvent(7, EventKind.GATE, 12.5, None, "2026-11-22T09:00:00Z", FlightState.ARMING, {"fence": 3})
    assert FlightEvent.from_document(event.to_document()) == event
    with pytest.raises(ValueError, match="nonsense"):
        FlightEvent.from_document({**event.to_document(), "kind": "nonsense"})
